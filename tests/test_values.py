"""Values are frozen, checked at the door, picklable and equal by content."""

import copy
import dataclasses
import math
import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from porous.errors import GridError, MeshError
from porous.values import (
    CENTRE,
    FILL,
    SHAPES,
    Block,
    Box,
    Frame,
    Held,
    Job,
    Material,
    Measure,
    Measures,
    Part,
    Pattern,
    Pressed,
    Step,
    SurfaceMesh,
    VolumeMesh,
    VoxelGrid,
)
from porous.values.units import METRES, length_ratio
from porous.values.value import adopted, frozen

BOX = Box((0, -1, 2), (3, 1, 7))
FRAME = Frame((0.5, -1, 2), (0.5, 0.25, 2), (3, 4, 5), (False, True, False), "um")
TETRAHEDRON = np.array([[0, 0, 0], [2, 0, 0], [0, 3, 0], [0, 0, 5.0]])
OUTWARD = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
STEEL = Material("steel", 210e3, 0.3, 7.85e-9, "EN 1993-1-1")


def grid(seed=0):
    fill = np.random.default_rng(seed).integers(0, 256, FRAME.shape, dtype=np.uint8)
    return VoxelGrid(FRAME, fill, bulk=np.full(FRAME.shape, 255, np.uint8), hausdorff=0.25)


def surface():
    return SurfaceMesh(TETRAHEDRON, OUTWARD, "cm", np.array([0, 1, 1, 1]), ("WALL", "CAP"))


def volume():
    return VolumeMesh(
        TETRAHEDRON,
        (Block("tet4", np.array([[0, 1, 2, 3]])),),
        {"phase": np.array([7])},
        {
            "ZMIN": Part("nodes", np.array([0, 1, 2])),
            "TOP": Part("faces", np.array([[0, 2]])),
            "SOLID": Part("cells", np.array([0])),
        },
    )


def pressing(fixed="ZMIN", loaded="TOP", pressure=1.5):
    held = Held(fixed, "displacement", components=(0, 1, 2))
    return Step("press", "static", (held,), (Pressed(loaded, pressure),))


VALUES = {
    "box": BOX,
    "frame": FRAME,
    "grid": grid(),
    "surface": surface(),
    "volume": volume(),
    "job": Job("weight", volume(), {"SOLID": STEEL}, (pressing(),)),
    "material": STEEL,
    "measure": Measure("porosity", 0.25, "1", "voxel fill", 0.01, "standard", "grid"),
    "undefined": Measure(
        "tortuosity_factor", math.nan, "1", "random walk", math.nan, "bound", "grid"
    ),
    "measures": Measures((Measure("volume", 3, "mm³", "triangles", 0, "exact", "surface"),)),
    "pattern": FILL,
}
each = pytest.mark.parametrize("value", VALUES.values(), ids=VALUES.keys())


def arrays_of(value):
    """Every array in a value, however deep."""
    if isinstance(value, np.ndarray):
        yield value
    elif dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            yield from arrays_of(getattr(value, field.name))
    elif hasattr(value, "values"):
        for member in value.values():
            yield from arrays_of(member)
    elif isinstance(value, tuple):
        for member in value:
            yield from arrays_of(member)


@each
def test_fields_cannot_be_set(value):
    for field in dataclasses.fields(value):
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(value, field.name, None)


@each
def test_copies_are_equal_and_as_frozen(value):
    for twin in (pickle.loads(pickle.dumps(value)), copy.deepcopy(value), copy.copy(value)):
        assert twin == value
        assert hash(twin) == hash(value)
        for array in arrays_of(twin):
            with pytest.raises(ValueError, match="read-only"):
                array[...] = 0


@each
def test_a_value_differs_from_its_neighbours(value):
    others = [other for other in VALUES.values() if other is not value]
    assert all(other != value for other in others)
    assert value != "something else"


def test_values_of_another_content_differ():
    assert grid(1) != grid(2)
    assert grid(1) == grid(1)
    assert volume() != dataclasses.replace(volume(), cell_tags={"phase": [8]})
    assert volume() != dataclasses.replace(volume(), cell_tags={"body": [7]})
    assert surface() != dataclasses.replace(surface(), unit="mm")


def test_mappings_of_a_mesh_cannot_be_changed():
    for twin in (volume(), pickle.loads(pickle.dumps(volume()))):
        with pytest.raises(TypeError):
            twin.parts["XMAX"] = Part("nodes", [0])
        with pytest.raises(TypeError):
            twin.cell_tags["phase"] = [1]


# --- arrays --------------------------------------------------------------------------------


def test_the_caller_keeps_its_array_and_cannot_reach_ours():
    mine = np.zeros(FRAME.shape, np.uint8)
    ours = VoxelGrid(FRAME, mine)
    mine[0, 0, 0] = 9
    assert ours.fill[0, 0, 0] == 0


def test_a_read_only_view_of_a_writable_array_is_copied():
    owner = np.zeros(FRAME.shape, np.uint8)
    view = owner.view()
    view.flags.writeable = False
    ours = VoxelGrid(FRAME, view)
    owner[0, 0, 0] = 9
    assert ours.fill[0, 0, 0] == 0


def test_an_array_that_nobody_can_write_to_is_not_copied():
    made = adopted(np.zeros(FRAME.size, np.uint8).reshape(FRAME.shape))
    assert np.shares_memory(VoxelGrid(FRAME, made).fill, made)


@given(npst.arrays(np.int32, npst.array_shapes(max_dims=3, max_side=5)))
def test_frozen_is_the_same_numbers_contiguous_and_read_only(array):
    for given_array in (array, array.T, array[::2], array.tolist()):
        result = frozen(given_array, np.float64)
        assert result.flags.c_contiguous
        assert not result.flags.writeable
        assert np.array_equal(result, np.asarray(given_array, float))


def test_indices_that_are_not_whole_are_refused_not_rounded():
    with pytest.raises(MeshError, match=r"triangles: got float64; wanted whole numbers"):
        SurfaceMesh(TETRAHEDRON, OUTWARD + 0.5)
    with pytest.raises(
        MeshError, match=r"labels: got numbers from 0 to 65536; they do not fit int16"
    ):
        SurfaceMesh(TETRAHEDRON, OUTWARD, labels=np.array([0, 0, 0, 65536]))
    with pytest.raises(MeshError, match=r"tet4: got float64"):
        Block("tet4", np.array([[0, 1, 2, 3.0]]))


# --- box -----------------------------------------------------------------------------------


def test_box_measures_itself():
    assert BOX.lengths == (3, 2, 5)
    assert BOX.volume == 30
    assert BOX.centre == (1.5, 0, 4.5)
    assert len(set(BOX.corners)) == 8
    assert BOX.corners[1] == (0, -1, 7)
    assert BOX.grown(1) == Box((-1, -2, 1), (4, 2, 8))


@pytest.mark.parametrize(
    ("lower", "upper", "message"),
    [
        ((0, 0, 1), (1, 1, 0), "lies above"),
        ((0, 0), (1, 1, 1), "wanted three numbers"),
        ((0, 0, math.nan), (1, 1, 1), "wanted three finite numbers"),
        ((0, 0, 0), (1, 1, math.inf), "wanted three finite numbers"),
        ("123", (4, 5, 6), "wanted three numbers"),
        (None, (1, 1, 1), "wanted three numbers"),
        ((0, 0, 0), (10**400, 1, 1), "wanted three numbers"),
    ],
)
def test_box_refuses(lower, upper, message):
    with pytest.raises(GridError, match=message):
        Box(lower, upper)


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.zeros((4, 2)), np.zeros(3)])
def test_box_of_no_points_is_refused(points):
    with pytest.raises(GridError, match=r"wanted \(n, 3\) with n ≥ 1"):
        Box.of_points(points)


coordinates = st.floats(-1e6, 1e6, allow_subnormal=False)
clouds = npst.arrays(float, st.tuples(st.integers(1, 6), st.just(3)), elements=coordinates)


@given(clouds, clouds)
def test_union_holds_both_and_is_smallest(a, b):
    first, second = Box.of_points(a), Box.of_points(b)
    union = first.union(second)
    assert union.contains(first)
    assert union.contains(second)
    assert union == Box.of_points(np.vstack([a, b]))
    assert union == second.union(first)


# --- frame ---------------------------------------------------------------------------------


def test_frame_lies_where_it_says():
    assert FRAME.box == Box((0.5, -1, 2), (2, 0, 12))
    assert FRAME.size == 60
    assert FRAME.voxel_volume == 0.25
    assert math.isclose(FRAME.diagonal, math.sqrt(0.25 + 0.0625 + 4))
    assert FRAME.centres(0).tolist() == [0.75, 1.25, 1.75]


@given(st.lists(st.floats(0.01, 100), min_size=3, max_size=3), st.integers(1, 300))
def test_a_fitted_frame_covers_its_box_with_voxels_near_the_asked_size(lengths, voxels):
    box = Box((1, -2, 3), tuple(o + a for o, a in zip((1, -2, 3), lengths, strict=True)))
    frame = Frame.fit(box, voxels=voxels)
    assert max(frame.shape) == voxels
    assert np.allclose(frame.box.upper, box.upper, rtol=1e-12)
    h = max(box.lengths) / voxels
    for n, length in zip(frame.shape, box.lengths, strict=True):
        assert n == max(1, round(length / h))


@given(st.lists(st.floats(0.5, 9), min_size=3, max_size=3), st.floats(0.05, 0.4))
def test_a_cubic_frame_pads_by_less_than_a_voxel(lengths, h):
    box = Box((0, 0, 0), tuple(lengths))
    frame = Frame.fit(box, spacing=(h, h, h), cubic=True)
    assert frame.spacing == (h, h, h)
    for outer, inner in zip(frame.box.upper, box.upper, strict=True):
        assert inner - 1e-6 * h <= outer < inner + h


def test_a_cubic_frame_does_not_stretch_a_period():
    box = Box((0, 0, 0), (1, 2, 0.5))
    periodic = (False, False, True)
    assert Frame.fit(box, voxels=8, cubic=True, periodic=periodic).shape == (4, 8, 2)
    with pytest.raises(GridError, match=r"do not divide the period 0\.5 along z"):
        Frame.fit(box, voxels=7, cubic=True, periodic=periodic)


def test_tiles_have_the_very_coordinates_of_the_whole():
    frame = Frame((0.1, 0.2, 0.3), (0.7, 0.11, 1.3), (9, 8, 7))
    tile = frame.tile((2, 3, 1), (9, 5, 7)).tile((1, 0, 2), (4, 2, 3))
    assert tile.shape == (3, 2, 1)
    for axis, (start, stop) in enumerate([(3, 6), (3, 5), (3, 4)]):
        assert tile.centres(axis).tolist() == frame.centres(axis)[start:stop].tolist()
    assert tile.origin == frame.origin


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"spacing": (1, 0, 1)}, "wanted three positive lengths"),
        ({"spacing": (1, 1, math.nan)}, "three finite numbers"),
        ({"shape": (0, 1, 1)}, "at least one voxel per axis"),
        ({"shape": (1, 1)}, "three whole numbers"),
        ({"shape": (2.5, 1, 1)}, "three whole numbers"),
        ({"origin": (1, 2, "here")}, "three numbers"),
        ({"periodic": True}, "three of True and False"),
        ({"periodic": (1, 0)}, "three of True and False"),
        ({"unit": "furlong"}, "wanted one of nm, um, mm, cm, m, in"),
    ],
)
def test_frame_refuses(change, message):
    with pytest.raises(GridError, match=message):
        dataclasses.replace(FRAME, **change)


@pytest.mark.parametrize(
    ("how", "message"),
    [
        ({}, "give one of voxels"),
        ({"voxels": 3, "spacing": (1, 1, 1)}, "give one of voxels"),
        ({"voxels": 0}, "at least 1"),
        ({"voxels": 2.5}, "a whole number"),
        ({"spacing": (1, 1, -1)}, "three positive lengths"),
        ({"spacing": (1e-320, 1, 1)}, "beyond counting"),
    ],
)
def test_fit_refuses(how, message):
    with pytest.raises(GridError, match=message):
        Frame.fit(BOX, **how)


def test_a_flat_domain_is_refused():
    with pytest.raises(GridError, match="has no volume"):
        Frame.fit(Box((0, 0, 0), (1, 0, 2)), voxels=3)


# --- grid ----------------------------------------------------------------------------------


def test_solid_is_half_full_or_more():
    fill = np.zeros((1, 2, 3), np.uint8)
    fill[0] = [[0, 127, 128], [255, 1, 200]]
    frame = Frame((0, 0, 0), (1, 1, 1), (1, 2, 3))
    assert VoxelGrid(frame, fill).solid.tolist() == [[[False, False, True], [True, False, True]]]


@given(npst.arrays(bool, st.just(FRAME.shape)))
def test_a_binary_grid_holds_just_two_fills(solid):
    made = VoxelGrid.of_solid(solid, FRAME)
    assert set(np.unique(made.fill)) <= {0, 255}
    assert np.array_equal(made.solid, solid)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"fill": np.ones(FRAME.shape, bool)}, "fill: got bool; wanted uint8"),
        ({"fill": np.ones((5, 4, 3), np.uint8)}, r"the frame has \(3, 4, 5\)"),
        ({"bulk": np.ones(FRAME.shape)}, "bulk: got float64"),
        ({"sampling": "guess"}, "wanted one of"),
        ({"hausdorff": -0.1}, "wanted a distance"),
        ({"hausdorff": math.nan}, "wanted a distance"),
    ],
)
def test_grid_refuses(change, message):
    with pytest.raises(GridError, match=message):
        dataclasses.replace(grid(), **change)


# --- surface -------------------------------------------------------------------------------


def test_surface_measures_itself():
    assert math.isclose(surface().volume, 5)
    flat = 3 + 5 + 7.5
    slanted = math.sqrt(3**2 + 5**2 + 7.5**2)
    assert math.isclose(surface().area, flat + slanted)
    assert np.allclose(surface().area_vectors.sum(axis=0), 0)
    assert surface().box == Box((0, 0, 0), (2, 3, 5))


@given(clouds.filter(lambda c: len(c) >= 1), st.floats(-1e3, 1e3))
def test_volume_does_not_depend_on_the_place(shift, far):
    moved = SurfaceMesh(TETRAHEDRON + np.clip(shift[0], -1e3, 1e3) + far, OUTWARD)
    assert math.isclose(moved.volume, 5, rel_tol=1e-9)


def test_an_empty_surface_has_no_volume():
    empty = SurfaceMesh(np.zeros((0, 3)), np.zeros((0, 3), np.int64))
    assert (empty.volume, empty.area) == (0, 0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"points": TETRAHEDRON[:, :2]}, r"surface points: got shape \(4, 2\)"),
        ({"points": np.where(TETRAHEDRON == 5, np.nan, TETRAHEDRON)}, "point 3 is"),
        ({"triangles": OUTWARD + 1}, "indices run from 1 to 4; there are 4 points"),
        ({"triangles": OUTWARD - 1}, "indices run from -1"),
        ({"triangles": OUTWARD[:, :2]}, r"wanted \(n, 3\)"),
        ({"labels": [0, 1]}, "one per triangle"),
        ({"labels": [0, 1, 2, 0]}, "indices into the 2 names"),
        ({"labels": [0, 1, -1, 0]}, "indices into the 2 names"),
    ],
)
def test_surface_refuses(change, message):
    with pytest.raises(MeshError, match=message):
        dataclasses.replace(surface(), **change)


# --- volume mesh ---------------------------------------------------------------------------

UNIT_CUBE = np.array(
    [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1.0]]
)


@pytest.mark.parametrize("shape", SHAPES)
def test_faces_look_outwards_and_close(shape):
    points = TETRAHEDRON if shape.startswith("tet") else UNIT_CUBE * [2, 3, 5]
    points = points[[0, 1, 3, 4, 5, 7]] if shape == "wed6" else points
    edges = [
        (face[i], face[(i + 1) % len(face)])
        for face in SHAPES[shape].faces
        for i in range(len(face))
    ]
    assert len(set(edges)) == len(edges)
    assert {(b, a) for a, b in edges} == set(edges)
    centre = points.mean(axis=0)
    for face in SHAPES[shape].faces:
        a, b, c = points[list(face[:3])]
        assert np.cross(b - a, c - a) @ (a - centre) > 0


@given(npst.arrays(float, (8, 3), elements=st.floats(-0.1, 0.1)))
def test_the_volume_of_a_warped_brick_is_that_of_its_jacobian(warp):
    corners = UNIT_CUBE * [2, 3, 5] + warp
    mesh = VolumeMesh(corners, (Block("hex8", [range(8)]),))
    node, weight = np.polynomial.legendre.leggauss(3)
    total = 0.0
    for x, wx in zip((node + 1) / 2, weight / 2, strict=True):
        for y, wy in zip((node + 1) / 2, weight / 2, strict=True):
            for z, wz in zip((node + 1) / 2, weight / 2, strict=True):
                t = np.array([x, y, z])
                factors = np.where(UNIT_CUBE == 1, t, 1 - t)
                slopes = np.where(UNIT_CUBE == 1, 1.0, -1.0)
                gradient = np.stack(
                    [
                        slopes[:, a] * factors[:, b] * factors[:, c]
                        for a, b, c in ((0, 1, 2), (1, 0, 2), (2, 0, 1))
                    ],
                    axis=1,
                )
                total += wx * wy * wz * np.linalg.det(corners.T @ gradient)
    assert math.isclose(mesh.volumes[0], total, rel_tol=1e-12)


def test_cells_count_through_the_blocks():
    far = np.vstack([UNIT_CUBE, TETRAHEDRON + 10])
    mesh = VolumeMesh(far, (Block("hex8", [range(8)]), Block("tet4", [[8, 9, 10, 11]])))
    assert mesh.cells == 2
    assert np.allclose(mesh.volumes, [1, 5])
    named = dataclasses.replace(mesh, parts={"LAST": Part("faces", [[0, 5], [1, 3]])})
    assert named.parts["LAST"].members.shape == (2, 2)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Block("tet5", [[0]]), "wanted one of tet4, hex8, tet10"),
        (lambda: Part("edges", [0]), "wanted one of"),
        (lambda: Part("faces", [0, 1]), r"got shape \(2,\); wanted \(n, 2\)"),
        (lambda: Part("faces", [[0, 1, 2]]), r"got shape \(1, 3\); wanted \(n, 2\)"),
        (lambda: Part("nodes", [[0, 1]]), r"wanted \(n,\)"),
        (lambda: Part("nodes", 3), r"got shape \(\)"),
        (lambda: dataclasses.replace(volume(), parts={"A": Part("nodes", [4])}), "there are 4"),
        (lambda: dataclasses.replace(volume(), parts={"A": Part("cells", [1])}), "there are 1"),
        (
            lambda: dataclasses.replace(volume(), parts={"A": Part("faces", [[0, 4]])}),
            "cell 0 has no face 4; its faces are 0 to 3",
        ),
        (lambda: dataclasses.replace(volume(), cell_tags={"t": [1, 2]}), "there are 1 cells"),
        (lambda: VolumeMesh(TETRAHEDRON, (Block("tet4", [[0, 1, 2, 4]]),)), "there are 4 points"),
        (lambda: VolumeMesh(TETRAHEDRON, (Block("tet4", [[0, 1, 2]]),)), r"wanted \(n, 4\)"),
    ],
)
def test_volume_mesh_refuses(make, message):
    with pytest.raises(MeshError, match=message):
        make()


# --- job -----------------------------------------------------------------------------------


def test_a_step_speaks_only_of_parts_that_the_mesh_has():
    with pytest.raises(MeshError, match="no part of nodes named 'BASE'; there are ZMIN"):
        Job("x", volume(), {"SOLID": STEEL}, (pressing("BASE"),))
    with pytest.raises(MeshError, match="no part of faces named 'ZMIN'; there are TOP"):
        Job("x", volume(), {"SOLID": STEEL}, (pressing("ZMIN", "ZMIN"),))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"youngs_modulus": 0}, "youngs_modulus = 0; wanted more than zero"),
        ({"youngs_modulus": math.inf}, "youngs_modulus = inf; wanted more than zero"),
        ({"poissons_ratio": 0.5}, "wanted a number between −1 and 0.5"),
        ({"density": math.nan}, "wanted more than zero"),
    ],
)
def test_material_refuses(change, message):
    with pytest.raises(MeshError, match=message):
        dataclasses.replace(STEEL, **change)


def test_pressure_is_a_number():
    with pytest.raises(MeshError, match="pressure: got nan MPa"):
        pressing(pressure=math.nan)


# --- measures ------------------------------------------------------------------------------


def row(name, value, method, of="grid"):
    return Measure(name, value, "mm²", method, 0.5, "standard", of)


TABLE = Measures(
    (
        row("surface_area", 9, "voxel faces"),
        row("surface_area", 6.1, "triangles", "surface"),
        row("surface_area", 6.2, "crofton"),
        row("interface_area", 5, "something new"),
    )
)


def test_the_best_row_is_by_method_not_by_place():
    assert TABLE["surface_area"].method == "crofton"
    assert TABLE["surface_area", "voxel faces"].value == 9
    assert TABLE["interface_area"].value == 5
    assert [r.value for r in TABLE.all("surface_area")] == [9, 6.1, 6.2]
    assert TABLE.names == ("surface_area", "interface_area")
    assert "surface_area" in TABLE
    assert "genus" not in TABLE
    assert len(TABLE + TABLE) == 8


def test_a_measure_that_is_not_there_names_what_is():
    with pytest.raises(
        KeyError, match=r"no measure 'genus'; there are surface_area \(voxel faces\)"
    ):
        TABLE["genus"]


@pytest.mark.parametrize(
    ("measure", "text"),
    [
        (
            Measure("porosity", 1 / 3, "1", "closed form", 0, "exact", "model"),
            "porosity = 0.333333 (closed form, exact)",
        ),
        (
            Measure("volume", 2, "mm³", "voxel count", 0.25, "bound", "grid"),
            "volume = 2 mm³ (voxel count, ± 0.25 bound)",
        ),
        (row("surface_area", 6.2, "crofton"), "surface_area = 6.2 mm² (crofton, ± 0.5)"),
    ],
)
def test_a_measure_says_what_it_is(measure, text):
    assert str(measure) == text


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"kind": "certain"}, "kind: got 'certain'"),
        ({"of": "picture"}, "of: got 'picture'"),
        ({"uncertainty": -1}, "wanted zero or more"),
        ({"kind": "exact"}, "an exact number has no uncertainty"),
    ],
)
def test_measure_refuses(change, message):
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(row("surface_area", 6.2, "crofton"), **change)


# --- pattern and units ---------------------------------------------------------------------


def test_the_patterns_are_what_their_names_say():
    assert CENTRE.points == 1
    assert FILL.points == 64
    x, y = FILL.rows.T
    assert len(set(x)) == len(set(y)) == 16
    assert len(np.unique(FILL.depths)) == 64
    # No plane across an axis leaves more than one sample line (or depth) in a sixteenth.
    assert np.array_equal(np.sort((FILL.depths.ravel() * 64).astype(int)), np.arange(64))


@pytest.mark.parametrize(
    ("rows", "depths", "message"),
    [
        ([0.5, 0.5], [[0.5]], r"rows \(R, 2\)"),
        ([[0.5, 0.5]], [[0.5], [0.5]], "as many depths as rows"),
        ([[0.5, 0.5]], [np.linspace(0.1, 0.9, 65)], "at most 64"),
        ([[0.5, 1.0]], [[0.5]], "strictly inside"),
        ([[0.5, 0.5]], [[0.7, 0.2]], "to rise"),
    ],
)
def test_pattern_refuses(rows, depths, message):
    with pytest.raises(GridError, match=message):
        Pattern(np.array(rows), np.array(depths))


@given(st.sampled_from(sorted(METRES)), st.sampled_from(sorted(METRES)))
def test_units_convert_there_and_back(a, b):
    assert math.isclose(length_ratio(a, b) * length_ratio(b, a), 1)


def test_an_inch_is_25_4_mm():
    assert math.isclose(length_ratio("in", "mm"), 25.4)
