"""Voxels, faces and Euler numbers of digit sets: kernels, oracle, closed forms and brute force."""

from itertools import product

import naive_measures
import numpy as np
import pytest
from skimage.measure import euler_number as skeuler

from porous import ifs, measures, voxelize
from porous.models.digits import DigitSet
from porous.models.oracle import Prefractal
from porous.values import Frame, VoxelGrid

measures_of = {
    "euler_number": measures.euler_number,
    "euler_number_26": measures.euler_number_26,
}
THREE = list(product(range(3), repeat=3))


def by_ones(*counts):
    """Return the digits of base 3 with so many coordinates equal to 1."""
    return [d for d in THREE if d.count(1) in counts]


# Number of kept digits; closed forms in units of one voxel: cells, faces and χ of the closed union
# at levels 1, 2, 3.
SETS = {
    "menger": (3, by_ones(0, 1), lambda n: 2 * 20**n + 4 * 8**n, (-4, -80, -1408)),
    "vicsek 7": (3, by_ones(2, 3), lambda n: 4 * 7**n + 2, (1, 1, 1)),
    "vicsek 9": (3, by_ones(0, 3), lambda n: 6 * 9**n, (1, 1, 1)),
    "cantor dust": (3, by_ones(0), lambda n: 6 * 8**n, (8, 64, 512)),
    "mosely light": (3, by_ones(1, 2), lambda n: (30 * 18**n + 48 * 5**n) // 13, (2, 12, 192)),
    "mosely heavy": (3, by_ones(1, 2, 3), lambda n: (12 * 19**n + 30 * 5**n) // 7, (1, 1, 1)),
    "carpet": (
        3,
        [d for d in THREE if d[:2] != (1, 1)],
        lambda n: (4 * 24**n + 16 * 9**n) // 5 + 2 * 8**n,
        (0, -8, -72),
    ),
    "minus centre": (3, by_ones(0, 1, 2), lambda n: (6 * 26**n + 96 * 9**n) // 17, (2, 28, 704)),
    "edge cubes": (3, by_ones(1), lambda n: 6 * 12**n, (-4, -72, -888)),
    "even parity": (
        2,
        [d for d in product(range(2), repeat=3) if sum(d) % 2 == 0],
        lambda n: 6 * 4**n,
        (1, -2, -14),
    ),
    "minus corner": (
        2,
        [d for d in product(range(2), repeat=3) if any(d)],
        lambda n: (9 * 3**n + 3 * 7**n) // 2,
        (1, 2, 18),
    ),
}


def prefractal(divisions, keep, level):
    """Return the solid voxels of a digit set by repeated products of its table."""
    table = np.zeros((divisions,) * 3, bool)
    table[tuple(np.array(keep).T)] = True
    solid = np.ones((1, 1, 1), bool)
    for _ in range(level):
        solid = np.kron(solid, table).astype(bool)
    return solid


def grid_of(solid, periodic=(False, False, False)):
    side = 1 / len(solid)
    return VoxelGrid.of_solid(solid, Frame((0, 0, 0), (side,) * 3, solid.shape, periodic))


def counted(solid, periodic=(False, False, False)):
    """Return cells, faces and both Euler numbers as the measures of a grid tell them."""
    grid, n = grid_of(solid, periodic), len(solid)
    return (
        round(measures.volume(grid, method="voxel count").value * n**3),
        round(measures.surface_area(grid, method="voxel faces").value * n**2),
        measures.euler_number(grid).value,
        measures.euler_number_26(grid).value,
    )


def by_hand(solid, periodic=(False, False, False)):
    vefc = naive_measures.complex_counts(solid, periodic)
    return (
        int(solid.sum()),
        sum(naive_measures.faces(solid, periodic)),
        naive_measures.euler_number_6(solid, periodic),
        int(np.dot(vefc, (1, -1, 1, -1))),
    )


def oracle(divisions, keep, level, periodic=(False, False, False)):
    body = Prefractal(DigitSet(divisions, np.array(keep)), level, periodic)
    return (
        body.cells,
        body.faces,
        body.count("euler_number"),
        body.count("euler_number_26"),
    )


@pytest.mark.parametrize("level", [1, 2, 3])
@pytest.mark.parametrize("name", SETS)
def test_eleven_sets_equal_oracle_and_closed_form(name, level):
    divisions, keep, faces, euler = SETS[name]
    solid = prefractal(divisions, keep, level)
    found = counted(solid)
    assert found == oracle(divisions, keep, level)
    assert found[0] == len(keep) ** level
    assert found[1] == faces(level)
    assert found[3] == euler[level - 1]
    if divisions**level <= 9:
        assert found == by_hand(solid)


@pytest.mark.slow
@pytest.mark.parametrize("name", SETS)
def test_eleven_sets_equal_brute_force_at_level_three(name):
    divisions, keep, _, _ = SETS[name]
    solid = prefractal(divisions, keep, 3)
    assert counted(solid) == by_hand(solid)


def random_digits(seed):
    random = np.random.default_rng(seed)
    divisions = 2 + seed % 3
    table = random.random((divisions,) * 3) < random.uniform(0.3, 0.9)
    table[tuple(random.integers(0, divisions, 3))] = True
    return divisions, np.argwhere(table).tolist()


@pytest.mark.parametrize("seed", range(20))
def test_random_sets_equal_oracle_and_brute_force(seed):
    divisions, keep = random_digits(seed)
    periodic = tuple(bool(seed >> (2 + axis) & 1) for axis in range(3))
    for level, wraps in product((1, 2, 3), ((False, False, False), periodic)):
        solid = prefractal(divisions, keep, level)
        found = counted(solid, wraps)
        assert found == oracle(divisions, keep, level, wraps)
        if len(solid) <= 9:
            assert found == by_hand(solid, wraps)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(20))
def test_random_sets_equal_brute_force_at_level_two(seed):
    divisions, keep = random_digits(seed)
    solid = prefractal(divisions, keep, 2)
    assert counted(solid) == by_hand(solid)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(20))
def test_random_sets_as_models_equal_scikit_image_at_every_level(seed):
    divisions, keep = random_digits(seed)
    for level in (1, 2, 3):
        solid = prefractal(divisions, keep, level)
        digits = DigitSet(divisions, keep)
        grid = voxelize(ifs(digits, level=level), voxels=divisions**level, sampling="centre")
        assert np.array_equal(grid.solid, solid)
        padded = np.pad(solid, 1)
        faces = sum(int((np.diff(padded.astype(np.int8), axis=a) != 0).sum()) for a in range(3))
        closed = Prefractal(digits, level)
        h = 1 / divisions**level
        area = measures.surface_area(grid, method="voxel faces").value
        assert area == pytest.approx(faces * h**2, rel=1e-12)
        assert closed.count("cells") == solid.sum() == int(grid.solid.sum())
        assert sum(closed.count(f"faces_{axis}") for axis in "xyz") == faces
        for name, connectivity in (("euler_number", 1), ("euler_number_26", 3)):
            judged = skeuler(padded, connectivity=connectivity)
            assert closed.count(name) == judged == measures_of[name](grid).value


@pytest.mark.parametrize("name", SETS)
def test_components_and_genus_follow_the_oracle_where_it_knows(name):
    divisions, keep, _, _ = SETS[name]
    for level in (1, 2, 3):
        body = Prefractal(DigitSet(divisions, np.array(keep)), level)
        grid = grid_of(prefractal(divisions, keep, level))
        for connectivity, pieces, genus in (
            (6, measures.components, measures.genus),
            (26, measures.components_26, measures.genus_26),
        ):
            assert body.components(connectivity) in (None, pieces(grid).value)
            assert body.genus(connectivity) in (None, genus(grid).value)


def test_menger_genus_is_that_of_the_literature():
    # OEIS A135918.
    grids = [grid_of(prefractal(3, SETS["menger"][1], level)) for level in range(4)]
    assert [measures.genus(grid).value for grid in grids] == [0, 5, 81, 1409]
