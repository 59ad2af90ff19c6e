"""Bodies of simplices against point-by-point twins, closed forms and pieces."""

import itertools
import math
import pickle
from dataclasses import dataclass, replace

import naive_sampling
import naive_simplices as naive
import numpy as np
import pytest
from scipy.spatial import ConvexHull, Delaunay

from porous.errors import ModelError
from porous.kernels import simplices as kernels
from porous.models.pieces import Pieces
from porous.models.primitive import named
from porous.models.simplices import HEXA_TETS, Simplices, hexa_tets, octa_tets, volumes
from porous.models.simplices import _with_means as with_means
from porous.stages import _sampled, voxelize
from porous.values import CENTRE, FILL, Box, Frame, Pattern

UNIT = np.array(list(itertools.product((0.0, 1.0), repeat=3)))
LINES = Pattern(np.array([[0.3, 0.6], [0.7, 0.2]]), np.array([[0.2, 0.9], [0.1, 0.5]]))
DRAWS = 100

INSIDE = 1e-9
"""Twins may differ where a sample is nearer to the surface from within …"""
OUTSIDE = 4e-5
"""… or from without, in voxels: bodies are closed."""


@dataclass(frozen=True)
class Union:
    """The least model: simplices in a box."""

    body: Simplices
    domain: Box
    bulk: Box
    unit: str = "mm"

    def sample(self, frame, pattern):
        return self.body.sample(frame, pattern)

    def cover(self, frame):
        return self.body.cover(frame)


def some_frame(random, most=6):
    spacing = random.uniform(0.1, 0.5, 3)
    return Frame(tuple(random.normal(size=3)), tuple(spacing), tuple(random.integers(2, most, 3)))


def some_points(random, frame, *shape):
    """Points in and about a frame, in groups of very different size."""
    low, size = np.array(frame.box.lower), np.array(frame.box.lengths)
    middle = low + size * random.uniform(-0.1, 1.1, (shape[0], *(1,) * (len(shape) - 1), 3))
    extent = 10.0 ** random.uniform(-2, 0, (shape[0], *(1,) * len(shape)))
    return middle + size * extent * random.uniform(-1, 1, (*shape, 3))


def some_body(random, frame, count=3):
    step = min(frame.spacing)
    tets = some_points(random, frame, count, 4)
    thin = tets[0]
    tets[0] = thin.mean(axis=0) + (thin - thin.mean(axis=0)) * [1, 1, 1e-4]
    balls = np.column_stack([some_points(random, frame, count), random.uniform(0, step, count)])
    return Simplices(
        tets,
        balls,
        some_points(random, frame, count, 2),
        random.uniform(0, step, count),
        some_points(random, frame, count, 3),
        random.uniform(0, step, count),
    )


def mixed(seed=7, count=40):
    """A frame of unequal axes and a body of all kinds, more than a block of each."""
    random = np.random.default_rng(seed)
    frame = Frame((0.05, -0.1, 0.0), (0.07, 0.06, 0.09), (13, 17, 11))
    body = some_body(random, frame, count)
    for _ in range(3):
        body = body.joined(some_body(random, frame, count))
    small = [np.where(radii < 0.03, radii, 0.0) for radii in (body.capsule_radii, body.plate_radii)]
    return frame, replace(body, capsule_radii=small[0], plate_radii=small[1], balls=body.balls[:9])


def scaled(body, frame):
    """The tetrahedra of a body in voxels; swept simplices stay in the world."""
    return (body.tets - frame.origin) / frame.spacing


def agree(body, frame, pattern):
    """The bits of all samples but those that lie on a surface equal the twin's."""
    points = naive_sampling.samples(frame, pattern).reshape(-1, 3)
    found = naive_sampling.bits(body.sample(frame, pattern), pattern.points).ravel()
    step = np.array(frame.spacing)
    depth = np.maximum(
        naive.depth_in_tets((points - frame.origin) / step, scaled(body, frame)),
        naive.depth(points, replace(body, tets=body.tets[:0])) / step.max(),
    )
    unsure = (depth > -OUTSIDE) & (depth < INSIDE)
    assert unsure.mean() < 1e-2
    assert np.array_equal(found[~unsure], depth[~unsure] > 0)
    return found


# --- twins ---------------------------------------------------------------------------------


@pytest.mark.parametrize("pattern", [CENTRE, FILL, LINES], ids=["centre", "fill", "lines"])
def test_bodies_equal_their_twin(pattern):
    random = np.random.default_rng(pattern.points)
    some = 0
    for _ in range(DRAWS):
        frame = some_frame(random)
        found = agree(some_body(random, frame), frame, pattern)
        some += 0.02 < found.mean() < 0.98
    assert some > DRAWS / 3


@pytest.mark.parametrize("kind", ["tets", "balls", "capsules", "plates"])
def test_each_kind_equals_its_twin(kind):
    random = np.random.default_rng(len(kind))
    for _ in range(DRAWS // 4):
        frame = some_frame(random)
        whole = some_body(random, frame)
        own = {kind: getattr(whole, kind)}
        if kind in ("capsules", "plates"):
            own[f"{kind[:-1]}_radii"] = getattr(whole, f"{kind[:-1]}_radii")
        agree(Simplices(**own), frame, LINES)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_simplices_along_the_axes_equal_their_twin(axis):
    way = np.eye(3)[axis]
    side = np.eye(3)[axis - 1]
    ends = np.array([[0.2, 0.3, 0.4] - 0.1 * way, [0.2, 0.3, 0.4] + 0.5 * way])
    triangle = np.array(
        [[0.5, 0.5, 0.5], [0.5, 0.5, 0.5] + 0.3 * way, [0.5, 0.5, 0.5] + 0.4 * side]
    )
    twice = np.array([[0.8, 0.1, 0.2]] * 2)
    needle = np.array([[0.1, 0.8, 0.1], [0.1, 0.8, 0.1] + 0.4 * way, [0.1, 0.8, 0.1] + 0.2 * way])
    body = Simplices(
        capsules=np.array([ends, twice]),
        capsule_radii=np.array([0.08, 0.05]),
        plates=np.array([triangle, needle]),
        plate_radii=np.array([0.06, 0.04]),
    )
    frame = Frame((-0.1, -0.1, -0.1), (0.117, 0.093, 0.131), (10, 12, 9))
    agree(body, frame, FILL)


@pytest.mark.parametrize("seed", range(4))
def test_no_corner_matters_more_than_another(seed):
    random = np.random.default_rng(seed)
    frame = some_frame(random, 9)
    tets = some_points(random, frame, 30, 4)
    body = Simplices(tets, capsules=tets[:, :2], capsule_radii=np.full(30, 0.05))
    turned = Simplices(
        tets[::-1, random.permutation(4)], capsules=tets[:, 1::-1], capsule_radii=np.full(30, 0.05)
    )
    assert np.array_equal(body.sample(frame, FILL), turned.sample(frame, FILL))
    assert np.array_equal(body.cover(frame)[0], turned.cover(frame)[0])


# --- tiles, threads, symmetries ------------------------------------------------------------


def test_tiles_are_parts_of_the_whole():
    frame, body = mixed()
    whole, cover = body.sample(frame, FILL), body.cover(frame)[0]
    random = np.random.default_rng(1)
    for _ in range(20):
        start = random.integers(0, frame.shape)
        stop = random.integers(start + 1, np.array(frame.shape) + 1)
        part = tuple(slice(a, b) for a, b in zip(start, stop, strict=True))
        tile = frame.tile(tuple(start.tolist()), tuple(stop.tolist()))
        assert np.array_equal(body.sample(tile, FILL), whole[part])
        assert np.array_equal(body.cover(tile)[0], cover[part])


def test_the_number_of_threads_does_not_show(monkeypatch):
    _, body = mixed()
    model = Union(body, body.box, body.box)
    monkeypatch.setattr(_sampled, "TILE", (7, 5, 6))
    grids = []
    for count in ("1", "2", "5"):
        monkeypatch.setenv("POROUS_THREADS", count)
        grids.append(voxelize(model, spacing=(0.06, 0.05, 0.07)))
    assert grids[0] == grids[1] == grids[2]
    monkeypatch.setattr(_sampled, "TILE", (64, 64, 64))
    assert voxelize(model, spacing=(0.06, 0.05, 0.07)) == grids[0]


def test_the_length_of_a_call_does_not_show(monkeypatch):
    frame, body = mixed()
    whole, cover = body.sample(frame, FILL), body.cover(frame)[0]
    monkeypatch.setattr(kernels, "BATCH", 1)
    assert np.array_equal(body.sample(frame, FILL), whole)
    assert np.array_equal(body.cover(frame)[0], cover)


def test_a_union_with_itself_is_itself():
    frame, body = mixed()
    twice = body.joined(body)
    assert len(twice.tets) == 2 * len(body.tets)
    assert np.array_equal(twice.sample(frame, FILL), body.sample(frame, FILL))
    assert np.array_equal(twice.cover(frame)[0], body.cover(frame)[0])


def test_a_union_is_the_union_of_its_parts():
    frame, body = mixed()
    parts = [
        Simplices(body.tets),
        Simplices(balls=body.balls),
        Simplices(capsules=body.capsules, capsule_radii=body.capsule_radii),
        Simplices(plates=body.plates, plate_radii=body.plate_radii),
    ]
    masks = [part.sample(frame, FILL) for part in parts]
    assert all(mask.any() for mask in masks)
    assert np.array_equal(np.bitwise_or.reduce(masks), body.sample(frame, FILL))
    covers = [part.cover(frame)[0] for part in parts]
    assert np.array_equal(np.bitwise_or.reduce(covers), body.cover(frame)[0])


@pytest.mark.parametrize("order", [(1, 2, 0), (0, 2, 1)])
def test_permuting_axes_permutes_the_grid(order):
    frame, body = mixed()
    order = list(order)
    moved = replace(
        body,
        tets=body.tets[..., order],
        balls=body.balls[:, [*order, 3]],
        capsules=body.capsules[..., order],
        plates=body.plates[..., order],
    )
    turned = [
        tuple(np.array(v)[order].tolist()) for v in (frame.origin, frame.spacing, frame.shape)
    ]
    there = moved.sample(Frame(*turned), CENTRE)
    assert np.array_equal(there, np.transpose(body.sample(frame, CENTRE), order))
    marks = moved.cover(Frame(*turned))[0]
    assert np.array_equal(marks, np.transpose(body.cover(frame)[0], order))


# --- closed bodies -------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(5))
def test_tetrahedra_that_abut_leave_no_gap(seed):
    # Corners on a lattice, so that many samples lie on shared faces; corners that neighbours share
    # differ in the last digits.
    random = np.random.default_rng(seed)
    corners = np.unique(random.integers(0, 9, (60, 3)) / 2, axis=0)
    found = corners[Delaunay(corners).simplices]
    tets = found * (1 + 1e-15 * random.integers(-2, 3, found.shape))
    frame = Frame((-0.25, -0.25, -0.25), (0.5, 0.25, 0.5), (10, 20, 10))
    masks = Simplices(tets).sample(frame, CENTRE)
    hull = ConvexHull(corners).equations
    points = naive_sampling.samples(frame, CENTRE)[..., 0, :]
    height = (points @ hull[:, :3].T + hull[:, 3]).max(axis=-1)
    assert np.isclose(height, 0).sum() > 10
    assert np.array_equal(masks > 0, height < 1e-9)


def test_a_cube_cut_in_tetrahedra_is_the_cube():
    pieces = Pieces(named("cube"), np.eye(3, 4)[None])
    fine = with_means(UNIT[None])[:, HEXA_TETS].reshape(-1, 4, 3)
    coarse = hexa_tets(UNIT[None])
    assert (len(fine), len(coarse)) == (24, 5)
    for spacing, pattern in itertools.product([0.125, 0.1, 0.13], [CENTRE, FILL, LINES]):
        # With the first spacing, and half a voxel aside, faces pass through voxels' centres.
        for shift in (0.0, spacing / 2):
            frame = Frame((-shift, -shift, -shift), (spacing, spacing, spacing / 2), (11, 11, 22))
            wanted = pieces.sample(frame, pattern)
            for tets in (fine, coarse):
                assert np.array_equal(Simplices(tets).sample(frame, pattern), wanted)
                assert np.array_equal(Simplices(tets).cover(frame)[0], pieces.cover(frame)[0])


@pytest.mark.parametrize("seed", range(6))
def test_turned_blocks_cut_in_tetrahedra_are_the_blocks(seed):
    random = np.random.default_rng(seed)
    matrix = random.uniform(-1, 1, (3, 3))
    frames = np.array([np.column_stack([matrix, matrix @ d]) for d in UNIT])
    cells = UNIT @ matrix.T + frames[:, None, :, 3]
    box = Box.of_points(cells.reshape(-1, 3)).grown(0.03)
    frame = Frame(box.lower, tuple(np.array(box.lengths) / (11, 7, 9)), (11, 7, 9))
    wanted = Pieces(named("cube"), frames)
    body = Simplices(hexa_tets(cells))
    assert len(body.tets) == 40
    assert np.array_equal(body.sample(frame, FILL), wanted.sample(frame, FILL))
    assert np.array_equal(body.cover(frame)[0], wanted.cover(frame)[0])


def test_samples_on_the_surface_are_in():
    tet = np.array([[[0, 0, 0], [2, 0, 0], [0, 2, 0], [0, 0, 2]]]) + 0.5
    masks = Simplices(tet).sample(Frame((0, 0, 0), (1, 1, 1), (4, 4, 4)), CENTRE)
    index = np.indices((4, 4, 4)).sum(axis=0)
    assert np.array_equal(masks > 0, index <= 2)


def test_flat_tetrahedra_hold_no_sample():
    frame = Frame((0, 0, 0), (1, 1, 1), (5, 5, 5))
    square = np.array([[[0.5, 0.5, 2.5], [4.5, 0.5, 2.5], [0.5, 4.5, 2.5], [4.5, 4.5, 2.5]]])
    line = np.linspace([0.5, 0.5, 0.5], [4.5, 4.5, 4.5], 4)[None]
    point = np.full((1, 4, 3), 2.5)
    for tets in (square, line, point):
        body = Simplices(tets)
        assert not body.sample(frame, FILL).any()
        assert not body.sample(frame, CENTRE).any()
        assert body.cover(frame)[0].any()


@pytest.mark.parametrize("height", [1e-4, 1e-6, 1e-8, 1e-10])
def test_flat_tetrahedra_do_not_spread(height):
    # A plane of samples passes between facets that are almost parallel to it.
    random = np.random.default_rng(3)
    frame = Frame((0, 0, 0), (1, 1, 1), (24, 24, 2))
    points = naive_sampling.samples(frame, CENTRE)[:, :, 0, 0, :2]
    for _ in range(DRAWS):
        corners = np.column_stack([random.uniform(2, 22, (4, 2)), np.full(4, 0.5)])
        corners[:, 2] += height * np.array([1, -1, 1, -1])
        found = Simplices(corners[None]).sample(frame, CENTRE)[:, :, 0] > 0
        hull = ConvexHull(corners[:, :2]).equations
        away = (points @ hull[:, :2].T + hull[:, 2]).max(axis=-1)
        assert not found[away > OUTSIDE].any()


# --- volumes -------------------------------------------------------------------------------


def curved(random, count, size=0.25):
    return UNIT + random.uniform(-size, size, (count, 8, 3))


def volume(body, voxels, margin=0.011):
    box = body.box.grown(margin)
    frame = Frame.fit(box, voxels=voxels)
    return float(np.bitwise_count(body.sample(frame, FILL)).sum()) / 64 * frame.voxel_volume


def test_tetrahedra_have_the_volume_of_their_hexahedra():
    random = np.random.default_rng(11)
    cells = curved(random, DRAWS)
    found = volumes(hexa_tets(cells)).reshape(DRAWS, 24)
    assert (found > 0).all()
    for cell, parts in zip(cells, found, strict=True):
        assert parts.sum() == pytest.approx(naive.trilinear_volume(cell), rel=1e-13)


def test_straight_hexahedra_cost_less():
    random = np.random.default_rng(12)
    maps = random.uniform(-1, 1, (DRAWS, 3, 3))
    maps *= np.sign(np.linalg.det(maps))[:, None, None]
    straight = np.einsum("kab,nb->kna", maps, UNIT) + random.normal(size=(DRAWS, 1, 3))
    found = volumes(hexa_tets(straight))
    assert len(found) == 5 * DRAWS
    assert (found > 0).all()
    assert found.reshape(-1, 5).sum(axis=1) == pytest.approx(np.linalg.det(maps), rel=1e-12)
    bent = curved(random, 2)
    mixed_up = np.concatenate([straight[:1], bent[:1], straight[1:3], bent[1:]])
    parts = [hexa_tets(cell[None]) for cell in mixed_up]
    assert [len(part) for part in parts] == [5, 24, 5, 5, 24]
    assert np.array_equal(hexa_tets(mixed_up), np.concatenate(parts))
    barely = straight[:1].copy()
    barely[0, 7] += 1e-9
    assert len(hexa_tets(barely)) == 24


def test_neighbours_cut_a_shared_face_alike():
    # The faces of two cells beside each other: every triangle on the shared one occurs twice.
    random = np.random.default_rng(13)
    grid = np.stack(np.meshgrid([0, 1, 2], [0, 1], [0, 1], indexing="ij"), axis=-1) * 1.0
    grid += random.uniform(-0.2, 0.2, grid.shape)
    cells = np.array([grid[:2].reshape(8, 3), grid[1:].reshape(8, 3)])
    tets = hexa_tets(cells)
    faces = tets[:, [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]]].reshape(-1, 3, 3)
    keys = [tuple(sorted(map(tuple, np.round(face, 12).tolist()))) for face in faces]
    single = [key for key in keys if keys.count(key) == 1]
    assert len(single) == 2 * 24 - 2 * 4
    assert len(set(keys)) == (4 * 48 - len(single)) // 2 + len(single)


def test_curved_hexahedra_are_sampled_as_such():
    # The 24 tetrahedra differ from the trilinear cell near its bent faces only.
    cell = curved(np.random.default_rng(14), 1, 0.1)[0]
    frame = Frame((-0.2, -0.2, -0.2), (0.11, 0.12, 0.1), (13, 12, 14))
    found = naive_sampling.bits(Simplices(hexa_tets(cell[None])).sample(frame, LINES), 4)
    points = naive_sampling.samples(frame, LINES).reshape(-1, 3)
    wanted = naive.in_trilinear(points, cell).reshape(found.shape)
    assert (found != wanted).mean() < 0.01
    assert found.mean() == pytest.approx(wanted.mean(), rel=5e-3)


def test_sampled_volume_converges():
    # Samples are a lattice of spacing s: about 1/s² of them lie at the surface, and those that fall
    # to the wrong side by chance leave an error of s³ · √(1/s²) = s².
    random = np.random.default_rng(15)
    errors = []
    for cell in curved(random, 12, 0.2):
        body, exact = Simplices(hexa_tets(cell[None])), naive.trilinear_volume(cell)
        errors.append([volume(body, n) / exact - 1 for n in (6, 12, 24, 48)])
    typical = np.sqrt(np.mean(np.square(errors), axis=0))
    order = np.polyfit(np.log([6, 12, 24, 48]), -np.log(typical), 1)[0]
    assert 1.6 < order < 2.6
    assert typical[-1] < 1e-4


SWEPT = {
    "ball": (
        Simplices(balls=[[0.1, 0.2, 0.3, 0.7]]),
        4 / 3 * math.pi * 0.7**3,
    ),
    "capsule": (
        Simplices(capsules=[[[0, 0, 0], [1, 2, 3]]], capsule_radii=[0.6]),
        math.pi * 0.6**2 * math.sqrt(14) + 4 / 3 * math.pi * 0.6**3,
    ),
    "plate": (
        Simplices(plates=[[[0, 0, 0], [3, 0, 1], [0, 4, 0.5]]], plate_radii=[0.3]),
        # Steiner: 2 r times the area, π r² / 2 times the perimeter, a ball.
        0.3 * np.linalg.norm(np.cross([3, 0, 1], [0, 4, 0.5]))
        + math.pi * 0.3**2 / 2 * (10**0.5 + 16.25**0.5 + 25.25**0.5)
        + 4 / 3 * math.pi * 0.3**3,
    ),
}


@pytest.mark.parametrize("kind", SWEPT)
def test_swept_simplices_have_the_volume_of_steiners_formula(kind):
    body, exact = SWEPT[kind]
    errors = [abs(volume(body, n) / exact - 1) for n in (8, 32, 96)]
    assert errors[0] < 3e-2
    assert errors[1] < 3e-3
    assert errors[2] < 3e-4


def test_octahedra_are_four_tetrahedra():
    random = np.random.default_rng(16)
    ends = np.array([-np.eye(3), np.eye(3)]).swapaxes(0, 1).reshape(6, 3)
    tets = octa_tets(ends[None])
    assert volumes(tets) == pytest.approx(np.full(4, 1 / 3), rel=1e-15)
    for _ in range(10):
        matrix, shift = random.uniform(-1, 1, (3, 3)), random.normal(size=3)
        cells = (ends @ matrix.T + shift)[None]
        box = Box.of_points(cells[0]).grown(0.05)
        frame = Frame(box.lower, tuple(np.array(box.lengths) / (8, 7, 9)), (8, 7, 9))
        middle = named("octahedron").points
        place = np.linalg.lstsq(
            np.column_stack([middle, np.ones(6)]), ends_like(middle, cells[0]), rcond=None
        )[0]
        wanted = Pieces(named("octahedron"), place.T[None])
        body = Simplices(octa_tets(cells))
        assert np.array_equal(body.sample(frame, FILL), wanted.sample(frame, FILL))


def ends_like(points, corners):
    """Corners of an octahedron, in opposite pairs, in the order of another's points."""
    centre = points.mean(axis=0)
    axes = []
    for i in range(6):
        j = next(k for k in range(6) if np.allclose(points[i] + points[k], 2 * centre))
        if (j, i) not in axes:
            axes.append((i, j))
    result = np.empty((6, 3))
    for axis, (i, j) in enumerate(axes):
        result[i], result[j] = corners[2 * axis], corners[2 * axis + 1]
    return result


def test_volumes_are_signed():
    tet = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    assert volumes([tet, tet[[1, 0, 2, 3]], tet * 0]).tolist() == [1 / 6, -1 / 6, 0]


# --- growing -------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(8))
def test_grown_tetrahedra_equal_grown_pieces(seed):
    random = np.random.default_rng(seed)
    place = np.column_stack([random.uniform(-1, 1, (3, 3)), random.normal(size=3)])
    solid = named("tetrahedron")
    radius = random.uniform(0.02, 0.3)
    tets = (solid.points @ place[:, :3].T + place[:, 3])[None]
    box = Box.of_points(tets[0]).grown(radius * 1.1)
    frame = Frame(box.lower, tuple(np.array(box.lengths) / (8, 9, 7)), (8, 9, 7))
    wanted, body = Pieces(solid, place[None], radius), Simplices(tets).grown(radius)
    assert np.array_equal(body.sample(frame, FILL), wanted.sample(frame, FILL))
    marks, bound = body.cover(frame)
    assert bound == wanted.cover(frame)[1]
    assert not (marks & ~wanted.cover(frame)[0]).any()


@pytest.mark.parametrize("seed", range(4))
def test_grown_bodies_hold_what_is_near(seed):
    random = np.random.default_rng(100 + seed)
    frame = some_frame(random, 9)
    body, radius = some_body(random, frame), random.uniform(0.5, 1) * min(frame.spacing)
    points = naive_sampling.samples(frame, LINES).reshape(-1, 3)
    found = naive_sampling.bits(body.grown(radius).sample(frame, LINES), 4).ravel()
    depth = naive.depth(points, body) + radius
    sure = np.abs(depth) > 1e-5
    assert np.array_equal(found[sure], depth[sure] > 0)


def test_growing_needs_the_skin_alone():
    # Two cells beside each other: faces between tetrahedra add nothing.
    random = np.random.default_rng(17)
    cell = curved(random, 1)
    tets = hexa_tets(cell)
    skin = tets[:, 1:]  # the face opposite the centre
    frame = Frame((-0.5, -0.5, -0.5), (0.2, 0.17, 0.19), (10, 12, 11))
    all_faces, outer = Simplices(tets).grown(0.15), Simplices(tets).grown(0.15, skin)
    assert (len(all_faces.plates), len(outer.plates)) == (96, 24)
    assert np.array_equal(all_faces.sample(frame, FILL), outer.sample(frame, FILL))


def test_growing_twice_is_growing_once():
    random = np.random.default_rng(18)
    frame = some_frame(random, 9)
    body = some_body(random, frame)
    once, twice = body.grown(0.3), body.grown(0.125).grown(0.175)
    assert np.array_equal(once.sample(frame, FILL), twice.sample(frame, FILL))
    assert np.array_equal(body.grown(0).sample(frame, FILL), body.sample(frame, FILL))
    assert np.array_equal(body.grown(0).cover(frame)[0], body.cover(frame)[0])
    agree(once, frame, LINES)


@pytest.mark.parametrize("radius", [-0.1, math.inf, math.nan])
def test_growing_by_no_length_is_refused(radius):
    with pytest.raises(ModelError, match="wanted a length"):
        Simplices().grown(radius)


# --- covers --------------------------------------------------------------------------------


def simplices_of(body):
    return [body.tets, body.balls[:, None, :3], body.capsules, body.plates]


def test_tetrahedra_mark_just_the_voxels_they_touch():
    random = np.random.default_rng(20)
    for _ in range(DRAWS // 5):
        frame = some_frame(random, 5)
        tets = some_points(random, frame, 2, 4)
        tets[0] = tets[0].mean(axis=0) + (tets[0] - tets[0].mean(axis=0)) * [1, 1, 0]
        thin = Simplices(
            tets,
            capsules=some_points(random, frame, 1, 2),
            capsule_radii=np.zeros(1),
            plates=some_points(random, frame, 1, 3),
            plate_radii=np.zeros(1),
            balls=np.column_stack([some_points(random, frame, 1), [0.0]]),
        )
        found = thin.cover(frame)[0] > 0
        hulls = [simplex for group in simplices_of(thin) for simplex in group]
        assert not (naive.touched(hulls, frame, slack=-1e-6) & ~found).any()
        assert not (found & ~naive.touched(hulls, frame, slack=1e-5)).any()


def test_covers_are_certified():
    random = np.random.default_rng(21)
    for _ in range(DRAWS):
        frame = some_frame(random, 8)
        body = some_body(random, frame, 2)
        marks, bound = body.cover(frame)
        assert bound == pytest.approx(frame.diagonal, rel=2e-5)
        radii = [np.zeros(2), body.balls[:, 3], body.capsule_radii, body.plate_radii]
        for corners, reach in zip(simplices_of(body), radii, strict=True):
            points = naive.points_of(corners, 300, random).reshape(2, -1, 3)
            way = random.normal(size=points.shape)
            way /= np.linalg.norm(way, axis=2, keepdims=True)
            ends = (points + way * reach[:, None, None]).reshape(-1, 3)
            index = np.floor((ends - frame.origin) / frame.spacing).astype(int)
            inside = ((index >= 0) & (index < frame.shape)).all(axis=1)
            assert marks[tuple(index[inside].T)].all()


@pytest.mark.parametrize("radius", [0.0, 1e-3, 0.3])
def test_a_touch_at_a_corner_is_covered(radius):
    # Along a diagonal a voxel's centre is as far from what it touches as can be.
    frame = Frame((0, 0, 0), (0.5, 0.1, 0.2), (9, 21, 13))
    step = np.array(frame.spacing)
    for way in itertools.product((-1, 1), repeat=3):
        unit = way * step / frame.diagonal
        corner = (np.array([4, 10, 6]) + (np.array(way) + 1) / 2) * step
        end = corner + (radius - 1e-7) * unit
        bodies = [
            Simplices(balls=[[*end, radius]]),
            Simplices(capsules=[[end, end + 0.1 * unit]], capsule_radii=[radius]),
            Simplices(plates=[[end + 0.1 * unit, end, end + 0.1 * unit]], plate_radii=[radius]),
        ]
        for body in bodies:
            marks = body.cover(frame)[0]
            assert marks[4, 10, 6]


def test_a_tile_sees_what_lies_beside_it():
    # Half a diagonal is more than two voxels along y.
    frame = Frame((0, 0, 0), (0.5, 0.1, 0.2), (3, 21, 5))
    body = Simplices(balls=[[0.75, 1.05, 0.5, 0.01]])
    marks = body.cover(frame)[0]
    assert marks.sum(axis=1)[1, 2] == 5
    for voxel in np.ndindex(*frame.shape):
        tile = frame.tile(voxel, tuple(k + 1 for k in voxel))
        assert body.cover(tile)[0][0, 0, 0] == marks[voxel]


def test_every_point_of_a_cover_is_within_its_bound():
    random = np.random.default_rng(22)
    for _ in range(DRAWS // 4):
        frame = some_frame(random)
        body = some_body(random, frame, 2)
        marks, bound = body.cover(frame)
        voxels = np.argwhere(marks)
        corners = np.array(list(itertools.product((0, 0.5, 1), repeat=3)))
        points = frame.origin + (voxels[:, None] + corners).reshape(-1, 3) * frame.spacing
        assert (naive.depth(points, body) >= -bound).all()


def test_a_sample_is_covered():
    frame, body = mixed()
    assert not (body.sample(frame, FILL)[body.cover(frame)[0] == 0]).any()


# --- the value -----------------------------------------------------------------------------


def test_nothing_is_empty():
    frame = Frame((0, 0, 0), (1, 1, 1), (2, 3, 4))
    nothing = Simplices()
    assert nothing.empty
    assert not nothing.sample(frame, FILL).any()
    assert not nothing.cover(frame)[0].any()
    assert nothing.grown(1.0).empty
    with pytest.raises(ModelError, match="nothing has no box"):
        _ = nothing.box
    assert len(hexa_tets(np.zeros((0, 8, 3)))) == len(octa_tets(np.zeros((0, 6, 3)))) == 0
    assert len(volumes(np.zeros((0, 4, 3)))) == 0


def test_a_box_holds_all_kinds():
    body = Simplices(
        [[[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, -3]]],
        [[5, 0, 0, 1]],
        [[[0, 2, 0], [0, 7, 0]]],
        [0.5],
        [[[0, 0, 0], [0, 0, 4], [-2, 0, 0]]],
        [0.25],
    )
    assert not body.empty
    assert body.box == Box((-2.25, -1, -3), (6, 7.5, 4.25))


def test_bodies_are_values():
    _, body = mixed()
    assert pickle.loads(pickle.dumps(body)) == body
    assert body != replace(body, tets=body.tets[1:])
    assert hash(body) == hash(replace(body))
    given = np.zeros((1, 4, 3))
    held = Simplices(given)
    given[0] = 1.0
    assert not held.tets.any()
    with pytest.raises(ValueError, match="read-only"):
        body.tets[0] = 0


BAD = [
    ({"tets": np.zeros((4, 3))}, r"tets: got shape \(4, 3\); wanted \(n, 4, 3\)"),
    ({"tets": np.full((1, 4, 3), np.nan)}, "tets: got a number that is not finite"),
    ({"tets": [[1, 2], [3]]}, "tets: got no array of numbers"),
    ({"tets": "abc"}, "tets: got no array of numbers"),
    ({"balls": np.zeros((2, 3))}, r"balls: got shape \(2, 3\); wanted \(n, 4\)"),
    ({"balls": [[0, 0, 0, -1]]}, "balls: got radius -1.0; wanted lengths, zero or more"),
    ({"balls": [[0, 0, 0, np.inf]]}, "balls: got a number that is not finite"),
    ({"capsules": np.zeros((2, 3, 3))}, "capsules: got shape"),
    ({"capsules": np.zeros((2, 2, 3))}, "capsule_radii: got 0 for 2 capsules; wanted one for each"),
    ({"capsules": np.zeros((1, 2, 3)), "capsule_radii": [-2]}, "capsule_radii: got radius -2.0"),
    ({"plates": np.zeros((1, 3))}, "plates: got shape"),
    ({"plates": np.zeros((1, 3, 3)), "plate_radii": [[1]]}, r"plate_radii: got shape \(1, 1\)"),
    ({"plates": np.zeros((1, 3, 3)), "plate_radii": 1.0}, r"plate_radii: got shape \(\); wanted"),
    ({"plate_radii": [1.0]}, "plate_radii: got 1 for 0 plates"),
]


@pytest.mark.parametrize(("fields", "text"), BAD)
def test_bodies_that_cannot_be(fields, text):
    with pytest.raises(ModelError, match=text):
        Simplices(**fields)


def test_cells_that_cannot_be():
    for split, wanted in ((hexa_tets, "8, 3"), (octa_tets, "6, 3"), (volumes, "4, 3")):
        with pytest.raises(ModelError, match=rf"wanted \(n, {wanted}\)"):
            split(np.zeros((2, 5, 3)))
    with pytest.raises(ModelError, match="skin: got shape"):
        Simplices().grown(1.0, np.zeros((3, 3)))
