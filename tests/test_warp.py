"""Fractal homeomorphisms: h is one-to-one, keeps faces and topology, and refuses what folds."""

import itertools
import math
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from naive_elasticity import loaded
from stepped import crossings

import porous as po
from porous.errors import GridError, MeshError, ModelError, RecipeError
from porous.formats import inp
from porous.guests import ccx
from porous.jobs import compression, material
from porous.models.digits import named
from porous.models.hexa_volume import jacobian
from porous.models.homeomorphism import Homeomorphism
from porous.models.model import HasMembership
from porous.models.primitive import NAMES
from porous.models.trilinear import jacobians, least_jacobian
from porous.recipe import dump, parse, schema
from porous.values import CENTRE, FILL, Block

CORNERS = np.array(list(itertools.product((0, 1), repeat=3)))
REGULAR = np.stack(np.meshgrid(*[[0, 0.5, 1]] * 3, indexing="ij"), axis=-1)
BOX = po.Box((-1.0, 2.0, 0.5), (3.0, 5.0, 2.5))
TURN = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])


def random_offsets(size, seed):
    offsets = np.random.default_rng(seed).uniform(-size, size, (3, 3, 3, 3))
    return np.where(REGULAR == 0.5, offsets, 0)


@dataclass(frozen=True)
class Torus:
    """A solid torus, turned, known point by point and in no other way."""

    unit: str = "mm"
    domain: po.Box = BOX
    bulk: po.Box = BOX

    def sample(self, frame, pattern):
        raise NotImplementedError

    def check_membership(self):
        pass

    def contains(self, points):
        x, y, z = ((points - BOX.centre) / BOX.lengths @ TURN).T
        return (np.hypot(x, y) - 0.27) ** 2 + z**2 <= 0.13**2


def block(**given):
    """A Menger sponge in a box of unequal edges."""
    corners = [np.where(c, BOX.upper, BOX.lower) for c in CORNERS]
    recipe = {"kind": "bcifs", "cell": "hex-8", "controls": [c.tolist() for c in corners]}
    recipe |= {"level": 2, "digits": {"divisions": 3, "keep": "menger"}} | given
    return po.build(parse({"model": recipe}))


def warped(offsets):
    return Homeomorphism(REGULAR + offsets)


moderate = st.integers(0, 10**6).map(lambda seed: warped(random_offsets(0.12, seed)))


# --- a slow twin ---------------------------------------------------------------------------


def naive_cell(lattice, digit, place):
    """The trilinear cell of a digit, mirrored where it is 1, as a sum over corners."""
    weights = np.where(CORNERS, place, 1 - place).prod(axis=1)
    return weights @ lattice[tuple(np.where(CORNERS, 1, 2 * np.asarray(digit)).T)]


def naive_h(lattice, place, digits):
    """h by its definition: the image under a cell of h of the place within that cell."""
    if digits == 0:
        return place
    digit = (place > 0.5).astype(int)
    return naive_cell(
        lattice, digit, naive_h(lattice, np.where(digit, 2 - 2 * place, 2 * place), digits - 1)
    )


def naive_inverse(lattice, image, digits):
    """The middle of the dyadic cell whose image holds a point: Newton's method in each cell."""
    address = []
    for _ in range(digits):
        found = [(b, within(lattice, b, image)) for b in CORNERS]
        digit, image = min(found, key=lambda each: np.abs(each[1] - 0.5).max())
        assert np.abs(image - 0.5).max() < 0.5 + 1e-7
        address.append(digit)
    place = np.full(3, 0.5)
    for digit in reversed(address):
        place = np.where(digit, 1 - place / 2, place / 2)
    return place


def within(lattice, digit, image):
    """Where in a trilinear cell a point lies, to rounding; far off where it is not in it."""
    place = np.full(3, 0.5)
    for _ in range(15):
        slope = [
            (naive_cell(lattice, digit, place + e) - naive_cell(lattice, digit, place - e)) / 2e-3
            for e in 1e-3 * np.eye(3)
        ]
        rest = naive_cell(lattice, digit, place) - image
        if np.abs(rest).max() < 1e-14:
            break
        place = np.clip(place - np.linalg.solve(np.transpose(slope), rest), -2, 3)
    return place if np.abs(rest).max() < 1e-10 else np.full(3, 9.0)


@settings(max_examples=20)
@given(moderate, st.integers(1, 12))
def test_the_kernel_is_the_definition(warp, digits):
    places = np.random.default_rng(digits).random((8, 3))
    wanted = [naive_h(warp.lattice, place, digits) for place in places]
    assert np.abs(warp.moved(places, digits) - wanted).max() < 1e-14


# --- h is a homeomorphism of the cube ------------------------------------------------------


def test_the_regular_lattice_moves_nothing():
    places = np.random.default_rng(1).random((500, 3))
    for digits in (1, 20, 52):
        assert np.abs(warped(0).moved(places, digits) - places).max() < 1e-15


def test_a_model_that_is_not_moved_has_its_own_voxels():
    plain = block()
    bent = po.warp(plain, {})
    for sampling, voxels in (("fill", 12), ("centre", 27)):
        own, other = (po.voxelize(m, voxels=voxels, sampling=sampling) for m in (plain, bent))
        assert np.array_equal(own.fill, other.fill)


@settings(max_examples=20)
@given(moderate, st.integers(0, 2), st.sampled_from([0.0, 1.0]))
def test_faces_go_to_themselves(warp, axis, side):
    places = np.random.default_rng(2).random((50, 3))
    places[:, axis] = side
    moved = warp.moved(places)
    assert (moved[:, axis] == side).all()
    assert np.abs(moved - places).max() > 1e-3


@settings(max_examples=20)
@given(st.integers(0, 10**6), st.integers(0, 2))
def test_neighbours_agree_on_their_whole_common_face(seed, axis):
    lattice = REGULAR + random_offsets(0.18, seed)
    for place in np.random.default_rng(3).random((4, 3)):
        place[axis] = 1
        for digit in CORNERS[CORNERS[:, axis] == 0]:
            beyond = digit + np.eye(3, dtype=int)[axis]
            assert np.array_equal(
                naive_cell(lattice, digit, place), naive_cell(lattice, beyond, place)
            )


@settings(max_examples=20)
@given(moderate, st.integers(0, 2), st.sampled_from([0.5, 0.25, 0.625]))
def test_there_is_no_jump_between_cells(warp, axis, plane):
    places = np.random.default_rng(4).random((50, 3))
    sides = []
    for shift in (-1e-12, 1e-12):
        places[:, axis] = plane + shift
        sides.append(warp.moved(places))
    assert np.abs(sides[0] - sides[1]).max() < 3e-5


def test_every_point_is_the_image_of_one_address_and_of_no_other():
    lattice = warped(random_offsets(0.15, 5)).lattice
    warp = Homeomorphism(lattice)
    for place in np.random.default_rng(6).random((3, 3)):
        there = naive_inverse(lattice, warp.moved(place)[0], 10)
        assert np.abs(there - place).max() <= 2.0**-10
        back = warp.moved(naive_inverse(lattice, place, 12))[0]
        assert np.abs(back - place).max() < 0.01


def test_a_grid_of_addresses_has_as_many_images_in_order_along_edges():
    warp = warped(random_offsets(0.15, 7))
    line = np.arange(17) / 16
    grid = np.stack(np.meshgrid(line, line, line, indexing="ij"), axis=-1)
    images = warp.moved(grid.reshape(-1, 3)).reshape(grid.shape)
    assert len(np.unique(images.reshape(-1, 3).round(9), axis=0)) == 17**3
    for axis in range(3):
        edge = np.moveaxis(images, axis, 0)[:, 0, 0, axis]
        assert (np.diff(edge) > 0).all()


def test_corners_of_words_are_products_of_matrices():
    warp = warped(random_offsets(0.15, 8))
    weights = [np.prod(np.where(CORNERS[:, None], c, 1 - c), axis=2) for c in warp.cells]
    i, j = 3, 6
    product = CORNERS.T @ weights[i] @ weights[j]
    wanted = [
        naive_cell(warp.lattice, CORNERS[i], naive_cell(warp.lattice, CORNERS[j], c.astype(float)))
        for c in CORNERS
    ]
    assert np.abs(product.T - wanted).max() < 1e-15


@settings(max_examples=20)
@given(moderate)
def test_cells_of_three_levels_do_not_fold_at_their_corners(warp):
    """All 512: up to offsets of 0.12. Of random ones up to 0.18 about one draw in ten has some."""
    a = np.array([np.prod(np.where(CORNERS[:, None], c, 1 - c), axis=2) for c in warp.cells])
    corners = np.einsum("dp,ipq,jqr,krs->ijksd", CORNERS.T, a, a, a, optimize=True)
    mirrored = [(-1) ** np.sum(word) for word in itertools.product(CORNERS, repeat=3)]
    found = jacobians(corners.reshape(512, 8, 3))[:, ::2, ::2, ::2] * 512
    assert (found * np.reshape(mirrored, (512, 1, 1, 1)) > 0.02).all()


def test_fewer_digits_stay_within_the_dyadic_cell_that_the_error_speaks_of():
    model = po.warp(Torus(), random_offsets(0.15, 9))
    for place in np.random.default_rng(10).random((3, 3)):
        near = naive_inverse(model.bend.lattice, model.bend.moved(place, 5)[0], 9)
        assert (np.floor(near * 32) == np.floor(place * 32)).all()
    frame = po.voxelize(model, voxels=8).frame
    cell = np.linalg.norm(BOX.lengths) * 2.0**-15
    assert model.sampling_error(frame) == pytest.approx(cell)
    assert model.sampling_error(frame) < 5e-4 * min(frame.spacing)


# --- topology ------------------------------------------------------------------------------


@pytest.mark.parametrize("voxels", [32, 64])
def test_a_torus_stays_a_torus(voxels):
    for offsets in ({}, random_offsets(0.15, 11)):
        grid = po.voxelize(po.warp(Torus(), offsets), voxels=voxels, sampling="centre")
        assert po.measures.euler_number(grid).value == 0
        assert po.measures.components(grid).value == 1


@pytest.mark.slow
@pytest.mark.parametrize("voxels", [54, 81])
def test_a_sponge_keeps_its_tunnels(voxels):
    # Centres alone would make specks of the boundary's finest spikes; fills average them.
    grid = po.voxelize(po.warp(block(), random_offsets(0.1, 12)), voxels=voxels)
    assert po.measures.components(grid).value == 1
    assert po.measures.euler_number(grid).value == -80
    assert (grid.fill != po.voxelize(block(), voxels=voxels).fill).mean() > 0.1


# --- sampling ------------------------------------------------------------------------------


def test_the_box_is_all_that_is_sampled_and_the_bulk():
    model = po.warp(block(level=0), random_offsets(0.15, 13))
    assert model.domain == model.bulk == block().domain
    grid = po.voxelize(model, voxels=12)
    assert (grid.fill == 255).all()
    assert po.measures.porosity(grid).value == 0


def test_tiles_are_parts_of_the_whole():
    model = po.warp(block(), random_offsets(0.15, 14))
    frame = po.Frame.fit(model.domain, voxels=20)
    whole = model.sample(frame, FILL)
    part = model.sample(frame.tile((3, 2, 1), (11, 9, 7)), FILL)
    assert np.array_equal(part, whole[3:11, 2:9, 1:7])


def test_samples_are_points_of_the_body():
    model = po.warp(block(), random_offsets(0.15, 15))
    frame = po.Frame.fit(po.Box((-1.5, 2.0, 0.4), (3.5, 5.5, 2.5)), voxels=21)
    places = np.stack(np.meshgrid(*map(frame.centres, range(3)), indexing="ij"), axis=-1)
    inside = model.contains(places.reshape(-1, 3)).reshape(frame.shape)
    assert np.array_equal(model.sample(frame, CENTRE).astype(bool), inside)
    assert inside.any()


def test_what_is_warped_can_be_warped_again():
    once = po.warp(Torus(), random_offsets(0.1, 16))
    twice = po.warp(once, random_offsets(0.1, 17))
    places = np.random.default_rng(18).random((200, 3))
    world = np.array(BOX.lower) + places * BOX.lengths
    there = np.array(BOX.lower) + once.bend.moved(twice.bend.moved(places)) * BOX.lengths
    assert np.array_equal(twice.contains(world), Torus().contains(there))


def flake(primitive, **given):
    """Six images of a solid, one of them turned, stretched and overlapping its neighbour."""
    maps = [(np.eye(3) * 0.4, shift) for shift in 0.6 * CORNERS[[0, 3, 5, 6]]]
    maps.append((np.diag([0.5, 0.3, 0.4]) @ TURN, [0.3, 0.5, 0.1]))
    return po.ifs(maps, level=2, primitive=primitive, size=2.0, **given)


BODIES = {
    "menger": lambda: po.ifs(named("menger"), level=3, size=2.0),
    "vicsek": lambda: po.ifs(named("vicsek-9"), level=1, size=2.0),
    **{name: lambda name=name: flake(name) for name in NAMES},
    "mesh": lambda: flake(po.read("presets/cross.obj")),
    "fused": lambda: po.ifs(named("even-parity"), level=2, contacts="fuse", contact_radius=0.03),
    "straight": block,
    "bent": lambda: block(
        level=1, controls=(CORNERS * 2 + CORNERS[::-1, [1, 2, 0]] * 0.4).tolist()
    ),
    "octa": lambda: po.build(po.load("tetra-octa", set={"model.level": 2})),
}


@pytest.mark.parametrize("name", BODIES)
def test_points_lie_where_lines_say(name):
    model = BODIES[name]()
    assert isinstance(model, HasMembership)
    box = model.domain.grown(0.02)
    voxels = (9, 10, 11) if name == "mesh" else (25, 29, 31)
    frame = po.Frame.fit(box, spacing=tuple(np.array(box.lengths) / voxels))
    points = np.stack(np.meshgrid(*map(frame.centres, range(3)), indexing="ij"), axis=-1)
    found = model.contains(points.reshape(-1, 3)).reshape(frame.shape)
    assert np.array_equal(found, model.sample(frame, CENTRE).astype(bool))
    assert 0 < found.mean() < 1


def test_solids_are_closed_and_leave_no_gaps():
    corner = np.array([[1 / 3, 1 / 3, 0.1], [0, 0, 0], [1, 1, 1], [2 / 3, 1 / 3, 1 / 3]])
    assert po.ifs(named("menger")).contains(corner).all()
    cubes = po.ifs([(np.eye(3) / 2, c / 2) for c in CORNERS], primitive="cube", level=2)
    tets = block(level=1, digits={"divisions": 2, "keep": "full-2"})
    line = np.array(BOX.lower) + np.linspace(0, 1, 65)[:, None] * BOX.lengths
    assert cubes.contains(np.repeat(np.linspace(0, 1, 65)[:, None], 3, axis=1)).all()
    assert tets.contains(line).all()


# --- refusals ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("at", "by", "says"),
    [
        ((0, 0, 0), (0.1, 0, 0), r"0\.1 along x at \[0, 0, 0\], which .* corner.*wanted 0"),
        ((1, 0, 0), (0.1, 0.2, 0), r"0\.2 along y at \[1, 0, 0\], which .* edge.*wanted 0"),
        ((1, 2, 1), (0.1, -0.3, 0.1), r"-0\.3 along y at \[1, 2, 1\], which .* face.*wanted 0"),
        ((1, 1, 1), (0, 0, 0.5), r"0\.5 along z at \[1, 1, 1\], .* inside .* between −0.5 and 0.5"),
        ((1, 0, 2), (-0.6, 0, 0), r"-0\.6 along x at \[1, 0, 2\].*between −0.5 and 0.5"),
    ],
)
def test_points_outside_their_slots_are_named(at, by, says):
    with pytest.raises(ModelError, match=says):
        po.warp(Torus(), {at: by})


def test_cells_that_hardly_contract_are_refused_with_the_number():
    with pytest.raises(ModelError, match=r"3 cells still keep 0\.9\d* of a difference.*0\.75"):
        po.warp(Torus(), {(1, 0, 0): (0.49, 0, 0)})


def test_cells_shrink_as_the_coefficient_says():
    assert warped(0).contraction == pytest.approx(1 - (1 - 1 / 8) ** 3)
    warp = warped(random_offsets(0.15, 19))
    assert warped(0).contraction < warp.contraction < 0.5
    for words in (1, 2, 3):
        cells = np.random.default_rng(22).integers(0, 8**words, (100, 1, 3))
        corners = warp.moved(((cells + CORNERS) / 8**words).reshape(-1, 3)).reshape(100, 8, 3)
        assert 0 < np.ptp(corners, axis=1).max() <= warp.contraction**words


def test_a_cell_that_folds_over_is_named():
    with pytest.raises(ModelError, match=r"cell \[1, 1, 1\] is folded over.* -\d"):
        po.warp(Torus(), {(1, 1, 1): (0.3, 0.3, 0.3), (2, 1, 1): (0, -0.2, -0.2)})


POWERS = np.linspace(0, 1, 21)[:, None] ** np.arange(3)


def values(coefficients):
    return np.einsum("ai,bj,ck,ijk->abc", POWERS, POWERS, POWERS, coefficients)


@pytest.mark.parametrize("size", [0.1, 0.25, 0.35])
def test_theleast_jacobian_is_that_of_a_dense_grid(size):
    shifts = np.random.default_rng(21).uniform(-size, size, (40, 8, 3))
    for corners in CORNERS + shifts:
        dense = values(jacobian(corners.T)).min()
        least, certain = least_jacobian(jacobians(corners[None])[0])
        assert (least > 0) == (dense > 0) or abs(dense) < 0.02
        assert certain or abs(dense) < 1e-3


def test_folds_between_corners_are_found():
    side, up = np.array([[1, 0], [0, 1]]), np.array([[1, 0.1], [-0.1, 0.1]])
    corners = [(x, *(y * side[x] + z * up[x])) for x, y, z in CORNERS]
    dense = values(jacobian(np.transpose(corners)))
    assert dense[::20, ::20, ::20].min() == pytest.approx(0.1)
    assert dense.min() < -0.1
    assert least_jacobian(jacobians(np.array([corners]))[0])[0] < 0


@pytest.mark.parametrize(
    ("model", "says"),
    [
        (lambda: po.ifs(named("menger"), level="limit"), "got the attractor.*wanted a level"),
        (lambda: po.ifs(named("menger"), offset=0.1), r"an offset of 0\.1.*wanted a level"),
        (lambda: po.build(po.load("beam-twisted")), "SweptBody is known on lattices.*wanted"),
        (lambda: po.build(po.load("branching-struts")), "CIFS is known on lattices.*wanted"),
        (lambda: po.build(po.load("fern")), "cannot be asked point by point|on lattices"),
    ],
)
def test_models_without_points_are_refused(model, says):
    with pytest.raises(ModelError, match=says):
        po.warp(model(), {})
    with pytest.raises(ModelError, match=r"or voxelize it, and bend the voxels by warp_grid$"):
        po.warp(model(), {})


def test_what_cannot_be_asked_point_by_point_is_bent_as_voxels():
    tree = po.tree((2,), (0.5,), radius=0.1, level=1, plate=0.1)
    bent = po.warp_grid(po.voxelize(tree, voxels=32), {(1, 1, 1): (0.08, -0.06, 0.05)})
    assert po.measures.components(bent).value == 1


@pytest.mark.parametrize(
    "offsets",
    [{(3, 0, 0): (0, 0, 0)}, {(1, 1, 1): (0, 0)}, {(1, 1, 1): "abc"}, np.zeros((3, 3, 3)), np.nan],
)
def test_offsets_of_another_kind_are_refused(offsets):
    with pytest.raises(ModelError, match=r"offsets: got .*wanted"):
        po.warp(Torus(), offsets)


def test_offsets_that_are_not_finite_are_told_as_they_are():
    with pytest.raises(ModelError, match=r"^offsets: got nan; wanted finite numbers"):
        po.warp(Torus(), {(1, 1, 1): (0.1, math.nan, 0)})
    with pytest.raises(ModelError, match=r"^offsets: got inf; wanted finite numbers"):
        po.warp(Torus(), math.inf)


def test_what_cannot_be_known_is_not_claimed():
    model = po.warp(block(), random_offsets(0.1, 20))
    with pytest.raises(GridError):
        po.voxelize(model, per_feature=4)
    with pytest.raises(GridError, match="cover"):
        po.voxelize(model, voxels=9, sampling="cover")
    with pytest.raises(ModelError, match="from 0 to 1"):
        model.bend.moved([[0.5, 0.5, 1.5]])


# --- recipes -------------------------------------------------------------------------------

TABLE = {
    "kind": "warp",
    "model": {"kind": "ifs", "digits": {"divisions": 3, "keep": "menger"}, "level": 1},
    "offsets": [{"at": [1, 1, 1], "by": [0.1, -0.1, 0.05]}, {"at": [1, 0, 0], "by": [0.1, 0, 0]}],
}


def test_a_recipe_makes_what_python_makes():
    recipe = parse({"model": TABLE, "voxels": {"voxels": 9}})
    wanted = po.warp(
        po.ifs(named("menger"), level=1, size=1.0),
        {(1, 1, 1): (0.1, -0.1, 0.05), (1, 0, 0): (0.1, 0, 0)},
    )
    assert po.build(recipe) == wanted
    assert "model_warp" in schema()["$defs"]
    assert "[model.model]" in dump(recipe)


def test_a_recipe_is_read_as_it_was_written(tmp_path):
    recipe = parse({"model": TABLE, "voxels": {"voxels": 9}})
    (tmp_path / "again.toml").write_text(dump(recipe))
    assert po.load(tmp_path / "again.toml") == recipe


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"model": {"kind": "ifs", "levle": 2}}, r"model\.model\.levle: unknown key.*level"),
        ({"model": {"kind": "none"}}, r"model\.model.*wanted.*ifs"),
        ({"offsets": [{"at": [1, 1], "by": [0, 0, 0]}]}, r"model\.offsets.*wanted \[i, j, k\]"),
        ({"offsets": 3}, r"model\.offsets: got 3; wanted tables"),
    ],
)
def test_recipes_that_cannot_be_understood(change, says):
    with pytest.raises(RecipeError, match=says):
        parse({"model": TABLE | change})


def test_a_point_given_twice_is_refused():
    twice = [{"at": [1, 1, 1], "by": [0, 0, 0.1]}] * 2
    with pytest.raises(ModelError, match=r"offsets: \[1, 1, 1\] is there twice"):
        po.build(parse({"model": TABLE | {"offsets": twice}}))


# --- voxels --------------------------------------------------------------------------------


def torus_grid(voxels):
    """A torus of voxels, solid where their centres are."""
    frame = po.Frame.fit(BOX, voxels=voxels)
    places = np.stack(np.meshgrid(*map(frame.centres, range(3)), indexing="ij"), axis=-1)
    solid = Torus().contains(places.reshape(-1, 3)).reshape(frame.shape)
    return po.VoxelGrid.of_solid(solid, frame)


def test_a_grid_that_is_not_moved_keeps_its_bytes():
    frame = po.Frame.fit(BOX, voxels=20)
    fill, bulk = np.random.default_rng(30).integers(0, 256, (2, *frame.shape), np.uint8)
    grid = po.VoxelGrid(frame, fill, bulk)
    assert po.warp_grid(grid, {}) == grid


def test_voxels_are_pulled_back_sample_by_sample():
    """A slow twin: each sample of a voxel is looked up where h carries it."""
    offsets = random_offsets(0.15, 31)
    grid = torus_grid(9)
    shape, bend = np.array(grid.frame.shape), Homeomorphism(REGULAR + offsets)
    found = po.warp_grid(grid, offsets)
    for voxel in np.random.default_rng(32).integers(0, shape, (40, 3)):
        samples = [
            (*row, depth)
            for row, depths in zip(FILL.rows, FILL.depths, strict=True)
            for depth in depths
        ]
        places = bend.moved((voxel + np.array(samples)) / shape)
        index = np.minimum((places * shape).astype(int), shape - 1)
        mean = grid.fill[tuple(index.T)].mean()
        assert abs(found.fill[tuple(voxel)] - mean) <= 0.51
    assert (found.fill != grid.fill).mean() > 0.1


@pytest.mark.parametrize("voxels", [32, 64])
def test_a_torus_of_voxels_stays_a_torus(voxels):
    grid = torus_grid(voxels)
    bent = po.warp_grid(grid, random_offsets(0.15, 11))
    for each in (grid, bent):
        assert po.measures.euler_number(each).value == 0
        assert po.measures.components(each).value == 1
    assert (grid.solid != bent.solid).mean() > 0.03


@pytest.mark.slow
@pytest.mark.parametrize("voxels", [54, 81])
def test_a_sponge_of_voxels_keeps_its_tunnels(voxels):
    bent = po.warp_grid(po.voxelize(block(), voxels=voxels), random_offsets(0.1, 12))
    assert po.measures.components(bent).value == 1
    assert po.measures.euler_number(bent).value == -80


def test_voxels_of_a_body_and_of_its_model_agree():
    offsets = random_offsets(0.12, 33)
    by_grid = po.warp_grid(torus_grid(40), offsets)
    by_model = po.voxelize(po.warp(Torus(), offsets), voxels=40, sampling="centre")
    assert (by_grid.solid != by_model.solid).mean() < 0.012
    assert (torus_grid(40).solid != by_model.solid).mean() > 0.03


def test_periodic_sides_are_moved_alike_or_not_at_all():
    frame = po.Frame((0, 0, 0), (0.1, 0.2, 0.3), (8, 6, 7), (False, True, False))
    fill = np.random.default_rng(34).integers(0, 256, frame.shape, np.uint8)
    offsets = {(1, 0, 1): (0.1, 0, -0.1), (1, 2, 1): (0.1, 0, -0.1)}
    assert po.warp_grid(po.VoxelGrid(frame, fill), offsets).frame.periodic == (False, True, False)
    with pytest.raises(GridError, match="periodic along y, and its two sides"):
        po.warp_grid(po.VoxelGrid(frame, fill), {(1, 0, 1): (0.1, 0, -0.1)})
    with pytest.raises(GridError, match="got a Torus; wanted a grid in memory"):
        po.warp_grid(Torus(), {})


# --- meshes --------------------------------------------------------------------------------


@settings(max_examples=40)
@given(st.floats(0, 0.3), st.integers(0, 10**6))
def test_there_and_back_again(size, seed):
    try:
        warp = warped(random_offsets(size, seed))
    except ModelError:
        assume(False)
    assume(warp.contraction < 0.5)
    places = np.random.default_rng(seed).random((50, 3))
    assert np.abs(warp.moved(warp.moved_back(places)) - places).max() < 1e-9


def test_a_point_that_newton_does_not_find_from_the_middle_is_found():
    rng = np.random.default_rng(1819)
    offsets = rng.uniform(-1, 1, (3, 3, 3, 3)) * rng.uniform(0.2, 0.45)
    offsets *= rng.random((3, 3, 3, 3)) < rng.uniform(0.1, 1)
    warp = warped(np.where(REGULAR == 0.5, offsets, 0))
    assert warp.contraction > 0.7
    place = [[0.5642464113140989, 0.0, 0.5977891083090132]]
    assert np.abs(warp.moved(warp.moved_back(place)) - place).max() < 1e-9


def test_back_is_where_the_definition_says():
    warp = warped(random_offsets(0.15, 40))
    for place in np.random.default_rng(41).random((3, 3)):
        assert np.abs(warp.moved_back(place)[0] - naive_inverse(warp.lattice, place, 12)).max() < (
            2.0**-12
        )


@settings(max_examples=10)
@given(moderate, st.integers(0, 2), st.sampled_from([0.0, 1.0]))
def test_back_from_a_side_is_on_that_side(warp, axis, side):
    places = np.random.default_rng(42).random((30, 3))
    places[:, axis] = side
    back = warp.moved_back(places)
    assert (back[:, axis] == side).all()
    assert ((back >= 0) & (back <= 1)).all()


def test_middles_of_cells_go_back_to_where_they_belong():
    """Lattice points lie on the sides of eight cells at once."""
    warp = warped(random_offsets(0.18, 43))
    assert (
        np.abs(warp.moved_back(warp.lattice.reshape(-1, 3)) - REGULAR.reshape(-1, 3)).max() < 1e-12
    )


@pytest.mark.parametrize("voxels", [16, 32])
def test_a_surface_keeps_its_triangles_and_its_topology(voxels):
    surface, offsets = po.extract_surface(torus_grid(voxels)), random_offsets(0.1, 44)
    bent = po.warp_mesh(surface, offsets, box=BOX)
    assert np.array_equal(bent.triangles, surface.triangles)
    assert (bent.names, bent.unit) == (surface.names, surface.unit)
    assert po.measures.euler_number(bent).value == po.measures.euler_number(surface).value == 0
    bend = Homeomorphism(REGULAR + offsets)
    back = np.array(BOX.lower) + BOX.lengths * bend.moved((bent.points - BOX.lower) / BOX.lengths)
    assert np.abs(back - surface.points).max() < 1e-9
    assert np.abs(bent.points - surface.points).max() > 0.05


def test_a_surface_grows_and_shrinks_as_the_body_does():
    surface, offsets = po.extract_surface(torus_grid(48)), random_offsets(0.1, 45)
    bent = po.warp_mesh(surface, offsets, box=BOX)
    grid = po.voxelize(po.warp(Torus(), offsets), voxels=64, sampling="centre")
    wanted = po.measures.volume(grid).value / (2 * np.pi**2 * 0.27 * 0.13**2 * BOX.volume)
    assert bent.volume / surface.volume == pytest.approx(wanted, rel=3e-3)
    assert abs(wanted - 1) > 0.03


def test_the_mesh_has_the_box_where_none_is_given():
    grid = po.VoxelGrid.of_solid(
        np.ones((4, 5, 6), bool), po.Frame((1, 2, 3), (1, 1, 1), (4, 5, 6))
    )
    mesh = po.name_parts(po.hexahedralize(grid), grid.frame.box)
    offsets = random_offsets(0.05, 46)
    bent = po.warp_mesh(mesh, offsets)
    assert po.warp_mesh(mesh, offsets, box=grid.frame.box) == bent
    assert (bent.blocks, dict(bent.parts)) == (mesh.blocks, dict(mesh.parts))
    for index, name in enumerate(("XMIN", "XMAX", "YMIN", "YMAX", "ZMIN", "ZMAX")):
        axis, end = divmod(index, 2)
        side = (grid.frame.box.lower, grid.frame.box.upper)[end][axis]
        assert (bent.points[mesh.parts[name].members, axis] == side).all()
    assert bent.volumes.sum() == pytest.approx(4 * 5 * 6, rel=1e-12)
    assert np.ptp(bent.volumes) > 0.1


@pytest.mark.parametrize("level", [1, 2])
def test_cells_of_a_sponge_keep_what_joins_them(level):
    mesh = po.mesh_cells(block(level=level))
    bent = po.warp_mesh(mesh, random_offsets(0.04, 47))
    own, other = (po.measures.measure(m) for m in (mesh, bent))
    for name in ("euler_number", "components"):
        assert own[name].value == other[name].value
    assert (bent.volumes > 0).all()
    assert mesh.is_of_cells
    assert not bent.is_of_cells


@pytest.mark.judge
def test_a_warped_sponge_is_pressed_by_the_solver(judge):
    mesh = po.warp_mesh(po.mesh_cells(block(level=1)), random_offsets(0.08, 47))
    job = compression(mesh, material=material("steel"), pressure=2.0)
    found = ccx.solve(inp.write(job), program=judge("ccx"))
    area = sum(areas[:, 2].sum() for _, areas in loaded(job))
    assert abs(area - 8 / 9 * 4 * 3) > 0.01
    assert found.reaction[2] == pytest.approx(2.0 * area, rel=1e-5)
    assert found.volume == pytest.approx(mesh.volumes.sum(), rel=1e-5)


def grid_mesh(shape):
    frame = po.Frame((0, 0, 0), tuple(1 / n for n in shape), shape)
    return po.hexahedralize(po.VoxelGrid.of_solid(np.ones(shape, bool), frame))


def test_a_cell_that_would_fold_is_named():
    with pytest.raises(MeshError, match=r"cell \d+ near \(.*\) would be turned over or folded"):
        po.warp_mesh(grid_mesh((9, 7, 8)), random_offsets(0.2, 1))


def test_tetrahedra_that_would_turn_over_are_named():
    mesh = grid_mesh((9, 7, 8))
    tets = mesh.blocks[0].cells[
        :, [[0, 1, 2, 6], [0, 2, 3, 6], [0, 3, 7, 6], [0, 7, 4, 6], [0, 4, 5, 6], [0, 5, 1, 6]]
    ]
    mesh = po.VolumeMesh(mesh.points, (Block("tet4", tets.reshape(-1, 4)),))
    assert (mesh.volumes > 0).all()
    gentle = po.warp_mesh(mesh, random_offsets(0.04, 48))
    assert gentle.volumes.sum() == pytest.approx(1)
    with pytest.raises(MeshError, match=r"cell \d+ near .* turned over"):
        po.warp_mesh(mesh, random_offsets(0.25, 0))


def test_triangles_that_would_cross_are_named():
    sheet = po.VoxelGrid.of_solid(
        np.indices((12, 12, 40))[2] % 2 == 0, po.Frame((0, 0, 0), (1, 1, 0.3), (12, 12, 40))
    )
    with pytest.raises(MeshError, match=r"triangle \d+ near \(.*\) would cross or touch another"):
        po.warp_mesh(po.extract_surface(sheet), random_offsets(0.2, 49))


def test_meshes_that_cannot_be_warped():
    mesh = grid_mesh((2, 3, 4))
    with pytest.raises(MeshError, match=r"point \d+ at .* outside the box .*wanted a box"):
        po.warp_mesh(mesh, {}, box=po.Box((0, 0, 0), (1, 1, 0.5)))
    with pytest.raises(MeshError, match="has no volume"):
        po.warp_mesh(mesh, {}, box=po.Box((0, 0, 0), (1, 1, 0)))
    with pytest.raises(MeshError, match="open edges"):
        po.warp_mesh(po.SurfaceMesh(np.eye(3), [[0, 1, 2]]), {})
    ten = po.VolumeMesh(np.random.default_rng(0).random((10, 3)), (Block("tet10", [range(10)]),))
    with pytest.raises(MeshError, match="got cells of shape tet10; wanted tet4 and hex8"):
        po.warp_mesh(ten, {})


@pytest.mark.parametrize(
    ("offsets", "says"),
    [
        ({(1, 0, 0): (0.49, 0, 0)}, "3 cells still keep"),
        ({(1, 1, 1): (0.3, 0.3, 0.3), (2, 1, 1): (0, -0.2, -0.2)}, "is folded over"),
        ({(0, 0, 0): (0.1, 0, 0)}, "belongs to its corner"),
    ],
)
def test_values_are_warped_by_homeomorphisms_only(offsets, says):
    for warp, value in ((po.warp_grid, torus_grid(8)), (po.warp_mesh, grid_mesh((2, 2, 2)))):
        with pytest.raises(ModelError, match=says):
            warp(value, offsets)


def slab(count, low, high):
    """Points and cells of count × count × 1 hexahedra between two heights of the unit cube."""
    side = np.arange(count + 1) / count
    points = np.stack(np.meshgrid(side, side, (low, high), indexing="ij"), axis=-1).reshape(-1, 3)
    number = np.arange(len(points)).reshape(count + 1, count + 1, 2)
    cells = [
        [number[i + a, j + b, c] for c in (0, 1) for a, b in ((0, 0), (1, 0), (1, 1), (0, 1))]
        for i, j in itertools.product(range(count), repeat=2)
    ]
    return points, np.array(cells)


def sides(points, cells):
    """The six sides of every hexahedron, as fans of four triangles about their means."""
    local = [[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]]
    quads = cells[:, local].reshape(-1, 4)
    hubs = len(points) + np.arange(len(quads))
    fans = [np.column_stack([quads[:, i], quads[:, (i + 1) % 4], hubs]) for i in range(4)]
    return po.SurfaceMesh(np.vstack([points, points[quads].mean(axis=1)]), np.concatenate(fans))


def test_cells_beside_each_other_do_not_run_through_each_other():
    """Two slabs with a narrow gap, divided differently: no cell folds, but they may meet."""
    (below, first), (above, second) = slab(1, 0, 0.39), slab(3, 0.41, 1)
    points, cells = np.vstack([below, above]), np.vstack([first, second + len(below)])
    both = po.VolumeMesh(points, (Block("hex8", cells),))
    refused, passed = 0, 0
    for seed in range(40):
        try:
            bent = po.warp_mesh(both, random_offsets(0.15, seed))
        except MeshError as error:
            refused += "the body would cross itself" in str(error)
            continue
        passed += 1
        apart = [sides(bent.points, part) for part in (cells[:1], cells[1:])]
        joined = po.SurfaceMesh(
            np.vstack([s.points for s in apart]),
            np.vstack([apart[0].triangles, apart[1].triangles + len(apart[0].points)]),
        )
        alone = sum(map(crossings, apart))
        assert crossings(joined) == alone
    assert refused > 0
    assert passed > 0


BEY = ["0 01 02 03", "01 1 12 13", "02 12 2 23", "03 13 23 3"]
BEY += ["01 02 03 13", "01 02 12 13", "02 03 13 23", "02 12 13 23"]
"""The eight children of a tetrahedron, by its vertices and the points of its edges (Bey 1995)."""


@pytest.mark.parametrize("t", [0.42, 0.5, 0.6])
def test_tetrahedra_are_cut_into_eight_wherever_their_edges_are(t):
    """The same cut of all edges, from first to second vertex, would be a homeomorphism too."""
    corners = np.vstack([np.zeros(3), np.eye(3)])
    at = {str(i): corners[i] for i in range(4)}
    for i, j in itertools.combinations(range(4), 2):
        at[f"{i}{j}"] = (1 - t) * corners[i] + t * corners[j]
    children = np.array([[at[name] for name in child.split()] for child in BEY])
    sides = children[:, 1:] - children[:, :1]
    assert np.abs(np.linalg.det(sides)).sum() == pytest.approx(1, abs=1e-14)
    places = np.random.default_rng(0).dirichlet(np.ones(4), 500)[:, 1:]
    local = np.einsum("pkx,kxy->pky", places[:, None] - children[None, :, 0], np.linalg.inv(sides))
    inside = (local > 0).all(axis=2) & (local.sum(axis=2) < 1)
    assert (inside.sum(axis=1) == 1).all()
