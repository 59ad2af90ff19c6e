"""LS-DYNA decks: fields, parts, and elements that are bricks with nodes that fall together."""

import re

import numpy as np
import pytest
import strict_k
from deck_meshes import SHAPED, SOFT, STEEL, STEPS, counts, element, volume, written, zoo, zoo_job

from porous import formats
from porous.errors import FormatError
from porous.formats import k
from porous.values import SHAPES, Block, Job, Material, Part, Step, VolumeMesh

LINEAR = ("tet4", "wed6", "hex8")
FORMULATIONS = {"tet4": 10, "hex8": 2, "wed6": 15, "tet10": 16, "hex20": 23}


def cards(deck):
    """Return the keywords of a deck in order, each with its lines of data."""
    result = []
    for line in deck.splitlines():
        if line.startswith("*"):
            result.append((line, []))
        elif not line.startswith("$"):
            result[-1][1].append(line)
    return result


def fields(line, width):
    assert len(line) % width == 0, line
    return [line[i : i + width].strip() for i in range(0, len(line), width)]


def of(deck, keyword):
    return [lines for name, lines in cards(deck) if name == keyword]


@pytest.mark.parametrize("shape", SHAPED)
def test_elements_have_the_lines_that_their_keyword_asks_for(shape):
    deck = written(k, zoo((shape,)))
    keyword = "*ELEMENT_SOLID_H20" if shape == "hex20" else "*ELEMENT_SOLID"
    (lines,) = of(deck, keyword)
    expected = {"tet10": [2, 10], "hex20": [2, 10, 10]}.get(shape, [10])
    assert [len(fields(line, 8)) for line in lines] == expected
    (section,) = of(deck, "*SECTION_SOLID")
    assert fields(section[0], 10) == ["1", str(FORMULATIONS[shape])]


@pytest.mark.parametrize("shape", LINEAR)
def test_linear_elements_are_positive_and_their_nodes_fall_together_as_the_manual_says(shape):
    (lines,) = of(written(k, zoo((shape,))), "*ELEMENT_SOLID")
    numbers = np.array(fields(lines[0], 8)[2:], int)
    x = element(shape)[numbers - 1]
    assert len(set(numbers)) == SHAPES[shape].nodes
    if shape == "tet4":  # N1 N2 N3 N4 N4 N4 N4 N4, which is no brick of that volume
        assert len(set(numbers[3:])) == 1
        size = np.linalg.det(x[1:4] - x[0]) / 6
    else:  # N1 N2 N3 N4 N5 N5 N6 N6 is one, bent over a rectangle
        assert shape == "hex8" or (numbers[4], numbers[6]) == (numbers[5], numbers[7])
        size = VolumeMesh(x, (Block("hex8", np.arange(8)[None]),)).volumes[0]
    assert size == pytest.approx(volume((shape,)), rel=1e-14)


@pytest.mark.parametrize("shape", ["tet10", "hex20"])
def test_nodes_in_the_middle_of_edges_follow_the_corners(shape):
    deck = written(k, zoo((shape,)))
    lines = next(lines for name, lines in cards(deck) if name.startswith("*ELEMENT"))
    numbers = np.array([word for line in lines[1:] for word in fields(line, 8)], int)
    points = element(shape)[numbers - 1]
    ring = [(0, 1), (1, 2), (2, 3), (3, 0)]
    edges = {
        "tet10": [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)],
        "hex20": [*ring, *((a + 4, b + 4) for a, b in ring), *((a, a + 4) for a in range(4))],
    }[shape]
    middle = [(points[a] + points[b]) / 2 for a, b in edges]
    assert np.allclose(points[len(points) - len(edges) :], middle)


def test_parts_are_of_one_material_and_one_shape():
    deck = written(k, zoo_job("modal"))
    parts = of(deck, "*PART")
    assert [lines[0] for lines in parts] == [
        *("SOLID tet4", "SOLID hex8", "SOLID tet10", "PORE hex20", "PORE wed6"),
    ]
    rows = [fields(lines[1], 10) for lines in parts]
    assert [row[0] for row in rows] == ["1", "2", "3", "4", "5"]
    assert [row[2] for row in rows] == ["1", "1", "1", "2", "2"]
    sections = dict(fields(lines[0], 10) for lines in of(deck, "*SECTION_SOLID"))
    assert [int(sections[row[1]]) for row in rows] == [FORMULATIONS[shape] for shape in SHAPED]
    materials = [fields(lines[0], 10) for lines in of(deck, "*MAT_ELASTIC")]
    steel, soft = ([float(word) for word in row[1:]] for row in materials)
    assert steel == [STEEL.density, STEEL.youngs_modulus, 0.3]
    assert soft == [SOFT.density, SOFT.youngs_modulus, 0.45]
    for number, lines in enumerate(
        (lines for name, lines in cards(deck) if name.startswith("*ELEMENT")), 1
    ):
        assert fields(lines[0], 8)[:2] == [str(number)] * 2


def sets(deck, keyword, width=10):
    result = {}
    for lines in of(deck, keyword):
        result[lines[0]] = [int(word) for line in lines[2:] for word in fields(line, width)]
        assert all(len(line) <= 80 for line in lines)
    return result


def test_sets_are_what_the_parts_are():
    mesh = zoo()
    deck = written(k, mesh)
    nodes, solids = sets(deck, "*SET_NODE_LIST_TITLE"), sets(deck, "*SET_SOLID_TITLE")
    assert nodes == {"ZMIN": (mesh.parts["ZMIN"].members + 1).tolist()}
    assert solids == {
        name: (mesh.parts[name].members + 1).tolist() for name in ("SOLID", "PORE", "WORD_01")
    }
    segments = sets(deck, "*SET_SEGMENT_TITLE")
    assert {name: len(some) for name, some in segments.items()} == {
        "ZMIN_FACES": 4 * 5,
        "N_3_ODD___NAME": 4 * 25,
    }
    # Seen from outside: the area vectors of closed bodies add up to nothing.
    corners = mesh.points[np.array(segments["N_3_ODD___NAME"]).reshape(-1, 4) - 1]
    area = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]) / 2
    assert np.abs(area.sum(axis=0)).max() < 1e-14
    flux = np.einsum("ij,ij->", area, corners.mean(axis=1) * [0, 0, 1])
    assert flux > 0


def test_identifiers_of_sets_are_their_own():
    deck = written(k, zoo_job(shapes=LINEAR))
    for keyword in ("*SET_NODE_LIST_TITLE", "*SET_SOLID_TITLE", "*SET_SEGMENT_TITLE"):
        numbers = [lines[1].strip() for lines in of(deck, keyword)]
        assert len(set(numbers)) == len(numbers)


def test_a_static_step_is_linear_and_its_loads_are_curves():
    deck = written(k, zoo_job(shapes=LINEAR, system="m-SI"))
    names = [name for name, _ in cards(deck)]
    assert names[0] == "*KEYWORD"
    assert names[-1] == "*END"
    assert fields(of(deck, "*CONTROL_IMPLICIT_GENERAL")[0][0], 10) == ["1", "1.0"]
    assert fields(of(deck, "*CONTROL_IMPLICIT_SOLUTION")[0][0], 10) == ["1"]
    curves = {}
    for number, *points in of(deck, "*DEFINE_CURVE"):
        rows = [[float(word) for word in fields(line, 20)] for line in points]
        assert rows[0] == [0.0, 0.0]
        curves[number.strip()] = rows[1]
    identifiers = {lines[0]: lines[1].strip() for lines in of(deck, "*SET_NODE_LIST_TITLE")}
    segments = {lines[0]: lines[1].strip() for lines in of(deck, "*SET_SEGMENT_TITLE")}
    (fixed,) = of(deck, "*BOUNDARY_SPC_SET")
    assert fields(fixed[0], 10) == [identifiers["ZMIN"], "0", "1", "1", "0", "0", "0", "0"]
    (moved,) = of(deck, "*BOUNDARY_PRESCRIBED_MOTION_SET")
    node_set, axis, kind, curve, scale = fields(moved[0], 10)
    assert (node_set, axis, kind, scale) == (identifiers["ZMIN"], "3", "2", "1.0")
    assert curves[curve] == [1.0, pytest.approx(-1.25e-4, rel=1e-12)]
    (pressed,) = of(deck, "*LOAD_SEGMENT_SET")
    segment_set, curve, scale, arrival = fields(pressed[0], 10)
    assert (segment_set, scale, arrival) == (segments["ZMIN_FACES"], "1.0", "0.0")
    assert curves[curve] == [1.0, 2.5e6]


def test_a_modal_step_says_how_many():
    deck = written(k, zoo_job("modal"))
    assert fields(of(deck, "*CONTROL_IMPLICIT_EIGENVALUE")[0][0], 10) == ["7"]
    assert not of(deck, "*CONTROL_IMPLICIT_SOLUTION")
    assert fields(of(deck, "*BOUNDARY_SPC_SET")[0][0], 10)[2:5] == ["1", "1", "1"]


def test_pressures_on_quadratic_faces_are_refused():
    with pytest.raises(FormatError, match="pressure on faces of quadratic"):
        written(k, zoo_job())


def test_a_material_without_density_is_refused_in_a_step_and_told_in_a_mesh():
    light = Material("light", 1.0, 0.2)
    mesh = zoo(("hex8",))
    with pytest.raises(FormatError, match="material light: has no density"):
        written(k, Job("job", mesh, {"SOLID": light}, (STEPS["static"],)))
    deck = written(k, Job("job", mesh, {"SOLID": light}))
    assert not of(deck, "*MAT_ELASTIC")
    assert fields(of(deck, "*PART")[0][1], 10) == ["1", "1", "0"]
    assert re.search(r"^\$ material 1, SOLID: not given", deck, re.M)


def test_a_strict_reader_takes_what_is_written(tmp_path):
    pressed = Step("press", "static", STEPS["modal"].held, STEPS["static"].pressed)
    parts = {"SOLID": STEEL, "PORE": SOFT}
    static = Job("job", zoo(LINEAR), parts, (pressed,))
    for name, job, shapes in (("static", static, LINEAR), ("modal", zoo_job("modal"), SHAPED)):
        formats.write(job, tmp_path / f"{name}.k")
        told = strict_k.read(tmp_path / f"{name}.k")
        assert told["elements"] == dict.fromkeys(shapes, 1)
        assert told["nodes"] == len(zoo(shapes).points)
        assert told["volume"] == pytest.approx(volume(shapes), rel=1e-12)
        wanted = counts(zoo(shapes))
        assert told["node_sets"] == wanted["nodes"]
        assert told["cell_sets"] == wanted["cells"]
        assert list(told["face_sets"].values()) == list(wanted["faces"].values())


def test_too_many_cells_are_refused(monkeypatch):
    monkeypatch.setattr(k, "MOST", 4)
    with pytest.raises(FormatError, match="1 cells; a deck holds 4"):
        written(k, zoo(("hex8",)))


def test_faces_named_twice_stand_once():
    mesh = zoo(("hex8",))
    twice = {"TWICE": Part("faces", np.array([[0, 1], [0, 1]]))}
    deck = written(k, VolumeMesh(mesh.points, mesh.blocks, {}, twice))
    assert len(sets(deck, "*SET_SEGMENT_TITLE")["TWICE"]) == 4
