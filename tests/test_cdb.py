"""Ansys archives: what mapdl_archive reads, and that faces and fields are as Ansys numbers them."""

import re

import numpy as np
import pytest
from deck_meshes import SHAPED, SOFT, STEEL, STEPS, counts, written, zoo, zoo_job
from test_inp import voxel_job

from porous import formats
from porous.errors import FormatError
from porous.formats import cdb
from porous.formats._groups import face_elements
from porous.values import SHAPES, Job, Part, Pressed, Step, VolumeMesh

BRICK = ("JILK", "IJNM", "JKON", "KLPO", "LIMP", "MNOP")
FACES = {
    185: BRICK,
    186: BRICK,
    187: ("JIK", "IJL", "JKL", "KIL"),
    285: ("JIK", "IJL", "JKL", "KIL"),
}
"""Faces of elements by their nodes I, J, K, …, as the Element Reference lists them."""


@pytest.fixture(scope="module")
def decks():
    """Every kind of value that an archive is made of, by the name of its file."""
    voxels = voxel_job(np.ones((3, 2, 4), bool), (0.1, 0.25, 1 / 3), unit="cm")
    jobs = {kind: zoo_job(kind) for kind in STEPS}
    alone = {shape: zoo(shapes=(shape,)) for shape in SHAPED}
    bare = {"bare": zoo(unit="nm")}
    return jobs | alone | bare | {"si": zoo_job(system="m-SI", unit="in"), "voxels": voxels}


@pytest.mark.judge
def test_mapdl_archive_reads_what_was_written(decks, ask, tmp_path):
    for name, value in decks.items():
        formats.write(value, tmp_path / f"{name}.cdb")
    said = ask("mapdl", *(tmp_path / f"{name}.cdb" for name in decks))
    for (name, value), got in zip(decks.items(), said, strict=True):
        mesh = getattr(value, "mesh", value)
        scale = {"bare": 1e-6, "si": 0.0254, "voxels": 10.0}.get(name, 1.0)
        points = np.array(got["points"])
        # Fourteen digits: half a unit of the last.
        assert (
            np.abs(points - mesh.points * scale) <= 5.01e-14 * np.abs(mesh.points) * scale
        ).all()
        assert got["numbers"]
        assert got["elements"] == {
            shape: sum(len(b.cells) for b in mesh.blocks if b.shape == shape)
            for shape in dict.fromkeys(b.shape for b in mesh.blocks)
        }
        assert got["volume"] == pytest.approx(mesh.volumes.sum() * scale**3, rel=1e-9)
        assert got["off_middle"] <= 1e-12 * scale
        assert_components(got, mesh)
    assert said[list(decks).index("static")]["materials"] == {"1": 3, "2": 2}


def assert_components(got, mesh):
    names = {"3 odd/é name": "N_3_ODD___NAME"}
    wanted = counts(mesh)
    faces = {
        name: len(np.unique(np.concatenate([n.ravel() for _, n in found.values()])))
        for name in wanted["faces"]
        for found in [face_elements(mesh, mesh.parts[name].members)]
    }
    assert got["cell_sets"] == wanted["cells"]
    assert got["node_sets"] == {names.get(n, n): c for n, c in (wanted["nodes"] | faces).items()}


def block(deck, head, width, end):
    """Return the lines of a block as rows of fields."""
    lines = deck[deck.index(head) :].splitlines()[2:]
    stop = next(i for i, line in enumerate(lines) if re.match(end, line))
    assert all(len(line) % width == 0 for line in lines[:stop])
    return [[line[i : i + width] for i in range(0, len(line), width)] for line in lines[:stop]]


def test_fields_are_as_wide_as_their_formats_say(decks):
    for value in decks.values():
        deck = written(cdb, value)
        lines = deck[deck.index("NBLOCK") :].splitlines()
        assert lines[1] == "(3i9,6e21.13e3)"
        mesh = getattr(value, "mesh", value)
        for number, line in enumerate(lines[2 : 2 + len(mesh.points)], 1):
            assert line[:27].split() == [str(number), "0", "0"]
            assert re.fullmatch(r"([ -]\d\.\d{13}e[+-]\d{3}){3}", line[27:]), line
        assert lines[2 + len(mesh.points)].startswith("N,R5.3,LOC,")
        rows = block(deck, "EBLOCK", 9, " +-1$")
        count = sum(1 + (SHAPES[b.shape].nodes > 8) for b in mesh.blocks for _ in b.cells)
        assert len(rows) == count
        for name in re.findall(r"^CMBLOCK,(\w+),", deck, re.M):
            assert len(name) <= 32
            assert re.match("[A-Z]", name)


def test_wide_and_narrow_exponents_are_three_digits():
    mesh = zoo(("tet4",))
    for scale in (1e-120, 1e-99, 1e98, 1e110, -1.0):
        points = mesh.points * scale
        moved = written(cdb, VolumeMesh(points, mesh.blocks))
        lines = moved[moved.index("NBLOCK") :].splitlines()[2:6]
        assert {len(line) for line in lines} == {27 + 63}
        read = np.array([[float(line[27 + 21 * i :][:21]) for i in range(3)] for line in lines])
        assert (np.abs(read - points) <= 5.01e-14 * np.abs(points)).all()


@pytest.mark.parametrize("shape", SHAPED)
def test_pressures_go_to_the_faces_that_ansys_calls_so(shape):
    mesh = zoo((shape,))
    step = Step("press", "static", pressed=(Pressed("3 odd/é name", 1.5),))
    deck = written(cdb, Job("job", mesh, {"SOLID": STEEL}, (step,)))
    kind = int(re.search(r"^ET,1,(\d+)$", deck, re.M)[1])
    words = [int(word) for row in block(deck, "EBLOCK", 9, " +-1$") for word in row]
    nodes = dict(zip("IJKLMNOP", words[11:], strict=False))
    pressed = re.findall(r"^SFE,1,(\d),PRES,0,1\.5$", deck, re.M)
    for face, number in zip(SHAPES[shape].faces, pressed, strict=True):
        named = {nodes[letter] for letter in FACES[kind][int(number) - 1]}
        assert named == {node + 1 for node in face}


def test_commands_of_each_step():
    deck = written(cdb, zoo_job(system="m-SI"))
    for line in ("D,ZMIN,UX,0.0", "D,ZMIN,UZ,-0.000125", "ANTYPE,STATIC", "LSCLEAR,ALL", "SOLVE"):
        assert f"\n{line}\n" in deck
    assert "\nMP,EX,2,1234567890.0\n" in deck
    assert len(re.findall(r"^SFE,\d,\d,PRES,0,2500000.0$", deck, re.M)) == 5
    modal = written(cdb, zoo_job("modal"))
    assert "ANTYPE,MODAL\nMODOPT,LANB,7\nMXPAND,7\nD,ZMIN,UX,0.0\n" in modal
    heat = written(cdb, zoo_job("conduction"))
    assert re.findall(r"^ET,\d,(\d+)$", heat, re.M) == ["70", "70", "87", "90", "70"]
    assert "\nMP,KXX,2,0.02\n" in heat
    assert "\nD,ZMIN,TEMP,300.5\n" in heat
    assert "SOLVE" not in written(cdb, zoo())


def test_names_of_parts_of_all_kinds_are_one_space():
    mesh = zoo(("tet4",))
    parts = {"grip 1": Part("nodes", np.array([0])), "GRIP-1": Part("cells", np.array([0]))}
    with pytest.raises(FormatError, match="'grip 1' and 'GRIP-1' would both be GRIP_1"):
        written(cdb, VolumeMesh(mesh.points, mesh.blocks, {}, parts))
    long = {f"{'x' * 32}{i}": Part("nodes", np.array([i])) for i in range(2)}
    with pytest.raises(FormatError, match=r"would both be X{32} "):
        written(cdb, VolumeMesh(mesh.points, mesh.blocks, {}, long))


def test_runs_of_components_are_numbers_with_their_ends_negative():
    mesh = zoo(("hex20",))
    parts = {"SOME": Part("nodes", np.array([0, 2, 3, 5, 6, 7, 8, 9, 19, 19]))}
    deck = written(cdb, VolumeMesh(mesh.points, mesh.blocks, {}, parts))
    assert (
        f"CMBLOCK,SOME,NODE,{6:8d}\n(8i10)\n{1:10d}{3:10d}{4:10d}{6:10d}{-10:10d}{20:10d}\n" in deck
    )


def test_what_is_not_known_of_a_material_is_left_out():
    deck = written(cdb, zoo_job())
    assert re.findall(r"^MP,(\w+),2,", deck, re.M) == ["EX", "PRXY", "DENS", "KXX"]
    assert SOFT.specific_heat is None
