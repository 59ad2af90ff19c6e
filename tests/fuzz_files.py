"""Files that no one wrote: mutants of good ones, and sentences of each format's own grammar."""

import io
import re
import struct
import zipfile

import numpy as np
import test_hostile_frd
from hypothesis import strategies as st
from test_hostile import HEX

# --- mutants -----------------------------------------------------------------------------------

NUMBERS = ("", "0", "1", "3", "-1", "0.5", "nan", "-inf", "1e12", "1e400", "-1e308", "1_0", "x")
NUMBERS += ("9" * 40, *(str(2**power) for power in (16, 31, 32, 53, 63, 64)), str(2**63 - 1))
NUMBERS += tuple(str(-(2**power)) for power in (31, 63))
NUMBER = re.compile(rb"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?")
WORDS = [struct.pack(form, number) for form in "<>" for form in (f"{form}I", f"{form}Q")
         for number in (0, 1, 2**16, 2**31, 2**32 - 1)]  # fmt: skip
WORDS += [struct.pack("<f", value) for value in (np.nan, np.inf, -3e38)] + [b"\xff" * 8, b"\0" * 64]


def _flip(data, place, _other, pick):
    data = bytearray(data)
    data[int(place * len(data))] ^= 1 << pick % 8
    return bytes(data)


def _cut(data, place, _other, _pick):
    return data[: int(place * len(data))]


def _splice(data, place, other, pick):
    return data[: int(place * len(data))] + other[pick * len(other) // 256 :]


def _word(data, place, _other, pick):
    place, word = int(place * len(data)), WORDS[pick % len(WORDS)]
    return data[:place] + word + data[place + len(word) :]


def _number(data, place, _other, pick):
    found = list(NUMBER.finditer(data))
    if not found:
        return data
    one = found[int(place * len(found))]
    return data[: one.start()] + NUMBERS[pick % len(NUMBERS)].encode() + data[one.end() :]


def _lines(data, place, _other, pick):
    lines = data.splitlines(keepends=True)
    at = int(place * len(lines))
    return b"".join([*lines[:at], *lines[at : at + 1] * (pick % 3), *lines[at + 1 :]])


def _erase(data, place, _other, pick):
    place = int(place * len(data))
    return data[:place] + data[place + 1 + pick % 9 :]


def _double(data, place, _other, pick):
    place = int(place * len(data))
    return data[:place] + data[place : place + 1 + pick] * 2 + data[place + 1 + pick :]


WAYS = (_flip, _cut, _splice, _word, _number, _number, _lines, _erase, _double)


@st.composite
def mutants(draw, files):
    """Draw one of the good files, changed in one to four places."""
    data, other = draw(st.sampled_from(files)), draw(st.sampled_from(files))
    steps = st.tuples(st.sampled_from(WAYS), st.floats(0, 0.999), st.integers(0, 255))
    for way, place, pick in draw(st.lists(steps, min_size=1, max_size=4)):
        data = way(data, place, other, pick) or data
    return data


# --- sentences ---------------------------------------------------------------------------------

SMALL = st.sampled_from(["0", "1", "2", "3", "4"])
WORD = SMALL | SMALL | SMALL | SMALL | st.sampled_from(NUMBERS)
"""Mostly numbers that mean something: a file in which nothing does is refused in its first line."""


@st.composite
def filled(draw, text):
    """Draw what stands in the place of each ``@`` of a text."""
    pieces = text.split("@")
    return "".join(piece + word for piece, word in zip(pieces, [
        *(draw(WORD) for _ in pieces[1:]), ""], strict=True))  # fmt: skip


def sentences(head, lines, tail="", *, most=12, end="\n"):
    """Draw texts of any of these lines in any order between a beginning and an end."""
    middle = st.lists(st.sampled_from(lines), max_size=most).map(end.join)
    whole = middle.map(lambda text: f"{head}{end if head else ''}{text}{end}{tail}")
    return whole.flatmap(filled).map(str.encode)


TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1"
OBJ = sentences(
    TETRAHEDRON,
    [
        "v @ @ @",
        "v @ @ @ 1",
        "f @ @ @",
        "f @/1 @//2 @/1/2 @",
        "f -1 @ @",
        "g side",
        "o",
        "#f",
        "f 1 2 3",
    ],
)
FACET = (
    "facet normal 0 0 1\nouter loop\nvertex @ @ @\nvertex 1 0 0\nvertex 0 @ 0\nendloop\nendfacet"
)
STL_TEXT = sentences("solid it", [FACET, "facet", "endsolid", "solid x", FACET.upper()], "endsolid")
STL = STL_TEXT | st.builds(
    lambda head, count, rows, more: (
        head.ljust(80, b" ")[:80] + struct.pack("<I", count) + rows + more
    ),
    st.sampled_from([b"", b"solid", b"porous STL unit=um", b"porous STL unit=mm origin=1,nan,2"]),
    st.integers(0, 3) | st.sampled_from([2**31, 2**32 - 1]),
    st.integers(0, 3).flatmap(lambda n: st.binary(min_size=50 * n, max_size=50 * n)),
    st.binary(max_size=3),
)
PROPERTY = ["property double x", "property float y", "property double z", "property uchar red"]
LIST = ["property list uchar int vertex_indices", "property list int float vertex_indices",
        "property list char uint vertex_index", "property int label"]  # fmt: skip


@st.composite
def plys(draw):
    """Draw a header of any properties, and a body of text or bytes."""
    order = draw(st.sampled_from(["ascii", "binary_little_endian", "binary_big_endian"]))
    points = draw(st.lists(st.sampled_from(PROPERTY), max_size=5)) or PROPERTY[:3]
    corners = draw(st.lists(st.sampled_from(LIST), min_size=1, max_size=2))
    count = draw(st.sampled_from(["4"] * 6 + ["3", "@"]))
    faces = draw(st.sampled_from(["1", "1", "1", "2", "@"]))
    if draw(st.integers(0, 3)):
        points, corners = PROPERTY[:3], LIST[:1]
    if draw(st.integers(0, 3)):
        points, corners, count, faces = (
            ["property double x", "property double y", PROPERTY[2]],
            LIST[:1],
            "4",
            "1",
        )
    lines = ["ply", f"format {order} 1.0", f"element vertex {count}", *points]
    lines += [f"element face {faces}", *corners, "end_header", ""]
    head = draw(filled("\n".join(lines))).encode()
    if order == "ascii":
        rows = ["3 0 1 2", "3 0 1 2", "3 @ @ @", "4 0 1 2 @", "@ @", "@"]
        return head + draw(sentences("0 0 0\n1 0 0\n0 1 0\n0 0 1", rows, most=2))
    end = ">" if "big" in order else "<"
    place = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], f"{end}f8").tobytes()
    face = b"\3" + np.arange(3, dtype=f"{end}i4").tobytes()
    head += draw(st.sampled_from([place] * 3) | st.binary(max_size=99))
    return head + draw(st.sampled_from([face] * 3) | st.binary(max_size=40))


CORNERS = ["0, 0, 0", "2, 0, 0", "2, 3, 0", "0, 3, 0", "0, 0, 5", "2, 0, 5", "2, 3, 5", "0, 3, 5"]
DECK = "*NODE\n" + "\n".join(f"{i}, {place}" for i, place in enumerate(CORNERS, 1))
ELEMENTS = ["*ELEMENT, TYPE=C3D8", "1, 1, 2, 3, 4, 5, 6, 7, 8", "*ELEMENT, TYPE=C3D4, ELSET=A",
            "@, 1, 2, 4, 5", "2, @, @, @, @", "@, 1, 2, 3, 4, 5, 6, 7, @", "*ELEMENT, TYPE=C3D@",
            "*ELEMENT,", "TYPE=C3D6", "3, 1, 2, 3, 5, 6, @", "*ELEMENT, TYPE=C3D10"]  # fmt: skip
INP = sentences(
    f"{DECK}\n*ELEMENT, TYPE=C3D8\n9, 1, 2, 3, 4, 5, 6, 7, 8",
    [*ELEMENTS, "*NODE, NSET=@", "@, @, @, @", "** a word", "*NSET, NSET=A", "@,", "*STEP",
     "*NODE, SYSTEM=R", "*INCLUDE, INPUT=@", ", ,", "*SURFACE, NAME=@", "*ELEMENT, TYPE=S4"],
)  # fmt: skip


@st.composite
def mshs(draw):
    """Draw nodes and elements of either version in text, their counts right or not."""
    old = draw(st.booleans())
    places = [place.replace(",", "") for place in CORNERS]
    rows = ["1 5 2 0 1 1 2 3 4 5 6 7 8", "2 4 2 0 1 1 2 4 5", "3 4 2 @ @ @ @ @ @", "4 @ 0 1 2 3"]
    rows += ["5 3 1 0 1 2 3 4", "6 15 0 1", "@ 6 2 0 1 1 2 3 5 6 @"]
    count = draw(st.sampled_from(["8", "8", "8", "@"]))
    if old:
        nodes = "\n".join(f"{i} {place}" for i, place in enumerate(places, 1))
        chosen = draw(st.lists(st.sampled_from(rows), min_size=1, max_size=5))
        total = draw(st.sampled_from([str(len(chosen)), str(len(chosen)), "@"]))
        text = f"{count}\n{nodes}\n$EndNodes\n$Elements\n{total}\n" + "\n".join(chosen)
        head = "$MeshFormat\n2.2 0 8\n"
    else:
        labels = "\n".join(map(str, range(1, 9)))
        rows = ["3 1 5 1\n1 1 2 3 4 5 6 7 8", "3 1 4 1\n2 1 2 4 5", "3 1 4 1\n3 @ @ @ @", "3 1 @ @"]
        chosen = draw(st.lists(st.sampled_from(rows), min_size=1, max_size=4))
        blocks = draw(st.sampled_from([str(len(chosen)), str(len(chosen)), "@"]))
        text = f"1 {count} 1 8\n3 1 {draw(st.sampled_from('0001'))} 8\n{labels}\n"
        text += "\n".join(places) + f"\n$EndNodes\n$Elements\n{blocks} {blocks} 1 9\n"
        text += "\n".join(chosen)
        head = "$MeshFormat\n4.1 0 8\n"
    whole = f"{head}$EndMeshFormat\n$Nodes\n{text}\n$EndElements\n"
    return draw(filled(whole)).encode()


XML = '<VTKFile type="@kind" byte_order="LittleEndian"{}>'.replace("@kind", "{}")
ARRAY = '<DataArray type="{}" Name="{}" NumberOfComponents="{}" format="ascii">{}</DataArray>'
TYPES = st.sampled_from(
    ["UInt8", "Int8", "Int32", "Int64", "UInt64", "Float32", "Float64", "String"]
)


@st.composite
def vtus(draw):
    """Draw an unstructured grid of a few cells whose every number may be any."""
    row = " ".join(draw(st.lists(WORD, min_size=12, max_size=12)))
    place = draw(st.sampled_from(["0 0 0 2 0 0 0 3 0 0 0 5"] * 3 + [row]))
    cells = draw(st.sampled_from(["0 1 2 3", "0 1 2 3 3 2 1 0", "1 0 0 1 2 3", "0 1 2 @"]))
    ends, types = draw(
        st.sampled_from(
            [("4", "10"), ("4 8", "10 10"), ("2 6", "3 10"), ("@ @", "@ @"), ("4 @", "10 @")]
        )
    )
    form = draw(st.sampled_from(["Int64"] * 20) | TYPES) if draw(st.booleans()) else "Int64"
    count = str(len(ends.split()))
    arrays = [(form, "connectivity", "1", cells), (form, "offsets", "1", ends)]
    arrays += [("UInt8", "types", "1", types)]
    tag = ARRAY.format(draw(TYPES), "phase", "1", " ".join(["@"] * int(count)))
    name = draw(st.sampled_from(["nodes:A", "faces:B", "pairs:C", "cells:@"]))
    part = ARRAY.format("Int64", name, draw(st.sampled_from("12")), "@ @")
    part = part.replace(" format", f' NumberOfTuples="{draw(st.sampled_from("12@"))}" format')
    part = draw(st.sampled_from(["", "", part]))
    tag = draw(st.sampled_from(["", tag]))
    text = (
        f"{XML.format('UnstructuredGrid', '')}<UnstructuredGrid><FieldData>{part}</FieldData>"
        f'<Piece NumberOfPoints="{draw(st.sampled_from(["4"] * 4 + ["@"]))}" NumberOfCells="'
        f'{draw(st.sampled_from([count] * 4 + ["@"]))}"><CellData>{tag}</CellData><Points>'
        f"{ARRAY.format('Float64', 'Points', '3', place)}</Points><Cells>"
        + "".join(ARRAY.format(*array) for array in arrays)
        + "</Cells></Piece></UnstructuredGrid></VTKFile>"
    )
    return draw(filled(text)).encode()


@st.composite
def vtis(draw):
    """Draw an image of a few voxels whose every number may be any."""
    extent = draw(st.sampled_from(["0 1 0 2 0 3"] * 3 + ["@ @ @ @ @ @", "0 @ 0 2 0 3"]))
    extent = draw(filled(extent))
    values = draw(st.sampled_from(["0 255 7 0 1 2", "0 255 7 0 1 @"]))
    field = ARRAY.format(
        draw(st.sampled_from(["Float64", "String"])),
        draw(st.sampled_from(["metres_per_unit", "hausdorff", "sampling", "periodic", "start"])),
        draw(st.sampled_from("13")),
        draw(st.sampled_from(["@", "@ @ @", "0.001", "1 2 3", "99 111 118 101 114 0"])),
    )
    field = draw(st.sampled_from(["", field]))
    text = (
        f'{XML.format("ImageData", "")}<ImageData WholeExtent="{extent}" Origin="0 @ 0" '
        f'Spacing="{draw(st.sampled_from(["1 2 3", "1 @ 3"]))}"><FieldData>{field}</FieldData>'
        f'<Piece Extent="{extent}"><CellData>'
        f"{ARRAY.format(draw(st.sampled_from(['UInt8'] * 4) | TYPES), 'fill', '1', values)}"
        "</CellData></Piece></ImageData></VTKFile>"
    )
    return draw(filled(text)).encode()


def headed(first, fields, last, bodies):
    """Draw a header of fields, each there, changed, twice or missing, and a body."""

    @st.composite
    def draw_one(draw):
        lines = [
            line if draw(st.integers(0, 9)) else draw(st.sampled_from([other, other, "", line * 2]))
            for line, other in fields
        ]
        text = draw(filled(first + "".join(lines) + last))
        return text.encode() + draw(st.sampled_from(bodies))

    return draw_one()


GREY = bytes([0, 255] * 12)
NRRD = headed(
    "NRRD0004\n",
    [
        ("type: uint8\n", "type: @\n"),
        ("dimension: 3\n", "dimension: @\n"),
        ("sizes: 2 3 4\n", "sizes: @ @ @\n"),
        ("spacings: 1 2 3\n", "space directions: (@,0,0) (0,@,@) (0,0,1)\nspace dimension: 3\n"),
        ("encoding: raw\n", "encoding: text\n"),
        ("endian: little\n", "byte skip: @\n"),
        ("# x\n", "line skip: @\n"),
        ("a:=b\n", 'units: "mm" "mm" "@"\n'),
        ("content: x\n", "data file: @\n"),
    ],
    "\n",
    [GREY, GREY[:-1], b"0 255 " * 12, b""],
)
MHD = headed(
    "",
    [
        ("NDims = 3\n", "NDims = @\n"),
        ("DimSize = 2 3 4\n", "DimSize = @ @ @\n"),
        ("ElementType = MET_UCHAR\n", "ElementType = MET_FLOAT\n"),
        ("ElementSpacing = 1 2 3\n", "ElementSpacing = @ @ @\n"),
        ("BinaryData = True\n", "CompressedData = True\n"),
        ("ElementByteOrderMSB = False\n", "CompressedDataSize = @\n"),
        ("Offset = 0 0 0\n", "Offset = @ @ 0\n"),
        ("Comment = x\n", "HeaderSize = @\n"),
        ("Name = a\n", "TransformMatrix = @ 0 0 0 1 0 0 @ 1\n"),
    ],
    "ElementDataFile = LOCAL\n",
    [GREY, GREY[:-1], GREY + b"x", b""],
)


@st.composite
def npzs(draw):
    """Draw an archive whose arrays say anything of their shape and type."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", draw(st.sampled_from([0, 8]))) as archive:
        for name in ("fill", "spacing", *draw(st.sets(st.sampled_from(OTHERS), max_size=2))):
            archive.writestr(f"{name}.npy", draw(arrays(name)))
    return stream.getvalue()


OTHERS = ["bulk", "origin", "periodic", "unit", "sampling", "hausdorff", "start"]
LENGTH = st.integers(0, 4) | st.sampled_from([-1, 2**31, 2**63, 10**20])


@st.composite
def arrays(draw, name):
    """Draw an array, as it should be or with a header that says anything."""
    right = {"fill": ("|u1", (2, 3, 4), GREY), "spacing": ("<f8", (3,), np.ones(3).tobytes())}
    form, shape, data = right.get(name, ("<f8", (3,), np.ones(3).tobytes()))
    if not draw(st.integers(0, 3)):
        form = draw(st.sampled_from(["|u1", "|b1", "<f8", ">f4", "<U3", "|O", "|V0", "<i8", "|S0"]))
        shape = draw(st.tuples(LENGTH, LENGTH, LENGTH) | st.tuples(LENGTH) | st.just(()))
        data = draw(st.sampled_from([GREY, b"", bytes(range(24)), b"\xff" * 24]))
    head = repr({"descr": form, "fortran_order": draw(st.booleans()), "shape": shape}).encode()
    return b"\x93NUMPY\1\0" + struct.pack("<H", len(head) + 1) + head + b"\n" + data


@st.composite
def tifs(draw):
    """Draw a stack whose directories are near enough to read, and any of whose tags may lie."""
    pages = draw(st.integers(1, 3))
    data = b"II*\0" + struct.pack("<I", 8)
    lies = st.tuples(
        st.sampled_from(
            [256, 257, 258, 259, 262, 270, 273, 277, 278, 279, 282, 284, 317, 322, 339]
        ),
        st.integers(0, 14),
        st.sampled_from([0, 1, 2, 5, 2**16, 2**32 - 1]),
        st.sampled_from([0, 1, 2, 5, 8, 32773, 2**16, 2**31, 2**32 - 1]),
    )
    for number in range(pages):
        tags = dict.fromkeys((256, 257, 273, 278, 279, 258, 259, 262, 277))
        end = len(data) + 2 + 12 * 9 + 4
        right = (4, 6, end, 6, 24, 8, 1, 1, 1)
        tags = {tag: (4, 1, value) for tag, value in zip(tags, right, strict=True)}
        for tag, *what in draw(st.lists(lies, max_size=2)):
            if tag in tags:
                tags[tag] = tuple(what)
        rows = b"".join(struct.pack("<HHII", tag, *tags[tag]) for tag in sorted(tags))
        link = end + 24 if number + 1 < pages else draw(st.sampled_from([0, 0, 0, 8, end]))
        data += struct.pack("<H", 9) + rows + struct.pack("<I", link) + GREY
    return data


MESH = (
    '<object id="@"><mesh><vertices><vertex x="@" y="0" z="0"/><vertex x="1" y="@" z="0"/>'
    '<vertex x="0" y="1" z="0"/></vertices><triangles><triangle v1="0" v2="1" v3="@"/>'
    "</triangles></mesh></object>"
)
MADE = '<object id="@"><components><component objectid="@"/></components></object>'
TURNED = MADE.replace("/></c", ' transform="@ 0 0 0 1 0 0 0 1 @ 0 0"/></c')
PIECES = [MESH, MESH, MADE, TURNED, "<vertex/>", "<triangle/>", "<o/>"]
CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
FIRST = PIECES[0].replace('id="@"', 'id="1"').replace("@", "2")
MODEL = sentences(
    f'<model unit="millimeter" xmlns="{CORE}"><resources>{FIRST}',
    PIECES,
    '</resources><build><item objectid="@"/></build></model>',
    most=4,
)
ROOTS = (
    '<Relationships><Relationship Target="/3D/3dmodel.model" Id="r" '
    'Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/></Relationships>'
)


def package(model):
    """Return a 3MF package of a model."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr("_rels/.rels", ROOTS)
        archive.writestr("3D/3dmodel.model", model)
    return stream.getvalue()


@st.composite
def frds(draw):
    """Draw a hexahedron and fields on it whose every count may be any."""
    kind, line = draw(
        st.sampled_from([(1, HEX)] * 3 + [(3, HEX[:4]), (1, [*HEX[:7], 9]), (5, HEX)])
    )
    values = st.lists(st.floats(width=32), min_size=24, max_size=24)
    fields = draw(
        st.lists(
            st.builds(
                test_hostile_frd.block,
                st.just(test_hostile_frd.FIELD)
                | values.map(lambda numbers: np.array(numbers).reshape(8, 3)),
                name=st.sampled_from(["DISP", "FLUX", "", "12345678"]),
                count=st.sampled_from([8, 8, 8, 0, -1, 10**11]),
                parts=st.sampled_from([3, 3, 3, 1, 4]),
                made=st.integers(0, 1),
                step=st.integers(0, 3) | st.just(99999),
                kind=st.sampled_from([0, 0, 2, 99]),
            ),
            max_size=3,
        )
    )
    shown = test_hostile_frd.element(draw(st.integers(1, 2)), kind, line) + "\n"
    right = {"elements": shown, "fields": "".join(fields)}
    lies = {"count": [8, 8, 8, 7, "x"], "cells": [1, 1, 2], "form": [1, 1, 1, 0, 2]}
    return test_hostile_frd.frd(
        **right, **{key: draw(st.sampled_from(values)) for key, values in lies.items()}
    )


GRAMMARS = {
    ".frd": frds(),
    ".3mf": MODEL.map(package),
    ".inp": INP,
    ".mhd": MHD,
    ".msh": mshs(),
    ".npz": npzs(),
    ".nrrd": NRRD,
    ".obj": OBJ,
    ".ply": plys(),
    ".stl": STL,
    ".tif": tifs(),
    ".vti": vtis(),
    ".vtu": vtus(),
}
"""What makes up files of each format that is read."""
