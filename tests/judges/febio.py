"""Read FEBio models with pyfebio, whose schema refuses what FEBio 4.0 does not know."""

import json
import sys
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
from pyfebio import boundary, loads
from pyfebio.control import Control, SolidSolver
from pyfebio.model import Model

BOUNDARY = (boundary.BCZeroDisplacement, boundary.BCPrescribedDisplacement)
CORNERS = {"tet4": 4, "tet10": 4, "hex8": 8, "hex20": 8, "penta6": 6}
FACES = {
    4: ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)),
    6: ((0, 2, 1), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)),
    8: ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)),
}
EDGES = {
    "tet10": ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)),
    "hex20": (
        *((0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4)),
        *((0, 4), (1, 5), (2, 6), (3, 7)),
    ),
    "tri6": ((0, 1), (1, 2), (2, 0)),
    "quad8": ((0, 1), (1, 2), (2, 3), (3, 0)),
}


def taken(root, name):
    """Take a section out: pyfebio makes its numbers of Python's, but reads none from text."""
    section = root.find(name)
    if section is None:
        return ET.Element(name)
    root.remove(section)
    return section


def number(text):
    return int(text) if text.strip().isdigit() else text.strip()


def given(element):
    found = dict(element.attrib)
    for child in element:
        assert child.tag not in found
        found[child.tag] = given(child) if len(child) or child.attrib else number(child.text)
    if element.text and element.text.strip():
        found["text"] = number(element.text)
    return found


def checked(kind, element):
    """Return an element as the schema has it, or fail where it knows no such thing."""
    found = given(element)
    assert set(found) <= set(kind.model_fields), (set(found), kind)
    assert set(found.get("solver", ())) <= set(SolidSolver.model_fields)
    return kind(**found)


def row(text):
    return [int(word) for word in text.split(",")]


def volume(x):
    centre, total = x.mean(axis=0), 0.0
    for face in FACES[len(x)]:
        mean = x[list(face)].mean(axis=0)
        for a, b in zip(face, (*face[1:], face[0]), strict=True):
            total += np.linalg.det([x[a] - centre, x[b] - centre, mean - centre]) / 6
    return total


def off(x, kind):
    """Return how far nodes lie from the middle of the edges they are for."""
    edges = EDGES.get(kind, ())
    middle = [(x[a] + x[b]) / 2 for a, b in edges]
    return float(np.abs(np.array(middle) - x[len(x) - len(edges) :]).max()) if edges else 0.0


def area(x):
    """Return the area vector of a face from its corners."""
    mean = x.mean(axis=0)
    pairs = zip(x, np.roll(x, -1, axis=0), strict=True)
    return sum(np.cross(a - mean, b - mean) for a, b in pairs) / 2


def looked_at(path):
    root = ET.fromstring(Path(path).read_text("ascii"))
    units = root.find("Module/units")
    root.find("Module").remove(units)  # FEBio passes over it; the schema lacks it
    step = {name: taken(root, name) for name in ("Control", "Loads", "Boundary")}
    model = Model.from_xml(ET.tostring(root))
    kinds = {kind.model_fields["type"].default: kind for kind in BOUNDARY}
    mesh = model.mesh_
    place = {
        node.id: [float(word) for word in node.text.split(",")]
        for some in mesh.nodes
        for node in some.all_nodes
    }
    elements, total, away, domains = {}, 0.0, 0.0, {}
    for some in mesh.elements:
        shape = "wed6" if some.type == "penta6" else some.type
        elements[shape] = elements.get(shape, 0) + len(some.all_elements)
        domains[some.name] = [e.id for e in some.all_elements]
        for element in some.all_elements:
            x = np.array([place[number] for number in row(element.text)])
            total += volume(x[: CORNERS[some.type]])
            away = max(away, off(x, some.type))
    surfaces, vectors = {}, {}
    for surface in mesh.surfaces:
        found = {
            kind: [
                np.array([place[n] for n in row(f.text)]) for f in getattr(surface, f"all_{kind}")
            ]
            for kind in ("tri3", "tri6", "quad4", "quad8")
        }
        away = max([away, *(off(x, kind) for kind, some in found.items() for x in some)])
        surfaces[surface.name] = sum(map(len, found.values()))
        vectors[surface.name] = sum(
            area(x[: 3 if kind.startswith("tri") else 4])
            for kind, some in found.items()
            for x in some
        ).tolist()
    return {
        "units": units.text,
        "nodes": len(place),
        "points": [place[number] for number in sorted(place)],
        "elements": elements,
        "volume": total,
        "off_middle": away,
        "node_sets": {some.name: len(row(some.text)) for some in mesh.node_sets},
        "cell_sets": {some.name: len(row(some.text)) for some in mesh.element_sets},
        "face_sets": surfaces,
        "areas": vectors,
        "domains": {some.name: some.mat for some in model.meshdomains_.solid_domains},
        "cells": domains,
        "materials": {
            some.name: [some.E.text, some.v.text, some.density and some.density.text]
            for some in model.material_.all_materials
        },
        **done(step, kinds),
        "curve": [c.points.points for c in model.loaddata_.load_controllers],
    }


def done(step, kinds):
    """Return what the step is, holds and presses with; nothing where there is none."""
    held = [checked(kinds[bc.get("type")], bc) for bc in step["Boundary"]]
    pressed = [checked(loads.PressureLoad, load) for load in step["Loads"]]
    control = checked(Control, step["Control"]) if len(step["Control"]) else None
    return {
        "control": control and [control.analysis, control.time_steps, control.step_size],
        "held": [[bc.type, bc.node_set, *shown(bc)] for bc in held],
        "pressed": [[p.surface, p.linear, p.pressure.lc, p.pressure.text] for p in pressed],
    }


def shown(bc):
    if bc.type == "zero displacement":
        return [bc.x_dof, bc.y_dof, bc.z_dof]
    return [bc.dof, bc.value.lc, bc.value.text]


results = [looked_at(path) for path in sys.argv[1:]]
json.dump(results[0] if len(results) == 1 else results, sys.stdout)
