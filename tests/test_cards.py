"""What decks of cards share: numbers in columns, names, and jobs that they cannot hold."""

import importlib
import re
from itertools import pairwise

import numpy as np
import pytest
from deck_meshes import SOFT, STEEL, STEPS, written, zoo, zoo_job
from hypothesis import given
from hypothesis import strategies as st

from porous import formats
from porous.errors import FormatError
from porous.formats._cards import fit, node_rows, plain, runs
from porous.values import Block, Held, Job, Material, Part, Pressed, Step, VolumeMesh

STEMS = ("cdb", "bdf", "k", "feb")
LINEAR = ("tet4", "wed6", "hex8")


def form(stem):
    return importlib.import_module(f"porous.formats.{stem}")


each = pytest.mark.parametrize("stem", STEMS)
decks = pytest.mark.parametrize("stem", [*STEMS, "su2"])

reals = st.floats(-1e300, 1e300) | st.floats(-1e4, 1e4)


@given(st.lists(st.tuples(reals, reals, reals), min_size=1, max_size=5))
def test_coordinates_keep_what_sixteen_characters_hold(points):
    points = np.array(points)
    text = b"".join(node_rows(points, ("%8d", "", ""), "|\n")).decode()
    for number, (line, row) in enumerate(zip(text.splitlines(), points, strict=True), 1):
        assert len(line) == 8 + 3 * 16 + 1
        assert int(line[:8]) == number
        for word, value in zip([line[8 + 16 * i :][:16] for i in range(3)], row, strict=True):
            assert "." in word
            size = abs(value)
            bound = 5.01e-14 if size < 1 else 5.01e-13 * size if size < 1e12 else 5e-8 * size
            assert abs(float(word) - value) <= max(bound, 1e-300)
            if 1e-300 < size < 1e-5:
                assert abs(float(word) - value) <= 5.01e-9 * size


def test_columns_are_filled():
    line = b"".join(node_rows(np.array([[1 / 3, -1 / 3, 1e-7 / 3]]), ("%d", "", ""), "")).decode()
    assert line == "1" + "0.33333333333333" + "-0.3333333333333" + "3.3333333333e-08"


@given(st.floats(1e-30, 1e30) | st.floats(-1e30, -1e-30), st.sampled_from([10, 16, 20]))
def test_a_number_is_fitted_as_well_as_its_columns_allow(value, width):
    text = fit(value, width)
    assert len(text) <= width
    assert "." in text
    assert float(text) == pytest.approx(value, rel=0.5 * 10.0 ** (7 - width) * 10, abs=0)


@given(st.sets(st.integers(0, 60), min_size=1))
def test_runs_are_what_they_run_over(members):
    first, last = runs(np.array(sorted(members)))
    spans = [range(a, b + 1) for a, b in zip(first.tolist(), last.tolist(), strict=True)]
    assert [n for span in spans for n in span] == sorted(members)
    assert all(b.start > a.stop for a, b in pairwise(spans))


@given(st.text(max_size=40))
def test_plain_text_is_harmless(text):
    said = plain(text)
    assert re.fullmatch(r"([A-Za-z0-9][A-Za-z0-9 .,;:()/+_-]*)?", said)
    assert "--" not in said


SLY = "*END\n/EOF $ ENDDATA <x> --> %p% =1 \x07 é³"


@decks
def test_no_text_becomes_a_card(stem):
    mesh = zoo(LINEAR)
    calm = Job("calm", mesh, {}, why_no_step="none")
    sly = Job(SLY, mesh, {}, why_no_step=SLY, note=SLY)

    def cards(job):
        said = re.sub(r"<!--(?:(?!--).)*-->", "", written(form(stem), job))
        kept = (line for line in said.splitlines() if line and not re.match(r"[!$%]", line))
        return [line for line in kept if not re.match(r"/TITLE,|TITLE = ", line)]

    assert [len(a) - len(b) for a, b in zip(cards(sly), cards(calm), strict=True) if a != b] in (
        [],
        [len(plain(SLY)) - len("calm")],  # LS-DYNA's title stands alone
    )


@decks
def test_names_that_would_be_one_are_refused(stem):
    mesh = zoo(LINEAR)
    parts = {name: Part("faces", np.array([[0, 0]])) for name in ("grip 1", "grip_1")}
    with pytest.raises(FormatError, match="'grip 1' and 'grip_1' would both be GRIP_1"):
        written(form(stem), VolumeMesh(mesh.points, mesh.blocks, {}, parts))


@pytest.mark.parametrize("stem", ["bdf", "cdb", "feb", "k"])
def test_no_part_has_a_name_of_the_format_itself(stem):
    mesh = zoo(LINEAR)
    deck = written(
        form(stem),
        VolumeMesh(mesh.points, mesh.blocks, {}, {"all": Part("nodes", np.array([0]))}),
    )
    wanted = {
        "cdb": "CMBLOCK,N_ALL,NODE,       1\n",
        "feb": '<Nodes name="ALL_1">\n',
        "bdf": "$ nodes ALL: set 1\n",
        "k": "*SET_NODE_LIST_TITLE\nALL\n         1\n",
    }
    assert wanted[stem] in deck
    assert deck.count("CMBLOCK,ALL,") == 0
    assert deck.count('"ALL"') == (stem == "feb")


@decks
def test_an_empty_mesh_is_refused(stem):
    with pytest.raises(FormatError, match="no cells"):
        written(form(stem), VolumeMesh(np.zeros((0, 3)), ()))


def changed(step, **more):
    return Step(**{name: getattr(step, name) for name in ("name", "procedure", "held")} | more)


HOT = Held("ZMIN", "temperature", 1.0)
PUSH = Pressed("ZMIN_FACES", 1.0)


@each
@pytest.mark.parametrize(
    ("steps", "said"),
    [
        ((STEPS["static"], STEPS["modal"]), "modal and static"),
        ((changed(STEPS["static"], held=(HOT,)),), "cannot hold a temperature"),
        ((changed(STEPS["modal"], modes=0),), "0 modes; wanted 1 or more"),
        ((changed(STEPS["modal"], modes=3, pressed=(PUSH,)),), "bears no pressure"),
        ((changed(STEPS["static"], procedure="modal", modes=1),), "where they are"),
    ],
)
def test_steps_that_a_deck_cannot_hold_are_refused(stem, steps, said):
    mesh = zoo(LINEAR)
    job = Job("job", mesh, {"SOLID": STEEL, "PORE": SOFT}, steps)
    with pytest.raises(FormatError, match=said):
        written(form(stem), job)


@pytest.mark.parametrize("stem", ["k", "feb"])
def test_two_steps_are_refused_where_the_second_would_go_on(stem):
    mesh = zoo(LINEAR)
    job = Job("job", mesh, {"SOLID": STEEL, "PORE": SOFT}, (STEPS["static"],) * 2)
    with pytest.raises(FormatError, match=r"2 steps .* wanted 1"):
        written(form(stem), job)


@each
def test_numbers_of_numpy_are_numbers(stem):
    mesh = zoo(("hex8",))
    two = np.float64(2.5)
    mine = Material("mine", two, np.float64(0.25), np.float64(1e-9))
    held = Held("ZMIN", "displacement", two, (0, 1, 2))

    def job(material, held, pressure):
        step = Step("step", "static", (held,), (Pressed("ZMIN_FACES", pressure),))
        return Job("job", mesh, {"SOLID": material}, (step,))

    plainer = job(
        Material("mine", 2.5, 0.25, 1e-9), Held("ZMIN", "displacement", 2.5, (0, 1, 2)), 2.5
    )
    assert written(form(stem), job(mine, held, two)) == written(form(stem), plainer)


@each
def test_cells_of_nothing_are_refused(stem):
    job = Job("job", zoo(LINEAR), {"SOLID": STEEL}, (STEPS["static"],))
    with pytest.raises(FormatError, match=r"1 cells are made of nothing; wanted .* SOLID"):
        written(form(stem), job)


@each
def test_tied_nodes_are_refused(stem):
    mesh = zoo(("hex8",))
    pairs = {"XPAIRS": Part("pairs", np.array([[0, 1], [3, 2], [4, 5], [7, 6]]))}
    mesh = VolumeMesh(mesh.points, mesh.blocks, {}, {**mesh.parts, **pairs})
    written(form(stem), mesh)  # pairs themselves are left out
    with pytest.raises(FormatError, match=r"tied nodes \(XPAIRS\); wanted .inp"):
        written(form(stem), Job("job", mesh, {"SOLID": STEEL}, tied=("XPAIRS",)))


@pytest.mark.parametrize(("name", "wrong"), [("a.su2", "tet10"), ("a.su2", "static")])
def test_what_a_format_does_not_hold_is_told_by_the_registry(tmp_path, name, wrong):
    shapes = ("tet10",) if wrong == "tet10" else LINEAR
    with pytest.raises(FormatError, match=f"cannot hold .*{wrong}; wanted one of .*\\.bdf"):
        formats.write(zoo_job(shapes=shapes, procedure="static"), tmp_path / name)
    assert not list(tmp_path.iterdir())


@decks
def test_blocks_without_cells_and_blocks_of_one_shape_are_no_trouble(stem):
    mesh = zoo(("hex8", "hex8"))
    empty = Block("tet4", np.zeros((0, 4), np.int64))
    parts = {"SOLID": Part("cells", np.arange(2))}
    whole = VolumeMesh(mesh.points, (empty, *mesh.blocks), {}, parts)
    bare = VolumeMesh(mesh.points, mesh.blocks, {}, parts)
    shown, plainer = (re.sub(r"\d+", "n", written(form(stem), m)) for m in (whole, bare))
    assert sorted(set(shown.split())) == sorted(set(plainer.split()))
