"""A strict reader of SU2 meshes, for no program is there to judge them.

Written from SU2's documentation of its native mesh format: ``NDIME=``, ``NELEM=``, ``NPOIN=`` and
``NMARK=`` with their tables; elements by VTK's numbers, nodes from 0, ``%`` begins a comment. Every
boundary face must be in one marker, for the solver needs a condition on each.
"""

import numpy as np

KINDS = {10: ("tet4", 4), 12: ("hex8", 8), 13: ("wed6", 6)}
FACE_NODES = {5: 3, 9: 4}
FACES = {
    "tet4": ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)),
    "hex8": ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)),
    # VTK's wedge: the first triangle (0, 1, 2) is seen counter-clockwise from outside
    "wed6": ((0, 1, 2), (3, 5, 4), (0, 3, 4, 1), (1, 4, 5, 2), (2, 5, 3, 0)),
}


def read(path):
    """Return what a mesh holds, or fail where it is not as the format has it."""
    lines = [
        line.partition("%")[0].strip() for line in path.read_bytes().decode("ascii").split("\n")
    ]
    lines = [line for line in lines if line]
    place = 0

    def keyed(key):
        nonlocal place
        name, equals, value = lines[place].partition("=")
        assert (name.strip(), equals) == (key, "="), lines[place]
        place += 1
        return value.strip()

    def rows(count):
        nonlocal place
        found = lines[place : place + count]
        assert len(found) == count
        place += count
        return [line.split() for line in found]

    assert keyed("NDIME") == "3"
    cells = []
    for index, row in enumerate(rows(int(keyed("NELEM")))):
        shape, count = KINDS[int(row[0])]
        assert len(row) in (1 + count, 2 + count), row
        assert len(row) == 1 + count or int(row[-1]) == index
        cells.append((shape, [int(word) for word in row[1 : 1 + count]]))
    count = keyed("NPOIN").split()
    assert len(count) == 1
    points = []
    for index, row in enumerate(rows(int(count[0]))):
        assert len(row) in (3, 4)
        assert len(row) == 3 or int(row[3]) == index
        points.append([float(word) for word in row[:3]])
    points = np.array(points)
    markers = {}
    for _ in range(int(keyed("NMARK"))):
        name = keyed("MARKER_TAG")
        assert name
        assert not set(name) & set(" \t(),="), name
        assert name not in markers
        found = rows(int(keyed("MARKER_ELEMS")))
        assert found, f"marker {name} is empty"
        for row in found:
            assert len(row) == 1 + FACE_NODES[int(row[0])], row
        markers[name] = [tuple(int(word) for word in row[1:]) for row in found]
    assert place == len(lines), lines[place]
    check_faces(cells, markers)
    used = {node for _, nodes in cells for node in nodes}
    assert used == set(range(len(points)))
    shapes = [shape for shape, _ in cells]
    return {
        "nodes": len(points),
        "elements": {shape: shapes.count(shape) for shape in dict.fromkeys(shapes)},
        "volume": sum(volume(points, shape, nodes) for shape, nodes in cells),
        "face_sets": {name: len(faces) for name, faces in markers.items()},
    }


def check_faces(cells, markers):
    """Fail where a marker's face is no boundary face, or a boundary face is not in one marker."""
    sides = {}
    for shape, nodes in cells:
        for face in FACES[shape]:
            key = frozenset(nodes[i] for i in face)
            sides[key] = sides.get(key, 0) + 1
    assert max(sides.values()) <= 2
    boundary = {key for key, count in sides.items() if count == 1}
    marked = [frozenset(face) for faces in markers.values() for face in faces]
    assert len(marked) == len(set(marked))
    assert set(marked) == boundary


def volume(points, shape, nodes):
    corners = points[nodes]
    centre = corners.mean(axis=0)
    total = 0.0
    for face in FACES[shape]:
        p = corners[list(face)]
        mean = p.mean(axis=0)
        for a, b in zip(p, np.roll(p, -1, axis=0), strict=True):
            total += np.dot(np.cross(a - centre, b - centre), mean - centre) / 6
    assert total > 0, (shape, nodes)
    return total
