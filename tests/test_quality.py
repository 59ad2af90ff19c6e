"""Shapes of elements: closed forms of known ones, Verdict as judge of thousands, quadratic ones."""

import math
import time

import numpy as np
import pytest
import pyvista
from vtkmodules.vtkFiltersVerdict import vtkMeshQuality

from porous import measures
from porous.measures._mesh import VolumeCensus
from porous.measures._quality import quality
from porous.values import SHAPES, Block, VolumeMesh

TET = np.array([[0, 0, 0], [1, 0, 0], [0.5, math.sqrt(0.75), 0], [0.5, 0.0, 0.0]])
TET[3] = [0.5, math.sqrt(3) / 6, math.sqrt(2 / 3)]
HEX = np.array(
    [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]], float
)
WEDGE = np.concatenate([TET[:3], TET[:3] + np.array([0, 0, 1])])
REGULAR = {"tet4": TET, "hex8": HEX, "wed6": WEDGE}


def single(shape, points):
    return VolumeMesh(points, (Block(shape, np.arange(len(points))[None]),))


def of(mesh):
    return quality(mesh, mesh.volumes)


def cloud(shape, count, spread, seed=0):
    """Return cells, each the regular one stretched, sheared and with its corners moved."""
    generator = np.random.default_rng(seed)
    corners = REGULAR[shape]
    linear = np.eye(3) + 0.5 * generator.normal(size=(count, 3, 3))
    linear[np.linalg.det(linear) < 0] *= -1
    points = corners @ linear + spread * generator.normal(size=(count, *corners.shape))
    cells = np.arange(count * len(corners)).reshape(count, -1)
    return VolumeMesh(points.reshape(-1, 3), (Block(shape, cells),))


def in_vtk(mesh):
    # Verdict takes the corners of wedges as Abaqus does, not as VTK.
    block = mesh.blocks[0]
    return pyvista.UnstructuredGrid({SHAPES[block.shape].vtk: block.cells}, mesh.points)


def verdict(mesh, measure):
    """Return what VTK's Verdict says of each cell."""
    return np.asarray(in_vtk(mesh).cell_quality(measure)[measure])


def verdict_edge_ratios(mesh):
    judge = vtkMeshQuality()
    judge.SetInputData(in_vtk(mesh))
    for shape in ("Tet", "Hex", "Wedge"):
        getattr(judge, f"Set{shape}QualityMeasureToEdgeRatio")()
    judge.Update()
    return np.asarray(pyvista.wrap(judge.GetOutput())["Quality"])


def raised(mesh, shape):
    """Return the mesh of quadratic cells with nodes in the middles of the edges, not shared."""
    block = mesh.blocks[0]
    ends = np.array(SHAPES[shape].edges)
    middles = mesh.points[block.cells[:, ends]].mean(axis=2)
    nodes = len(mesh.points) + np.arange(len(block.cells) * len(ends)).reshape(-1, len(ends))
    points = np.concatenate([mesh.points, middles.reshape(-1, 3)])
    return VolumeMesh(points, (Block(shape, np.hstack([block.cells, nodes])),), mesh.cell_tags)


# --- known elements ------------------------------------------------------------------------

ANGLES = {"tet4": 2 * [math.degrees(math.acos(1 / 3))], "hex8": [90, 90], "wed6": [60, 90]}


@pytest.mark.parametrize("shape", REGULAR)
@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
def test_regular_elements_have_one_for_everything(shape, scale):
    found = of(single(shape, REGULAR[shape] * scale))
    assert [found.smallest_angle[0], found.largest_angle[0]] == pytest.approx(ANGLES[shape])
    for ratio in (found.jacobian, found.edge_ratio, found.aspect_ratio):
        assert ratio == pytest.approx(1, rel=1e-12)


def test_a_corner_of_a_cube():
    corner = single("tet4", np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]]))
    assert measures.smallest_dihedral_angle(corner).value == pytest.approx(
        math.degrees(math.acos(1 / math.sqrt(3)))
    )
    assert measures.largest_dihedral_angle(corner).value == pytest.approx(90)
    assert measures.largest_edge_ratio(corner).value == pytest.approx(math.sqrt(2))
    radius = 1 / (3 + math.sqrt(3))
    assert measures.largest_aspect_ratio(corner).value == pytest.approx(
        math.sqrt(2) / (2 * math.sqrt(6) * radius)
    )
    # Three edges at a sharp corner: one of length 1, two of √2.
    assert measures.smallest_scaled_jacobian(corner).value == pytest.approx(math.sqrt(2) / 2)


def test_a_box_and_a_sheared_box():
    box = of(single("hex8", HEX * [1, 2, 4]))
    assert box.edge_ratio[0] == pytest.approx(4)
    assert box.aspect_ratio[0] == pytest.approx(4 * 2 * (2 + 4 + 8) / (3 * 8) / 2)
    assert [box.smallest_angle[0], box.largest_angle[0]] == pytest.approx([90, 90])
    sheared = of(single("hex8", HEX @ np.array([[1, 0, 0], [0, 1, 0], [1, 0, 1]])))
    assert [sheared.smallest_angle[0], sheared.largest_angle[0]] == pytest.approx([45, 135])
    assert sheared.jacobian[0] == pytest.approx(math.sqrt(0.5))


@pytest.mark.parametrize("shape", REGULAR)
def test_flat_elements_and_such_turned_inside_out(shape):
    flat = of(single(shape, REGULAR[shape] * [1, 1, 0]))
    assert flat.smallest_angle[0] == 0
    assert flat.largest_angle[0] == 180
    assert flat.jacobian[0] == 0
    assert flat.aspect_ratio[0] == np.inf
    turned = of(single(shape, REGULAR[shape] * [1, 1, -1]))
    assert turned.jacobian[0] == pytest.approx(-1)
    point = of(single(shape, REGULAR[shape] * 0))
    assert point.edge_ratio[0] == np.inf
    assert point.smallest_angle[0] == 0


# --- the judge -----------------------------------------------------------------------------


@pytest.mark.parametrize("spread", [0.0, 0.1])
@pytest.mark.parametrize("shape", REGULAR)
def test_verdict_says_the_same(shape, spread):
    mesh = cloud(shape, 2000, spread)
    found = of(mesh)
    judged, proper = verdict(mesh, "scaled_jacobian"), found.jacobian > 0
    if shape == "hex8" and spread:  # Verdict asks at the centre too
        assert (judged <= found.jacobian + 1e-12).all()
        assert np.isclose(judged, found.jacobian, rtol=1e-9).mean() > 0.9
    else:  # of those inside out, Verdict takes another corner's
        np.testing.assert_allclose(found.jacobian[proper], judged[proper], rtol=1e-9, atol=1e-12)
        assert (judged[~proper] < 0).all()
    if shape != "hex8":
        np.testing.assert_allclose(found.edge_ratio, verdict_edge_ratios(mesh), rtol=1e-9)
    elif not spread:  # VTK's edge ratio of hexahedra forgets those along the third axis
        np.testing.assert_allclose(found.edge_ratio, verdict(mesh, "max_edge_ratio"), rtol=1e-9)


def test_verdict_on_aspect_ratios():
    mesh = cloud("tet4", 2000, 0.1)
    np.testing.assert_allclose(of(mesh).aspect_ratio, verdict(mesh, "aspect_ratio"), rtol=1e-7)


def test_angles_of_tetrahedra_are_those_about_their_edges():
    # Verdict's own are no judge: of some edges it takes 180° less the angle.
    mesh = cloud("tet4", 500, 0.1)
    corners, angles = mesh.points[mesh.blocks[0].cells], []
    for i, j, k, m in ((0, 1, 2, 3), (0, 2, 1, 3), (0, 3, 1, 2), (1, 2, 0, 3), (1, 3, 0, 2)):
        angles.append(angle_about(*(corners[:, n] for n in (i, j, k, m))))
    angles.append(angle_about(*(corners[:, n] for n in (2, 3, 0, 1))))
    found = of(mesh)
    np.testing.assert_allclose(found.smallest_angle, np.min(angles, axis=0), rtol=1e-8)
    np.testing.assert_allclose(found.largest_angle, np.max(angles, axis=0), rtol=1e-8)


def angle_about(start, stop, one, other):
    """Return the angles between two half planes that an edge bounds, one point of each given."""
    edge = (stop - start) / np.linalg.norm(stop - start, axis=1)[:, None]
    u, v = (w - (w * edge).sum(axis=1)[:, None] * edge for w in (one - start, other - start))
    sine = np.linalg.norm(np.cross(u, v), axis=1)
    return np.degrees(np.arctan2(sine, (u * v).sum(axis=1)))


def test_angles_of_hexahedra_are_those_at_their_corners():
    mesh = cloud("hex8", 300, 0.05)
    corners = mesh.points[mesh.blocks[0].cells]
    near = {0: (1, 3, 4), 1: (2, 0, 5), 2: (3, 1, 6), 3: (0, 2, 7)}
    near |= {4: (7, 5, 0), 5: (4, 6, 1), 6: (5, 7, 2), 7: (6, 4, 3)}
    angles = [
        angle_about(*(corners[:, n] for n in (corner, *(ends[(i + k) % 3] for k in range(3)))))
        for corner, ends in near.items()
        for i in range(3)
    ]
    found = of(mesh)
    np.testing.assert_allclose(found.smallest_angle, np.min(angles, axis=0), rtol=1e-8)
    np.testing.assert_allclose(found.largest_angle, np.max(angles, axis=0), rtol=1e-8)


# --- meshes --------------------------------------------------------------------------------


def test_percentiles_are_of_cells():
    mesh = cloud("tet4", 200, 0.1)
    found, table = of(mesh), measures.measure(mesh)
    for name, values in {
        "dihedral_angle": found.smallest_angle,
        "scaled_jacobian": found.jacobian,
        "edge_ratio": found.edge_ratio,
        "aspect_ratio": found.aspect_ratio,
    }.items():
        ranked = np.sort(values)
        assert table[f"{name}_p50"].value == ranked[99]
        worst, place = ("p99", 197) if name.endswith("ratio") else ("p1", 1)
        assert table[f"{name}_{worst}"].value == ranked[place]
    assert table["largest_dihedral_angle"].value == found.largest_angle.max()
    assert table["largest_dihedral_angle"].unit == "°"


@pytest.mark.parametrize(("linear", "quadratic"), [("tet4", "tet10"), ("hex8", "hex20")])
def test_quadratic_elements_are_told_by_their_corners(linear, quadratic):
    mesh = cloud(linear, 50, 0.1)
    for one, other in zip(of(mesh), of(raised(mesh, quadratic)), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9)
    rows, others = measures.measure(mesh), measures.measure(raised(mesh, quadratic))
    for row, other in zip(rows, others, strict=True):
        assert (row.name, row.method, row.unit) == (other.name, other.method, other.unit)
        assert row.value == pytest.approx(other.value, rel=1e-9)


def test_cells_of_several_shapes_stand_in_their_order():
    parts = [cloud(shape, 30, 0.1) for shape in REGULAR]
    starts = np.cumsum([0, *(len(part.points) for part in parts)])
    blocks = [
        Block(part.blocks[0].shape, part.blocks[0].cells + start)
        for part, start in zip(parts, starts, strict=False)
    ]
    mixed = of(VolumeMesh(np.concatenate([part.points for part in parts]), tuple(blocks)))
    for number, values in enumerate(mixed):
        np.testing.assert_array_equal(values, np.concatenate([of(part)[number] for part in parts]))


def test_slabs_do_not_show(monkeypatch):
    mesh = cloud("wed6", 100, 0.1)
    whole = of(mesh)
    monkeypatch.setattr("porous.measures._quality.SLAB", 7)
    for one, other in zip(whole, of(mesh), strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_hundred_thousand_cells_take_no_more_than_a_few_times_their_volumes():
    # A ratio within one run, for machines are shared; a million hexahedra take seconds.
    mesh = cloud("hex8", 100_000, 0.02)
    begin = time.perf_counter()
    volumes = mesh.volumes
    took = time.perf_counter() - begin
    begin = time.perf_counter()
    quality(mesh, volumes)
    assert time.perf_counter() - begin < 3 * took + 0.2


def test_a_census_asks_once(monkeypatch):
    calls = []
    monkeypatch.setattr(
        "porous.measures._mesh.quality", lambda *given: calls.append(1) or quality(*given)
    )
    census = VolumeCensus(cloud("tet4", 10, 0.1))
    assert census.quality is census.quality
    assert len(calls) == 1
