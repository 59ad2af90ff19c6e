"""Named parts that users bring back: sets of decks and groups of Gmsh, also hostile ones."""

import re
import subprocess
import time
import tracemalloc
import warnings

import deck_meshes
import neutral_meshes as meshes
import numpy as np
import pytest

from porous import formats
from porous.cli import main
from porous.errors import FormatError, FormatWarning
from porous.formats import inp, msh, msh2
from porous.formats._sets import faces_by_nodes, same_rows
from porous.values import VolumeMesh
from porous.values.volume_topology import faces, matched

SECONDS, BYTES = 2.0, 64 * 2**20
CUBES = [(x, y, z) for z in range(2) for y in range(2) for x in range(3)]
NODES = "".join(f"{i}, {x}, {y}, {z}\n" for i, (x, y, z) in enumerate(CUBES, 11))
NODES += "99, 5, 5, 5\n"
DECK = (
    f"*NODE, NSET=every\n{NODES}*ELEMENT, TYPE=C3D8, ELSET=left\n"
    "1, 11, 12, 15, 14, 17, 18, 21, 20\n"
    "*ELEMENT, TYPE=C3D8, ELSET=Right\n7, 12, 13, 16, 15, 18, 19, 22, 21\n"
)


def read(tmp_path, data, suffix=".inp"):
    path = tmp_path / f"given{suffix}"
    path.write_bytes(data.encode() if isinstance(data, str) else data)
    return formats.read(path)


def parts(tmp_path, more, suffix=".inp"):
    found = read(tmp_path, DECK + more, suffix).parts
    return {name: (part.kind, part.members.tolist()) for name, part in found.items()}


def same_parts(found, mesh, without=()):
    """Compare parts as sets of members, but for those without members and some others."""
    wanted = {n: p for n, p in mesh.parts.items() if len(p.members) and n not in without}
    assert set(found.parts) == set(wanted)
    for name, part in wanted.items():
        own = found.parts[name]
        assert own.kind == part.kind
        assert np.array_equal(np.unique(own.members, axis=0), np.unique(part.members, axis=0)), name


# --- what porous wrote -------------------------------------------------------------------------


@pytest.mark.parametrize("kind", meshes.KINDS)
def test_our_decks_read_back_equal(tmp_path, kind):
    mesh = meshes.body(kind)
    found = read(tmp_path, b"".join(inp.FORMAT.write(mesh)))
    assert found.blocks == mesh.blocks
    assert found.points == pytest.approx(mesh.points, rel=1e-9)
    same_parts(found, mesh)


@pytest.mark.parametrize("form", [msh.FORMAT, msh2.FORMAT], ids=lambda form: form.suffix)
@pytest.mark.parametrize("kind", meshes.KINDS)
def test_our_meshes_of_gmsh_read_back_equal(tmp_path, kind, form):
    mesh = meshes.body(kind, "um")
    found = read(tmp_path, b"".join(form.write(mesh)), form.suffix)
    assert (found.unit, found.blocks) == ("um", mesh.blocks)
    assert np.array_equal(found.points, mesh.points)
    said_by_faces = {f"{axis}{end}" for axis in "XYZ" for end in ("MIN", "MAX")}
    lost = {"SKIN", "WORD_00"} if form is msh2.FORMAT else set()
    same_parts(found, mesh, said_by_faces | lost)


def test_a_job_comes_back_as_its_mesh(tmp_path):
    job = deck_meshes.zoo_job("static", system="m-SI", title="*NSET, NSET=SLY\n1, 2")
    found = read(tmp_path, b"".join(inp.FORMAT.write(job)))
    assert found.unit == "m"
    assert found.points * 1e3 == pytest.approx(job.mesh.points, rel=1e-9)
    names = {"N_3_ODD___NAME": "3 odd/é name"}
    mesh = VolumeMesh(
        job.mesh.points,
        job.mesh.blocks,
        {},
        {**{n: p for n, p in job.mesh.parts.items() if n not in names.values()}},
    )
    same_parts(VolumeMesh(found.points, found.blocks, {}, dict(found.parts)), with_odd(mesh, job))


def with_odd(mesh, job):
    odd = {"N_3_ODD___NAME": job.mesh.parts["3 odd/é name"]}
    return VolumeMesh(mesh.points, mesh.blocks, {}, {**mesh.parts, **odd})


# --- sets of decks -----------------------------------------------------------------------------


def test_sets_are_read_in_every_way_they_are_said(tmp_path):
    more = """*nset, nset=low, generate
 11, 16
 17, 21, 4
*NSET, NSET="In Words"
low, 22,
** a word
 12, 99
*NSET, NSET=low
 22
*NSET, NSET=of_cells, ELSET=Right
*ELSET, ELSET=both
left, RIGHT
*ELSET, ELSET=sparse, GENERATE
1, 9, 3
*SURFACE, NAME=top, TYPE=ELEMENT
both, S2
 7, S4
*SURFACE, NAME=left
1, S6
"""
    assert parts(tmp_path, more) == {
        "LEFT": ("cells", [0]),
        "RIGHT": ("cells", [1]),
        "BOTH": ("cells", [0, 1]),
        "SPARSE": ("cells", [0, 1]),
        "TOP": ("faces", [[1, 3], [0, 1], [1, 1]]),
        "LEFT_FACES": ("faces", [[0, 5]]),
        "EVERY": ("nodes", list(range(12))),
        "LOW": ("nodes", [0, 1, 2, 3, 4, 5, 6, 10, 11]),
        "IN WORDS": ("nodes", [11, 1, 0, 2, 3, 4, 5, 6, 10]),
        "OF_CELLS": ("nodes", [1, 2, 4, 5, 7, 8, 10, 11]),
    }


def test_unsorted_members_keep_their_order(tmp_path):
    found = parts(tmp_path, "*NSET, NSET=a, UNSORTED\n15, 12, 15, 11\n")
    assert found["A"] == ("nodes", [4, 1, 0])


def test_elements_without_volume_are_in_no_set(tmp_path):
    shells = "*ELEMENT, TYPE=S4, ELSET=shells\n50, 11, 12, 15, 14\n*ELSET, ELSET=mixed\nshells, 7\n"
    found = parts(tmp_path, shells)
    assert "SHELLS" not in found
    assert found["MIXED"] == ("cells", [1])


LEFT_OUT = {
    "nothing": ("*NSET, NSET=far\n99\n", "1 parts select nothing of the volume elements .*: FAR$"),
    "nothing at all": ("*ELSET, ELSET=void\n", "select nothing .*: VOID$"),
    "out of range": ("*ELSET, ELSET=far\n2, 3, 10000000000\n-7\n", "select nothing .*: FAR$"),
    "a set that is not there": ("*NSET, NSET=a\nb\n", "name sets that do not stand before .*: A$"),
    "a circle": ("*NSET,NSET=a\nb\n*NSET,NSET=b\na\n", "2 parts name sets that do not .*: A, B$"),
    "a set of itself": ("*NSET,NSET=a\n11, a\n", "name sets that do not stand before .*: A$"),
    "surfaces of nodes": (
        "*SURFACE, NAME=s, TYPE=NODE\nlow\n",
        "are not of elements' faces .*: S$",
    ),
    "surfaces of shells": ("*SURFACE, NAME=s\n1, SPOS\n", "are not of elements' faces .*: S$"),
    "free surfaces": ("*SURFACE, NAME=s\n1\n", "are not of elements' faces .*: S$"),
    "surfaces of nothing": ("*SURFACE, NAME=s\nnone, S1\n", "name sets that do not stand .*: S$"),
    "many": ("".join(f"*NSET, NSET=n{i}\n" for i in range(9)), "9 parts .*: N0, .*, N4, 4 more$"),
}


@pytest.mark.parametrize("name", LEFT_OUT)
def test_what_selects_nothing_is_left_out_and_it_is_said(tmp_path, name):
    more, said = LEFT_OUT[name]
    with pytest.warns(FormatWarning, match=said) as notes:
        assert set(parts(tmp_path, more)) == {"LEFT", "RIGHT", "EVERY"}
    assert len(notes) == 1


BAD = {
    "a run of 10^12": ("*NSET, NSET=a, GENERATE\n1, 1000000000000\n", 12),
    "a run of 10^12 by 10^9": ("*NSET, NSET=a, GENERATE\n11, 1000000000000, 1000000000\n", 1),
    "a run beyond all": (
        f"*NSET, NSET=a, GENERATE\n1, 1{'0' * 40}\n",
        "GENERATE: got 1e.40; wanted a whole",
    ),
    "a run of words": (
        "*NSET, NSET=a, GENERATE\n1, many\n",
        "GENERATE: got 'many'; wanted a number",
    ),
    "a run of step 0": ("*NSET, NSET=a, GENERATE\n11, 15, 0\n", "got '11, 15, 0'; wanted a step"),
    "a run of step -1": ("*NSET, NSET=a, GENERATE\n15, 11, -1\n", "'15, 11, -1'; wanted a step"),
    "a run of one": (
        "*NSET, NSET=a, GENERATE\n15\n",
        "GENERATE: got '15'; wanted first, last and step",
    ),
    "a member in halves": ("*NSET, NSET=a\n11.5\n", "NSET A: got 11.5; wanted a whole number"),
    "a face too far": ("*SURFACE, NAME=s\n1, S6\nRight, S7\n", 0),
    "names of 10 kB": (f"*NSET, NSET={'n' * 10**4}\n11\n", 1),
    "names that steer": ("*NSET, NSET=\x1b[31m\u202eevil\n11\n", 1),
    "cards without a name": ("*NSET\n11\n*SURFACE, TYPE=ELEMENT\n1, S1\n*ELSET, ELSET=\n1\n", 0),
    "ten thousand sets": ("".join(f"*NSET,NSET=a{i}\n11\n" for i in range(10**4)), 10**4),
}


@pytest.mark.parametrize("name", BAD)
@pytest.mark.filterwarnings("ignore::porous.errors.FormatWarning")
def test_hostile_sets(tmp_path, name):
    more, wanted = BAD[name]
    if isinstance(wanted, str):
        bounded(tmp_path, (DECK + more).encode(), ".inp", wanted)
        return
    found = bounded(tmp_path, (DECK + more).encode(), ".inp")
    own = {n: p for n, p in found.parts.items() if n not in ("LEFT", "RIGHT", "EVERY")}
    assert sum(len(part.members) for part in own.values()) == wanted
    assert all(n.isprintable() and len(n) <= 127 for n in own)


def bounded(tmp_path, data, suffix, wanted=None):
    """Read within two seconds and 64 MiB; return the mesh, or check the refusal."""
    read(tmp_path, DECK)  # so that what is imported is not counted
    tracemalloc.start()
    start = time.process_time()
    try:
        if wanted is None:
            return read(tmp_path, data, suffix)
        with pytest.raises(FormatError) as error:
            read(tmp_path, data, suffix)
        assert re.search(wanted, str(error.value)), str(error.value)
        assert "\n" not in str(error.value)
        return None
    finally:
        spent, peak = time.process_time() - start, tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert spent < 2 * SECONDS  # what traces memory doubles the time
        assert peak < BYTES


def many_cells(count):
    nodes = "".join(f"{i}, {i % 2}, {i // 2 % 2}, {i // 4}\n" for i in range(1, 9))
    cells = "".join(f"{i}, 1, 2, 4, 3, 5, 6, 8, 7\n" for i in range(1, count + 1))
    return f"*NODE\n{nodes}*ELEMENT, TYPE=C3D8, ELSET=S\n{cells}"


def test_sets_of_sets_may_not_say_more_than_the_file_is_long_for(tmp_path):
    cards = "".join(f"*ELSET, ELSET=A{i}\nS\n" for i in range(4000))
    bounded(tmp_path, (many_cells(5000) + cards).encode(), ".inp", "sets: more than .* members")
    runs = "*NSET, NSET=A, GENERATE\n" + "1, 2\n7, 8, 9\n" * 100000
    found = bounded(tmp_path, (many_cells(1) + runs).encode(), ".inp")
    assert found.parts["A"].members.tolist() == [0, 1, 6]


# --- groups of Gmsh ----------------------------------------------------------------------------

HEAD = "$MeshFormat\n{version} 0 8\n$EndMeshFormat\n"
FACES = [[11, 14, 15, 12], [12, 13, 16, 15], [12, 15, 21, 18], [18, 21, 15, 12], [11, 12, 21, 20]]
"""Below each cell, between them seen from the first and from the second, and one of no cell."""
HEXES = [[11, 12, 15, 14, 17, 18, 21, 20], [12, 13, 16, 15, 18, 19, 22, 21]]


def rows(table):
    return "".join(" ".join(map(str, row)) + "\n" for row in table)


def gmsh_2(elements, more="", names=""):
    nodes = [(i, *place) for i, place in enumerate(CUBES, 11)]
    numbered = [(i, *row) for i, row in enumerate(elements, 1)]
    return (
        f"{HEAD.format(version=2.2)}{names}$Nodes\n{len(nodes)}\n{rows(nodes)}$EndNodes\n"
        f"$Elements\n{len(elements)}\n{rows(numbered)}$EndElements\n{more}"
    ).encode()


def gmsh_4(entities, blocks, more="", names=""):
    """Blocks are of dimension, entity, type and the nodes of each element."""
    labels = rows([[i] for i, _ in enumerate(CUBES, 11)])
    total = sum(len(nodes) for *_, nodes in blocks)
    body, number = "", 1000 + total
    for *head, nodes in blocks:
        body += rows([[*head, len(nodes)]])
        body += rows([[number - len(nodes) + i, *row] for i, row in enumerate(nodes)])
        number -= len(nodes)  # later blocks have lower numbers
    return (
        f"{HEAD.format(version=4.1)}{names}$Entities\n{entities}$EndEntities\n"
        f"$Nodes\n1 {len(CUBES)} 1 99\n3 1 0 {len(CUBES)}\n{labels}{rows(CUBES)}$EndNodes\n"
        f"$Elements\n{len(blocks)} {total} 1 {total}\n{body}$EndElements\n{more}"
    ).encode()


def named(*lines):
    body = "".join(f"{line}\n" for line in lines)
    return f"$PhysicalNames\n{len(lines)}\n{body}$EndPhysicalNames\n"


def members(mesh):
    return {name: (part.kind, part.members.tolist()) for name, part in mesh.parts.items()}


GROUPS_2 = [
    *[(5, 2, 1, 1, *HEXES[0]), (5, 2, 2, 1, *HEXES[1]), (5, 3, 7, 1, 5, *HEXES[1])],
    *[(3, 2, 4, 1, *face) for face in (FACES[0], FACES[3])],
    *[(3, 2, 5, 1, *face) for face in FACES[1:3]],
    *[(3, 2, 0, 1, *FACES[0]), (15, 2, 2, 1, 13), (15, 2, 2, 1, 11), (15, 0, 15)],
]
FOUND = {
    "left": ("cells", [0]),
    "right": ("cells", [1]),
    "VOLUME_7": ("cells", [1]),
    "SURFACE_4": ("faces", [[0, 0], [1, 5]]),
    "right_FACES": ("faces", [[0, 3], [1, 0]]),
    "right_NODES": ("nodes", [0, 2]),
}
NAMES = named('3 1 "left"', '3 2 "right"', '2 5 "right"', '0 2 "right"')


def test_groups_of_2(tmp_path):
    found = read(tmp_path, gmsh_2(GROUPS_2, names=NAMES), ".msh")
    assert members(found) == FOUND
    assert found.cells == 2


def test_groups_of_4_with_cells_in_the_order_of_their_numbers(tmp_path):
    entities = "1 0 2 2\n1 0 0 0 1 2\n1 0 0 0 1 1 1 1 4 0\n2 0 0 0 1 1 1 1 -5 1 8\n"
    entities += "1 0 0 0 1 1 1 1 1 0\n2 0 0 0 1 1 1 2 2 7 2 1 2\n"
    points, one, two = [[13], [11]], [FACES[0], FACES[3]], FACES[1:3]
    blocks = [(3, 2, 5, HEXES[1:]), (0, 1, 15, points), (2, 1, 3, one), (2, 2, 3, two)]
    blocks += [(2, 9, 3, [FACES[4]]), (3, 1, 5, HEXES[:1])]  # no entity 9 is there
    found = read(tmp_path, gmsh_4(entities, blocks, names=NAMES), ".msh")
    assert members(found) == FOUND
    assert found.points[found.blocks[0].cells[0, 0]].tolist() == [0, 0, 0]


@pytest.mark.parametrize("size", [4, 8])
@pytest.mark.parametrize("end", "<>")
def test_groups_and_pairs_in_binary_of_either_order(tmp_path, end, size):
    def sizes(*numbers):
        return np.array(numbers, f"{end}u{size}").tobytes()

    def ints(*numbers):
        return np.array(numbers, f"{end}i4").tobytes()

    def reals(numbers):
        return np.array(numbers, f"{end}f8").tobytes()

    box = reals([0, 0, 0, 1, 1, 1])
    entities = sizes(1, 0, 1, 1) + ints(4) + reals([0, 0, 0]) + sizes(1) + ints(2)
    entities += ints(5) + box + sizes(1) + ints(-4) + sizes(1) + ints(9)
    entities += ints(6) + box + sizes(2) + ints(1, 7) + sizes(2) + ints(5, -5)
    nodes = sizes(1, 12, 11, 22) + ints(3, 6, 0) + sizes(12, *range(11, 23)) + reals(CUBES)
    elements = sizes(3, 4, 1, 4) + ints(0, 4, 15) + sizes(1, 1, 13)
    elements += ints(2, 5, 3) + sizes(1, 2, *FACES[3])
    elements += ints(3, 6, 5) + sizes(2, 4, *HEXES[1], 3, *HEXES[0])
    links = sizes(1) + ints(2, 5, 5) + sizes(16) + reals(range(16)) + sizes(2, 13, 11, 16, 14)
    body = b"".join(
        b"$%s\n%s\n$End%s\n" % (name, some, name)
        for name, some in (
            (b"MeshFormat", b"4.1 1 %d\n" % size + ints(1)),
            (b"PhysicalNames", b'1\n3 7 "seven"'),
            (b"Entities", entities),
            (b"Nodes", nodes),
            (b"Elements", elements),
            (b"Periodic", links),
        )
    )
    assert members(read(tmp_path, body, ".msh")) == {
        "seven": ("cells", [0, 1]),
        "VOLUME_1": ("cells", [0, 1]),
        "SURFACE_4": ("faces", [[1, 5]]),
        "POINT_2": ("nodes", [2]),
        "XPAIRS": ("pairs", [[0, 2], [3, 5]]),
    }


def test_a_face_without_its_cell_and_groups_of_lines_are_left_out(tmp_path):
    elements = [(5, 2, 1, 1, *HEXES[0]), (3, 2, 4, 1, *FACES[4]), (3, 2, 6, 1, *FACES[1])]
    elements += [(1, 2, 3, 1, 11, 12), (15, 2, 5, 1, 13)]
    with pytest.warns(FormatWarning) as notes:
        found = read(tmp_path, gmsh_2(elements, names=named('3 8 "none"')), ".msh")
    assert set(found.parts) == {"VOLUME_1"}
    said = " ".join(str(note.message) for note in notes)
    assert "2 faces of groups are faces of no volume element" in said
    assert "4 parts select nothing of the volume elements and are left out: none, SURFACE_" in said
    assert "1 parts are of lines and are left out: CURVE_3" in said


def test_shifts_along_axes_are_pairs_and_others_are_said(tmp_path):
    cells = [(5, 2, 1, 1, *row) for row in HEXES]
    along = [(11, 13), (14, 16), (17, 19), (20, 22)]
    up = [(17 + i, 11 + i) for i in range(6)]
    turned = [(11, 13), (14, 19)]
    text = "$Periodic\n4\n2 1 2\nAffine 1 0 0 2 0 1 0 0 0 0 1 0 0 0 0 1\n4\n" + rows(along)
    text += f"2 3 4\n6\n{rows(up)}2 5 6\n2\n{rows(turned)}1 1 2\n1\n11 13\n$EndPeriodic\n"
    with pytest.warns(FormatWarning, match=r"1 links of .Periodic are no shifts along an axis"):
        found = members(read(tmp_path, gmsh_2(cells, text), ".msh"))
    assert found["XPAIRS"] == ("pairs", [[0, 2], [3, 5], [6, 8], [9, 11]])
    assert found["ZPAIRS"] == ("pairs", [[i, i + 6] for i in range(6)])
    assert set(found) == {"VOLUME_1", "XPAIRS", "ZPAIRS"}


ONE = (3, 1, 5, HEXES)
ENTITY = "0 0 0 1\n1 0 0 0 1 1 1 {groups} 0\n"
PLAIN = [(5, 0, *HEXES[0])]
GROUPED = [(5, 2, 1, 1, *HEXES[0])]
HOSTILE = {
    "groups 1e12": (gmsh_4(ENTITY.format(groups=10**12), [ONE]), "Entities would take .* numbers"),
    "groups -1": (gmsh_4(ENTITY.format(groups=-1), [ONE]), "Entities: got -1; wanted zero or mo"),
    "entities 1e15": (gmsh_4(f"0 0 0 {10**15}\n", [ONE]), "Entities would take 1 numbers; the f"),
    "entities too few": (gmsh_4("0 0 0 0\n1 0 0 0\n", [ONE]), "Entities: got '4 numbers more'"),
    "an entity that is not there": (gmsh_4("0 0 0 0\n", [ONE]), {}),
    "a group of 10^9": (gmsh_4(ENTITY.format(groups=f"1 {10**9}"), [ONE]), {f"VOLUME_{10**9}": 2}),
    "a tag below zero": (gmsh_2([(5, 2, -3, 1, *HEXES[0])]), {"VOLUME_3": 1}),
    "names without quotes": (gmsh_2(GROUPED, names=named("3 1 x")), "PhysicalNames: got '3 1 x'"),
    "names that lie": (
        gmsh_2(GROUPED, names=NAMES.replace("\n4\n", "\n3\n")),
        "'3'; wanted 4, its",
    ),
    "names of 10 kB": (gmsh_2(GROUPED, names=named(f'3 1 "{"n" * 10**4}"')), {"n" * 127: 1}),
    "names that steer": (gmsh_2(GROUPED, names=named('3 1 "\x1b[31m\u202e"')), {"_[31m_": 1}),
    "links 1e12": (
        gmsh_2(PLAIN, f"$Periodic\n{10**12}\n$EndPeriodic\n"),
        "Periodic would take 4 numbers; the file has 0 left",
    ),
    "pairs 1e12": (
        gmsh_2(PLAIN, f"$Periodic\n1\n2 1 2\n{10**12}\n11 12\n$EndPeriodic\n"),
        "Periodic would take 2000000000000 numbers; the file has 2 left",
    ),
    "pairs of nodes that are not there": (
        gmsh_2(PLAIN, "$Periodic\n1\n2 1 2\n1\n98 99\n$EndPeriodic\n"),
        {},
    ),
    "a unit of another world": (
        gmsh_2(PLAIN, "$Comments\nmade by porous; lengths in ly\n$EndComments\n"),
        {},
    ),
}


@pytest.mark.parametrize("name", HOSTILE)
@pytest.mark.filterwarnings("ignore::porous.errors.FormatWarning")
def test_hostile_groups(tmp_path, name):
    data, wanted = HOSTILE[name]
    if isinstance(wanted, str):
        bounded(tmp_path, data, ".msh", wanted)
        return
    mesh = bounded(tmp_path, data, ".msh")
    assert mesh.unit == "mm"
    assert {n: len(part.members) for n, part in mesh.parts.items()} == wanted


def test_groups_of_entities_may_not_say_more_than_the_file_is_long_for(tmp_path):
    groups = " ".join(map(str, [1000, *range(1, 1001)]))
    data = gmsh_4(ENTITY.format(groups=groups), [(3, 1, 5, HEXES * 2500)])
    bounded(tmp_path, data, ".msh", "sets: more than .* members; the file is too short for it")


# --- what they stand on ------------------------------------------------------------------------


def test_rows_that_have_one_sum_are_told_apart():
    a, b = (np.random.default_rng(7).integers(1 << 62, size=2) | 1).tolist()
    rows = np.array([[0, 0], [b, -a], [0, 0], [1, 2]])
    first, place = same_rows(rows)
    assert np.array_equal(rows[first][place], rows)
    assert len(first) == 3


@pytest.mark.parametrize("kind", meshes.KINDS)
def test_every_face_is_found_from_outside_and_from_inside(kind):
    mesh = meshes.body(kind)
    every = faces(mesh)
    one, two = matched(every)
    other = np.arange(len(every.members))
    other[one], other[two] = two, one
    for width in (3, 4):
        own = (every.nodes >= 0).sum(axis=1) == width
        corners = every.nodes[own][:, :width]
        for some, wanted in ((corners, every.members), (corners[:, ::-1], every.members[other])):
            found = faces_by_nodes(mesh.blocks, len(mesh.points), some)
            assert np.array_equal(found, wanted[own])


# --- what others make --------------------------------------------------------------------------


@pytest.mark.judge
def test_groups_of_gmsh_go_into_a_deck_that_the_solver_reads(tmp_path, ask, judge):
    """Gmsh makes two boxes with groups in all its dialects; CalculiX runs on their sets."""
    said = ask("gmsh_groups", tmp_path)
    assert len(said["files"]) == 5
    for path in said["files"]:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            mesh = formats.read(path)
        found = {name: (part.kind, len(part.members)) for name, part in mesh.parts.items()}
        pairs = found.pop("XPAIRS")
        assert found == {name: tuple(some) for name, some in said["groups"].items()}
        assert pairs == ("pairs", said["pairs"]) or "quadratic" in path
    deck = tmp_path / "chain.inp"
    assert main(["convert", said["files"][0], str(deck)]) == 0
    back = dict(formats.read(deck).parts)
    assert back.pop("SOLID").members.tolist() == list(range(mesh.cells))  # all of any deck of ours
    assert {n: (p.kind, len(p.members)) for n, p in back.items()} == {
        name.upper(): (part.kind, len(part.members))
        for name, part in formats.read(said["files"][0]).parts.items()
    }
    with deck.open("a") as more:
        more.write(
            "*MATERIAL, NAME=M\n*ELASTIC\n1000., 0.\n*DENSITY\n1.\n"
            "*SOLID SECTION, ELSET=BELOW, MATERIAL=M\n"
            "*SOLID SECTION, ELSET=ABOVE, MATERIAL=M\n*STEP\n*STATIC\n"
            "*BOUNDARY\nHELD, 1, 3\n"
            "*DLOAD\nBELOW, GRAV, 0., 0., 0., -1.\n*EL PRINT, ELSET=ABOVE, TOTALS=ONLY\nEVOL\n"
            "*END STEP\n"
        )
    subprocess.run(
        [judge("ccx"), "-i", "chain"],
        cwd=tmp_path,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        timeout=60,
        check=True,
    )
    volume = re.search(r"volume.*?(\d\S+E[-+]\d+)", (tmp_path / "chain.dat").read_text(), re.DOTALL)
    assert float(volume[1]) == pytest.approx(said["volume"], rel=1e-5)
