"""Voxelizing against point-by-point twins, closed forms and symmetries."""

import itertools
import math
import threading
from dataclasses import dataclass, field, replace

import naive_sampling as naive
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from porous.errors import Cancelled, GridError, MemoryLimitError, ModelError
from porous.models.digits import DigitSet
from porous.models.pieces import Pieces
from porous.models.primitive import Primitive, named, of_surface
from porous.models.rasterise import cover_pieces, fill_digits, sample_digits, sample_pieces
from porous.stages import _sampled, _voxelize, voxelize
from porous.values import CENTRE, FILL, Box, Frame, Pattern, SurfaceMesh

UNIT = Box((0, 0, 0), (1, 1, 1))
MENGER = [d for d in itertools.product(range(3), repeat=3) if sum(v == 1 for v in d) < 2]
LINES = Pattern(np.array([[0.3, 0.6], [0.7, 0.2]]), np.array([[0.2, 0.9], [0.1, 0.5]]))


@dataclass(frozen=True)
class Union:
    """The least model: pieces in a box."""

    pieces: Pieces
    domain: Box = UNIT
    bulk: Box = UNIT
    unit: str = "mm"
    feature_size: float | None = None

    def sample(self, frame, pattern):
        return self.pieces.sample(frame, pattern)

    def cover(self, frame):
        return self.pieces.cover(frame)


@dataclass(frozen=True)
class Digits:
    """A digit set with its short cut."""

    digits: DigitSet
    level: int
    domain: Box = UNIT
    bulk: Box = UNIT
    unit: str = "mm"
    feature_size: float | None = None
    asked: list = field(default_factory=list)

    def sample(self, frame, pattern):
        self.asked.append(frame)
        return sample_digits(self.digits, self.level, self.domain, frame, pattern)

    def fill(self, frame, pattern, progress=None):
        return fill_digits(self.digits, self.level, self.domain, frame, pattern, progress=progress)


def placed(matrix, shift):
    return np.column_stack([matrix, shift])


def rotation(seed):
    q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q))


def words(maps, level):
    frames = np.eye(3, 4)[None]
    for _ in range(level):
        frames = np.array(
            [placed(f[:, :3] @ A, f[:, :3] @ b + f[:, 3]) for f in frames for A, b in maps]
        )
    return frames


numbers = st.floats(-1, 1, allow_nan=False, width=32)
matrices = st.lists(numbers, min_size=9, max_size=9).map(lambda v: np.array(v).reshape(3, 3))
maps_of_space = st.tuples(
    matrices.filter(lambda m: abs(np.linalg.det(m)) > 0.02).map(
        lambda m: m * 0.6 / np.linalg.norm(m, 2)
    ),
    st.tuples(numbers, numbers, numbers).map(lambda t: np.array(t) * 0.4),
)
systems = st.lists(maps_of_space, min_size=2, max_size=3)
shapes = st.tuples(st.integers(3, 6), st.integers(3, 6), st.integers(3, 6))
patterns = st.sampled_from([CENTRE, FILL, LINES])


def around(primitive, frames, shape, margin=0.05):
    """A frame of a shape around images of a primitive, with unequal steps."""
    low = np.array(
        list(itertools.product(*zip(primitive.box.lower, primitive.box.upper, strict=True)))
    )
    ends = np.einsum("kab,nb->kna", frames[:, :, :3], low) + frames[:, None, :, 3]
    box = Box.of_points(ends.reshape(-1, 3)).grown(margin)
    return Frame(box.lower, np.array(box.lengths) / shape, shape)


def agree(masks, depth, pattern, slack=1e-5):
    """Bits equal a twin's, but where it is nearer to a surface than ``slack``."""
    found = naive.bits(masks, pattern.points)
    sure = np.abs(depth) > slack
    assert sure.mean() > 0.9
    assert (found == (depth > 0))[sure].all()
    assert not (masks >> np.uint64(pattern.points - 1) >> np.uint64(1)).any()


# --- twins ---------------------------------------------------------------------------------


@settings(max_examples=15)
@given(systems, st.integers(0, 2), st.sampled_from(list("cotdi")), shapes, patterns)
def test_hulls_equal_their_twin(maps, level, letter, shape, pattern):
    primitive = named(
        {
            "c": "cube",
            "o": "octahedron",
            "t": "tetrahedron",
            "d": "dodecahedron",
            "i": "icosahedron",
        }[letter]
    )
    frames = words(maps, level)
    frame = around(primitive, frames, shape)
    depth = naive.depth_in_hulls(naive.samples(frame, pattern), primitive, frames)
    agree(sample_pieces(primitive, frames, frame, pattern), depth, pattern)


@settings(max_examples=25)
@given(systems, st.integers(0, 2), shapes, patterns)
def test_ellipsoids_equal_their_twin(maps, level, shape, pattern):
    ball, frames = named("ball"), words(maps, level)
    frame = around(ball, frames, shape)
    depth = naive.depth_in_ellipsoids(naive.samples(frame, pattern), ball, frames)
    agree(sample_pieces(ball, frames, frame, pattern), depth, pattern)


def star():
    """A closed mesh that is not convex: a cube with a pyramid pressed into each face."""
    cube = named("cube")
    points, triangles = list(cube.points), []
    for facet, plane in zip(cube.facets, cube.planes, strict=True):
        points.append(cube.points[facet].mean(axis=0) - 0.3 * plane[:3])
        ends = zip(facet, np.roll(facet, -1), strict=True)
        triangles += [(a, b, len(points) - 1) for a, b in ends]
    return of_surface(SurfaceMesh(np.array(points), np.array(triangles)))


@settings(max_examples=6)
@given(systems, st.integers(0, 1), shapes)
def test_meshes_equal_their_twin(maps, level, shape):
    solid, frames = star(), words(maps, level)
    frame = around(solid, frames, shape)
    points = naive.samples(frame, LINES)
    inside = np.zeros(points.shape[:-1], bool)
    near = np.full(points.shape[:-1], np.inf)
    for f in frames:
        corners = (solid.points @ f[:, :3].T + f[:, 3])[solid.triangles]
        flat = points.reshape(-1, 3)
        inside |= (np.abs(naive.windings(flat, corners)) > 0.5).reshape(inside.shape)
        near = np.minimum(near, naive.distance_to_triangles(flat, corners).reshape(near.shape))
    depth = np.where(inside, near, -near)
    agree(sample_pieces(solid, frames, frame, LINES), depth, LINES)


@settings(max_examples=15)
@given(systems, st.sampled_from(["tetrahedron", "cube", "star"]), st.floats(0.02, 0.3), shapes)
def test_grown_pieces_equal_their_twin(maps, name, radius, shape):
    solid = star() if name == "star" else named(name)
    frames = words(maps, 1)
    frame = around(solid, frames, shape, margin=radius + 0.05)
    points = naive.samples(frame, LINES).reshape(-1, 3)
    depth = np.full(len(points), -np.inf)
    for f in frames:
        corners = (solid.points @ f[:, :3].T + f[:, 3])[solid.triangles]
        distance = naive.distance_to_triangles(points, corners)
        inside = np.abs(naive.windings(points, corners)) > 0.5
        depth = np.maximum(depth, radius + np.where(inside, distance, -distance))
    masks = sample_pieces(solid, frames, frame, LINES, offset=radius)
    agree(masks, depth.reshape(*frame.shape, -1), LINES)


@settings(max_examples=5)
@given(systems, st.floats(0.02, 0.3), shapes)
def test_grown_ellipsoids_equal_their_twin(maps, radius, shape):
    ball, frames = named("ball"), words(maps, 1)
    frame = around(ball, frames, shape, margin=radius + 0.05)
    points = naive.samples(frame, LINES)
    centres = frames[:, :, :3] @ ball.points[0] + frames[:, :, 3]
    depth = naive.depth_in_grown_ellipsoids(points, centres, frames[:, :, :3], radius)
    agree(sample_pieces(ball, frames, frame, LINES, offset=radius), depth, LINES)


def test_balls_are_joined():
    balls = np.array([[0.3, 0.4, 0.5, 0.2], [0.7, 0.5, 0.5, 0.1]])
    frame = Frame((0, 0.1, 0.2), (0.09, 0.08, 0.07), (9, 8, 7))
    points = naive.samples(frame, FILL)
    depth = np.max(
        [
            r - np.linalg.norm(points - c, axis=-1)
            for c, r in zip(balls[:, :3], balls[:, 3], strict=True)
        ],
        axis=0,
    )
    empty = np.zeros((0, 3, 4))
    agree(sample_pieces(named("cube"), empty, frame, FILL, balls=balls), depth, FILL)


# --- digit sets ----------------------------------------------------------------------------


@st.composite
def digit_sets(draw):
    base = draw(st.integers(2, 4))
    cells = st.tuples(*[st.integers(0, base - 1)] * 3)
    return DigitSet(base, np.array(sorted(draw(st.sets(cells, min_size=1, max_size=base**3)))))


@settings(max_examples=25)
@given(digit_sets(), st.integers(0, 3), shapes, patterns, st.booleans())
def test_digit_sets_equal_their_twin(digits, level, shape, pattern, beyond):
    margin = 0.13 if beyond else 0.0
    frame = Frame((-margin,) * 3, (1 + 2 * margin) / np.array(shape), shape)
    found = naive.bits(sample_digits(digits, level, UNIT, frame, pattern), pattern.points)
    points = naive.samples(frame, pattern)
    wanted = [
        naive.in_digits(p, digits.divisions, digits.keep, level) for p in points.reshape(-1, 3)
    ]
    assert np.array_equal(found.ravel(), wanted)


@settings(max_examples=25)
@given(digit_sets(), st.integers(0, 2), shapes, patterns)
def test_digit_sets_equal_their_cubes(digits, level, shape, pattern):
    frame = Frame((0, 0, 0), 1 / np.array(shape), shape)
    step = np.eye(3) / digits.divisions
    frames = words([(step, d / digits.divisions) for d in digits.keep], level)
    cubes = sample_pieces(named("cube"), frames, frame, pattern)
    assert np.array_equal(sample_digits(digits, level, UNIT, frame, pattern), cubes)


@settings(max_examples=25)
@given(digit_sets(), st.integers(0, 2), st.tuples(*[st.integers(1, 2)] * 3))
def test_aligned_voxels_are_full_or_empty(digits, level, per_cell):
    shape = np.array(per_cell) * digits.divisions**level
    frame = Frame((0, 0, 0), 1 / shape, tuple(int(n) for n in shape))
    fill = fill_digits(digits, level, UNIT, frame, FILL)
    assert set(np.unique(fill)) <= {0, 255}
    assert (fill == 255).sum() == len(digits.keep) ** level * np.prod(per_cell)
    counted = np.bitwise_count(sample_digits(digits, level, UNIT, frame, FILL))
    assert np.array_equal(fill, np.where(counted == 64, 255, 0))


def test_the_short_cut_is_taken_where_voxels_are_whole_and_only_there():
    digits = DigitSet(3, np.array(MENGER))
    assert fill_digits(digits, 2, UNIT, Frame.fit(UNIT, voxels=10), FILL) is None
    assert fill_digits(digits, 2, UNIT, Frame.fit(UNIT, voxels=10), CENTRE) is not None
    model = Digits(digits, 2)
    voxelize(model, voxels=18)
    assert model.asked == []
    voxelize(model, voxels=10)
    assert model.asked != []


@pytest.mark.parametrize("voxels", [10, 27, 32])
@pytest.mark.parametrize("sampling", ["fill", "centre"])
def test_the_short_cut_and_counting_give_the_same_bytes(voxels, sampling):
    model = Digits(DigitSet(3, np.array(MENGER)), 3)
    slow = Union(
        Pieces(named("cube"), words([(np.eye(3) / 3, np.array(d) / 3) for d in MENGER], 3))
    )
    assert voxelize(model, voxels=voxels, sampling=sampling) == voxelize(
        slow, voxels=voxels, sampling=sampling
    )


def test_cells_beyond_floating_point_are_refused():
    with pytest.raises(ModelError, match=r"2\^60 cells"):
        sample_digits(
            DigitSet(2, np.zeros((1, 3), int)), 60, UNIT, Frame.fit(UNIT, voxels=3), CENTRE
        )


def test_many_divisions_need_no_table_of_all():
    digits = DigitSet(1 << 20, np.array([[0, 0, 0], [1 << 19, 1 << 19, 1 << 19]]))
    frame = Frame((0, 0, 0), (2.0**-20,) * 3, (2, 2, 2))
    assert int(fill_digits(digits, 1, UNIT, frame).sum()) == 255


# --- symmetries ----------------------------------------------------------------------------


def some_union(primitive="cube", offset=0.0):
    maps = [
        (rotation(1) * 0.5, np.array([0.3, 0.2, 0.1])),
        (np.diag([0.4, 0.5, 0.3]), np.array([0.5, 0.1, 0.6])),
        (rotation(2) @ np.diag([0.6, 0.2, 0.4]), np.array([0.4, 0.5, 0.3])),
    ]
    solid = star() if primitive == "star" else named(primitive)
    balls = np.array([[0.2, 0.8, 0.5, 0.15]])
    return Pieces(solid, words(maps, 2), offset, balls)


KINDS = [
    ("cube", 0.0),
    ("ball", 0.0),
    ("star", 0.0),
    ("cube", 0.05),
    ("ball", 0.04),
    ("star", 0.03),
]
each_kind = pytest.mark.parametrize(("primitive", "offset"), KINDS)


@each_kind
def test_tiles_are_parts_of_the_whole(primitive, offset):
    pieces = some_union(primitive, offset)
    frame = Frame((0.05, -0.1, 0.0), (0.07, 0.06, 0.09), (13, 17, 11))
    whole, cover = pieces.sample(frame, FILL), pieces.cover(frame)[0]
    for start, stop in [
        ((0, 0, 0), (5, 9, 11)),
        ((4, 8, 3), (13, 10, 7)),
        ((12, 16, 10), (13, 17, 11)),
    ]:
        part = tuple(slice(a, b) for a, b in zip(start, stop, strict=True))
        tile = frame.tile(start, stop)
        assert np.array_equal(pieces.sample(tile, FILL), whole[part])
        assert np.array_equal(pieces.cover(tile)[0], cover[part])


@each_kind
def test_the_number_of_threads_does_not_show(primitive, offset, monkeypatch):
    model = Union(some_union(primitive, offset))
    monkeypatch.setattr(_sampled, "TILE", (7, 5, 6))
    grids = []
    for count in ("1", "2", "5"):
        monkeypatch.setenv("POROUS_THREADS", count)
        grids.append(voxelize(model, spacing=(0.06, 0.05, 0.07)))
    assert grids[0] == grids[1] == grids[2]
    monkeypatch.setattr(_sampled, "TILE", (64, 64, 64))
    assert voxelize(model, spacing=(0.06, 0.05, 0.07)) == grids[0]


@pytest.mark.parametrize(("primitive", "offset"), [*KINDS[:4], KINDS[5]])
@pytest.mark.parametrize("order", [(1, 2, 0), (0, 2, 1)])
def test_permuting_axes_permutes_the_grid(primitive, offset, order):
    pieces = some_union(primitive, offset)
    turn = np.eye(3)[list(order)]
    moved = replace(
        pieces,
        frames=np.einsum("ab,kbc->kac", turn, pieces.frames),
        balls=np.column_stack([pieces.balls[:, list(order)], pieces.balls[:, 3]]),
    )
    frame = Frame((0.05, -0.1, 0.0), (0.031, 0.04, 0.037), (24, 25, 26))
    back = Frame(
        *(
            tuple(np.array(v)[list(order)].tolist())
            for v in (frame.origin, frame.spacing, frame.shape)
        )
    )
    assert np.array_equal(
        moved.sample(back, CENTRE), np.transpose(pieces.sample(frame, CENTRE), order)
    )


def test_permuting_axes_permutes_digits_too():
    digits = DigitSet(2, np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0]]))
    turned = DigitSet(2, digits.keep[:, [1, 2, 0]])
    # Four voxels on eight cells: every centre lies on planes between cells.
    a = sample_digits(digits, 3, UNIT, Frame.fit(UNIT, voxels=4), CENTRE)
    b = sample_digits(turned, 3, UNIT, Frame.fit(UNIT, voxels=4), CENTRE)
    assert a.any()
    assert not a.all()
    assert np.array_equal(b, np.transpose(a, (1, 2, 0)))


@pytest.mark.parametrize("voxels", [7, 12, 16])
def test_a_symmetric_set_gives_a_symmetric_grid(voxels):
    fill = voxelize(
        Digits(DigitSet(2, np.array([(0, 0, 0), (1, 1, 1), (0, 1, 1), (1, 0, 0)])), 3),
        voxels=voxels,
        sampling="centre",
    ).fill
    assert np.array_equal(fill, fill[::-1, ::-1, ::-1])


@each_kind
def test_a_union_with_itself_is_itself(primitive, offset):
    pieces = some_union(primitive, offset)
    twice = replace(pieces, frames=np.concatenate([pieces.frames, pieces.frames[::-1]]))
    frame = Frame((0.05, -0.1, 0.0), (0.07, 0.06, 0.09), (13, 17, 11))
    assert np.array_equal(twice.sample(frame, FILL), pieces.sample(frame, FILL))


@each_kind
def test_moving_by_whole_voxels_moves_the_grid(primitive, offset):
    pieces = some_union(primitive, offset)
    spacing = np.array([1 / 16, 1 / 8, 1 / 16])
    step = np.array([3, -2, 5])
    shift = step * spacing
    moved = replace(
        pieces,
        frames=pieces.frames + np.concatenate([np.zeros((3, 3)), shift[:, None]], axis=1),
        balls=pieces.balls + np.append(shift, 0.0),
    )
    frame = Frame((0.0, -0.25, 0.0), tuple(spacing), (20, 12, 18))
    elsewhere = replace(frame, start=tuple(int(v) for v in step))
    assert np.array_equal(moved.sample(elsewhere, FILL), pieces.sample(frame, FILL))


def test_pieces_that_abut_leave_no_gap():
    # A box cut into slanted tetrahedra, none of whose faces is exact in floating point.
    turn = rotation(5)
    cube = named("cube")
    corners = np.array(list(itertools.permutations(np.eye(3))))
    frames = []
    for a, b, c in corners:
        frames.append(placed(turn @ np.column_stack([a, a + b, a + b + c]), turn @ [0.1, 0.2, 0.3]))
    simplex = Primitive(
        "simplex",
        np.vstack([np.zeros(3), np.eye(3)]),
        np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]),
        convex=True,
    )
    whole = placed(turn, turn @ [0.1, 0.2, 0.3])[None]
    frame = around(cube, whole, (24, 26, 22))
    wanted = sample_pieces(cube, whole, frame, FILL)
    for solid in (simplex, replace(simplex, convex=False)):
        assert np.array_equal(sample_pieces(solid, np.array(frames), frame, FILL), wanted)


def test_a_mesh_of_a_cube_equals_the_cube_even_where_lines_run_along_its_faces():
    solid = named("cube")
    mesh = replace(of_surface(SurfaceMesh(solid.points, solid.triangles)), convex=False)
    frames = np.array([placed(np.eye(3), np.zeros(3)), placed(rotation(3), [0.3, 0.2, 0.7])])
    for origin, pattern in itertools.product((-0.5, -0.4375), (CENTRE, FILL)):
        frame = Frame((origin,) * 3, (0.125,) * 3, (16, 16, 16))
        found = sample_pieces(mesh, frames, frame, pattern)
        assert np.array_equal(found, sample_pieces(solid, frames, frame, pattern))


@pytest.mark.parametrize("name", ["tetrahedron", "octahedron", "dodecahedron", "icosahedron"])
def test_a_mesh_of_a_solid_equals_the_solid(name):
    solid = named(name)
    mesh = replace(of_surface(SurfaceMesh(solid.points, solid.triangles)), convex=False)
    frames = words([(rotation(6) * 0.6, np.array([0.1, 0.3, 0.2])), (rotation(3), np.zeros(3))], 1)
    frame = around(solid, frames, (25, 23, 24))
    found = sample_pieces(mesh, frames, frame, FILL)
    assert np.array_equal(found, sample_pieces(solid, frames, frame, FILL))


def test_a_mirrored_mesh_is_solid():
    solid = star()
    mirror = np.array([placed(np.diag([-1.0, 1.0, 1.0]), [1.0, 0.0, 0.0])])
    frame = Frame((-0.01, -0.02, -0.03), (0.1, 0.11, 0.09), (11, 10, 12))
    straight = sample_pieces(solid, np.eye(3, 4)[None], frame, FILL)
    counts = [
        np.bitwise_count(m).sum() for m in (straight, sample_pieces(solid, mirror, frame, FILL))
    ]
    assert counts[0] == pytest.approx(counts[1], rel=2e-3)


# --- closed forms --------------------------------------------------------------------------


def volume(pieces, box, voxels):
    frame = Frame.fit(box, voxels=voxels)
    return float(np.bitwise_count(pieces.sample(frame, FILL)).sum()) / 64 * frame.voxel_volume


BOX = Box((-1.02, -1.1, -1.05), (1.13, 1.0, 1.07))


@pytest.mark.parametrize(
    ("name", "voxels", "bar"),
    # An edge of twenty voxels and more: axis-parallel faces off the lattice are the worst case.
    [("cube", 44, 5e-3), ("tetrahedron", 44, 1e-2), ("ball", 44, 1e-3)],
)
def test_volumes_of_solids_in_any_place(name, voxels, bar):
    solid = named(name)
    for seed in range(5):
        shift = np.random.default_rng(seed).uniform(-0.9, 0.0, 3)
        pieces = Pieces(solid, placed(np.eye(3), shift)[None])
        assert volume(pieces, BOX, voxels) == pytest.approx(solid.volume, rel=bar)


@pytest.mark.parametrize(
    "name", ["cube", "tetrahedron", "octahedron", "dodecahedron", "icosahedron"]
)
def test_volumes_of_turned_solids(name):
    solid = named(name)
    for seed in range(4):
        turn = rotation(seed)
        pieces = Pieces(solid, placed(turn, -turn @ [0.5, 0.5, 0.5])[None])
        assert volume(pieces, BOX, 44) == pytest.approx(solid.volume, rel=2e-3)


def exterior(solid):
    """Σ length · exterior angle over the edges: twice the mean width term of Steiner's formula."""
    if solid == "cube":
        return 12 * math.pi / 2
    return 6 * math.sqrt(2) * (math.pi - math.acos(1 / 3))


@pytest.mark.parametrize("name", ["cube", "tetrahedron"])
@pytest.mark.parametrize("radius", [0.05, 0.2])
def test_steiners_formula_for_solids(name, radius):
    solid, turn = named(name), rotation(8)
    pieces = Pieces(solid, placed(turn, -turn @ [0.5, 0.5, 0.5])[None], radius)
    wanted = (
        solid.volume
        + solid.area * radius
        + exterior(name) / 2 * radius**2
        + 4 / 3 * math.pi * radius**3
    )
    assert volume(pieces, BOX.grown(0.1), 48) == pytest.approx(wanted, rel=2e-3)


@pytest.mark.parametrize("primitive", ["cube", "ball", "star"])
@pytest.mark.parametrize("edges", [(0, 0, 0), (1, 0, 0), (1, 0.5, 0)])
def test_steiners_formula_for_flat_bodies(primitive, edges):
    solid = star() if primitive == "star" else named(primitive)
    turn, radius = rotation(4), 0.25
    frames = placed(turn @ np.diag(edges), 0.01 - turn @ np.array(edges) / 2)[None]
    shadow = {"ball": (1.0, math.pi / 4, math.pi * 1.0)}.get(primitive, (1.0, 1.0, None))
    ball = 4 / 3 * math.pi * radius**3
    if edges[1] == 0:
        wanted = math.pi * radius**2 * edges[0] + ball
    else:
        area = shadow[1] * edges[0] * edges[1]
        around_ = 3.0 if primitive != "ball" else ellipse_perimeter(0.5, 0.25)
        wanted = 2 * area * radius + around_ * math.pi / 2 * radius**2 + ball
    pieces = Pieces(solid, frames, radius)
    box = Box.of_points(np.array([np.full(3, -1.4), np.full(3, 1.5)]))
    assert volume(pieces, box, 60) == pytest.approx(wanted, rel=3e-3)
    assert not replace(pieces, offset=0.0).sample(Frame.fit(box, voxels=9), FILL).any()


def ellipse_perimeter(a, b):
    t = (np.arange(20_000) + 0.5) / 20_000 * 2 * math.pi
    return float(np.hypot(a * np.sin(t), b * np.cos(t)).mean() * 2 * math.pi)


def test_menger_against_the_closed_form():
    for level in range(4):
        grid = voxelize(Digits(DigitSet(3, np.array(MENGER)), level), voxels=27)
        assert int(grid.fill.astype(int).sum()) == 255 * 27**3 * 20**level // 27**level
    for voxels in (50, 64):
        grid = voxelize(Digits(DigitSet(3, np.array(MENGER)), 2), voxels=voxels)
        assert grid.fill.mean() / 255 == pytest.approx((20 / 27) ** 2, rel=5e-3)


# --- voxelize ------------------------------------------------------------------------------

CUBE = Union(Pieces(named("cube"), np.eye(3, 4)[None]), feature_size=1 / 3)


def test_resolutions():
    assert voxelize(CUBE, voxels=7).frame.shape == (7, 7, 7)
    assert voxelize(CUBE, spacing=(0.1, 0.26, 0.5)).frame.shape == (10, 4, 2)
    assert voxelize(CUBE, per_feature=4).frame.shape == (12, 12, 12)
    grid = voxelize(CUBE, voxels=4, periodic=(True, False, True))
    assert grid.frame.periodic == (True, False, True)
    assert grid.frame.unit == "mm"
    assert grid.sampling == "fill"
    assert grid.bulk is None
    assert grid.hausdorff is None


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({}, "no resolution"),
        ({"voxels": 3, "spacing": (1, 1, 1)}, "voxels and spacing"),
        ({"voxels": 0}, "at least 1"),
        ({"per_feature": -1}, "positive"),
        ({"per_feature": math.nan}, "positive"),
        ({"voxels": 3, "sampling": "center"}, "centre"),
        ({"spacing": (0.1, 0.1, 0)}, "positive"),
    ],
)
def test_what_cannot_be_voxelized(options, text):
    with pytest.raises(GridError, match=text):
        voxelize(CUBE, **options)


def test_features_of_every_size_want_voxels():
    with pytest.raises(GridError, match="give voxels"):
        voxelize(replace(CUBE, feature_size=None), per_feature=4)


def test_a_model_without_cover_is_told():
    with pytest.raises(GridError, match="fill or centre"):
        voxelize(Digits(DigitSet(3, np.array(MENGER)), 1), voxels=3, sampling="cover")


def test_too_many_voxels_are_refused_before_anything_is_made(monkeypatch):
    model = Digits(DigitSet(3, np.array(MENGER)), 2)
    with pytest.raises(MemoryLimitError, match=r"100000 × 100000 × 100000.*Choose voxels = \d+"):
        voxelize(model, voxels=100_000)
    assert model.asked == []
    monkeypatch.setattr(_voxelize, "available", lambda: 300_000_000)
    with pytest.raises(MemoryLimitError) as caught:
        voxelize(model, voxels=5000)
    largest = int(str(caught.value).split("voxels = ")[1].split()[0])
    _voxelize.check_grid_memory(Frame.fit(UNIT, voxels=largest), 1)
    with pytest.raises(MemoryLimitError):
        _voxelize.check_grid_memory(Frame.fit(UNIT, voxels=largest + 1), 1)


def test_bulk_is_the_exact_part_of_each_voxel():
    bulk = Box((0.1, 0.0, 0.25), (0.8, 0.5, 1.0))
    grid = voxelize(replace(CUBE, bulk=bulk), voxels=4)
    x, y, z = np.array([0.6, 1, 1, 0.2]), np.array([1, 1, 0, 0]), np.array([0, 1, 1, 1])
    assert np.array_equal(grid.bulk, np.rint(255 * x[:, None, None] * y[:, None] * z))
    assert voxelize(replace(CUBE, bulk=UNIT.grown(0.1)), voxels=4).bulk is None


def test_padding_is_no_bulk():
    model = replace(CUBE, domain=Box((0, 0, 0), (1, 0.5, 0.9)), bulk=Box((0, 0, 0), (1, 0.5, 0.9)))
    assert voxelize(model, voxels=5).bulk is None
    grid = voxelize(model, voxels=5, cubic=True)
    assert grid.frame.shape == (5, 3, 5)
    assert grid.bulk.mean() / 255 == pytest.approx(0.45 / 0.6, abs=2e-3)


def test_progress_and_cancelling(monkeypatch):
    monkeypatch.setattr(_sampled, "TILE", (4, 4, 4))
    seen = []
    voxelize(CUBE, voxels=16, progress=lambda stage, done: seen.append((stage, done)))
    assert {stage for stage, _ in seen} == {"voxelize"}
    done = [d for _, d in seen]
    assert done == sorted(done)
    assert done[-1] == 1.0
    assert len(done) == 64

    asked = []
    lock = threading.Lock()

    @dataclass(frozen=True)
    class Slow(Union):
        def sample(self, frame, pattern):
            with lock:
                asked.append(frame)
            return super().sample(frame, pattern)

    def stop(_stage, done):
        if done > 0.1:
            raise Cancelled("enough")

    with pytest.raises(Cancelled, match="enough"):
        voxelize(Slow(CUBE.pieces), voxels=40, progress=stop)
    assert len(asked) < 900


def test_progress_of_the_short_cut():
    seen = []
    voxelize(
        Digits(DigitSet(3, np.array(MENGER)), 2), voxels=9, progress=lambda _, d: seen.append(d)
    )
    assert seen[-1] == 1.0


def test_fills_are_counts():
    table = _sampled._fills(FILL)
    assert (table[0], table[32], table[64]) == (0, 128, 255)
    assert _sampled._fills(CENTRE).tolist() == [0, 255]


def test_cover_of_a_model():
    grid = voxelize(CUBE, voxels=5, sampling="cover")
    assert (grid.fill == 255).all()
    assert grid.hausdorff == pytest.approx(grid.frame.diagonal, rel=1e-4)


@pytest.mark.parametrize(
    ("options", "text"),
    [({"offset": -1.0}, "offset"), ({"balls": np.zeros((2, 3))}, "balls")],
)
def test_pieces_that_cannot_be(options, text):
    with pytest.raises(ModelError, match=text):
        cover_pieces(named("cube"), np.eye(3, 4)[None], Frame.fit(UNIT, voxels=2), **options)


def test_frames_have_a_shape():
    with pytest.raises(ModelError, match="frames"):
        Pieces(named("cube"), np.eye(4)[None])
