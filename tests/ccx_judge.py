"""CalculiX as a judge of decks: what it counts in sets, and what volumes and areas it finds."""

import re

import meshio
import numpy as np
from programs import said

SHAPES = {"tetra": "tet4", "tetra10": "tet10", "wedge": "wed6"}
SHAPES |= {"hexahedron": "hex8", "hexahedron20": "hex20"}
BARE = """*MATERIAL, NAME=JUDGE
*ELASTIC
1., 0.
*SOLID SECTION, ELSET={every}, MATERIAL=JUDGE
*STEP
*STATIC
*BOUNDARY
{held}, 1, 3
*END STEP
"""
"""What a deck without a step needs to be run."""
PRINTS = {
    "NSET": "*NODE PRINT, NSET={}\nU\n",
    "ELSET": "*EL PRINT, ELSET={}\nEVOL\n",
    "SURFACE": "*SECTION PRINT, SURFACE={0}, NAME=P{0}\nSOAREA\n",
}
HEAD = re.compile(r"^ (.+?) for (?:surface )?set (\S+) and time .*$", re.MULTILINE)
AREA = re.compile(r"^ +area, normal.*\n\s*\n +(\S+)", re.MULTILINE)


def check_deck(program, path, *, every, held):
    """Return what CalculiX finds in a deck as it stands, but that it prints every set.

    ``every`` and ``held`` name a set of all elements, and one of nodes that are held where the
    deck itself has no step. A dictionary as judges of meshes give it; of a surface also its area,
    in ``areas``.
    """
    text = path.read_text("ascii")
    names = dict.fromkeys(re.findall(r"^\*(NSET|ELSET|SURFACE), (?:\w+=)(\w+)", text, re.M))
    names["ELSET", every] = None  # where there is one block, its elements' card says it
    if "*STEP" not in text:
        text += BARE.format(every=every, held=held)
    asked = "".join(PRINTS[kind].format(name) for kind, name in names)
    before, end, after = text.rpartition("*END STEP")
    judged = path.with_name(f"{path.stem}-judged.inp")
    judged.write_text(before + asked + end + after, "ascii")
    log, _ = said([program, "-i", judged.stem], path.parent)
    assert "*ERROR" not in log, log[-2000:]
    return counted(path) | printed(judged.with_suffix(".dat").read_text(), names, every)


def counted(path):
    """Return the nodes, and the elements by shape, that meshio reads, which knows no surfaces."""
    plain = path.with_name(f"{path.stem}-plain.inp")
    plain.write_text(re.sub(r"\*SURFACE[^*]*", "", path.read_text("ascii")), "ascii")
    mesh = meshio.read(plain)
    elements = {}
    for block in mesh.cells:
        shape = SHAPES[block.type]
        elements[shape] = elements.get(shape, 0) + len(block.data)
    return {"nodes": len(mesh.points), "elements": elements}


def printed(text, names, every):
    """Return the sizes of sets and the areas of surfaces that a solver's results tell."""
    heads = list(HEAD.finditer(text))
    ends = [head.start() for head in heads[1:]] + [len(text)]
    rows, areas = {}, {}
    for head, end in zip(heads, ends, strict=True):
        what, name = head.groups()
        block = text[head.end() : end]
        if what.startswith("statistics"):
            areas[name] = float(AREA.search(block)[1])
        elif not what.startswith("total"):
            rows[name] = np.array([line.split() for line in block.splitlines() if line], float)
    sizes = {
        kind: {n: len(set(rows[n][:, 0].tolist())) for k, n in names if k == kind}
        for kind in ("NSET", "ELSET")
    }
    return {
        "node_sets": sizes["NSET"],
        "cell_sets": sizes["ELSET"],
        "areas": areas,
        "volume": float(rows[every][:, 1].sum()),
    }
