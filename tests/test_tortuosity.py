"""Geometric tortuosity: straight, tilted and winding ways of known length; Dijkstra's bracket."""

import itertools
import math

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

import porous as po
from porous.errors import Cancelled, GridError
from porous.kernels.geodesic import path_lengths
from porous.measures import geometric_tortuosity, survey
from porous.values import Frame, VoxelGrid

SPACINGS = [(1.0, 1.0, 1.0), (1.0, 1.5, 0.8), (0.4, 0.2, 0.2)]


def grid_of(solid, spacing=(1.0, 1.0, 1.0), periodic=(False, False, False), bulk=None):
    frame = Frame((1, 2, 3), spacing, solid.shape, periodic)
    grid = VoxelGrid.of_solid(solid, frame)
    return grid if bulk is None else VoxelGrid(frame, grid.fill, bulk)


def smooth(shape, seed, width=2.0, share=0.5):
    field = gaussian_filter(np.random.default_rng(seed).random(shape), width, mode="wrap")
    return field < np.quantile(field, share)


def along(grid, axis="x"):
    return geometric_tortuosity(grid, axis=axis).value


def chamfer(spacing):
    """How much longer than straight ways over 26 neighbours are, at most, in free space."""
    worst = 0.0
    for a, b, c in itertools.permutations(spacing):
        edge, corner = math.hypot(a, b), math.hypot(a, b, c)
        worst = max(worst, math.hypot(1, (edge - a) / b, (corner - edge) / c))
    return worst


def naive_lengths(mask, spacing, periodic=(False, False)):
    """Shortest ways over the graph of 26 neighbours to the last layer, by Dijkstra."""
    number = np.full(mask.shape, -1)
    number[mask] = np.arange(mask.sum())
    ends, weights = [], []
    wraps = (False, *periodic)
    for step in itertools.product((-1, 0, 1), repeat=3):
        other = np.roll(number, step, (0, 1, 2))
        for axis in range(3):
            if step[axis] and not wraps[axis]:
                edge = [slice(None)] * 3
                edge[axis] = 0 if step[axis] > 0 else -1
                other[tuple(edge)] = -1
        both = (number >= 0) & (other >= 0)
        ends.append(np.stack([number[both], other[both]]))
        weights.append(np.full(both.sum(), math.hypot(*np.multiply(step, spacing))))
    first = number[0][mask[0]]
    count = int(mask.sum())
    ends.append(np.stack([np.full(len(first), count), first]))
    weights.append(np.full(len(first), spacing[0] / 2))
    graph = coo_array((np.concatenate(weights), np.hstack(ends)), (count + 1,) * 2).tocsr()
    found = np.append(dijkstra(graph, indices=count), np.inf)
    return found[number[-1]] * np.where(number[-1] >= 0, 1, np.inf)


@pytest.mark.parametrize("spacing", SPACINGS)
@pytest.mark.parametrize("axis", "xyz")
@pytest.mark.parametrize("periodic", [False, True])
def test_an_open_box_is_straight(spacing, axis, periodic):
    grid = grid_of(np.zeros((8, 9, 12), bool), spacing, (periodic,) * 3)
    row = geometric_tortuosity(grid, axis=axis)
    assert row.value == 1
    assert (row.name, row.unit, row.kind) == (f"geometric_tortuosity_{axis}", "1", "standard")


@pytest.mark.parametrize(
    ("spacing", "bound"), [((1, 1, 1), 0.012), ((1, 1.5, 0.8), 0.015), ((0.4, 0.2, 0.2), 0.006)]
)
def test_free_space_is_straight_in_every_direction(spacing, bound):
    """About a point, whose front is nowhere flat: never too short, and hardly too long."""
    n = 40
    mask = np.ones((n, 2 * n + 1, 2 * n + 1), bool)
    mask[0] = False
    mask[0, n, n] = True
    found = path_lengths(mask, spacing)
    y, z = (np.arange(-n, n + 1) * h for h in spacing[1:])
    straight = np.sqrt(((n - 1) * spacing[0]) ** 2 + y[:, None] ** 2 + z**2) + spacing[0] / 2
    assert (found / straight > 1 - 1e-12).all()
    assert (found / straight).max() < 1 + bound
    assert found[n, n] == pytest.approx(straight[n, n], rel=1e-12)


@pytest.mark.parametrize("spacing", SPACINGS)
@pytest.mark.parametrize("periodic", [(False, False), (True, False), (True, True)])
def test_lengths_lie_in_the_bracket_of_dijkstra(spacing, periodic):
    for seed, width, share in ((0, 2, 0.5), (1, 1, 0.6), (2, 0.0, 0.6), (3, 0.0, 0.85)):
        mask = ~smooth((13, 17, 11), seed, width, share)
        found = path_lengths(mask, spacing, periodic=periodic)
        wanted = naive_lengths(mask, spacing, periodic)
        assert np.array_equal(np.isfinite(found), np.isfinite(wanted))
        reached = np.isfinite(found)
        assert (found[reached] <= wanted[reached] + 1e-9).all()
        assert (found[reached] >= wanted[reached] / chamfer(spacing)).all()


def tilted(n, slope, wide):
    """A slab of void between planes that rise by ``slope`` along x; the same for every z."""
    x, y = np.arange(n) + 0.5, np.arange(int(n * (1 + slope))) + 0.5
    off = y - (slope * x[:, None] + n / 2)
    return np.repeat((abs(off) >= wide / 2)[:, :, None], 4, axis=2)


@pytest.mark.parametrize("slope", [1.0, 0.5])
def test_a_tilted_slab_is_longer_by_its_slope(slope):
    """The shortest way starts at the upper edge of one side; it is straight, to every place."""
    n, wide = 96, 16
    solid = tilted(n, slope, wide)
    found = along(grid_of(solid, periodic=(False, False, True)))
    rise = slope * n + np.arange(0.5, wide) - wide
    wanted = np.hypot(n, rise).mean() / n
    assert found == pytest.approx(wanted, rel=0.01)
    thin = along(grid_of(tilted(n, slope, 3), periodic=(False, False, True)))
    assert thin == pytest.approx(math.hypot(1, slope), rel=0.04)


def plates(scale):
    """Two plates across x, open at opposite sides of y."""
    solid = np.zeros((24 * scale, 20 * scale, 1), bool)
    solid[7 * scale : 8 * scale, : 15 * scale] = True
    solid[16 * scale : 17 * scale, 5 * scale :] = True
    return solid


def test_staggered_plates_make_a_detour_of_known_length():
    """As taut as a string about both edges; half a voxel off them, so that errors halve too."""
    taut = 7 + 1 + math.hypot(8, 10) + 1 + 7
    errors = []
    for scale in (2, 4, 8):
        lengths = path_lengths(~plates(scale), (1 / scale,) * 3, periodic=(False, True))
        errors.append((lengths.min() + 0.5 / scale) / taut - 1)
    assert 0 < errors[0] < 0.01
    assert errors[1] == pytest.approx(errors[0] / 2, rel=0.1)
    assert errors[2] == pytest.approx(errors[1] / 2, rel=0.1)


def test_the_uncertainty_covers_what_walls_are_off():
    taut = 7 + 1 + math.hypot(8, 10) + 1 + 7
    grid = grid_of(np.repeat(plates(2), 8, axis=2), (0.5,) * 3, (False, False, True))
    row = survey(grid, only=["tortuosity"]).measures["least_geometric_tortuosity_x"]
    assert abs(row.value - taut / 24) < 2 * row.uncertainty < 0.03


def test_a_serpentine_is_as_long_as_it_is():
    """A channel of one voxel: along every wall, and across the corners."""
    row = np.zeros((13, 9), bool)
    for start, place in ((0, 0), (4, 8), (8, 0)):
        row[start : start + 5, place] = True
    row[4] = row[8] = True
    path = [(0, 0), (3, 0), (4, 1), (4, 7), (5, 8), (7, 8), (8, 7), (8, 1), (9, 0), (12, 0)]
    length = sum(math.dist(a, b) for a, b in itertools.pairwise(path)) + 1
    found = survey(grid_of(~row[:, :, None]), only=["tortuosity"]).measures
    assert found["least_geometric_tortuosity_x"].value == pytest.approx(length / 13)


def test_menger_sponges_have_straight_ways():
    model = po.build(po.load("menger", set={"model.level": 2}))
    found = survey(po.voxelize(model, voxels=18), only=["tortuosity"])
    assert [row.value for row in found.measures] == [1] * 6
    assert {row.uncertainty for row in found.measures} == {0}
    assert [curve.series for curve in found.curves] == ["along x", "along y", "along z"]
    assert all(curve.y.sum() == pytest.approx(1) for curve in found.curves)


def test_nothing_leads_through_a_wall():
    solid = np.zeros((8, 9, 10), bool)
    solid[4] = True
    found = survey(grid_of(solid), only=["tortuosity"])
    assert [row.value for row in found.measures] == [math.inf, math.inf, 1, 1, 1, 1]
    assert found.measures["geometric_tortuosity_x"].uncertainty == math.inf
    assert [curve.series for curve in found.curves] == ["along y", "along z"]


def test_pores_that_touch_at_edges_lead_on():
    """As they do for through porosity: pores are joined by faces, edges and corners."""
    solid = np.ones((4, 5, 3), bool)
    for i in range(4):
        solid[i, i, 1] = False
    assert along(grid_of(solid)) == pytest.approx((3 * math.sqrt(2) + 1) / 4)
    assert po.measures.through_porosity_x(grid_of(solid)).value > 0


@pytest.fixture(scope="module")
def pores():
    return smooth((20, 24, 28), 5)


@pytest.mark.parametrize("order", [(1, 2, 0), (2, 0, 1), (1, 0, 2)])
def test_axes_are_alike(pores, order):
    spacing = (1.0, 1.3, 0.7)
    turned = np.ascontiguousarray(pores.transpose(order))
    other = grid_of(turned, tuple(spacing[a] for a in order))
    for axis in range(3):
        found = along(grid_of(pores, spacing), "xyz"[order[axis]])
        assert along(other, "xyz"[axis]) == pytest.approx(found, rel=1e-9)


def test_periodic_bodies_may_be_moved_across(pores):
    found = along(grid_of(pores, periodic=(False, True, True)))
    moved = np.roll(pores, (11, -9), (1, 2))
    assert along(grid_of(moved, periodic=(False, True, True))) == pytest.approx(found, rel=1e-12)
    assert along(grid_of(pores)) >= found


def packed(cut, n=24):
    """One cell of touching balls, body-centred, cut open so many voxels further along x."""
    at = (np.arange(n) + 0.37) / n
    solid = np.zeros((n, n, n), bool)
    for centre in (0.0, 0.5):
        square = ((at - centre + 0.5) % 1 - 0.5) ** 2
        solid |= square[:, None, None] + square[:, None] + square <= 3 / 16
    return grid_of(np.roll(solid, -cut, 0), (1 / n,) * 3, (True,) * 3)


def test_a_cell_is_as_tortuous_wherever_it_is_cut():
    rows = [geometric_tortuosity(packed(cut)) for cut in (0, 3, 6, 9)]
    ends = [geometric_tortuosity(replace_periodic(packed(cut))).value for cut in (0, 3, 6, 9)]
    values = np.array([row.value for row in rows])
    assert np.ptp(ends) > 0.03  # from side to side it is another number
    assert np.ptp(values) < 0.006
    assert min(row.uncertainty for row in rows) > np.ptp(values) / 2
    assert min(ends) < values.min() < values.max() < max(ends)


def replace_periodic(grid):
    """The same, open along x."""
    return grid_of(grid.solid, grid.frame.spacing, (False, True, True))


def test_a_way_from_period_to_period_leads_through_every_cut():
    """A wavy wall lets nothing pass, though from where it is cut open ways lead to its image."""
    n = 12
    x, y = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    off = (x - 2 * np.sin(2 * np.pi * y / n) + n / 2) % n - n / 2
    wall = np.repeat((abs(off) <= 1)[:, :, None], 4, axis=2)
    assert math.isfinite(along(grid_of(wall, periodic=(False, True, True))))
    found = geometric_tortuosity(grid_of(wall, periodic=(True,) * 3))
    assert (found.value, found.uncertainty) == (math.inf, math.inf)


def test_the_shortest_way_is_the_same_from_either_side(pores):
    there, back = (
        survey(grid_of(solid), only=["tortuosity"]).measures["least_geometric_tortuosity_x"].value
        for solid in (pores, np.ascontiguousarray(pores[::-1]))
    )
    assert there == pytest.approx(back, rel=0.01)
    assert there <= along(grid_of(pores))


def test_a_box_within_the_grid_has_its_own_sides():
    solid = smooth((16, 18, 20), 6)
    inner = (slice(2, 14), slice(3, 17), slice(0, 20))
    bulk = np.zeros(solid.shape, np.uint8)
    bulk[inner] = 255
    alone = grid_of(np.ascontiguousarray(solid[inner]))
    assert along(grid_of(solid, bulk=bulk)) == pytest.approx(along(alone))
    bulk[5, 5, 5] = 0
    with pytest.raises(GridError, match="no box"):
        along(grid_of(solid, bulk=bulk))
    assert not survey(grid_of(solid, bulk=bulk), only=["tortuosity"]).measures


def test_what_is_asked_for_wrongly_is_refused():
    with pytest.raises(GridError, match="axis: got 'w'"):
        geometric_tortuosity(grid_of(np.zeros((4, 4, 4), bool)), axis="w")
    with pytest.raises(GridError, match="no pore"):
        geometric_tortuosity(grid_of(np.ones((4, 4, 4), bool)))


def test_large_grids_are_taken_coarser_and_work_may_be_cancelled(monkeypatch):
    from porous.measures import _tortuosity

    monkeypatch.setattr(_tortuosity, "MOST", 20**3)
    told = []
    grid = grid_of(smooth((24, 24, 24), 7))
    found = survey(grid, only=["tortuosity"], progress=lambda *what: told.append(what))
    assert "12 × 12 × 12 voxels" in found.notes[0]
    done = [share for name, share in told if name == "fast marching"]
    assert done == sorted(done)
    assert 0 < max(done) <= 1

    def stop(*_):
        raise Cancelled("enough")

    with pytest.raises(Cancelled):
        geometric_tortuosity(grid, progress=stop)
