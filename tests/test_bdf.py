"""Nastran decks: what pyNastran and Gmsh read, and that every card keeps to its fields."""

import re

import numpy as np
import pytest
from deck_meshes import SHAPED, SOFT, STEEL, STEPS, base, counts, volume, written, zoo, zoo_job
from test_inp import voxel_job

from porous import formats
from porous.formats import bdf
from porous.values import SHAPES, Held, Job, Part, Pressed, Step, VolumeMesh

LINEAR = ("tet4", "wed6", "hex8")
CLOSE = 5.01e-14
"""Half of the last decimal of coordinates from 0 to 10, in units of their column's first digit."""


@pytest.fixture(scope="module")
def decks():
    """Every kind of value that a deck is made of, by the name of its file."""
    voxels = voxel_job(np.ones((3, 2, 4), bool), (0.1, 0.25, 1 / 3), unit="cm")
    jobs = {kind: zoo_job(kind) for kind in STEPS}
    alone = {shape: zoo_job(shapes=(shape,)) for shape in SHAPED}
    bare = {"bare": zoo(unit="um")}
    return jobs | alone | bare | {"si": zoo_job(system="m-SI", unit="in"), "voxels": voxels}


@pytest.mark.judge
def test_pynastran_reads_what_was_written(decks, ask, tmp_path):
    for name, value in decks.items():
        formats.write(value, tmp_path / f"{name}.bdf")
    said = ask("pynastran", *(tmp_path / f"{name}.bdf" for name in decks))
    found = dict(zip(decks, said, strict=True))
    for name, value in decks.items():
        mesh, got = getattr(value, "mesh", value), found[name]
        scale = {"bare": 1e-3, "si": 0.0254, "voxels": 10.0}.get(name, 1.0)
        points = np.array(got["points"])
        # Coordinates reach 10 in two decks, whose last decimal is one less.
        assert np.abs(points - mesh.points * scale).max() <= (CLOSE * 10 if scale == 10 else CLOSE)
        assert got["elements"] == {
            shape: sum(len(b.cells) for b in mesh.blocks if b.shape == shape)
            for shape in dict.fromkeys(b.shape for b in mesh.blocks)
        }
        assert got["volume"] == pytest.approx(mesh.volumes.sum() * scale**3, rel=1e-9)
        assert got["off_middle"] <= 4 * CLOSE
        names = {"3 odd/é name": "N_3_ODD___NAME"}
        for kind, sets in (("nodes", "node_sets"), ("cells", "cell_sets"), ("faces", "face_sets")):
            assert got[sets] == {names.get(n, n): c for n, c in counts(mesh)[kind].items()}
    check_steps(found)


def check_steps(found):
    assert [found[name]["sol"] for name in STEPS] == [101, 103, 153]
    assert found["static"]["properties"] == {"1": 3, "2": 2}
    steel, soft = (found["si"]["materials"][n] for n in "12")
    assert steel == pytest.approx([2.1e11, 0.3, 7850.0], rel=1e-9)
    assert soft == pytest.approx([1.23456789e9, 0.45, 1250.0], rel=1e-9)
    assert found["static"]["materials"]["2"] == [SOFT.youngs_modulus, 0.45, SOFT.density]
    # The pressure on the faces below pushes up, and is 1e6 times as much in pascals.
    for name, area in (("static", base()), *((s, base((s,))) for s in SHAPED)):
        (step,) = found[name]["steps"]
        assert step["force"] == pytest.approx([0, 0, 2.5 * area], abs=1e-12)
        assert step["held"] == np.sum(zoo((name,) if name in SHAPED else SHAPED).points[:, 2] == 0)
    assert found["si"]["steps"][0]["force"][2] == pytest.approx(2.5e6 * base() * 0.0254**2)
    assert found["voxels"]["steps"][0]["force"] == pytest.approx([0, 0, -3.0 * 3 * 5.0])
    assert found["modal"]["methods"] == {"1": 7}


@pytest.mark.judge
def test_gmsh_reads_the_linear_elements(ask, tmp_path):
    # Its reader takes quadratic elements for linear ones, and writes past its own memory.
    formats.write(zoo_job(shapes=LINEAR), tmp_path / "deck.bdf")
    said = ask("gmsh_mesh", tmp_path / "deck.bdf")
    assert said["complaints"] == []
    assert said["elements"] == dict.fromkeys(LINEAR, 1)
    assert said["volume"] == pytest.approx(volume(LINEAR), rel=1e-12)
    assert said["least"] > 0


def bulk(deck):
    return deck.partition("BEGIN BULK\n")[2].splitlines()


def test_every_card_keeps_to_its_fields(decks):
    for value in decks.values():
        control, _, cards = written(bdf, value).partition("BEGIN BULK\n")
        assert all(len(line) <= 72 for line in control.splitlines())
        for line in cards.splitlines():
            if line.startswith("$"):
                continue
            assert len(line) <= 72
            width = 16 if "*" in line[:8] else 8
            fields = [line[start : start + width] for start in range(8, len(line), width)]
            assert all(re.fullmatch(r" *([-+0-9.e]*|THRU)", field) for field in fields), line
            for field in fields[2:] if line.startswith("GRID") else []:
                assert "." in field


def test_upright_edges_of_a_brick_come_before_those_of_its_top():
    lines = bulk(written(bdf, zoo(("hex20",))))
    start = next(i for i, line in enumerate(lines) if line.startswith("CHEXA"))
    words = " ".join([lines[start][24:], *lines[start + 1 : start + 3]]).split()
    points = zoo(("hex20",)).points[np.array(words, int) - 1]
    bottom, upright, top = points[8:12], points[12:16], points[16:20]
    assert np.ptp(bottom[:, 2]) == np.ptp(top[:, 2]) == 0
    assert np.allclose(upright, (points[:4] + points[4:8]) / 2)


def test_pressures_name_faces_as_the_guide_says():
    for shape in SHAPED:
        mesh = zoo((shape,))
        faces = np.array([(0, f) for f in range(len(SHAPES[shape].faces))])
        mesh = VolumeMesh(mesh.points, mesh.blocks, {}, {"ALL": Part("faces", faces)})
        cards = [line for line in bulk(written(bdf, mesh)) if line.startswith("PLOAD4")]
        quadrangles_first = sorted(SHAPES[shape].faces, key=lambda face: -len(face))
        for card, face in zip(cards, quadrangles_first, strict=True):
            first, other = int(card[56:64]) - 1, card[64:72].strip()
            assert first in face
            if shape.startswith("tet"):
                assert {int(other) - 1} == {0, 1, 2, 3} - set(face)
            elif len(face) == 4:
                assert int(other) - 1 == face[(face.index(first) + 2) % 4]
            else:
                assert other == ""


def test_each_step_is_a_case_of_its_own():
    held = (Held("ZMIN", "displacement", components=(0, 1, 2)),)
    pressed = Pressed("3 odd/é name", 4.0)
    steps = [Step(name, "static", held, pressed=(pressed,) * n) for n, name in enumerate("abc")]
    job = Job("three", zoo(), {"SOLID": STEEL, "PORE": SOFT}, tuple(steps))
    control, _, cards = written(bdf, job).partition("BEGIN BULK\n")
    assert re.findall(r"SUBCASE (\d)", control) == ["1", "2", "3"]
    assert re.findall(r"LOAD = (\d+)", control) == ["11", "12"]
    assert re.findall(r"^LOAD\* +(\d+)", cards, re.M) == ["11", "12"]
    # Three or more fields go on in a second pair of lines.
    assert re.search(r"^LOAD\* +12 +1\.0 +4\.0 +3\n\* +4\.0 +3\n", cards, re.M)


def test_what_is_not_known_of_a_material_is_not_made_up():
    deck = written(bdf, zoo())
    assert "add MAT1 1" in deck
    assert "MAT1*" not in deck
    assert "MAT4" not in written(bdf, Job("job", zoo(), {"SOLID": STEEL.__class__("x", 1.0, 0.2)}))
