"""Hausdorff distance: brute force, axioms of a metric, and the theorem of prefractals."""

import math
from dataclasses import replace
from itertools import pairwise

import naive_measures
import numpy as np
import pytest

from porous import build, ifs, load, measures, voxelize
from porous.errors import GridError, MeshError
from porous.measures import hausdorff_distance
from porous.values import Frame, SurfaceMesh, VoxelGrid

SPACING = (0.5, 0.4, 0.3)


def random_points(seed, n=40):
    return np.random.default_rng(seed).normal(size=(n, 3))


def random_grid(seed, shape=(6, 7, 8), *, origin=(0, 0, 0), density=0.03):
    solid = np.random.default_rng(seed).random(shape) < density
    solid[tuple(n // 2 for n in shape)] = True
    return VoxelGrid.of_solid(solid, Frame(origin, SPACING, shape))


def octahedron(radius=1.0, *, centre=(0, 0, 0), unit="mm"):
    points = np.concatenate([np.eye(3), -np.eye(3)]) * radius + centre
    faces = [[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]]
    return SurfaceMesh(points, np.array(faces), unit)


def spans(row):
    return row.value - row.uncertainty - 1e-12, row.value + row.uncertainty + 1e-12


def corners_of(grid, n=4):
    """Return lattices of points on the solid voxels, their corners among them."""
    steps = np.stack(np.meshgrid(*[np.linspace(0, 1, n)] * 3), axis=-1).reshape(-1, 3)
    index = np.argwhere(grid.solid)
    points = (index[:, None] + steps).reshape(-1, 3) * grid.frame.spacing + grid.frame.origin
    return np.unique(points.round(12), axis=0)


# --- point sets ----------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(5))
def test_point_sets_are_exact(seed):
    a, b = random_points(seed), random_points(seed + 100, n=23) + seed
    row = hausdorff_distance(a, b)
    assert row.value == pytest.approx(naive_measures.hausdorff(a, b), rel=1e-14)
    assert (row.uncertainty, row.kind, row.unit) == (0, "bound", "mm")


def test_it_is_a_metric_on_point_sets():
    a, b, c = (random_points(seed) for seed in range(3))
    ab, ba = hausdorff_distance(a, b).value, hausdorff_distance(b, a).value
    assert ab == ba > 0
    assert hausdorff_distance(a, a).value == 0
    assert ab <= hausdorff_distance(a, c).value + hausdorff_distance(c, b).value


# --- grids ---------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("moved", [(0, 0, 0), (2, -1, 3)])
def test_grids_of_one_lattice_are_within_their_bounds(seed, moved):
    a = random_grid(seed)
    b = random_grid(seed + 50, (5, 8, 6), origin=tuple(np.multiply(moved, SPACING)))
    row = hausdorff_distance(a, b)
    one, other = corners_of(a), corners_of(b)
    # Points on voxels are nowhere farther apart than a third of a diagonal.
    found, slack = naive_measures.hausdorff(one, other), a.frame.diagonal / 6
    assert row.value - row.uncertainty - slack <= found <= row.value + row.uncertainty + slack
    assert row.uncertainty <= a.frame.diagonal / 4 + 1e-12
    assert hausdorff_distance(b, a).value == pytest.approx(row.value, rel=1e-12)


def test_a_grid_is_at_no_distance_of_itself():
    grid = random_grid(1)
    row = hausdorff_distance(grid, replace(grid))
    assert row.value == row.uncertainty == 0


@pytest.mark.parametrize("seed", range(4))
def test_grids_of_two_lattices(seed):
    a = random_grid(seed)
    b = VoxelGrid(Frame((0.1, 0.2, 0.3), (0.45, 0.5, 0.35), (6, 7, 8)), a.fill)
    row = hausdorff_distance(a, b)
    found = naive_measures.hausdorff(corners_of(a), corners_of(b))
    slack = max(a.frame.diagonal, b.frame.diagonal) / 6
    assert row.value - row.uncertainty - slack <= found <= row.value + row.uncertainty + slack


def test_a_grid_and_points():
    grid = VoxelGrid.of_solid(np.ones((2, 2, 2), bool), Frame((0, 0, 0), (1, 1, 1), (2, 2, 2)))
    low, high = spans(hausdorff_distance(grid, np.array([[1.0, 1.0, 1.0]])))
    assert low <= math.sqrt(3) <= high
    assert high - low <= grid.frame.diagonal / 2 + 1e-9


def test_units_are_converted():
    a = random_grid(3)
    frame = Frame((0, 0, 0), tuple(h / 10 for h in SPACING), a.frame.shape, unit="cm")
    row = hausdorff_distance(a, VoxelGrid(frame, a.fill))
    assert (row.value, row.unit) == (0, "mm")


def test_the_grids_own_certificates_are_added():
    a, b = random_grid(3), random_grid(4)
    plain = hausdorff_distance(a, b)
    told = hausdorff_distance(replace(a, hausdorff=0.25), replace(b, hausdorff=0.5))
    assert told.uncertainty == pytest.approx(plain.uncertainty + 0.75)


# --- prefractals ---------------------------------------------------------------------------


def menger(level, voxels=81, *, primitive="cube", sampling="centre"):
    corners = [(i, j, k) for i in range(3) for j in range(3) for k in range(3)]
    maps = [(np.eye(3) / 3, np.array(d) / 3) for d in corners if d.count(1) < 2]
    model = ifs(maps, level=level, primitive=primitive)
    return voxelize(model, voxels=voxels, sampling=sampling)


def test_menger_prefractals_close_in_as_the_theorem_says():
    # The farthest point of a cube from its 20 sub-cubes is its centre, √2/6 edges away from the
    # nearest inner edge; T_i scales distances by 3^−n.
    grids = [menger(level) for level in range(5)]
    for level, (coarse, fine) in enumerate(pairwise(grids)):
        low, high = spans(hausdorff_distance(coarse, fine))
        assert low <= math.sqrt(2) / 6 * 3.0**-level <= high
    to_last = [hausdorff_distance(grid, grids[-1]).value for grid in grids]
    assert all(a > 2 * b for a, b in pairwise(to_last) if b > 0)


@pytest.mark.parametrize("primitive", ["tetrahedron", "ball"])
def test_the_initial_shape_does_not_matter(primitive):
    # d(Fⁿ(K), Fⁿ(K')) ≤ 3^−n d(K, K'), and the cube's corners are this far from the other shape.
    apart = {"tetrahedron": 1 / math.sqrt(3), "ball": math.sqrt(3) / 2 - 0.5}[primitive]
    for level in range(4):
        pair = [
            menger(level, voxels=54, primitive=p, sampling="cover") for p in ("cube", primitive)
        ]
        low, high = spans(hausdorff_distance(*pair))
        assert low <= apart * 3.0**-level
        if level == 0:
            assert apart <= high


def test_grids_obey_the_triangle_inequality():
    a, b, c = (menger(level, voxels=27) for level in (0, 1, 2))
    ac, ab, bc = (hausdorff_distance(*pair) for pair in ((a, c), (a, b), (b, c)))
    assert spans(ac)[0] <= spans(ab)[1] + spans(bc)[1]
    assert hausdorff_distance(a, c).value == hausdorff_distance(c, a).value


# --- surfaces ------------------------------------------------------------------------------


def test_concentric_octahedra():
    row = hausdorff_distance(octahedron(), octahedron(1.5), resolution=0.02)
    low, high = spans(row)
    assert low <= 0.5 <= high
    assert high - low <= 4 * 0.02
    finer = hausdorff_distance(octahedron(), octahedron(1.5))
    assert finer.uncertainty < row.uncertainty
    assert spans(finer)[0] <= 0.5 <= spans(finer)[1]


@pytest.mark.parametrize("seed", range(3))
def test_surfaces_equal_their_triangles_sampled_densely(seed):
    shift = np.random.default_rng(seed).normal(size=3)
    a, b = octahedron(), octahedron(0.7, centre=shift)
    low, high = spans(hausdorff_distance(a, b, resolution=0.03))
    weights = np.array([(i, j, 12 - i - j) for i in range(13) for j in range(13 - i)]) / 12
    one, other = (np.einsum("pk,tki->tpi", weights, s.corners).reshape(-1, 3) for s in (a, b))
    slack = math.sqrt(2) / 12
    found = naive_measures.hausdorff(one, other)
    assert low - slack <= found <= high + slack


def test_surfaces_of_two_units():
    tenth = octahedron(0.1, unit="cm")
    row = hausdorff_distance(octahedron(), tenth, resolution=0.05)
    assert row.unit == "mm"
    assert spans(row)[0] <= 0


def test_a_moved_surface_is_as_far_as_it_was_moved():
    row = hausdorff_distance(octahedron(), octahedron(centre=(0, 0, 0.25)), resolution=0.02)
    assert spans(row)[0] <= 0.25 <= spans(row)[1]


# --- refusals ------------------------------------------------------------------------------


def test_what_cannot_be_compared_is_refused():
    grid = random_grid(0)
    empty = VoxelGrid(grid.frame, np.zeros_like(grid.fill))
    with pytest.raises(GridError, match="a body and a boundary"):
        hausdorff_distance(grid, octahedron())
    with pytest.raises(GridError, match="no solid voxel"):
        hausdorff_distance(grid, empty)
    with pytest.raises(GridError, match="no solid voxel"):
        hausdorff_distance(empty, np.zeros((1, 3)))
    with pytest.raises(MeshError, match="no triangles"):
        hausdorff_distance(SurfaceMesh(np.zeros((0, 3)), np.zeros((0, 3), int)), octahedron())
    for bad in (np.zeros((0, 3)), np.zeros((3, 2)), np.full((2, 3), np.nan)):
        with pytest.raises(MeshError, match="wanted"):
            measures.hausdorff_distance(bad, np.zeros((1, 3)))


def test_a_shape_that_is_not_convex_comes_as_near_level_by_level():
    # d(Fⁿ(K), A) ≤ 3⁻ⁿ d(K, A), for crossing bars as for any other closed mesh.
    def crosses(level):
        recipe = load("menger-crosses", set={"model.level": level})
        return voxelize(build(recipe), voxels=81, sampling="cover")

    sponge = crosses("limit")
    distances = [hausdorff_distance(crosses(level), sponge) for level in range(4)]
    furthest = distances[0].value + distances[0].uncertainty
    for level, distance in enumerate(distances):
        assert distance.value - distance.uncertainty <= furthest * 3.0**-level
    assert distances[0].value > math.sqrt(2) / 4 - distances[0].uncertainty  # a corner of the cube
    assert all(near.value < 0.6 * far.value for far, near in pairwise(distances[:3]))
