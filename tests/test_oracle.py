"""The transfer matrix against published closed forms and against voxels counted one by one."""

from fractions import Fraction

import naive_oracle as naive
import numpy as np
import pytest

from porous.kernels.windows import FUNCTIONALS, window_histogram
from porous.models.digits import DigitSet, named
from porous.models.features import narrowest_run
from porous.models.ifs import ifs
from porous.models.oracle import Prefractal
from porous.stages import voxelize

# Cells, faces and χ of the closed union at level n, for n ≥ the last column.
TABLE = {
    "menger": (
        20,
        lambda n: 2 * 20**n + 4 * 8**n,
        lambda n: Fraction(192 - 38 * 8**n - 21 * 20**n, 133),
        0,
    ),
    "vicsek-7": (7, lambda n: 4 * 7**n + 2, lambda _: 1, 0),
    "vicsek-9": (9, lambda n: 6 * 9**n, lambda _: 1, 0),
    "cantor-dust": (8, lambda n: 6 * 8**n, lambda n: 8**n, 0),
    "mosely-light": (
        18,
        lambda n: Fraction(30 * 18**n + 48 * 5**n, 13),
        lambda n: Fraction(5 * 18**n, 153) + Fraction(24, 17),
        1,
    ),
    "mosely-heavy": (19, lambda n: Fraction(12 * 19**n + 30 * 5**n, 7), lambda _: 1, 0),
    "carpet-prism": (
        24,
        lambda n: Fraction(4 * 24**n + 16 * 9**n, 5) + 2 * 8**n,
        lambda n: Fraction(8 - 8**n, 7),
        0,
    ),
    "cube-minus-centre": (
        26,
        lambda n: Fraction(6 * 26**n + 96 * 9**n, 17),
        lambda n: Fraction(24 + 26**n, 25),
        0,
    ),
    "edge-cubes": (
        12,
        lambda n: 6 * 12**n,
        lambda n: Fraction(24, 11) - Fraction(17 * 12**n, 33),
        1,
    ),
    "even-parity": (4, lambda n: 6 * 4**n, lambda n: 2 - Fraction(4**n, 4), 1),
    "minus-corner": (
        7,
        lambda n: Fraction(9 * 3**n + 3 * 7**n, 2),
        lambda n: Fraction(19, 12) - Fraction(3 * 3**n, 8) + Fraction(13 * 7**n, 168),
        1,
    ),
}


@pytest.mark.parametrize("name", TABLE)
@pytest.mark.parametrize("level", [0, 1, 2, 3, 4, 5, 12])
def test_published_closed_forms(name, level):
    cells, faces, euler, from_level = TABLE[name]
    body = Prefractal(named(name), level)
    assert body.cells == body.count("cells") == cells**level
    assert body.faces == (faces(level) if level >= from_level else 6)
    if level >= from_level:
        assert body.count("euler_number_26") == euler(level)


@pytest.mark.parametrize("level", range(6))
def test_menger_vertices_edges_faces_and_genus(level):
    body = Prefractal(named("menger"), level)
    n = level
    vertices = (
        Fraction(192, 133)
        + Fraction(192, 85) * 3**n
        + Fraction(88, 35) * 8**n
        + Fraction(576, 323) * 20**n
    )
    edges = Fraction(192, 85) * 3**n + Fraction(24, 5) * 8**n + Fraction(84, 17) * 20**n
    assert body.count("vertices") == vertices
    assert body.count("edges") == edges
    assert body.count("faces") == 4 * 20**n + 2 * 8**n
    assert body.genus(6) == body.genus(26) == 1 - body.count("euler_number")


def test_menger_genus_is_the_known_sequence():
    # OEIS A135918.
    genera = [Prefractal(named("menger"), n).genus() for n in range(5)]
    assert genera == [0, 5, 81, 1409, 26433]


def check_against_voxels(digits, level, periodic=(False, False, False)):
    body = Prefractal(digits, level, periodic)
    solid = naive.voxels(digits.divisions, digits.keep, level)
    assert body.histogram == naive.histogram(solid, periodic)
    for connectivity in (6, 26):
        known = body.components(connectivity)
        assert known in (None, naive.components(solid, connectivity, periodic))
    if any(periodic):
        assert body.cavities() is None
        assert body.genus() is None
        return
    assert body.faces == naive.faces(solid)
    assert body.count("euler_number_26") == naive.euler_number_26(solid)
    assert body.count("euler_number") == naive.euler_number_6(solid)
    assert narrowest_run(digits, level) == naive.narrowest_run(solid)
    for connectivity in (6, 26):
        assert body.cavities(connectivity) in (None, naive.cavities(solid, connectivity))


@pytest.mark.parametrize("name", TABLE)
@pytest.mark.parametrize("level", [0, 1, 2])
def test_named_sets_against_voxels(name, level):
    check_against_voxels(named(name), level)


PERIODIC = [(True, True, True), (True, False, False), (False, True, True), (False, False, True)]


@pytest.mark.parametrize("seed", range(20))
def test_random_digit_sets_against_voxels(seed):
    rng = np.random.default_rng(seed)
    divisions = 2 + seed % 3
    digits = DigitSet(divisions, naive.random_digits(rng, divisions))
    for level in range(4 if divisions == 2 else 3 if divisions == 3 else 2):
        check_against_voxels(digits, level)
        check_against_voxels(digits, level, PERIODIC[(seed + level) % 4])


@pytest.mark.parametrize("name", ["menger", "vicsek-7", "cantor-dust", "even-parity"])
def test_a_periodic_body_is_what_is_added_by_one_more_copy(name):
    digits = named(name)
    for level in (1, 2):
        tile = Prefractal(digits, level, (True, False, False))
        solid = naive.voxels(digits.divisions, digits.keep, level)
        two, three = np.concatenate([solid] * 2), np.concatenate([solid] * 3)
        for functional in ("faces_x", "faces_y", "euler_number", "euler_number_26", "edges"):
            one_more = [
                int(np.dot(naive.histogram(body), FUNCTIONALS[functional])) for body in (two, three)
            ]
            assert tile.count(functional) == one_more[1] - one_more[0]


def test_components_where_they_are_known():
    pieces = {
        (name, connectivity): Prefractal(named(name), 3).components(connectivity)
        for name in TABLE
        for connectivity in (6, 26)
    }
    assert pieces["menger", 6] == pieces["vicsek-7", 6] == 1
    assert pieces["vicsek-9", 6] == 729
    assert pieces["vicsek-9", 26] == 1
    assert pieces["cantor-dust", 6] == pieces["cantor-dust", 26] == 512
    assert pieces["even-parity", 6] == 64
    assert pieces["edge-cubes", 6] == 1728


def test_cavities_are_not_claimed_where_they_are():
    assert Prefractal(named("cube-minus-centre"), 1).cavities() == 1
    assert Prefractal(named("cube-minus-centre"), 2).cavities() is None
    assert Prefractal(named("menger"), 5).cavities() == 0
    # Under the rule of the 6-connected solid, Mosely's light sponge drains through its corners.
    assert Prefractal(named("mosely-light"), 3).genus() == 2401


def test_deep_levels_are_whole_numbers():
    body = Prefractal(named("menger"), 40)
    assert body.count("cells") == 20**40
    assert body.faces == 2 * 20**40 + 4 * 8**40
    assert sum(body.histogram) == (3**40 + 1) ** 3
    assert narrowest_run(named("menger"), 40) == 1


def test_narrowest_run_of_wide_gaps():
    digits = DigitSet(5, np.array([[0, 0, 0], [3, 0, 0], [4, 0, 0]]))
    for level in range(4):
        solid = naive.voxels(5, digits.keep, level)
        assert narrowest_run(digits, level) == naive.narrowest_run(solid)
    assert narrowest_run(DigitSet(2, np.array([[0, 0, 0]])), 5) is None


def test_many_divisions_cost_no_loop_over_sub_cubes():
    rng = np.random.default_rng(5)
    every = np.argwhere(rng.random((40, 40, 40)) < 0.5)
    body = Prefractal(DigitSet(40, every), 1, (False, True, False))
    solid = naive.voxels(40, every, 1)
    assert body.count("cells") == len(every)
    padded = np.pad(np.pad(solid, ((0, 0), (1, 1), (0, 0)), mode="wrap"), ((1, 1), (0, 0), (1, 1)))
    inner = padded[:, 1:-1, :].astype(int)
    assert body.count("faces_x") == np.abs(np.diff(inner, axis=0)).sum()


def check_grid(digits, level, periodic=(False, False, False)):
    """The model's own voxels, counted by the kernel, against the transfer matrix."""
    model = ifs(digits, level=level)
    count = digits.divisions**level
    grid = voxelize(model, voxels=count, sampling="centre", periodic=periodic)
    assert grid.frame.shape == (count,) * 3
    body = Prefractal(digits, level, periodic)
    assert tuple(window_histogram(grid.fill, periodic=periodic).tolist()) == body.histogram
    assert int(grid.solid.sum()) == body.cells
    assert (grid.solid == naive.voxels(digits.divisions, digits.keep, level)).all()


@pytest.mark.parametrize("name", TABLE)
def test_voxels_of_the_named_sets_have_the_oracle_s_windows(name):
    for level in (1, 2, 3):
        check_grid(named(name), level)
    check_grid(named(name), 2, (True, False, True))


@pytest.mark.parametrize("seed", range(20))
def test_voxels_of_random_sets_have_the_oracle_s_windows(seed):
    rng = np.random.default_rng(100 + seed)
    divisions = 2 + seed % 3
    digits = DigitSet(divisions, naive.random_digits(rng, divisions))
    for level in (1, 2, 3):
        check_grid(digits, level, PERIODIC[seed % 4] if level == 2 else (False, False, False))
