"""Read Nastran decks with pyNastran: the whole deck, with case control and cross references."""

import json
import re
import sys
from pathlib import Path

import numpy as np
from pyNastran.bdf.bdf import read_bdf
from pyNastran.bdf.mesh_utils.loads import sum_forces_moments

NODES = {"CTETRA": {4: "tet4", 10: "tet10"}, "CHEXA": {8: "hex8", 20: "hex20"}}
NODES["CPENTA"] = {6: "wed6"}
RING = ((0, 1), (1, 2), (2, 3), (3, 0))
EDGES = {
    "tet10": ((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)),
    "hex20": (*RING, *((a, a + 4) for a in range(4)), *((a + 4, b + 4) for a, b in RING)),
}
"""As the Quick Reference Guide draws G5 and G9 onwards."""


def looked_at(path):
    text = Path(path).read_text("ascii")
    whole = "no material is given" not in text
    model = read_bdf(path, xref=whole, punch=False, debug=None)
    if not whole:
        model.cross_reference(xref_materials=False, xref_properties=False)
    place = {number: node.xyz for number, node in model.nodes.items()}
    elements, off, volume = {}, 0.0, 0.0
    for element in model.elements.values():
        shape = NODES[element.type][len(element.node_ids)]
        x = np.array([place[number] for number in element.node_ids])
        if shape in EDGES:
            corners = len(x) - len(EDGES[shape])
            middle = np.array([(x[a] + x[b]) / 2 for a, b in EDGES[shape]])
            off = max(off, float(np.abs(middle - x[corners:]).max()))
        elements[shape] = elements.get(shape, 0) + 1
        volume += element.Volume()
    return {
        "nodes": len(place),
        "points": [place[number].tolist() for number in sorted(place)],
        "elements": elements,
        "volume": volume,
        "off_middle": off,
        "sol": model.sol,
        "properties": {
            n: [e.Pid() for e in model.elements.values()].count(n) for n in model.properties
        },
        "materials": {
            n: [m.e, m.nu, m.rho] for n, m in model.materials.items() if m.type == "MAT1"
        },
        **named_sets(model, text),
        **steps(model, whole),
    }


def named_sets(model, text):
    """Return the sizes of sets by the names that comments give to their numbers."""
    control = model.case_control_deck.subcases[0] if model.case_control_deck else None
    found = {"node_sets": {}, "cell_sets": {}, "face_sets": {}}
    for kind, name, number in re.findall(r"^\$ (nodes|cells) (\S+): set (\d+)$", text, re.M):
        members = control.params[f"SET {number}"][0]
        found["node_sets" if kind == "nodes" else "cell_sets"][name] = len(set(members))
    for name, number in re.findall(r"^\$ faces (\S+): load set (\d+)$", text, re.M):
        found["face_sets"][name] = len(model.loads[int(number)])
    return found


def steps(model, whole):
    """Return what each step holds, and the sum of the forces that it presses with."""
    if not whole:
        return {}
    result = []
    for number, case in sorted(model.case_control_deck.subcases.items()):
        step = {"held": 0, "force": [0.0, 0.0, 0.0]}
        if number == 0:
            continue
        if "SPC" in case.params:
            cards = model.spcs[case["SPC"][0]]
            step["held"] = len({n for card in cards for n in card.node_ids})
        if "LOAD" in case.params:
            force, _ = sum_forces_moments(model, np.zeros(3), case["LOAD"][0])
            step["force"] = force.tolist()
        result.append(step)
    return {"steps": result, "methods": {n: card.nd for n, card in model.methods.items()}}


results = [looked_at(path) for path in sys.argv[1:]]
json.dump(results[0] if len(results) == 1 else results, sys.stdout)
