"""OpenFOAM as a judge of cases: what checkMesh finds in a folder that we wrote."""

import os
import re
from pathlib import Path

from programs import said

PLACE = "/usr/share/openfoam"
NUMBER = r"([-+\d.e]+)"
SHAPES = {"hexahedra": "hex8", "prisms": "wed6", "tetrahedra": "tet4"}


def openfoam(program, folder, *arguments, seconds=60.0):
    """Run a program of OpenFOAM on a case, and return what it printed."""
    place = {"WM_PROJECT_DIR": os.environ.get("WM_PROJECT_DIR", PLACE)}
    command = [program, "-case", Path(folder).resolve(), *arguments]
    return "".join(said(command, seconds=seconds, environment=place))


def check_mesh(program, folder, *, thorough=True):
    """Return what ``checkMesh -allGeometry -allTopology`` finds, or without these options.

    A dictionary: ``ok`` (whether it says "Mesh OK"), ``nodes``, ``elements`` by shape, ``volume``
    in m³, ``regions``, ``non_orthogonality`` in degrees, ``patches`` (faces of each),
    ``face_sets``, ``cell_sets`` and ``node_sets`` (members of each zone), and ``said``: all that
    it printed.
    """
    options = ("-allGeometry", "-allTopology") if thorough else ()
    log = openfoam(program, folder, *options, "-constant")
    count = dict(re.findall(r"^    (\w[\w ]*): +(\d+)$", log, re.M))
    kinds = {shape: int(count[name]) for name, shape in SHAPES.items() if int(count[name])}
    others = sum(int(count[name]) for name in ("wedges", "pyramids", "tet wedges", "polyhedra"))
    return {
        "ok": "\nMesh OK." in log,
        "nodes": int(count["points"]),
        "elements": kinds | ({"others": others} if others else {}),
        "volume": after(log, rf"Total volume = {NUMBER}\.  Cell"),
        "regions": after(log, r"Number of regions: (\d+)"),
        "non_orthogonality": after(log, rf"non-orthogonality Max: {NUMBER}"),
        "patches": patches(folder),
        "face_sets": zones(folder, "face"),
        "cell_sets": zones(folder, "cell"),
        "node_sets": zones(folder, "point"),
        "said": log,
    }


def after(log, pattern):
    """Return the number that follows a phrase; NaN where it was not said."""
    found = re.search(pattern, log)
    return float(found[1]) if found else float("nan")


def patches(folder):
    """Return how many faces each patch has."""
    text = (Path(folder) / "constant" / "polyMesh" / "boundary").read_text()
    return {name: int(n) for name, n in re.findall(r"(\S+)\s*\{[^}]*?nFaces\s+(\d+);", text)}


def zones(folder, kind):
    """Return how many members each zone of a kind has: cell, face or point."""
    path = Path(folder) / "constant" / "polyMesh" / f"{kind}Zones"
    text = path.read_text() if path.exists() else ""
    found = re.findall(rf"^(\S+)\n\{{\n    type {kind}Zone;\n[^\n]*List<label>\n(\d+)$", text, re.M)
    return {name: int(n) for name, n in found}
