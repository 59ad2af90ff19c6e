"""Covers of limits with control points: what they hold, how far they reach, what must not show."""

import itertools

import naive_limits as naive
import naive_sampling
import numpy as np
import pytest
from rough import (
    BEZIER,
    bent,
    curve,
    koch,
    rough,
    sponge,
    straight,
    takagi,
    tetrahedra_and_octahedra,
)
from scipy.spatial import cKDTree

from porous.errors import ModelError
from porous.models import cell_cover, net
from porous.models.automaton import Automaton, State, Transition, of_maps
from porous.models.bcifs import bcifs
from porous.models.builders import Options, Texture, build_cell
from porous.models.cell_attractor import CellAttractor
from porous.models.cell_cover import cover_cells, sample_cells
from porous.models.cifs import cifs
from porous.models.cover import cover_attractor
from porous.models.digits import named
from porous.models.drawing import cell, image, nothing, sticks
from porous.models.enclosure import enclosing_balls
from porous.models.mixtures import weights_of
from porous.models.net import net_error
from porous.models.pieces import Pieces
from porous.models.primitive import named as solid_named
from porous.models.swept_body import Sweep
from porous.recipe import build, load
from porous.stages import voxelize
from porous.values import CENTRE, FILL, Box, Frame

CUBE = np.array(list(itertools.product((0.0, 1.0), repeat=3))).T
FRAME = np.hstack([np.zeros((3, 1)), np.eye(3)])


def menger_maps():
    digits = itertools.product(range(3), repeat=3)
    return [(np.eye(3) / 3, np.array(d) / 3) for d in digits if d.count(1) < 2]


def transient():
    """Threes once, then twos: two states of 27 controls."""
    threes = sponge(rough((0.4, 0.4), (0.2, 0.3, 0.2)), bend=bent(27, 2, 0.06))
    kept = [(0, 0, 0), (1, 0, 1), (0, 1, 1), (1, 1, 0)]
    twos = sponge(rough((0.4,), (0.2, 0.4)), kept)
    moves = [Transition(0, 1, t.matrix) for t in threes.transitions]
    moves += [Transition(1, 1, t.matrix) for t in twos.transitions]
    return Automaton((threes.states[0], twos.states[0]), tuple(moves))


SYSTEMS = {
    "a bent sponge": lambda: sponge(straight(3), bend=bent(8, 1)),
    "a Bézier sponge": lambda: sponge(BEZIER, bend=bent(27, 3, 0.05)),
    "rough": lambda: sponge(rough((0.5, 0.3), (0.3, -0.2, 0.3)), bend=bent(27, 4, 0.05)),
    "very rough": lambda: sponge(
        rough((0.5, 0.3), (0.45, -0.4, 0.45)), [(0, 0, 0), (1, 2, 0), (2, 1, 2)], bent(27, 5, 0.05)
    ),
    "Takagi's curve": lambda: curve(takagi(0.6), [(0, 0), (0.5, 1), (1, 0)]),
    "two shapes": lambda: tetrahedra_and_octahedra((4, 0), (8, 6)),
    "octahedra too": lambda: tetrahedra_and_octahedra((3, 1), (4, 2)),
    "transient": transient,
}
SLOW = {"rough", "transient", "a bent sponge"}
each_system = pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=pytest.mark.slow) if name in SLOW else name for name in SYSTEMS],
)


def framed(points, shape, margin=0.05):
    box = Box.of_points(points)
    box = box.grown(margin * max(box.lengths))
    return Frame(box.lower, np.array(box.lengths) / shape, shape)


def known(name, shape, part):
    """A system, a frame about it, and points no further than ``part`` · h from all of its limit."""
    automaton = SYSTEMS[name]()
    rough_points = naive.limit_points(automaton, 0.3)
    frame = framed(rough_points, shape, margin=0.1)
    size = part * min(frame.spacing)
    return automaton, frame, naive.limit_points(automaton, size), size


@each_system
def test_a_cover_holds_the_limit_and_reaches_no_further_than_it_says(name):
    automaton, frame, points, size = known(name, (9, 8, 7), 0.6)
    marks, bound = cover_cells(automaton, frame)
    assert marks.dtype == np.uint64
    assert set(np.unique(marks)) <= {0, 1}
    index, inside = naive.voxels_of(points, frame)
    assert inside.mean() > 0.9
    assert marks[tuple(index[inside].T)].all()
    assert naive.furthest(marks, frame, points) <= bound + size
    assert bound == pytest.approx(frame.diagonal + min(frame.spacing) / 8, rel=1e-4)


@each_system
def test_a_cover_does_not_depend_on_order_repetition_or_tiles(name):
    automaton = SYSTEMS[name]()
    frame = framed(naive.limit_points(automaton, 0.3), (15, 17, 13), margin=0.02)
    marks, _ = cover_cells(automaton, frame)
    mixed = (*automaton.transitions[::-1], automaton.transitions[0])
    again, _ = cover_cells(Automaton(automaton.states, mixed), frame)
    assert np.array_equal(again, marks)
    for start, stop in [((0, 0, 0), (9, 17, 5)), ((7, 6, 5), (15, 13, 13)), ((4, 4, 4), (5, 5, 5))]:
        part = tuple(slice(a, b) for a, b in zip(start, stop, strict=True))
        assert np.array_equal(cover_cells(automaton, frame.tile(start, stop))[0], marks[part])


def test_cells_of_four_controls_have_the_cover_of_their_maps():
    automaton = of_maps(menger_maps())
    frame = Frame((-0.02, -0.03, -0.01), (0.037, 0.041, 0.043), (29, 27, 25))
    marks, bound = cover_cells(automaton, frame)
    other, same = cover_attractor(automaton, enclosing_balls(automaton), frame)
    assert np.array_equal(marks, other)
    assert bound == same


def test_a_straight_hexahedron_is_the_sponge_of_its_maps():
    frame = Frame((-0.02, -0.03, -0.01), (0.037, 0.041, 0.043), (29, 27, 25))
    assert np.array_equal(
        cover_cells(sponge(straight(3)), frame)[0], cover_cells(of_maps(menger_maps()), frame)[0]
    )


def test_renamed_and_reordered_states_have_the_same_cover():
    automaton = SYSTEMS["octahedra too"]()
    states = automaton.states[::-1]
    moves = [Transition(1 - t.source, 1 - t.target, t.matrix) for t in automaton.transitions]
    other = Automaton(states, tuple(moves), 1)
    frame = framed(naive.limit_points(automaton, 0.3), (15, 17, 13))
    assert np.array_equal(cover_cells(other, frame)[0], cover_cells(automaton, frame)[0])


def test_work_without_end_is_refused(monkeypatch):
    monkeypatch.setattr(cell_cover, "MOST_STEPS", 1000)
    monkeypatch.setattr(cell_cover, "STEPS_PER_VOXEL", 0)
    automaton = SYSTEMS["rough"]()
    frame = framed(naive.limit_points(automaton, 0.3), (30, 30, 30))
    with pytest.raises(ModelError, match="overlap so much"):
        cover_cells(automaton, frame)


# --- grown by a ball -----------------------------------------------------------------------


@pytest.mark.parametrize(
    "name",
    [pytest.param("a bent sponge", marks=pytest.mark.slow), "very rough", "Takagi's curve"],
)
@pytest.mark.parametrize("steps", [0.7, 2.0])
def test_grown_limits_lie_where_they_should(name, steps):
    automaton, frame, points, size = known(name, (6, 8, 7), 0.5)
    radius = steps * min(frame.spacing)
    masks = sample_cells(automaton, frame, FILL, offset=radius)
    distance = cKDTree(points).query(naive_sampling.samples(frame, FILL))[0]
    found = naive_sampling.bits(masks, FILL.points)
    error = net_error(frame, radius)
    assert error <= 1.37 * max(min(frame.spacing) / net.CELLS, radius / 48) * (1 + 1e-9)
    assert found[distance <= radius - error].all()
    assert not found[distance > radius + error + size].any()
    assert found.any()
    marks, bound = cover_cells(automaton, frame, offset=radius)
    assert marks[masks != 0].all()
    assert naive.furthest(marks, frame, points) <= radius + bound + size


def test_grown_limits_are_tiled_without_seams():
    automaton = SYSTEMS["a bent sponge"]()
    frame = framed(naive.limit_points(automaton, 0.3), (13, 12, 14), margin=0.1)
    radius = 1.3 * min(frame.spacing)
    whole = sample_cells(automaton, frame, FILL, offset=radius)
    cover = cover_cells(automaton, frame, offset=radius)[0]
    for start, stop in [((0, 0, 0), (6, 12, 14)), ((5, 4, 7), (13, 9, 9))]:
        part = tuple(slice(a, b) for a, b in zip(start, stop, strict=True))
        tile = frame.tile(start, stop)
        assert np.array_equal(sample_cells(automaton, tile, FILL, offset=radius), whole[part])
        assert np.array_equal(cover_cells(automaton, tile, offset=radius)[0], cover[part])


def test_a_limit_without_offset_has_no_samples():
    frame = Frame((0, 0, 0), (0.2, 0.3, 0.4), (5, 4, 3))
    with pytest.raises(ModelError, match="cover"):
        sample_cells(sponge(straight(3)), frame, CENTRE, offset=0.0)


# --- cells that end ------------------------------------------------------------------------


def branching(drawing):
    """Blocks of eight controls: two smaller blocks, and one cell that ends by way of another."""
    block, leaf = State("block", CUBE), State("leaf", FRAME)
    places = [CUBE.T / 2, CUBE.T * [0.4, 0.5, 0.45] + [0.6, 0.5, 0.55]]
    moves = [Transition(0, 0, weights_of(block, points)) for points in places]
    moves.append(Transition(0, 1, weights_of(block, FRAME.T * 0.3 + [0.65, 0.05, 0.1])))
    moves.append(Transition(1, 2, weights_of(leaf, FRAME.T * [0.9, 0.8, 1.0])))
    drawings = (nothing(8), nothing(4), drawing(State("end", FRAME)))
    return Automaton((block, leaf, State("end", FRAME)), tuple(moves)), drawings


def ends_of(automaton, levels):
    """The frames of the cells that end down to a level."""
    inverse = automaton.states[2].inverse
    front, found = [(0, automaton.states[0].controls)], []
    for _ in range(levels):
        front = [(t.target, P @ t.matrix) for q, P in front for t in automaton.children[q]]
        found += [P @ inverse for q, P in front if q == 2]
    return np.array(found)


@pytest.mark.parametrize("drawing", ["cell", "cube", "ball"])
def test_cells_that_end_belong_to_the_limit(drawing):
    made = {"cell": lambda _: cell(4)}.get(drawing, lambda state: image(drawing, state))
    automaton, drawings = branching(made)
    frame = Frame((-0.03, -0.02, -0.04), (0.067, 0.063, 0.071), (16, 17, 15))
    marks, bound = cover_cells(automaton, frame, drawings=drawings)
    solid = solid_named("tetrahedron" if drawing == "cell" else drawing)
    frames = ends_of(automaton, 9)
    if drawing == "cell":
        # The tetrahedron of the controls, as an image of the primitive with its own corners.
        lifted = np.linalg.inv(np.vstack([solid.points.T, np.ones(4)]))
        frames = np.einsum("kab,bc->kac", frames, np.vstack([FRAME, np.ones(4)]) @ lifted)
    pieces = Pieces(solid, frames)
    inner = pieces.sample(frame, FILL) != 0
    assert inner.any()
    assert marks[inner].all()
    # What is deeper is within the size of a block of the ninth level, 2⁻⁷.
    around = pieces.cover(frame)[0] != 0
    index = np.argwhere((marks != 0) & ~around)
    places = frame.origin + (index + 0.5) * frame.spacing
    tree = cKDTree(frames[:, :, 3])
    assert tree.query(places)[0].max(initial=0) <= bound + 0.1
    assert bound >= frame.diagonal
    for start, stop in [((0, 0, 0), (9, 17, 5)), ((7, 6, 5), (16, 13, 15))]:
        part = tuple(slice(a, b) for a, b in zip(start, stop, strict=True))
        tile = frame.tile(start, stop)
        assert np.array_equal(cover_cells(automaton, tile, drawings=drawings)[0], marks[part])


def test_ends_that_cannot_be_limits_are_refused():
    frame = Frame((0, 0, 0), (0.2, 0.3, 0.4), (5, 4, 3))
    automaton, drawings = branching(lambda _: sticks(4, beams="edges", radius=0.1))
    with pytest.raises(ModelError, match="'end', whose radius"):
        cover_cells(automaton, frame, drawings=drawings)
    automaton, drawings = branching(lambda _: cell(4))
    with pytest.raises(ModelError, match="does not grow the cells of 'end'"):
        cover_cells(automaton, frame, drawings=drawings, offset=0.1)
    with pytest.raises(ModelError, match="does not grow the cells of 'end'"):
        sample_cells(automaton, frame, FILL, drawings=drawings, offset=0.1)
    finite = Automaton(automaton.states, automaton.transitions[2:])
    with pytest.raises(ModelError, match="all that start from 'block' end"):
        cover_cells(finite, frame, drawings=drawings)


# --- models --------------------------------------------------------------------------------


def test_a_controlled_system_of_other_controls_has_a_limit():
    automaton, drawings = branching(lambda _: cell(4))
    made = cifs(automaton, drawings, level="limit", size=30.0)
    grid = voxelize(made, spacing=(1.7, 1.5, 1.9), sampling="cover")
    wanted = grid.frame.diagonal + min(grid.frame.spacing) / 8
    assert grid.hausdorff == pytest.approx(wanted, rel=1e-4)
    assert not made.is_cut
    assert made.feature_size is None
    bare = cifs(automaton, [nothing(8), nothing(4), nothing(4)], level="limit", offset=0.05)
    assert voxelize(bare, voxels=30).sampling_error > 0
    with pytest.raises(ModelError, match="no volume"):
        made.sample(grid.frame, FILL)


def limit_of(cell_name, digits="menger", **more):
    sets = (named(digits),) if digits else ()
    texture = more.pop("texture", None)
    brep = build_cell(Options(cell_name, digits=sets, texture=texture))
    return bcifs(brep, level="limit", digits=sets, **more)


def test_a_limit_of_cells_is_a_model():
    texture = Texture(edge=(0.3, -0.2, 0.3), bump=(0.5, 0.3))
    controls = 2 * CUBE + bent(8, 1)
    made = limit_of("hex-27", texture=texture, controls=controls, size=4.0)
    assert isinstance(made, CellAttractor)
    assert made.level == "limit"
    assert max(made.domain.lengths) == pytest.approx(4.0, rel=1e-9)
    grid = voxelize(made, spacing=(0.3, 0.25, 0.2), sampling="cover")
    wanted = grid.frame.diagonal + min(grid.frame.spacing) / 8
    assert grid.hausdorff == pytest.approx(wanted, rel=1e-4)
    level = bcifs(made.system.brep, level=3, controls=made.system.controls)
    assert made.bulk_volume == pytest.approx(level.bulk_volume, rel=0.02)
    assert made.bulk_volume < made.bulk.volume
    inside = made.sample_bulk(grid.frame, FILL)
    assert inside.any()
    cut = limit_of("hex-8", domain=Box((0, 0, 0), (0.5, 0.6, 0.7)))
    assert cut.is_cut
    assert not limit_of("hex-8").is_cut
    assert voxelize(cut, voxels=12, sampling="cover").hausdorff is None


def test_the_limit_of_a_straight_block_is_the_sponge():
    maps = build(load("menger", set={"model.level": "limit", "voxels.voxels": 25}))
    made = limit_of("hex-8")
    one, two = (voxelize(model, voxels=25, sampling="cover") for model in (made, maps))
    assert np.array_equal(one.fill, two.fill)
    assert made.bulk_volume == pytest.approx(1, rel=1e-12)


def test_ever_deeper_bodies_come_as_near_the_limit_as_they_should():
    # Cells of a level lie in the hulls of what they come of: within 3⁻ⁿ·diam of the limit.
    controls = CUBE + bent(8, 5)
    made = limit_of("hex-8", controls=controls)
    frame = Frame.fit(made.domain.grown(0.1), spacing=(0.081, 0.077, 0.073))
    marks, bound = made.cover(frame)
    for level in (1, 2):
        body = bcifs(made.system.brep, level=level, digits=made.system.digits, controls=controls)
        cover, error = body.cover(frame)
        one, two = (np.argwhere(found) * np.array(frame.spacing) for found in (cover, marks))
        most = 3.0**-level * np.sqrt(3) * 1.3 + bound + error
        assert cKDTree(one).query(two)[0].max() <= most
        assert cKDTree(two).query(one)[0].max() <= most


KOCH = koch('level = "limit"\noffset = 0.02', voxels=40)


def test_a_curve_has_a_limit_where_it_has_a_thickness(tmp_path):
    path = tmp_path / "koch.toml"
    path.write_text(KOCH)
    made = build(load(path))
    assert made.domain.lengths == pytest.approx((1.04, np.sqrt(3) / 6 + 0.04, 0.04), abs=2e-3)
    assert voxelize(made, voxels=90).solid.any()
    path.write_text(KOCH.replace("offset = 0.02\n", ""))
    with pytest.raises(ModelError, match="lies in a plane; wanted an offset, or a domain"):
        build(load(path))
    path.write_text(
        KOCH.replace("offset = 0.02", "domain = { lower = [0, 0, -1], upper = [1, 1, 1] }")
    )
    grid = voxelize(build(load(path)), voxels=40, sampling="cover")
    assert grid.hausdorff is not None


@pytest.mark.parametrize(
    ("more", "wanted"),
    [
        ({"draw": Sweep(("edges",), 0.1)}, "swept along the cells of a level"),
        ({"contacts": "fuse"}, 'contacts: got "fuse", which joins cells'),
        ({"contacts": "shared"}, 'contacts: got "shared", which joins cells'),
        ({"offset": -1.0}, "wanted"),
    ],
)
def test_what_a_limit_of_cells_cannot_be(more, wanted):
    with pytest.raises(ModelError, match=wanted):
        limit_of("hex-8", **more)


def test_a_recipe_s_limit_is_covered_unless_it_grows():
    recipe = load("menger-bent", set={"model.level": "limit", "voxels.voxels": 20})
    assert recipe.voxels.sampling == "cover"
    grown = load(
        "menger-bent", set={"model.level": "limit", "model.offset": 2.0, "voxels.voxels": 20}
    )
    assert grown.voxels.sampling == "fill"
    model = build(grown)
    frame = Frame.fit(model.domain, voxels=20)
    assert model.sample(frame, FILL).any()
    assert 0 < model.sampling_error(frame) < 0.35 * frame.diagonal
