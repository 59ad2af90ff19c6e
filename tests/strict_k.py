"""A strict reader of LS-DYNA decks, for no program is there to judge them.

Written from the LS-DYNA Keyword User's Manual, volume I (R13): fields of fixed width, eight
columns for numbers in ``*NODE`` and ``*ELEMENT_SOLID``, sixteen for coordinates, ten elsewhere;
lines of at most 80 columns; ``$`` begins a comment. What it does not know, and whatever refers to
what is not there, it refuses.
"""

import re
from itertools import pairwise

import numpy as np

CARDS = {
    "PART": None,
    "SECTION_SOLID": "iii",
    "MAT_ELASTIC": "iffffff",
    "MAT_THERMAL_ISOTROPIC": None,
    "BOUNDARY_SPC_SET": "iiiiiiii",
    "BOUNDARY_PRESCRIBED_MOTION_SET": "iiiififf",
    "LOAD_SEGMENT_SET": "iiff",
    "CONTROL_TERMINATION": "fifff",
    "CONTROL_IMPLICIT_GENERAL": "ifiiiii",
    "CONTROL_IMPLICIT_SOLUTION": "iiffffff",
    "CONTROL_IMPLICIT_SOLVER": "iiiiiii",
    "CONTROL_IMPLICIT_EIGENVALUE": "ififif",
    "DATABASE_BINARY_D3PLOT": "ff",
    "DATABASE_SPCFORC": "fiii",
    "DATABASE_GLSTAT": "fiii",
}
"""Cards of fields ten columns wide: whole numbers and others."""
SETS = {"SET_NODE_LIST": "node_sets", "SET_SOLID": "cell_sets", "SET_SEGMENT": "face_sets"}
ELFORMS = {
    "tet4": (10, 13),
    "tet10": (16, 17),
    "hex8": (-2, -1, 1, 2),
    "wed6": (15, 1, 2),
    "hex20": (23,),
}
"""Element formulations of ``*SECTION_SOLID`` that suit each shape."""


class Deck:
    """What a deck says, and that it is right."""

    def __init__(self, text):
        assert text.isascii()
        self.nodes, self.elements, self.parts = {}, {}, {}
        self.ids = {"SECTION_SOLID": {}, "MAT_ELASTIC": {}, "DEFINE_CURVE": {}}
        self.sets = {kind: {} for kind in SETS.values()}
        self.titles = {}
        self.cards = []
        lines = text.splitlines()
        assert all(len(line) <= 80 for line in lines), max(lines, key=len)
        blocks, keyword = [], None
        for line in lines:
            if line.startswith("$"):
                continue
            if line.startswith("*"):
                keyword = line.strip()[1:]
                assert re.fullmatch(r"[A-Z0-9_]+", keyword), line
                blocks.append((keyword, []))
            else:
                assert keyword, line
                blocks[-1][1].append(line)
        assert blocks[0][0] == "KEYWORD"
        assert blocks[-1] == ("END", [])
        assert sum(name == "END" for name, _ in blocks) == 1
        for name, body in blocks[1:-1]:
            self.take(name, body)
        self.check()

    def take(self, name, body):  # noqa: C901
        if name == "TITLE":
            assert len(body) == 1
        elif name == "NODE":
            for line in body:
                number, *place = split(line, [8, 16, 16, 16], "ifff")
                assert number > 0
                assert number not in self.nodes
                self.nodes[number] = place
        elif name in ("ELEMENT_SOLID", "ELEMENT_SOLID_H20"):
            self.solids(name, body)
        elif name.removesuffix("_TITLE") in SETS:
            self.group(name, body)
        elif name == "DEFINE_CURVE":
            number = split(body[0], [10] * 7, "iiffffi")[0]
            points = [split(line, [20, 20], "ff") for line in body[1:]]
            assert len(points) >= 2
            assert all(a[0] < b[0] for a, b in pairwise(points))
            self.once("DEFINE_CURVE", number, points)
        elif name == "PART":
            assert len(body) % 2 == 0
            for title, line in zip(body[::2], body[1::2], strict=True):
                number, section, material, *_ = split(line, [10] * 8, "iiiiiiii")
                assert number not in self.parts
                self.parts[number] = (title.strip(), section, material)
        else:
            assert name in CARDS, f"unknown keyword *{name}"
            fields = CARDS[name]
            rows = [split(line, [10] * 8, fields) for line in body]
            assert rows, name
            if name in self.ids:
                for row in rows:
                    self.once(name, row[0], row)
            self.cards += [(name, row) for row in rows]

    def once(self, kind, number, content):
        assert number not in self.ids[kind]
        self.ids[kind][number] = content

    def solids(self, name, body):
        rows, index = [], 0
        while index < len(body):
            whole = [field for field in cut(body[index], [8] * 10) if field]
            if name == "ELEMENT_SOLID" and len(whole) == 10:
                number, part, *nodes = map(int, whole)
                rows.append((number, part, nodes))
                index += 1
                continue
            assert len(whole) == 2, body[index]
            lines = 2 if name.endswith("H20") else 1
            nodes = []
            for line in body[index + 1 : index + 1 + lines]:
                more = [int(field) for field in cut(line, [8] * 10) if field]
                assert len(more) == 10
                nodes += more
            rows.append((int(whole[0]), int(whole[1]), nodes))
            index += 1 + lines
        for number, part, nodes in rows:
            assert number > 0
            assert number not in self.elements
            self.elements[number] = (part, *shaped(nodes))

    def group(self, name, body):
        base = name.removesuffix("_TITLE")
        title = body.pop(0).strip() if name != base else ""
        number = split(body[0], [10] * 5, "iffff")[0]
        width = 4 if base == "SET_SEGMENT" else 8
        rows = [cut(line, [10] * 8)[:width] for line in body[1:]]
        rows = [[int(field) for field in row if field] for row in rows]
        kind = SETS[base]
        assert number not in self.sets[kind]
        self.titles[kind, number] = title
        if base == "SET_SEGMENT":
            assert all(len(row) == 4 for row in rows)
            self.sets[kind][number] = [tuple(dict.fromkeys(row)) for row in rows]
        else:
            assert all(len(row) == 8 for row in rows[:-1])
            self.sets[kind][number] = [member for row in rows for member in row if member]

    def check(self):  # noqa: C901
        used = set()
        for part, shape, nodes in self.elements.values():
            assert part in self.parts
            elform = self.ids["SECTION_SOLID"][self.parts[part][1]][1]
            assert elform in ELFORMS[shape], (shape, elform)
            assert len(set(nodes)) == len(nodes)
            used |= set(nodes)
        assert used <= set(self.nodes)
        materials = self.ids["MAT_ELASTIC"] or {0: None}  # a mesh alone: the user adds them
        for _, section, material in self.parts.values():
            assert section in self.ids["SECTION_SOLID"]
            assert material in materials
        for members in self.sets["node_sets"].values():
            assert set(members) <= set(self.nodes)
            assert len(set(members)) == len(members)
        for members in self.sets["cell_sets"].values():
            assert set(members) <= set(self.elements)
        self.check_segments()
        for name, row in self.cards:
            if name == "BOUNDARY_SPC_SET":
                assert row[0] in self.sets["node_sets"]
                assert set(row[2:5]) <= {0, 1}
                assert any(row[2:5])
            if name == "BOUNDARY_PRESCRIBED_MOTION_SET":
                assert row[0] in self.sets["node_sets"]
                assert 1 <= row[1] <= 7  # translations, rotations with 8; 4 and 8 need a vector
                assert row[2] in (0, 1, 2)  # velocity, acceleration, displacement
                assert row[3] in self.ids["DEFINE_CURVE"]
            if name == "LOAD_SEGMENT_SET":
                assert row[0] in self.sets["face_sets"]
                assert row[1] in self.ids["DEFINE_CURVE"]
        for row in self.ids["MAT_ELASTIC"].values():
            assert row[2] > 0
            assert -1 < row[3] < 0.5

    def check_segments(self):
        faces = {}
        for _, shape, nodes in self.elements.values():
            for face in FACES[shape]:
                key = frozenset(nodes[i] for i in face)
                faces[key] = faces.get(key, 0) + 1
        for members in self.sets["face_sets"].values():
            for segment in members:
                assert len(segment) in (3, 4)
                assert frozenset(segment) in faces

    def told(self):
        """Return what every judge tells of a mesh."""
        shapes = [shape for _, shape, _ in self.elements.values()]
        told = {
            kind: {self.titles[kind, n] or str(n): len(rows) for n, rows in found.items()}
            for kind, found in self.sets.items()
        }
        return {
            "nodes": len(self.nodes),
            "elements": {shape: shapes.count(shape) for shape in dict.fromkeys(shapes)},
            "volume": sum(self.volume(*element[1:]) for element in self.elements.values()),
            "parts": [title for title, _, _ in self.parts.values()],
            "cards": [name for name, _ in self.cards],
            **told,
        }

    def volume(self, shape, nodes):
        corners = np.array([self.nodes[n] for n in nodes])
        centre = corners[: CORNERS[shape]].mean(axis=0)
        total = 0.0
        for face in FACES[shape]:
            p = corners[list(face)]
            mean = p.mean(axis=0)
            for a, b in zip(p, np.roll(p, -1, axis=0), strict=True):
                part = np.dot(np.cross(a - centre, b - centre), mean - centre) / 6
                total += part
        assert total > 0, (shape, nodes)
        return total


FACES = {
    "tet4": ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)),
    "hex8": ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)),
    # the manual's pentahedron: N1 N2 N3 N4 are a face of four, N5 over N1 N2, N6 over N4 N3
    "wed6": ((0, 3, 2, 1), (0, 1, 4), (3, 5, 2), (1, 2, 5, 4), (0, 4, 5, 3)),
}
FACES["tet10"], FACES["hex20"] = FACES["tet4"], FACES["hex8"]
CORNERS = {"tet4": 4, "tet10": 4, "hex8": 8, "hex20": 8, "wed6": 6}


def shaped(nodes):
    """Return shape and distinct nodes of a solid: shapes of fewer nodes repeat some."""
    if len(nodes) == 20:
        return "hex20", nodes
    if len(nodes) == 10:
        return "tet10", nodes
    assert len(nodes) == 8
    if len(set(nodes)) == 8:
        return "hex8", nodes
    if nodes[4] == nodes[3] and len(set(nodes[3:])) == 1:
        return "tet4", nodes[:4]
    assert nodes[4] == nodes[5] and nodes[6] == nodes[7], nodes  # noqa: PT018
    return "wed6", [*nodes[:4], nodes[4], nodes[6]]


def cut(line, widths):
    """Return the fields of a line, stripped."""
    assert "," not in line
    assert "\t" not in line
    fields, at = [], 0
    for width in widths:
        fields.append(line[at : at + width].strip())
        at += width
    assert not line[at:].strip(), line
    for field in fields:
        assert " " not in field, f"two numbers in one field: {line!r}"
    return fields


def split(line, widths, kinds):
    """Return the numbers of a line; blank fields are zero."""
    fields = cut(line, widths)
    kinds = kinds or "f" * len(widths)
    assert not any(fields[len(kinds) :]), line
    return [
        (int(field) if kind == "i" else float(field)) if field else 0
        for field, kind in zip(fields, kinds, strict=False)
    ]


def read(path):
    """Return what a deck holds, or fail where it is not as the manual has it."""
    return Deck(path.read_bytes().decode("ascii")).told()
