"""Read Ansys archives with mapdl_archive; volumes by fans, of bricks whose nodes may coincide."""

import json
import sys

import mapdl_archive
import numpy as np

BRICK = ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7))
BRICK_EDGES = ((0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4))
BRICK_EDGES += ((0, 4), (1, 5), (2, 6), (3, 7))
TETRAHEDRON_EDGES = ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3))
SHAPES = {
    285: "tet4",
    185: "hex8",
    187: "tet10",
    186: "hex20",
    70: "hex8",
    87: "tet10",
    90: "hex20",
}


def brick(corners):
    centre, total = corners.mean(axis=0), 0.0
    for face in BRICK:
        mean = corners[list(face)].mean(axis=0)
        for a, b in zip(face, (*face[1:], face[0]), strict=True):
            total += np.linalg.det([corners[a] - centre, corners[b] - centre, mean - centre]) / 6
    return total


def looked_at(path):
    archive = mapdl_archive.Archive(path, parse_vtk=False)
    place = dict(zip(archive.nnum.tolist(), archive.nodes, strict=True))
    types = dict(archive.ekey.tolist())
    elements, volume, off, materials = {}, 0.0, 0.0, {}
    for element in archive.elem:
        nodes = [number for number in element[10:].tolist() if number > 0]
        shape = SHAPES[types[int(element[1])]]
        if shape == "hex8" and len(set(nodes)) < 8:
            shape = {6: "wed6", 4: "tet4"}[len(set(nodes))]
        x = np.array([place[number] for number in nodes])
        if shape in ("tet10", "hex20"):
            edges = TETRAHEDRON_EDGES if shape == "tet10" else BRICK_EDGES
            corners = 4 if shape == "tet10" else 8
            middle = np.array([(x[a] + x[b]) / 2 for a, b in edges])
            off = max(off, float(np.abs(middle - x[corners:]).max()))
        flat = shape.startswith("tet") and len(nodes) != 8
        volume += np.linalg.det(x[1:4] - x[0]) / 6 if flat else brick(x[:8])
        elements[shape] = elements.get(shape, 0) + 1
        materials[int(element[0])] = materials.get(int(element[0]), 0) + 1
    return {
        "nodes": len(archive.nnum),
        "numbers": archive.enum.tolist() == list(range(1, len(archive.enum) + 1)),
        "points": archive.nodes.tolist(),
        "elements": elements,
        "materials": materials,
        "volume": volume,
        "off_middle": off,
        "node_sets": {name: len(some) for name, some in archive.node_components.items()},
        "cell_sets": {name: len(some) for name, some in archive.element_components.items()},
    }


results = [looked_at(path) for path in sys.argv[1:]]
json.dump(results[0] if len(results) == 1 else results, sys.stdout)
