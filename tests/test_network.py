"""Pores and throats: packings whose coordination is known, and a watershed of others as judge."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from skimage.morphology import local_maxima
from skimage.segmentation import watershed

from porous.errors import Cancelled, GridError
from porous.kernels.components import label
from porous.kernels.distance import squared_distances
from porous.measures import PoreNetwork, pore_network, survey
from porous.values import Frame, VoxelGrid

PERIODIC = (True, True, True)
PACKINGS = {
    "simple cubic": ([(0, 0, 0)], 0.5),
    "body-centred": ([(0, 0, 0), (0.5, 0.5, 0.5)], 3**0.5 / 4),
    "face-centred": ([(0, 0, 0), (0.5, 0.5, 0), (0.5, 0, 0.5), (0, 0.5, 0.5)], 2**0.5 / 4),
}


def grid_of(solid, spacing=(1.0, 1.0, 1.0), periodic=(False, False, False), bulk=None):
    frame = Frame((1, 2, 3), spacing, solid.shape, periodic)
    grid = VoxelGrid.of_solid(solid, frame)
    return grid if bulk is None else VoxelGrid(frame, grid.fill, bulk)


def packing(name, n, cells=3):
    """Touching balls on a lattice of cells of edge 1, n voxels each, off the voxels' centres."""
    centres, radius = PACKINGS[name]
    places = [(np.arange(cells * n) + off) / n for off in (0.87, 0.61, 0.13)]
    near = np.full((cells * n,) * 3, np.inf)
    for centre in centres:
        x, y, z = (((p - c + 0.5) % 1 - 0.5) ** 2 for p, c in zip(places, centre, strict=True))
        near = np.minimum(near, x[:, None, None] + y[:, None] + z)
    return grid_of(near <= radius**2, (1 / n,) * 3, PERIODIC)


def smooth(shape, seed, width=3.0, share=0.5):
    field = gaussian_filter(np.random.default_rng(seed).random(shape), width, mode="wrap")
    return field < np.quantile(field, share)


def cavities(counts, wide=7, channel=3):
    """Cubes joined to their neighbours by square channels, shut in by a wall of three voxels."""
    step = wide + 5
    solid = np.ones([n * step + 1 for n in counts], bool)
    low, thin = (step + 1 - wide) // 2, (step + 1 - channel) // 2
    for index in np.ndindex(*counts):
        at = [n * step for n in index]
        solid[tuple(slice(a + low, a + low + wide) for a in at)] = False
        for axis in range(3):
            if index[axis] + 1 < counts[axis]:
                span = [slice(a + thin, a + thin + channel) for a in at]
                span[axis] = slice(at[axis] + low, at[axis] + low + step)
                solid[tuple(span)] = False
    return solid


@pytest.mark.parametrize(
    ("name", "n", "throats", "sizes", "widest"),
    [
        ("simple cubic", 32, {6: 1}, (3**0.5 - 1, 3**0.5 - 1), 2**0.5 - 1),
        ("body-centred", 32, {4: 12}, (5**0.5 / 2 - 3**0.5 / 2,) * 2, 1.125**0.5 - 3**0.5 / 2),
        ("face-centred", 48, {4: 8, 8: 4}, (0.75**0.5 - 0.5**0.5, 1 - 0.5**0.5), 0.1094),
    ],
)
def test_packings_of_balls_have_the_pores_and_throats_of_their_lattice(
    name, n, throats, sizes, widest
):
    """Voronoi cells' corners are pores, and the triangles of Delaunay's simplices throats."""
    cells = 96 // n
    found = pore_network(packing(name, n, cells))
    numbers, counts = np.unique(found.coordination_numbers, return_counts=True)
    assert dict(zip(numbers, counts, strict=True)) == {k: v * cells**3 for k, v in throats.items()}
    assert found.inscribed_diameters.min() == pytest.approx(min(sizes), abs=2 / n)
    assert found.inscribed_diameters.max() == pytest.approx(max(sizes), abs=2 / n)
    assert found.throat_diameters == pytest.approx(widest, abs=2 / n)
    assert not found.cut.any()


@pytest.mark.parametrize(
    ("name", "n", "throats"),
    [
        ("simple cubic", 40, {6: 1}),
        ("body-centred", 32, {4: 12}),
        ("face-centred", 48, {4: 8, 8: 4}),
    ],
)
def test_unit_cells_have_the_throats_of_their_lattice(name, n, throats):
    """One cell, whose pores touch their own images, and others in several periods, has all."""
    found = pore_network(packing(name, n, 1))
    numbers, counts = np.unique(found.coordination_numbers, return_counts=True)
    assert dict(zip(numbers, counts, strict=True)) == throats
    # Where the throat leads is as far as pores of the lattice are apart, whatever period it is in.
    ways = found.centres[found.throats[:, 1]] + found.periods - found.centres[found.throats[:, 0]]
    apart = np.linalg.norm(ways, axis=1)
    steps = {"simple cubic": 1.0, "body-centred": 8**-0.5, "face-centred": 3**0.5 / 4}
    assert apart == pytest.approx(steps[name], abs=3 / n)
    if name == "simple cubic":
        assert np.sort(found.periods, axis=0).tolist() == [[0, 0, 0], [0, 0, 0], [1, 1, 1]]


@pytest.mark.parametrize("counts", [(1, 1, 1), (2, 1, 3), (2, 2, 2)])
def test_cells_of_a_lattice_have_as_many_throats_as_more_of_them(counts):
    """Cubes joined by channels along all axes: six throats each, however few are in the grid."""
    solid = cavities((3, 3, 3), channel=3)[12:24, 12:24, 12:24]
    found = pore_network(grid_of(np.tile(solid, counts), (1.0, 0.8, 1.1), PERIODIC))
    assert found.coordination_numbers.tolist() == [6] * np.prod(counts)
    assert len(found.throats) == 3 * np.prod(counts)
    assert abs(found.periods).max() == 1
    open_ = pore_network(grid_of(np.tile(solid, (1, 1, 2)), periodic=(False, False, True)))
    assert (len(open_), open_.coordination_numbers.tolist()) == (2, [2, 2])


def test_pores_without_end_have_no_throats_to_themselves_but_to_each_other():
    """Two channels along z, of a constant width, with one opening between them in each period."""
    solid = np.ones((12, 22, 8), bool)
    solid[2:9, 2:9] = solid[2:9, 12:19] = False
    found = pore_network(grid_of(solid, periodic=PERIODIC))
    assert (len(found), len(found.throats)) == (2, 0)
    solid[4:7, 9:12, 2:5] = False
    found = pore_network(grid_of(solid, periodic=PERIODIC))
    assert (len(found), found.throats.tolist()) == (2, [[0, 1]])
    moved = pore_network(grid_of(np.roll(solid, (3, 9, 4), (0, 1, 2)), periodic=PERIODIC))
    assert moved.coordination_numbers.tolist() == [1, 1]


def test_a_lattice_of_cavities_has_a_throat_for_every_channel():
    counts, spacing = np.array((3, 4, 5)), np.array((1.0, 0.8, 1.1))
    solid = cavities(counts)
    found = pore_network(grid_of(solid, tuple(spacing)))
    assert len(found) == 60
    assert not found.cut.any()
    index = np.floor((found.centres - (1, 2, 3)) / (12 * spacing)).astype(int)
    assert len(np.unique(index, axis=0)) == 60
    ends = ((index == 0) | (index == counts - 1)).sum(axis=1)
    assert np.array_equal(found.coordination_numbers, 6 - ends)
    assert found.volumes.sum() == pytest.approx((~solid).sum() * np.prod(spacing))
    # Channels are three voxels wide. In a cavity of seven a ball reaches into one across y that is
    # shut on the other side: r² = 1.5² + (5.6 - r)².
    across = 0.8 * np.where(np.diff(index[found.throats], axis=1)[:, 0, 1] == 0, 1, 1.25)
    assert found.throat_diameters == pytest.approx(3 * across)
    assert abs(found.inscribed_diameters.min() - 2 * 33.61 / 11.2) <= 1.1


@pytest.mark.parametrize(("radius", "shift"), [(4.0, 0.0), (5.3, 0.3), (6.5, 0.7)])
def test_two_balls_and_a_neck_are_two_pores_and_a_throat(radius, shift):
    spacing = (1.0, 1.0, 0.5)
    x, y, z = np.meshgrid(
        *(np.arange(n) * h for n, h in zip((64, 34, 68), spacing, strict=True)), indexing="ij"
    )
    middle = [31.5 + shift, 16.5 + shift, 16.9 + shift]
    across = np.hypot(y - middle[1], z - middle[2])
    balls = [np.hypot(across, x - middle[0] - side) < 12 for side in (-15, 15)]
    neck = (across < radius) & (abs(x - middle[0]) < 15)
    found = pore_network(grid_of(~(balls[0] | balls[1] | neck), spacing))
    assert (len(found), found.throats.tolist()) == (2, [[0, 1]])
    assert found.throat_diameters[0] == pytest.approx(2 * radius, abs=2)
    assert found.inscribed_diameters == pytest.approx(24, abs=2)
    assert found.volumes[0] == pytest.approx(found.volumes[1], rel=0.05)


@pytest.mark.parametrize("narrow", [False, True])
def test_two_balls_that_overlap_are_one_pore_where_nothing_narrows(narrow):
    x, y, z = np.meshgrid(*(np.arange(n) - n / 2 for n in (60, 40, 42)), indexing="ij")
    apart = 12 if narrow else 4
    balls = [np.sqrt((x - side) ** 2 + y**2 + z**2) < 14 for side in (-apart, apart)]
    assert len(pore_network(grid_of(~(balls[0] | balls[1])))) == 1 + narrow


def test_a_gap_between_plates_is_one_pore_that_touches_itself():
    solid = np.zeros((12, 10, 14), bool)
    solid[:3] = True
    found = pore_network(grid_of(solid, periodic=PERIODIC))
    assert len(found) == 1
    assert not len(found.throats)
    assert found.coordination_numbers.tolist() == [0]
    assert found.inscribed_diameters[0] == 9


@pytest.fixture(scope="module", params=[0, 1])
def noise(request):
    periodic = PERIODIC if request.param else (False, False, False)
    return grid_of(smooth((48, 44, 52), request.param), periodic=periodic)


def test_the_watershed_of_others_divides_alike(noise):
    """Flooding by scikit-image from the same maxima, but for voxels between two of them."""
    found = pore_network(replace(noise, frame=replace(noise.frame, periodic=(False,) * 3)))
    pores = ~noise.solid
    squares = squared_distances(pores, (1, 1, 1)).values
    markers = np.where(local_maxima(squares, connectivity=3), found.labels, 0)
    theirs = watershed(-squares, markers, connectivity=np.ones((3, 3, 3)), mask=pores)
    assert len(found) > 20
    assert (theirs == found.labels)[pores].mean() > 0.97


def test_pores_are_connected_and_fill_the_pores(noise):
    found = pore_network(noise)
    assert np.array_equal(found.labels > 0, ~noise.solid)
    for pore in range(len(found)):
        part = found.labels == pore + 1
        assert label(part, 26, periodic=noise.frame.periodic)[1] == 1
        assert found.volumes[pore] == part.sum()
    ends = found.inscribed_diameters[found.throats]
    assert (found.throat_diameters <= ends.min(axis=1)).all()
    assert (np.diff(found.inscribed_diameters) <= 0).all()
    itself = found.throats[:, 0] == found.throats[:, 1]
    assert (found.throats[:, 0] <= found.throats[:, 1]).all()
    assert found.periods[itself].any(axis=1).all()
    assert len(np.unique(np.hstack([found.throats, found.periods]), axis=0)) == len(found.throats)
    if not any(noise.frame.periodic):
        assert not found.periods.any()


def test_throats_join_what_the_pores_join(noise):
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    found = pore_network(noise)
    graph = coo_array((np.ones(len(found.throats)), found.throats.T), (len(found),) * 2)
    pieces = label(~noise.solid, 26, periodic=noise.frame.periodic)[1]
    assert connected_components(graph, directed=False)[0] == pieces


def test_which_pores_a_side_cuts():
    solid = cavities((3, 3, 3))
    assert not pore_network(grid_of(solid)).cut.any()
    found = pore_network(grid_of(solid[6:], (1.0, 1.3, 0.8)))
    assert found.cut.sum() == 9
    assert (found.centres[found.cut, 0] < 6).all()
    wraps = pore_network(grid_of(solid[6:], periodic=(True, False, False)))
    assert not wraps.cut.any()
    bulk = np.full(solid.shape, 255, np.uint8)
    bulk[:, :, 31:] = 0
    inside = pore_network(grid_of(solid, bulk=bulk))
    assert inside.cut.sum() == 9
    assert inside.labels[:, :, 31:].max() == 0


@pytest.mark.parametrize("order", [(1, 2, 0), (2, 0, 1), (0, 2, 1)])
def test_axes_are_alike(order):
    solid, spacing = cavities((2, 3, 2), wide=9), (1.0, 1.25, 0.8)
    found = pore_network(grid_of(solid, spacing))
    turned = grid_of(np.ascontiguousarray(solid.transpose(order)), tuple(spacing[a] for a in order))
    other = pore_network(turned)
    assert (
        np.sort(other.coordination_numbers).tolist() == np.sort(found.coordination_numbers).tolist()
    )
    assert np.sort(other.throat_diameters) == pytest.approx(np.sort(found.throat_diameters))
    assert other.inscribed_diameters == pytest.approx(found.inscribed_diameters)


def test_periodic_bodies_may_be_moved():
    solid = smooth((40, 36, 44), 2)
    found = pore_network(grid_of(solid, periodic=PERIODIC))
    moved = pore_network(grid_of(np.roll(solid, (7, -11, 20), (0, 1, 2)), periodic=PERIODIC))
    assert len(moved) == len(found)
    assert moved.inscribed_diameters == pytest.approx(found.inscribed_diameters)
    assert len(moved.throats) == len(found.throats)
    assert np.sort(moved.throat_diameters) == pytest.approx(np.sort(found.throat_diameters))


def test_one_grid_gives_one_network_on_any_number_of_threads(monkeypatch, noise):
    found = pore_network(noise)
    monkeypatch.setenv("POROUS_THREADS", "1")
    assert pore_network(noise) == found


def test_a_survey_tells_numbers_and_curves():
    solid = np.pad(cavities((3, 3, 4), wide=11, channel=5), ((0, 1), (0, 1), (0, 1)), mode="edge")
    grid = grid_of(solid, (0.5, 0.5, 0.5))
    found, network = survey(grid, only=["network"]), pore_network(grid)
    rows = found.measures
    assert rows["pores"].value == 36
    assert rows["coordination_number_mean"].value == network.coordination_numbers.mean()
    assert rows["pore_diameter_p50"].value == np.median(network.diameters)
    assert rows["throat_diameter_mean"].value == network.throat_diameters.mean()
    assert rows["throat_diameter_p50"].uncertainty >= 0.5
    assert {row.unit for row in rows if "diameter" in row.name} == {"mm"}
    curves = {(c.name, c.series): c for c in found.curves}
    coordination = curves["coordination_number", "pores"]
    assert coordination.y.sum() == pytest.approx(1)
    assert coordination.y[3] == 8 / 36  # the corners
    sizes = curves["network_pore_diameter", "inscribed"]
    assert sizes.y[-1] == 1
    assert (np.diff(sizes.x) >= 0).all()


def test_large_grids_are_taken_coarser(monkeypatch):
    from porous.measures import _network

    monkeypatch.setattr(_network, "MOST", 30**3)
    told = []
    grid = grid_of(smooth((40, 40, 40), 4))
    found = survey(grid, only=["network"], progress=lambda name, _: told.append(name))
    assert "20 × 20 × 20 voxels" in found.notes[0]
    assert "watershed" in told


def test_bodies_without_pores_or_solid_have_no_network():
    for solid in (np.ones((4, 5, 6), bool), np.zeros((4, 5, 6), bool)):
        assert not survey(grid_of(solid), only=["network"]).measures
        with pytest.raises(GridError, match="pore"):
            pore_network(grid_of(solid))


def test_work_tells_how_far_it_is_and_may_be_cancelled(noise):
    told = []
    pore_network(noise, progress=lambda name, done: told.append((name, done)))
    assert {name for name, _ in told} == {"watershed", "local thickness"}
    told = [(name, done) for name, done in told if name == "watershed"]
    assert all(0 <= done <= 1 for _, done in told)
    assert [done for _, done in told] == sorted(done for _, done in told)

    def stop(*_):
        raise Cancelled("enough")

    with pytest.raises(Cancelled):
        pore_network(noise, progress=stop)


def test_a_network_is_checked():
    found = pore_network(grid_of(cavities((1, 1, 2))))
    with pytest.raises(GridError, match=r"volumes|centres"):
        PoreNetwork(
            found.frame,
            found.labels,
            found.centres[:1],
            found.volumes,
            found.inscribed_diameters,
            found.cut,
            found.throats,
            found.throat_diameters,
            found.periods,
        )
