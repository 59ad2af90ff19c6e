"""Measures tile by tile: the same rows as of the whole, in the memory of a tile, and exact."""

import pickle
from dataclasses import dataclass, field
from functools import partial
from itertools import product

import naive_measures
import numpy as np
import pytest

from porous import build, load, measures, voxelize
from porous.errors import Cancelled, GridError
from porous.measures._boxes import BoxCount, lattices
from porous.measures._census import Census, Extent, count_fills, count_windows, find_bulk
from porous.measures._connected import OUTSIDE, Phase, PieceCounts, Pieces, Sightings
from porous.measures._fold import Together, layers_of, tiles_of
from porous.values import Frame, Tiled, VoxelGrid

PERIODIC = list(product((False, True), repeat=3))
HUGE = 3 * 2**31


@dataclass
class Elsewhere:
    """A grid that is no ``VoxelGrid`` and remembers what it was asked for."""

    grid: VoxelGrid
    asked: list = field(default_factory=list)

    @property
    def frame(self):
        return self.grid.frame

    @property
    def sampling(self):
        return self.grid.sampling

    @property
    def sampling_error(self):
        return self.grid.sampling_error

    @property
    def hausdorff(self):
        return self.grid.hausdorff

    def block(self, start, stop):
        assert all(type(a) is int for a in (*start, *stop))
        self.asked.append(np.subtract(stop, start))
        fill, bulk = self.grid.block(start, stop)
        return fill.copy(), None if bulk is None else bulk.copy()


def random_grid(shape, seed, *, periodic=(False, False, False), binary=False, bulk=False):
    random = np.random.default_rng(seed)
    solid = random.random(shape) < random.uniform(0.2, 0.9)
    grey = np.where(solid, random.integers(128, 256, shape), random.integers(0, 128, shape))
    fill = np.where(solid, 255, 0) if binary else grey
    body = None
    if bulk:
        body = np.zeros(shape, np.uint8)
        body[tuple(slice(n // 5, None) for n in shape)] = 255
        body[random.random(shape) < 0.1] = 100
    frame = Frame((1, 2, 3), (0.5, 0.4, 0.3), shape, periodic)
    return VoxelGrid(frame, fill.astype(np.uint8), body, sampling_error=0.01 * (seed % 2))


def guillotine(start, stop, random):
    """Cut a box in two at random, and its halves again: tiles of all sizes in no lattice."""
    size = np.subtract(stop, start)
    axis = int(random.choice(np.flatnonzero(size == size.max())))
    if size[axis] < 2 or (random.random() < 0.5 and size.max() < 8):
        return [(start, stop)]
    cut = int(random.integers(start[axis] + 1, stop[axis]))
    lower, upper = list(stop), list(start)
    lower[axis] = upper[axis] = cut
    return guillotine(start, tuple(lower), random) + guillotine(tuple(upper), stop, random)


def odd_tiles(shape, seed):
    return guillotine((0, 0, 0), shape, np.random.default_rng(seed))


def told(pieces):
    rows = [pieces.sizes, pieces.marks, pieces.counts]
    return sorted(zip(*map(np.ndarray.tolist, rows), strict=True))


# --- the same rows -------------------------------------------------------------------------


@pytest.mark.parametrize("periodic", PERIODIC)
@pytest.mark.parametrize(("seed", "binary", "bulk"), [(0, True, True), (1, False, False)])
def test_rows_do_not_depend_on_tiles(periodic, seed, binary, bulk):
    shape = (11, 8, 9) if seed else (7, 12, 5)
    kind = {"binary": binary, "bulk": bulk ^ periodic[0]}
    grid = random_grid(shape, seed, periodic=periodic, **kind)
    source = Elsewhere(grid)
    assert isinstance(source, Tiled)
    whole = measures.measure(grid)
    assert measures.measure(source, tiles=odd_tiles(shape, seed)) == whole
    assert measures.measure(source, tiles=tiles_of(shape, size=150, chunk=(3, 2, 4))) == whole
    assert len(whole) > 16


def test_rows_of_a_sampled_bulk_do_not_depend_on_tiles():
    model = build(load("menger-bent", set={"model.level": 1}))
    grid = voxelize(model, voxels=20)
    assert grid.bulk is not None
    tiles = odd_tiles(grid.frame.shape, 5)
    one = measures.measure(grid, model=model)
    assert measures.measure(Elsewhere(grid), model=model, tiles=tiles) == one


def test_a_surface_may_come_from_a_grid_elsewhere():
    from porous import extract_surface

    grid = random_grid((7, 8, 9), 3)
    surface = extract_surface(grid)
    there = measures.measure(surface, grid=Elsewhere(grid))
    assert there == measures.measure(surface, grid=grid)


def test_a_stored_grid_is_measured_in_whole_chunks(tmp_path, monkeypatch):
    from porous.scale import Store, StoredGrid

    grid = random_grid((19, 17, 21), 5, periodic=(False, True, False), bulk=True)
    store = Store.create(
        tmp_path / "grid.zarr",
        grid.frame,
        chunk=(8, 7, 6),
        recipe_sha256="0" * 64,
        sampling=grid.sampling,
        sampling_error=grid.sampling_error,
        has_bulk=True,
    )
    for index, tile in enumerate(store.tiles):
        for name, array in zip(("fill", "bulk"), grid.block(*tile), strict=True):
            store.write(name, index, array)
    store.commit()
    stored, done = StoredGrid.open(tmp_path / "grid.zarr"), []
    cut = partial(tiles_of, size=1500)
    monkeypatch.setattr("porous.measures._census.tiles_of", cut)
    tiles = Census(stored).tiles
    assert tiles == cut(grid.frame.shape, chunk=(8, 7, 6))
    assert len(tiles) > 2
    assert all(a % n == 0 for start, _ in tiles for a, n in zip(start, (8, 7, 6), strict=True))
    rows = measures.measure(stored, progress=lambda *told: done.append(told), map=sent)
    assert rows == measures.measure(grid)
    assert len(done) == 2 * len(tiles)


@pytest.mark.parametrize("name", ["porosity", "open_porosity", "components_26", "volume", "genus"])
def test_each_measure_takes_a_grid_elsewhere(name):
    grid, function = random_grid((6, 7, 8), 1), getattr(measures, name)
    assert function(Elsewhere(grid)) == function(grid)


def test_boxes_outside_the_frame_are_refused():
    grid = random_grid((4, 5, 6), 0)
    for start, stop in (
        ((0, 0, 0), (5, 5, 6)),
        ((-1, 0, 0), (2, 2, 2)),
        ((2, 2, 2), (2, 3, 3)),
    ):
        with pytest.raises(GridError, match="wanted a box inside"):
            grid.block(start, stop)


@pytest.mark.parametrize("layers", [[[3, 0, 1], [4], [5, 5, 0]], [[0], [0, 1, 2], [2, 3]]])
def test_layers_come_in_the_order_asked_for(layers):
    grid = random_grid((4, 5, 6), 2, bulk=True)
    fill, bulk = layers_of(Elsewhere(grid), layers)
    np.testing.assert_array_equal(fill, grid.fill[np.ix_(*layers)])
    np.testing.assert_array_equal(bulk, grid.bulk[np.ix_(*layers)])


# --- pieces across borders -----------------------------------------------------------------


def spiral(n, height):
    """Return a square spiral one voxel wide, climbing at its end to one that runs beside it."""
    solid = np.zeros((n, n, height), bool)
    place, step = np.array([0, 0]), np.array([0, 1])
    for length in [n - 1, *(k for k in range(n - 1, 0, -2) for _ in range(2))]:
        for _ in range(length):
            solid[(*place, 0)] = True
            place = place + step
        step = np.array([step[1], -step[0]])
    solid[(*place, slice(None))] = True
    return solid


def comb(shape, *, back):
    """Return teeth along x that only a back at the far end joins."""
    solid = np.zeros(shape, bool)
    solid[:, ::2, ::2] = True
    if back:
        solid[-1] = True
    return solid


@pytest.mark.parametrize("size", [2, 3, 5])
def test_spirals_and_combs_are_joined_across_many_tiles(size):
    bodies = [
        (spiral(15, 3), 1),
        (comb((17, 5, 7), back=True), 1),
        (comb((17, 5, 7), back=False), 3 * 4),
        (comb((11, 5, 17), back=False).transpose(2, 1, 0), 3 * 9),
    ]
    for solid, pieces in bodies:
        frame = Frame((0, 0, 0), (1, 2, 3), solid.shape)
        source = Elsewhere(VoxelGrid.of_solid(solid, frame))
        tiles = tiles_of(solid.shape, size=size**3, chunk=(size,) * 3)
        assert len(tiles) > 500 // size**3
        found = Census(source, tiles=tiles).pieces(solid=True, connectivity=6)
        assert found.number == pieces
        assert found.voxels.sum() == solid.sum()


@pytest.mark.parametrize("turns", [1, 2, 3])
def test_a_helix_through_many_periods_is_endless_in_every_tiling(turns):
    # Each step leads on along x and, ``turns`` times in all, around y.
    shape = (12, 12 // turns, 5)
    fill = np.zeros(shape, np.uint8)
    for i in range(12):
        fill[i, [i % shape[1], (i + 1) % shape[1]], 2] = 255
    grid = VoxelGrid(Frame((0, 0, 0), (1, 1, 1), shape, (True, True, False)), fill)
    for seed in range(6):
        found = Census(grid, tiles=odd_tiles(shape, seed)).pieces(solid=True, connectivity=6)
        assert found.number == 1
        assert found.endless.tolist() == [[True, True, False]]


@pytest.mark.parametrize("periodic", PERIODIC)
@pytest.mark.parametrize("connectivity", [6, 26])
def test_pieces_of_any_tiling_in_any_order_are_those_of_flooding(periodic, connectivity):
    for seed in range(4):
        grid = random_grid((5, 6, 4), seed, periodic=periodic)
        _, count = naive_measures.label(grid.solid, connectivity, periodic)
        whole = Census(grid).pieces(solid=True, connectivity=connectivity)
        assert whole.number == count
        tiles = odd_tiles(grid.frame.shape, seed)
        np.random.default_rng(seed).shuffle(tiles)
        joined = Census(grid, tiles=tiles).pieces(solid=True, connectivity=connectivity)
        assert told(joined) == told(whole)


def test_tiles_that_leave_something_out_are_a_mistake():
    grid = random_grid((6, 7, 8), 2)
    with pytest.raises(ValueError, match="do not fill the grid"):
        _ = Census(grid, tiles=[((0, 0, 0), (3, 7, 8))]).pieces(solid=True, connectivity=26)


# --- tiles ---------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", [(1, 1, 1), (13, 7, 30), (40, 41, 42), (5, 200, 3)])
@pytest.mark.parametrize("chunk", [(1, 1, 1), (4, 8, 16)])
@pytest.mark.parametrize("size", [1, 50, 4000, 10**6])
def test_tiles_fill_a_grid_in_whole_chunks(shape, chunk, size):
    times = np.zeros(shape, int)
    for start, stop in tiles_of(shape, size=size, chunk=chunk):
        times[tuple(slice(a, b) for a, b in zip(start, stop, strict=True))] += 1
        assert all(a % c == 0 for a, c in zip(start, chunk, strict=True))
        assert np.prod(np.subtract(stop, start)) <= max(size, np.prod(chunk))
    assert (times == 1).all()


def test_tiles_of_large_grids_are_no_thin_slabs():
    tiles = tiles_of((2187, 2187, 2187))
    edges = np.array([np.subtract(stop, start) for start, stop in tiles])
    assert edges.min(axis=1).max() > 100
    assert (edges[:, 2] == 2187).all()
    assert edges.prod(axis=1).max() <= 2**26


@pytest.mark.parametrize("periodic", [(False, False, False), (True, True, True)])
def test_no_box_is_larger_than_a_tile_and_its_halo(periodic):
    grid = random_grid((30, 28, 26), 4, periodic=periodic, bulk=True)
    source = Elsewhere(grid)
    tiles = tiles_of(grid.frame.shape, size=2000, chunk=(8, 8, 8))
    measures.measure(source, tiles=tiles)
    assert len(tiles) > 10
    assert max(np.prod(source.asked, axis=1)) <= max(
        np.prod(np.subtract(stop, start) + 2) for start, stop in tiles
    )


def test_what_is_kept_of_pieces_is_their_border():
    # Single voxels in all of a long body: many pieces, and few that a further tile can join.
    fill = np.zeros((200, 9, 10), np.uint8)
    fill[::2, ::2, ::2] = 255
    grid = VoxelGrid(Frame((0, 0, 0), (1, 1, 1), fill.shape), fill)
    phase = Phase(True, 26, False, (0, 0, 0), (199, 8, 9))
    tiles = [((a, 0, 0), (a + 5, 9, 10)) for a in range(0, 195, 5)]
    counts = measures.fold(phase, grid, tiles)
    assert isinstance(counts, PieceCounts)
    assert len(counts.seen) <= 25
    assert len(counts.sizes) <= 25
    assert len(counts.done.sizes) == len(set(counts.done.marks.tolist())) < 20
    assert counts.done.number + len(counts.sizes) == 98 * 25


@dataclass(frozen=True)
class Menger:
    """A Menger sponge that is made where it is looked at and lies nowhere as a whole."""

    level: int
    sampling: str = "centre"
    sampling_error: float = 0.0
    hausdorff: float | None = None

    @property
    def frame(self):
        n = 3**self.level
        return Frame((0, 0, 0), (1 / n,) * 3, (n, n, n))

    def block(self, start, stop):
        index = np.ogrid[tuple(slice(a, b) for a, b in zip(start, stop, strict=True))]
        solid = np.ones(np.subtract(stop, start), bool)
        for scale in 3 ** np.arange(self.level):
            solid &= sum((i // scale % 3 == 1).astype(np.int8) for i in index) < 2
        return np.where(solid, np.uint8(255), np.uint8(0)), None


@pytest.mark.parametrize("chunk", [(27, 27, 27), (20, 32, 17)])
def test_a_menger_sponge_in_tiles_is_as_the_oracle_says(chunk):
    rows = measures.measure(
        Menger(4), tiles=tiles_of((81, 81, 81), size=np.prod(chunk), chunk=chunk)
    )
    oracle = measures.measure(build(load("menger", set={"model.level": 4})))
    names = ("components", "euler_number", "genus", "components_26", "euler_number_26", "genus_26")
    for name in names:
        assert rows[name].value == oracle[name].value
    count = rows["porosity", "voxel count"].value
    assert count == pytest.approx(oracle["porosity"].value, abs=1e-15)
    faces = rows["surface_area", "voxel faces"].value
    assert faces == pytest.approx(oracle["surface_area"].value)
    assert rows["closed_porosity"].value == 0
    assert rows["box_dimension"].value == pytest.approx(oracle["similarity_dimension"].value)
    assert rows["box_dimension"].uncertainty < 1e-12


# --- exact beyond 2³¹ ----------------------------------------------------------------------


def seen(voxel, owner, weight):
    return Sightings(
        np.array([voxel]),
        np.array([owner]),
        np.zeros((1, 3), np.int32),
        np.array([weight], np.int8),
    )


def test_pieces_larger_than_an_int32_add_up():
    one = PieceCounts(Pieces.none(), np.array([HUGE + 1]), np.array([1]), seen(2**62, 0, 4))
    other = PieceCounts(
        Pieces.none(), np.array([5, HUGE]), np.array([0, OUTSIDE]), seen(2**62, 1, 4)
    )
    whole = (one + other).pieces
    assert told(whole) == [(5, 0, 1), (2 * HUGE + 1, OUTSIDE | 1, 1)]
    many = Pieces(np.array([7]), np.array([0]), np.array([HUGE]))
    assert told(many + many) == [(7, 0, 2 * HUGE)]
    assert (many + many).voxels.sum() == 14 * HUGE
    beyond = Pieces(np.array([2**53 + 1]), np.array([0]), np.array([1]))
    assert (beyond + beyond).voxels.sum() == 2**54 + 2  # no float64 can hold 2⁵³ + 1


@dataclass(frozen=True)
class Slotted:
    """A solid block with one slot that is shut in, larger than an int32 can count."""

    shape: tuple[int, int, int]
    sampling: str = "centre"
    sampling_error: float = 0.0
    hausdorff: float | None = None

    @property
    def frame(self):
        return Frame((0, 0, 0), (1, 1, 1), self.shape)

    def block(self, start, stop):
        fill = np.full(np.subtract(stop, start), 255, np.uint8)
        slot = tuple(
            slice(max(a, s) - a, max(min(b, t), a) - a)
            for a, b, s, t in zip(start, stop, (3, 5, 7), (self.shape[0] - 3, 6, 9), strict=True)
        )
        fill[slot] = 0
        return fill, None


@pytest.mark.slow
@pytest.mark.nightly
def test_more_than_an_int32_of_solid_voxels_are_counted_one_by_one():
    shape = (1301, 1302, 1303)
    size, slot = 1301 * 1302 * 1303, 2 * (1301 - 6)
    census = Census(Slotted(shape))
    solid = Phase(True, 6, False, (0, 0, 0), (1300, 1301, 1302))
    census.take((count_fills, count_windows, solid))
    assert size > 2**31
    assert census.fills.histogram[255].sum() == census.number("cells") == size - slot
    assert told(census.counted(solid).pieces) == [(size - slot, 127, 1)]
    assert census.number("euler_number") == 2


# --- other machines, progress --------------------------------------------------------------


def sent(function, tiles):
    """Do what a cluster does: send the work, and the answer back."""
    for tile in tiles:
        there, where = pickle.loads(pickle.dumps((function, tile)))
        yield pickle.loads(pickle.dumps(there(where)))


def test_tiles_can_be_sent_to_other_machines():
    grid = random_grid((9, 8, 7), 6, periodic=(True, False, False), bulk=True)
    tiles = odd_tiles(grid.frame.shape, 1)
    assert measures.measure(grid, tiles=tiles, map=sent) == measures.measure(grid)


@pytest.mark.parametrize("bulk", [False, True])
def test_progress_is_told_after_each_tile_and_can_cancel(bulk):
    grid = random_grid((9, 8, 7), 6, bulk=bulk)
    tiles = odd_tiles(grid.frame.shape, 1)
    done = []
    rows = measures.measure(grid, tiles=tiles, progress=lambda *told: done.append(told))
    assert rows == measures.measure(grid)
    assert len(done) == (1 + bulk) * len(tiles)
    assert {stage for stage, _ in done} == {"measures"}
    shares = [share for _, share in done]
    assert shares == sorted(shares)
    assert shares[-1] == 1

    def cancel(_stage, share):
        if share > 0.5:
            raise Cancelled("enough")

    source = Elsewhere(grid)
    with pytest.raises(Cancelled):
        measures.measure(source, tiles=tiles, progress=cancel)
    assert source.asked


def test_one_pass_fetches_every_voxel_about_once():
    grid = random_grid((40, 42, 44), 0)
    source = Elsewhere(grid)
    measures.measure(source, tiles=tiles_of(grid.frame.shape, size=20**3))
    assert np.prod(source.asked, axis=1).sum() < 2 * grid.frame.size


def test_counts_taken_together_are_those_taken_alone():
    grid = random_grid((9, 8, 7), 3, periodic=(False, True, False))
    counts = (count_fills, count_windows, BoxCount(2))
    fills, windows, boxes = Together(counts)(grid, (2, 0, 3), (9, 8, 5)).of
    alone = [count(grid, (2, 0, 3), (9, 8, 5)) for count in counts]
    np.testing.assert_array_equal(fills.histogram, alone[0].histogram)
    np.testing.assert_array_equal(windows.seen, alone[1].seen)
    np.testing.assert_array_equal(boxes.counts, alone[2].counts)


@pytest.mark.parametrize("seed", range(3))
def test_the_bulk_is_found_in_every_tiling(seed):
    bulk = np.zeros((9, 8, 7), np.uint8)
    low, high = ((4, 1, 0), (6, 7, 5)) if seed else ((0, 0, 0), (0, 0, 0))
    bulk[tuple(map(slice, low, high))] = 255
    grid = VoxelGrid(Frame((0, 0, 0), (1, 1, 1), bulk.shape), bulk, bulk)
    found = measures.fold(find_bulk, grid, odd_tiles(bulk.shape, seed))
    if seed:
        assert found == Extent(low, tuple(np.subtract(high, 1).tolist()))
    else:
        assert found.first > found.last


# --- boxes ---------------------------------------------------------------------------------


def naive_boxes(solid, parts):
    return len(np.unique(np.argwhere(solid) * parts // solid.shape, axis=0))


@pytest.mark.parametrize("base", [2, 3, 5, None])
@pytest.mark.parametrize("seed", range(4))
def test_boxes_are_counted_one_by_one(base, seed):
    grid = random_grid([(17, 9, 11), (8, 16, 24), (9, 27, 18), (1, 2, 30)][seed], seed)
    shape = grid.frame.shape
    sizes, counts = measures.box_counts(grid, base=base)
    assert sizes[0] == 1
    assert sizes[-1] <= max(shape)
    boxes = lattices(shape, base)
    assert [box.size for box in boxes] == sizes.tolist()
    assert counts.tolist() == [naive_boxes(grid.solid, box.parts) for box in boxes]
    count = BoxCount.of(shape) if base is None else BoxCount(base)
    tiles = odd_tiles(shape, seed)
    sums = measures.fold(count, Elsewhere(grid), tiles)
    assert (sums.counts + list(map(len, sums.cut))).tolist() == counts.tolist()


@pytest.mark.parametrize("shape", [(10, 11, 7), (97, 100, 90), (82, 81, 81), (72, 144, 72)])
@pytest.mark.parametrize("base", [2, 3, None])
def test_boxes_fill_the_grid_and_are_alike(shape, base):
    boxes = lattices(shape, base)
    assert boxes[0].parts == shape
    assert len({box.parts for box in boxes}) == len(boxes)
    for box in boxes:
        for n, parts in zip(shape, box.parts, strict=True):
            wide = np.bincount(np.arange(n) * parts // n)
            assert len(wide) == parts
            assert wide.max() - wide.min() <= (n % parts > 0)
        if min(shape) >= box.wanted:
            assert box.size == pytest.approx(np.cbrt(np.prod(shape) / np.prod(box.parts)))
        if box.fits(shape):
            assert box.size == box.wanted


@pytest.mark.parametrize(
    ("shape", "base"),
    [
        ((81, 81, 162), 3),
        ((64, 32, 96), 2),
        ((216, 216, 216), 3),
        ((125, 250, 125), 5),
        ((100, 100, 100), None),
        ((7, 8, 9), None),
        ((1000, 1000, 1000), 5),
    ],
)
def test_boxes_fit_the_grid_where_they_can(shape, base):
    assert BoxCount.of(shape).base == base


@pytest.mark.parametrize(("thick", "dimension"), [(0, 3), (1, 2), (2, 1), (3, 0)])
def test_blocks_sheets_rods_and_voxels_have_whole_dimensions(thick, dimension):
    fill = np.zeros((32, 64, 96), np.uint8)
    fill[tuple([13] * thick + [slice(None)] * dimension)] = 255
    row = measures.box_dimension(VoxelGrid(Frame((0, 0, 0), (1, 2, 3), fill.shape), fill))
    assert row.value == pytest.approx(dimension, abs=1e-12)
    assert row.uncertainty < 1e-12
    assert (row.kind, row.of, row.unit) == ("standard", "grid", "1")


@pytest.mark.parametrize("n", [10, 25, 72, 97, 100])
@pytest.mark.parametrize("dimension", [3, 2, 1])
def test_bodies_in_grids_of_any_size_have_whole_dimensions(n, dimension):
    for place in (0, n // 2, n - 1):
        fill = np.zeros((n, n, n), np.uint8)
        fill[tuple([place] * (3 - dimension) + [slice(None)] * dimension)] = 255
        row = measures.box_dimension(VoxelGrid(Frame((0, 0, 0), (1, 2, 3), fill.shape), fill))
        assert row.value == pytest.approx(dimension, abs=1e-12)
        assert row.uncertainty < 1e-12


def test_one_layer_more_than_fits_a_fractal_hardly_changes_its_dimension():
    wide = np.zeros((82, 81, 81), np.uint8)
    wide[1:] = Menger(4).block((0, 0, 0), (81, 81, 81))[0]
    row = measures.box_dimension(VoxelGrid(Frame((0, 0, 0), (1, 1, 1), wide.shape), wide))
    assert abs(row.value - np.log(20) / np.log(3)) < 0.05


@pytest.mark.parametrize(
    ("preset", "level", "voxels"),
    [
        ("menger", 4, 81),
        ("vicsek-7", 4, 81),
        ("cantor-dust", 4, 81),
    ],
)
def test_fractals_on_their_lattice_have_their_dimension(preset, level, voxels):
    model = build(load(preset, set={"model.level": level}))
    grid = voxelize(model, voxels=voxels, sampling="centre")
    row = measures.box_dimension(grid)
    wanted = measures.similarity_dimension(model).value
    assert abs(row.value - wanted) <= 2 * row.uncertainty + 1e-9
    assert row.uncertainty < 0.3


@pytest.mark.parametrize("name", ["octahedron-flake", "vicsek-9", "jerusalem-cube"])
def test_covers_of_attractors_have_their_dimension(name):
    model = build(load(name, set={"model.level": "limit", "model.contacts": "apart"}))
    row = measures.box_dimension(voxelize(model, voxels=60, sampling="cover"))
    wanted = measures.similarity_dimension(model).value
    # Of four sizes: Student's factor is 2.2.
    assert abs(row.value - wanted) <= 2 * row.uncertainty < 1.6


@pytest.mark.parametrize("base", [2, 5])
def test_boxes_off_a_fractals_lattice_say_so_by_their_uncertainty(base):
    row = measures.box_dimension(Menger(4), base=base)
    wanted = np.log(20) / np.log(3)
    assert abs(row.value - wanted) <= 2 * row.uncertainty
    assert row.uncertainty > 0.1


def test_details_that_voxels_resolve_widen_the_uncertainty():
    coarse = measures.box_dimension(voxelize(build(load("menger")), voxels=9 * 9))
    assert abs(coarse.value - np.log(20) / np.log(3)) <= 2 * coarse.uncertainty


def test_grids_too_small_or_empty_have_no_box_dimension():
    frame = Frame((0, 0, 0), (1, 1, 1), (3, 2, 1))
    small = VoxelGrid(frame, np.full(frame.shape, 255, np.uint8))
    empty = random_grid((8, 9, 10), 0)
    empty = VoxelGrid(empty.frame, np.zeros(empty.frame.shape, np.uint8))
    for grid, why in ((small, "wanted 3 sizes"), (empty, "no solid voxel")):
        assert "box_dimension" not in measures.measure(grid)
        with pytest.raises(GridError, match=why):
            measures.box_dimension(grid)
    for base in (1, 0, 2.5):
        with pytest.raises(GridError, match="at least 2"):
            measures.box_counts(small, base=base)
