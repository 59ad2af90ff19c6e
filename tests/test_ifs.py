"""Iterated function systems: models and recipes, domains, closed forms, voxels of automata."""

import itertools
import math
import pickle
import re
import tomllib

import naive_oracle as naive
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import binary_dilation
from test_automaton import duplicated, renamed

import porous as po
from porous.errors import MemoryLimitError, MeshError, ModelError, RecipeError
from porous.models import primitive as primitives
from porous.models.automaton import Automaton, State, Transition, of_maps
from porous.models.digits import DigitSet, named
from porous.models.ifs import CutSet, ifs
from porous.models.model import HasBoundary, HasCover, HasExact, HasFeature, HasFill, Model
from porous.recipe import build, dump, load, parse
from porous.values import CENTRE, FILL, Box, Frame, SurfaceMesh

K = math.sqrt(2) - 1
CORNERS = np.array(Box((0, 0, 0), (1, 1, 1)).corners)


def about(points, ratio):
    """Similarities that shrink towards points."""
    return [(np.eye(3) * ratio, np.asarray(p, float) * (1 - ratio)) for p in points]


def tetrahedra(**options):
    return ifs(
        about(primitives.named("tetrahedron").points, 0.5), primitive="tetrahedron", **options
    )


def jerusalem(**options):
    edges = [
        np.insert(np.array(ends) * (1 - K**2), axis, K)
        for axis in range(3)
        for ends in np.ndindex(2, 2)
    ]
    return ifs(about(CORNERS, K) + [(np.eye(3) * K**2, e) for e in edges], **options)


def exact(model, periodic=(False, False, False)):
    return {row.name: row.value for row in model.exact(periodic)}


# --- what a model is -----------------------------------------------------------------------


def test_a_model_has_its_capabilities_and_is_a_value():
    model = ifs(named("menger"), level=2, size=9.0)
    for capability in (Model, HasCover, HasBoundary, HasExact, HasFill, HasFeature):
        assert isinstance(model, capability)
    model.frames()
    twin = pickle.loads(pickle.dumps(model))
    assert twin == model
    assert hash(twin) == hash(model)
    assert model != ifs(named("menger"), level=3, size=9.0)


def test_maps_an_automaton_and_a_digit_set_are_one():
    digits = named("menger")
    of_set = ifs(digits, level=2)
    assert ifs(digits.maps, level=2) == of_set
    of_automaton = ifs(of_maps(digits.maps), level=2)
    assert (of_automaton.frames() == of_set.frames()).all()
    assert of_automaton.digits is None


def test_size_is_the_longest_edge_of_the_domain():
    plain = ifs([(np.diag([0.5, 0.25, 0.5]), np.array([0, 0, 0.5]))], level=1, primitive="cube")
    assert plain.domain == Box((0, 0, 0), (1, 1, 1))
    sized = ifs(
        [(np.eye(3) / 2, np.array([1.0, 0, 0]))], level=2, size=10.0, unit="cm", offset=0.25
    )
    # The cube wanders to the fixed point (2, 0, 0): the orbit is twice as long as the cube.
    assert sized.bulk.lengths == pytest.approx((10, 5, 5), abs=0.02)
    assert sized.domain.lengths == pytest.approx((10.5, 5.5, 5.5), abs=0.02)
    assert sized.primitive.box.lengths == pytest.approx((5, 5, 5), abs=0.01)
    assert sized.unit == "cm"


def test_domain_and_bulk_of_one_s_own_are_in_model_units():
    model = ifs(
        named("vicsek-7"),
        level=1,
        size=20.0,
        domain=Box((-0.5, 0, 0), (1.5, 1, 1)),
        bulk=Box((0, 0, 0), (1, 1, 1)),
    )
    assert model.domain == Box((-5, 0, 0), (15, 10, 10))
    assert model.bulk == Box((0, 0, 0), (10, 10, 10))
    assert exact(model)["porosity"] == pytest.approx(1 - 7 / 27, rel=1e-14)
    # The body does not touch its periodic copies across the gap: nothing is claimed.
    assert model.exact((True, False, False)) == ()
    cut = ifs(named("vicsek-7"), level=1, domain=Box((0, 0, 0), (0.5, 1, 1)))
    assert cut.exact() == ()


def test_a_domain_does_not_depend_on_the_level():
    fern = [
        (np.diag([0.85, 0.85, 0.3]), np.array([0, 0.2, 0])),
        (np.array([[0.2, -0.3, 0], [0.2, 0.2, 0], [0, 0, 0.2]]), np.array([0, 0.1, 0])),
    ]
    domains = {ifs(fern, level=level, offset=0.1).domain for level in (0, 3, "limit")}
    assert len(domains) == 1


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"level": -1}, "level: got -1; wanted 0"),
        ({"level": 1.5}, "level: got 1.5"),
        ({"level": True}, "level: got True"),
        ({"level": "deep"}, "level: got 'deep'"),
        ({"level": 10**6}, "level: got 1000000"),
        ({"offset": -0.1}, "offset: got -0.1"),
        ({"offset": math.nan}, "offset: got nan"),
        ({"level": "limit", "contacts": "fuse"}, "fuse"),
        ({"primitive": "sphere"}, "primitive: got 'sphere'; wanted one of ball, cube"),
    ],
)
def test_options_that_cannot_be(options, message):
    with pytest.raises(ModelError, match=message):
        ifs(named("menger"), **options)


def test_maps_that_cannot_be():
    with pytest.raises(ModelError, match="no attractor: map 0 does not shrink"):
        ifs([(np.eye(3) * 1.01, np.zeros(3))])
    singular = [(np.eye(3) / 2, np.zeros(3)), (np.diag([0.5, 0.5, 0]), np.ones(3))]
    with pytest.raises(ModelError, match=r"maps\[1\]: got a singular matrix.*limit"):
        ifs(singular, level=2)
    assert ifs(singular, level="limit", offset=0.1).domain.lengths[2] > 0.2
    with pytest.raises(ModelError, match=r"maps\[0\].matrix"):
        ifs([(np.full((3, 3), np.nan), np.zeros(3))])
    with pytest.raises(ModelError, match="maps: got none"):
        ifs([])
    with pytest.raises(ModelError, match="maps: wanted at most 100000"):
        ifs((np.eye(3) / 2, np.zeros(3)) for _ in range(10**9))
    with pytest.raises(MeshError, match="primitive: got a int"):
        ifs(named("menger"), primitive=3)


def test_too_deep_says_how_many_cells():
    model = tetrahedra(level=40)
    with pytest.raises(MemoryLimitError, match=str(4**40)):
        model.frames()
    # Closed forms need no cells.
    assert exact(model)["volume"] == pytest.approx(0.5**40 / 3, rel=1e-12)


def test_an_attractor_has_neither_cells_nor_volume():
    model = ifs(named("menger"), level="limit")
    with pytest.raises(ModelError, match="has no cells"):
        model.frames()
    frame = Frame.fit(model.domain, voxels=9)
    with pytest.raises(ModelError, match="no volume"):
        model.sample(frame, FILL)
    assert model.smallest_feature() is None
    assert model.feature_size is None
    assert model.exact() == ()


# --- closed forms --------------------------------------------------------------------------


def test_menger_in_vacuum_and_as_a_tile():
    for level in range(5):
        found = exact(ifs(named("menger"), level=level, size=3.0))
        assert found["volume"] == pytest.approx(27 * (20 / 27) ** level, rel=1e-14)
        area = 9 * (2 * (20 / 9) ** level + 4 * (8 / 9) ** level)
        assert found["surface_area"] == pytest.approx(area, rel=1e-14)
        assert found["interface_area"] == pytest.approx(area - 54 * (8 / 9) ** level, abs=1e-12)
        assert found["specific_surface_area"] == pytest.approx(area / 27, rel=1e-14)
        assert found["porosity"] + found["relative_density"] == 1
    tile = exact(ifs(named("menger"), level=2), (True, True, True))
    assert tile["surface_area"] == tile["interface_area"]
    assert tile["surface_area"] == pytest.approx(
        2 * (20 / 9) ** 2 + 4 * (8 / 9) ** 2 - 6 * (8 / 9) ** 2, rel=1e-14
    )
    assert "genus" not in tile
    assert tile["components"] == 1


@pytest.mark.parametrize("level", range(5))
def test_sierpinski_tetrahedra(level):
    found = exact(tetrahedra(level=level, size=2.0))
    assert found["volume"] == pytest.approx(0.5**level * 8 / 3, rel=1e-12)
    assert found["surface_area"] == pytest.approx(4 * math.sqrt(3) * 2, rel=1e-12)
    assert found["components"] == found["euler_number"] == 4**level
    assert found["genus"] == 0
    assert found["porosity"] == pytest.approx(1 - 0.5**level / 3, rel=1e-12)


@pytest.mark.parametrize("level", range(4))
def test_octahedron_flake(level):
    solid = primitives.named("octahedron")
    found = exact(ifs(about(solid.points, 0.5), level=level, primitive="octahedron"))
    assert found["volume"] == pytest.approx(0.75**level * solid.volume, rel=1e-12)
    assert found["surface_area"] == pytest.approx(1.5**level * solid.area, rel=1e-12)
    assert found["components"] == 6**level


@pytest.mark.parametrize(
    ("name", "ratio"),
    [("dodecahedron", 1 / (2 + (1 + 5**0.5) / 2)), ("icosahedron", 1 / (1 + (1 + 5**0.5) / 2))],
)
def test_flakes_of_the_golden_ratio(name, ratio):
    solid = primitives.named(name)
    count = len(solid.points)
    found = exact(ifs(about(solid.points, ratio), level=3, primitive=name))
    assert found["volume"] == pytest.approx((count * ratio**3) ** 3 * solid.volume, rel=1e-9)
    assert found["components"] == count**3


def test_jerusalem_has_contacts_of_area():
    for level in range(4):
        found = exact(jerusalem(level=level))
        assert found["volume"] == pytest.approx(0.6291501**level, rel=1e-6)
        assert "surface_area" not in found or level == 0
        assert "components" not in found or level == 0


def test_balls_touch_in_points():
    found = exact(ifs(named("menger"), level=3, primitive="ball"))
    assert found["volume"] == pytest.approx((20 / 27) ** 3 * math.pi / 6, rel=1e-12)
    assert found["surface_area"] == pytest.approx((20 / 9) ** 3 * math.pi, rel=1e-12)
    assert found["components"] == 8000


def test_nothing_is_claimed_where_cells_overlap_or_stick_out():
    overlap = about(CORNERS, 0.51)
    assert exact(ifs(overlap, level=1)) == {}
    assert exact(ifs(overlap, level=0))["volume"] == 1.0
    out = [(np.eye(3) / 2, np.array([0.6, 0, 0])), (np.eye(3) / 2, np.array([0, 0, 0]))]
    assert exact(ifs(out, level=1)) == {}


def test_nothing_is_claimed_of_what_is_grown():
    assert exact(ifs(named("menger"), level=1, offset=0.01)) == {}
    assert exact(tetrahedra(level=1, contacts="fuse")) == {}
    assert exact(ifs(named("menger"), level=CutSet(0.2))) == {}
    # Menger's cells share faces: there is nothing to fuse.
    assert "volume" in exact(ifs(named("menger"), level=1, contacts="fuse"))


def test_affine_maps_without_overlap_have_a_volume():
    halves = [
        (np.diag([0.5, 0.3, 0.2]), np.array([0.5, 0, 0])),
        (np.diag([0.25, 0.6, 0.9]), np.array([0.0, 0.1, 0.1])),
    ]
    found = exact(ifs(halves, level=2))
    assert found["volume"] == pytest.approx((0.03 + 0.135) ** 2, rel=1e-12)
    assert "surface_area" not in found


def two_kinds():
    """Eight halves and the four halves of a tetrahedron's corners, by turns."""
    frame = State("f", np.hstack([np.zeros((3, 1)), np.eye(3)]))

    def moves(source, target, keep):
        automaton = of_maps(DigitSet(2, np.array(keep)).maps)
        return [Transition(source, target, t.matrix) for t in automaton.transitions]

    even = [(0, 0, 0), (1, 1, 0), (1, 0, 1), (0, 1, 1)]
    full = list(np.ndindex(2, 2, 2))
    return Automaton((frame, frame), (*moves(0, 1, full), *moves(1, 0, even)))


def test_volumes_of_several_states():
    volumes = [exact(ifs(two_kinds(), level=n))["volume"] for n in range(5)]
    assert volumes == pytest.approx([1, 1, 0.5, 0.5, 0.25], rel=1e-12)


# --- features ------------------------------------------------------------------------------


def test_features_and_pores_of_menger():
    model = ifs(named("menger"), level=3, size=81.0)
    assert model.smallest_feature() == model.smallest_pore() == pytest.approx(3.0, rel=1e-12)
    assert model.feature_size == pytest.approx(3.0, rel=1e-12)
    assert ifs(named("menger"), level=0).smallest_pore() is None
    grown = ifs(named("menger"), level=2, size=9.0, offset=0.2)
    assert grown.smallest_feature() == pytest.approx(1.4)
    assert grown.smallest_pore() == pytest.approx(0.6)


def test_deep_levels_have_features_too():
    model = ifs(named("cantor-dust"), level=1000)
    assert model.smallest_feature() == model.smallest_pore() == 0.0
    assert model.feature_size is None
    found = exact(model)
    assert found["porosity"] == 1.0
    assert found["euler_number"] == found["components"] == math.inf


def test_the_finest_printable_level():
    model = ifs(named("menger"), level=1, size=27.0)
    assert [model.finest_printable_level(f) for f in (28, 27, 9.5, 9, 1, 0.9)] == [
        None,
        0,
        0,
        1,
        3,
        3,
    ]
    assert ifs(named("menger"), level=1, offset=0.5).finest_printable_level(1.0) == math.inf
    with pytest.raises(ModelError, match="feature: got 0"):
        model.finest_printable_level(0)
    # A regular tetrahedron of edge a is a/√2 thick.
    thick = tetrahedra(level=2, size=1.0).smallest_feature()
    assert thick == pytest.approx(1 / 4, rel=1e-9)


def test_the_thinnest_cell_of_unequal_maps():
    model = jerusalem(level=2)
    assert model.smallest_feature() == pytest.approx(K**4, rel=1e-9)
    squeezed = ifs(
        [(np.diag([0.5, 0.25, 0.125]), np.zeros(3)), (np.eye(3) / 2, np.ones(3) / 2)], level=2
    )
    assert squeezed.smallest_feature() == pytest.approx(1 / 64, rel=1e-12)


def test_cut_sets_stop_at_a_size():
    model = jerusalem(level=CutSet(0.2))
    sizes = np.linalg.norm(model.frames()[:, :, :3], 2, axis=(1, 2))
    assert sizes.max() < 0.2
    assert {round(math.log(s) / math.log(K)) for s in sizes} == {2, 3}
    assert model.smallest_feature() == pytest.approx(sizes.min(), rel=1e-12)
    doubled = jerusalem(level=CutSet(0.4), size=2.0)
    np.testing.assert_allclose(doubled.frames()[:, :, :3], model.frames()[:, :, :3], atol=1e-15)


def test_fusing_leaves_the_domain_as_it_is():
    model = tetrahedra(level=2, size=4.0, contacts="fuse")
    # A quarter of the thinnest cell, which is a quarter of the whole.
    assert model.contact_radius == pytest.approx(0.25)
    assert model.domain == Box((0.0,) * 3, (4.0,) * 3)
    assert model.bulk == Box((0, 0, 0), (4, 4, 4))
    assert (model.balls[:, 3] == model.contact_radius).all()
    # Vertices of the first two subdivisions, less the four corners: 6 + 24.
    assert len(model.balls) == 30
    assert len(tetrahedra(level=2).balls) == 0


# --- voxels --------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["menger", "even-parity"])
def test_voxels_of_a_digit_set(name):
    digits = named(name)
    for level in (0, 1, 2):
        model = ifs(digits, level=level)
        n = digits.divisions**level
        masks = model.sample(Frame.fit(model.domain, voxels=n), CENTRE)
        assert (masks.astype(bool) == naive.voxels(digits.divisions, digits.keep, level)).all()


def odd_frame(model):
    return Frame.fit(
        model.domain,
        spacing=tuple(a / n for a, n in zip(model.domain.lengths, (11, 8, 13), strict=True)),
    )


@settings(deadline=None, derandomize=True, max_examples=6)
@given(seed=st.integers(0, 10**6))
def test_a_renamed_or_doubled_automaton_has_the_same_voxels(seed):
    rng = np.random.default_rng(seed)
    maps = [(rng.normal(size=(3, 3)) * 0.25, rng.uniform(size=3)) for _ in range(3)]
    plain = of_maps(maps)
    twin = duplicated(plain, rng)
    other = renamed(twin, [1, 0])
    model = ifs(plain, level=3, primitive="octahedron")
    frame = odd_frame(model)
    expected = model.sample(frame, FILL)
    for automaton in (twin, other):
        copy = ifs(automaton, level=3, primitive="octahedron")
        assert (copy.frames() == model.frames()).all()
        assert (copy.sample(frame, FILL) == expected).all()


def test_digits_and_cubes_give_the_same_voxels():
    fast = ifs(named("menger"), level=2)
    slow = ifs(of_maps(named("menger").maps), level=2)
    frame = odd_frame(fast)
    assert (fast.sample(frame, FILL) == slow.sample(frame, FILL)).all()
    marks, bound = fast.cover(frame)
    assert marks.any()
    assert bound <= frame.diagonal * (1 + 1e-4)


def test_an_attractor_with_offset_holds_its_prefractal_s_corners():
    model = ifs(named("vicsek-9"), level="limit", offset=0.05)
    frame = Frame.fit(model.domain, voxels=44)
    masks = model.sample(frame, CENTRE)
    centres = np.stack(
        np.meshgrid(*(frame.centres(axis) for axis in range(3)), indexing="ij"), axis=-1
    )
    # Corners of the cube and its centre belong to the attractor.
    for point in (*CORNERS, (0.5, 0.5, 0.5)):
        near = np.linalg.norm(centres - point, axis=-1) < 0.045
        assert near.any()
        assert masks[near].all()


# --- recipes -------------------------------------------------------------------------------

MENGER = {"kind": "ifs", "digits": {"keep": "menger"}, "level": 1}


def recipe(**model):
    table = {**MENGER, **model}
    if "maps" in model:
        del table["digits"]
    return parse({"model": table})


def test_a_recipe_gives_the_model_that_ifs_gives():
    assert build(recipe(size=3.0, unit="cm")) == ifs(named("menger"), level=1, size=3.0, unit="cm")
    maps = [{"matrix": A.tolist(), "translation": b.tolist()} for A, b in named("menger").maps]
    assert build(recipe(maps=maps)) == ifs(named("menger"), level=1, size=1.0)
    cut = build(recipe(level={"size": 0.2}))
    assert cut.level == CutSet(0.2)
    diagonal = {"divisions": 2, "keep": [[0, 0, 0], [1, 1, 1]]}
    table = {**MENGER, "digits": diagonal, "level": "limit"}
    limit = parse({"model": table, "voxels": {"voxels": 9}})
    assert build(limit) == ifs(DigitSet(2, np.array(diagonal["keep"])), level="limit", size=1.0)


def test_a_recipe_written_and_read_again_is_the_same():
    for table in ({}, {"level": {"size": 0.3}}, {"primitive": "ball", "offset": 0.1}):
        first = recipe(**table)
        assert parse(tomllib.loads(dump(first))) == first


@pytest.mark.parametrize(
    ("model", "message"),
    [
        ({"levle": 2}, r"model.levle: unknown key; did you mean 'level'"),
        ({"level": -1}, r"model.level: got -1; wanted a whole number"),
        ({"level": 1.5}, r"model.level: got 1.5"),
        ({"level": {"size": 0}}, r"model.level"),
        ({"size": 0.0}, r"model.size: got 0.0; wanted a length above zero"),
        ({"size": math.nan}, r"model.size"),
        ({"unit": "furlong"}, r'model.unit: got "furlong"; wanted nm'),
        ({"contacts": "glue"}, r'model.contacts: got "glue"'),
        ({"primitive": "cub"}, r"no primitive 'cub'; did you mean 'cube'"),
        ({"primitive": {"mesh": 3}}, r"model.primitive"),
        ({"digits": {"keep": "menge"}}, r"no set of digits 'menge'; did you mean 'menger'"),
        ({"digits": {"keep": "menger", "divisions": 4}}, r"has divisions = 3; got 4"),
        ({"digits": {"keep": [[0, 0, 0]]}}, r"wanted divisions"),
        ({"digits": {"divisions": 3, "keep": [[0, 0, 3]]}}, r"keep\[0\] = \[0, 0, 3\]"),
        ({"maps": []}, r"model.maps"),
        ({"maps": [{"matrix": [[1, 0], [0, 1]]}]}, r"model.maps.0.matrix"),
        ({"maps": [{"matrix": np.diag([0.5, math.nan, 0.5]).tolist()}]}, r"model.maps.0.matrix"),
        ({"digits": None}, r"neither of digits and maps"),
        ({"domain": {"lower": [0, 0, 0], "upper": [1, 0, 1]}}, r"domain"),
    ],
)
def test_recipes_that_cannot_be_understood(model, message):
    table = {key: value for key, value in {**MENGER, **model}.items() if value is not None}
    if "maps" in model:
        del table["digits"]
    with pytest.raises(RecipeError, match=message):
        parse({"model": table})


def test_both_digits_and_maps_are_too_many():
    with pytest.raises(RecipeError, match="both of digits and maps"):
        parse({"model": {**MENGER, "maps": [{"matrix": (np.eye(3) / 2).tolist()}]}})


def test_maps_without_attractor_are_found_when_the_model_is_built():
    growing = recipe(maps=[{"matrix": (np.eye(3) * 1.5).tolist()}])
    with pytest.raises(ModelError, match="no attractor"):
        build(growing)


def test_a_mesh_of_one_s_own(tmp_path):
    from porous.formats import write

    solid = primitives.named("octahedron").surface()
    write(solid, tmp_path / "solid.stl")
    table = {**MENGER, "primitive": {"mesh": "solid.stl"}}
    model = build(parse({"model": table}, folder=tmp_path))
    assert model.primitive.volume == pytest.approx(solid.volume, rel=1e-6)
    # The images of its box lie side by side, so its volumes add up.
    assert exact(model)["volume"] == pytest.approx(20 / 27 * solid.volume, rel=1e-6)
    direct = ifs(named("menger"), level=1, primitive=solid)
    assert direct.primitive.volume == pytest.approx(solid.volume, rel=1e-12)
    with pytest.raises(Exception, match=r"nothing\.stl"):
        build(parse({"model": {**MENGER, "primitive": {"mesh": "nothing.stl"}}}, folder=tmp_path))


def test_an_open_mesh_is_no_primitive():
    closed = primitives.named("cube").surface()
    opened = SurfaceMesh(closed.points, closed.triangles[1:])
    with pytest.raises(MeshError):
        ifs(named("menger"), level=1, primitive=opened)


@pytest.mark.parametrize("name", ["menger", "jerusalem-cube", "sierpinski-tetrahedron"])
def test_presets_build(name):
    model = build(load(name))
    assert model.domain.contains(model.bulk)
    assert max(model.bulk.lengths) == pytest.approx(1.0)


def moved(shift):
    """Four turned maps of a tetrahedron, all of it moved."""
    place, turn = (
        shift * np.array([1, 0.7, 0.3]),
        np.array([[0, -0.5, 0], [0.5, 0, 0], [0, 0, 0.5]]),
    )
    corners = np.array([[0, 0, 0], [1, 1, 0], [1, 0, 1], [0, 1, 1]]) / 2
    maps = [(turn, corner + (np.eye(3) - turn) @ place) for corner in corners]
    solid = po.exact_surface(
        po.ifs([(np.eye(3) / 2, np.zeros(3))], level=0, primitive="tetrahedron")
    )
    lower, upper = np.array([-0.55, -0.3, -0.05]), np.array([1.1, 1.2, 1.03])
    return po.ifs(
        maps,
        level=3,
        primitive=SurfaceMesh(solid.points + place, solid.triangles),
        domain=Box(tuple(place + lower), tuple(place + upper)),
    )


def test_a_body_far_away_is_the_same_or_refused():
    """Rounding grows with the coordinates: voxels are right, or there are none."""
    near = po.voxelize(moved(0.0), voxels=40)
    volume = int(near.fill.sum())
    for shift in (1.0, 30.0, 300.0, 1e6, 1e9):
        assert int(po.voxelize(moved(shift), voxels=40).fill.sum()) == pytest.approx(
            volume, rel=1e-3
        )
    # Samples may be off by a sixteenth of a voxel; covers are certain, or there are none.
    for sampling, shift, told in (("fill", 1e13, "e+13"), ("cover", 1.3e8, "e+08")):
        with pytest.raises(ModelError, match=r"lies at coordinates up to 1\.\d+" + re.escape(told)):
            po.voxelize(moved(shift), voxels=40, sampling=sampling)
    # An automaton whose controls are the unit axes loses digits of its matrices far away.
    maps = [(np.eye(3) / 2, np.full(3, 1e5) + corner) for corner in np.eye(3)]
    place = Box((2e5,) * 3, (2e5 + 2, 2e5 + 2, 2e5 + 2))
    assert po.voxelize(ifs(maps, level="limit", domain=place), voxels=9, sampling="cover")
    far = ifs(of_maps(maps), level="limit", domain=place)
    with pytest.raises(ModelError, match="rounding may move it"):
        po.voxelize(far, voxels=9, sampling="cover")


@pytest.mark.parametrize("width", [1e-13, 1e-18])
def test_a_zoom_deeper_than_numbers_reach_is_refused(width):
    """Rounding is that of the body, not of the window near the origin that is looked at."""
    end = np.array([0.9, 0.7, 0.3])
    maps = [(np.eye(3) * 0.6, 0.4 * end), (np.eye(3) * 0.6, -0.4 * end)]
    made = ifs(maps, level="limit", domain=Box((-width,) * 3, (width,) * 3))
    with pytest.raises(ModelError, match="rounding may move it"):
        po.voxelize(made, voxels=8, sampling="cover")


@pytest.mark.parametrize("level", [2, 4, "limit"])
@pytest.mark.parametrize("turn", [np.eye(3), np.eye(3)[[1, 2, 0]] * [1, -1, 1]])
def test_a_shift_by_a_power_of_two_leaves_the_same_bytes(level, turn):
    corners = np.array([[0, 0, 0], [1, 0, 0.5], [0.25, 1, 0], [0, 0.5, 1]])
    solid = primitives.named("octahedron")
    found = []
    for step in (0.0, 2.0**14):
        shift = step * np.array([1, -1, 0.5])
        maps = [(turn / 2, b / 2 + shift - turn @ shift / 2) for b in corners]
        lower, upper = shift - [1, 1.5, 1], shift + np.array([2, 1.5, 2])
        place = Box(tuple(lower), tuple(upper))
        body = SurfaceMesh(solid.points + shift, solid.triangles)
        made = ifs(maps, level=level, primitive=body, domain=place)
        how = ["cover"] if level == "limit" else ["fill", "cover"]
        grids = [po.voxelize(made, spacing=(1 / 16, 1 / 32, 3 / 32), sampling=s) for s in how]
        found.append([(grid.fill, grid.hausdorff) for grid in grids])
    for (near, bound), (far, other) in zip(*found, strict=True):
        assert near.any()
        assert np.array_equal(near, far)
        assert bound == other


@pytest.mark.parametrize("far", [1234.5, 1.1e4, 1.1e5])
def test_covers_far_away_hold_the_body_within_their_bound(far):
    here, made = moved(0.0), moved(far)
    placed = here.frames()
    corners = np.einsum("kij,nj->kni", placed[:, :, :3], here.primitive.points)
    corners = (corners + placed[:, None, :, 3]).reshape(-1, 3)
    near, grid = (po.voxelize(m, voxels=30, sampling="cover") for m in (here, made))
    assert grid.fill.shape == near.fill.shape
    shift = np.array(made.domain.lower) - here.domain.lower
    spacing, doubt = np.array(grid.frame.spacing), 1e-13 * far / min(grid.frame.spacing) + 1e-9
    held = np.zeros(len(corners), bool)
    for nudge in itertools.product((-doubt, doubt), repeat=3):
        at = (corners + shift - grid.frame.origin) / spacing + nudge
        index = np.clip(np.floor(at).astype(int), 0, np.array(grid.fill.shape) - 1)
        held |= grid.fill[tuple(index.T)] > 0
    assert held.all()
    # What is marked besides only touches the body, or nearly: it is next to what is near too.
    beside = binary_dilation(near.fill > 0, np.ones((3, 3, 3)))
    assert not (grid.fill > 0)[~beside].any()
    assert ((grid.fill > 0) != (near.fill > 0)).mean() < 0.02
    assert grid.hausdorff == pytest.approx(near.hausdorff, rel=1e-6)
