"""Topology of grids, surfaces and meshes; quality of elements; what models tell."""

import math
from dataclasses import replace

import numpy as np
import pytest

from porous import build, exact_surface, extract_surface, hexahedralize, ifs, load, measures
from porous.errors import GridError, MeshError, ModelError
from porous.measures import measure
from porous.measures._mesh import VolumeCensus, pinched_nodes
from porous.stages import quadratic
from porous.values import SHAPES, Block, Frame, SurfaceMesh, VolumeMesh, VoxelGrid
from porous.values.surface_topology import euler_number, pieces


def random_grid(seed, shape=(7, 8, 9), *, density=0.5, periodic=(False, False, False)):
    solid = np.random.default_rng(seed).random(shape) < density
    return VoxelGrid.of_solid(solid, Frame((1, 2, 3), (0.5, 0.4, 0.3), shape, periodic))


def shell():
    """Return a block of 5 × 6 × 7 voxels with a cavity and a tunnel."""
    fill = np.full((5, 6, 7), 255, np.uint8)
    fill[2, 2, 2] = 0
    fill[:, 4, 5] = 0
    return VoxelGrid(Frame((0, 0, 0), (1, 1, 1), (5, 6, 7)), fill)


def test_a_cavity_and_a_tunnel():
    grid = shell()
    assert measures.components(grid).value == 1
    assert measures.genus(grid).value == 1
    assert measures.euler_number(grid).value == 1 - 1 + 1
    table = measure(extract_surface(grid), grid=grid)
    told = {name: table[name].value for name in ("components", "genus", "euler_number", "shells")}
    assert told == {"components": 1, "genus": 1, "euler_number": 1, "shells": 2}
    assert table["surface_euler_number"].value == 2


@pytest.mark.parametrize("seed", range(8))
def test_surface_and_grid_agree_on_topology(seed):
    grid = random_grid(seed, density=0.2 + 0.08 * seed)
    surface = extract_surface(grid)
    for function in (measures.components, measures.euler_number, measures.genus):
        assert function(surface).value == function(grid).value
        assert function(surface).kind == function(grid).kind == "exact"
    assert euler_number(surface) == 2 * measures.euler_number(grid).value
    assert len(np.unique(pieces(surface))) == measure(surface)["shells"].value


@pytest.mark.parametrize("seed", range(4))
def test_hexahedra_and_grid_agree(seed):
    grid = random_grid(seed, density=0.75)
    mesh = measure(hexahedralize(grid), grid=grid)
    assert mesh["components"].value == measures.components(grid).value
    assert mesh["volume"].value == pytest.approx(measures.volume(grid).value)
    assert mesh["smallest_dihedral_angle"].value == pytest.approx(90)
    assert mesh["smallest_scaled_jacobian"].value == pytest.approx(1)
    assert mesh["smallest_cell_volume"].value == pytest.approx(0.06)
    assert mesh["porosity"].value == pytest.approx(measures.porosity(grid).value)


def test_a_cell_mesh_has_the_euler_number_of_its_solid():
    grid = shell()
    assert measure(hexahedralize(grid))["euler_number"].value == 1


@pytest.mark.parametrize("density", [0.3, 0.6])
@pytest.mark.parametrize("tags", [{}, {"address": None}])
def test_nodes_along_edges_change_nothing(density, tags):
    hexes = hexahedralize(random_grid(5, density=density))
    hexes = replace(hexes, cell_tags={name: np.arange(hexes.cells) for name in tags})
    rows, others = measure(hexes), measure(quadratic(hexes))
    assert [(row.name, row.method) for row in rows] == [(row.name, row.method) for row in others]
    for row, other in zip(rows, others, strict=True):
        assert other.value == pytest.approx(row.value, rel=1e-12)
    assert ("pinched_nodes" in rows) == bool(tags)


def test_pinched_nodes_of_quadratic_cells():
    # Two voids meet in one node, and nowhere else.
    solid = np.ones((4, 4, 4), bool)
    solid[1, 1, 1] = solid[2, 2, 2] = False
    hexes = hexahedralize(VoxelGrid.of_solid(solid, Frame((0, 0, 0), (1, 2, 3), solid.shape)))
    for mesh in (hexes, quadratic(hexes)):
        assert pinched_nodes(VolumeCensus(mesh)).value == 1


def test_genus_of_a_periodic_body_is_refused_and_left_out():
    grid = random_grid(0, periodic=(False, True, False))
    with pytest.raises(GridError, match="cap it"):
        measures.genus(grid)
    assert "genus" not in measure(grid)
    table = measure(extract_surface(grid), grid=grid)
    assert "euler_number" not in table
    assert "shells" in table


def test_caps_across_periodic_axes_are_no_surface():
    fill = np.full((6, 8, 10), 0, np.uint8)
    fill[:, 2:6, 3:8] = 255
    grid = VoxelGrid(Frame((0, 0, 0), (1, 1, 1), fill.shape, (True, False, False)), fill)
    surface = extract_surface(grid, method="voxel-faces")
    table = measure(surface, grid=grid)
    assert table["surface_area"].value == pytest.approx(6 * 2 * (4 + 5))
    assert measures.surface_area(surface).value == pytest.approx(6 * 2 * (4 + 5) + 2 * 4 * 5)
    assert table["volume"].value == pytest.approx(120)


# --- quality -------------------------------------------------------------------------------


def tetrahedron(apex):
    points = np.array([(0, 0, 0), (1, 0, 0), (0.5, math.sqrt(0.75), 0), apex], float)
    return VolumeMesh(points, (Block("tet4", np.array([[0, 1, 2, 3]])),))


def test_a_regular_tetrahedron():
    mesh = tetrahedron((0.5, math.sqrt(3) / 6, math.sqrt(2 / 3)))
    angle = measures.smallest_dihedral_angle(mesh)
    assert angle.value == pytest.approx(math.degrees(math.acos(1 / 3)))
    assert angle.unit == "°"
    assert measures.smallest_scaled_jacobian(mesh).value == pytest.approx(1)
    assert measures.volume(mesh).value == pytest.approx(math.sqrt(2) / 12)
    assert measures.volume(mesh).method == "tetrahedra"


def test_a_flat_tetrahedron_is_bad():
    mesh = tetrahedron((0.5, math.sqrt(3) / 6, 0.01))
    height = math.degrees(math.atan(0.01 / (math.sqrt(3) / 6)))
    assert measures.smallest_dihedral_angle(mesh).value == pytest.approx(height)
    assert 0 < measures.smallest_scaled_jacobian(mesh).value < 0.05


def test_a_tetrahedron_turned_inside_out_is_below_zero():
    assert measures.smallest_scaled_jacobian(tetrahedron((0.5, 0.3, -1))).value < 0


def test_a_sheared_hexahedron():
    points = np.array([(x + z / 2, y, z) for z in (0, 1) for y in (0, 1) for x in (0, 1)], float)
    mesh = VolumeMesh(points, (Block("hex8", np.array([[0, 1, 3, 2, 4, 5, 7, 6]])),))
    assert measures.smallest_scaled_jacobian(mesh).value == pytest.approx(1 / math.sqrt(1.25))
    assert measures.smallest_dihedral_angle(mesh).value == pytest.approx(
        math.degrees(math.atan2(1, 0.5))
    )


def test_meshes_of_several_shapes_and_none():
    hexes = hexahedralize(shell())
    extra = np.array([[20, 0, 0], [21, 0, 0], [20, 1, 0], [20, 0, 1]], float)
    cells = np.arange(4)[None] + len(hexes.points)
    mixed = VolumeMesh(np.concatenate([hexes.points, extra]), (*hexes.blocks, Block("tet4", cells)))
    table = measure(mixed)
    assert table["volume"].method == "cells"
    assert table["volume"].value == pytest.approx(204 + 1 / 6)
    assert table["components"].value == 2
    assert table["euler_number"].value == 2
    with pytest.raises(MeshError, match="no cells"):
        measure(VolumeMesh(np.zeros((0, 3)), ()))
    assert set(SHAPES) >= {"tet4", "hex8"}


# --- models --------------------------------------------------------------------------------


def test_what_a_model_tells():
    model = build(load("menger", set={"model.size": 3.0}))
    table = measure(model)
    assert table["porosity"].value == pytest.approx(1 - (20 / 27) ** 2, rel=1e-15)
    assert table["smallest_feature"].value == pytest.approx(1 / 3)
    assert table["smallest_pore"].value == pytest.approx(1 / 3)
    assert table["similarity_dimension"].value == pytest.approx(math.log(20) / math.log(3))
    assert table["affinity_dimension"].value == table["similarity_dimension"].value
    assert {row.of for row in table} == {"model"}
    assert measures.smallest_feature(model) == table["smallest_feature"]
    assert measures.smallest_pore(model) == table["smallest_pore"]
    assert measures.similarity_dimension(model) == table["similarity_dimension"]
    assert measures.affinity_dimension(model) == table["affinity_dimension"]


def test_what_is_known_of_maps_that_are_no_similarities_are_bounds():
    halves = (np.diag([1 / 2, 1 / 3, 1 / 2]), np.zeros(3))
    other = (np.diag([1 / 2, 1 / 3, 1 / 2]), np.array([1 / 2, 2 / 3, 1 / 2]))
    table = measure(ifs([halves, other], level=2))
    assert "similarity_dimension" not in table
    assert table["affinity_dimension"].spread == "at most"
    assert table["smallest_feature"].value == pytest.approx(1 / 9)
    assert table["smallest_feature"].spread == "at least"


def test_closed_forms_follow_the_grids_periodicity():
    model = build(load("menger"))
    frame = Frame((0, 0, 0), (1 / 9,) * 3, (9, 9, 9), (True, True, True))
    grid = VoxelGrid(frame, np.zeros((9, 9, 9), np.uint8))
    tiled, alone = measure(model, grid=grid), measure(model)
    assert tiled["surface_area"].value < alone["surface_area"].value
    assert tiled["porosity"].value == alone["porosity"].value


def test_the_finest_level_that_can_be_printed():
    model = build(load("menger", set={"model.size": 10.0}))
    assert measures.finest_printable_level(model, feature=1.0).value == 2
    assert measures.finest_printable_level(model, feature=0.2).value == 3
    assert measures.finest_printable_level(model, feature=10 / 27).value == 3
    with pytest.raises(ModelError, match="positive"):
        measures.finest_printable_level(model, feature=-1)
    with pytest.raises(ModelError, match="level 0 is thinner"):
        measures.finest_printable_level(model, feature=11)


def test_what_a_model_does_not_know_is_said():
    maps = [(np.diag([0.5, 0.4, 0.3]), (0, 0, 0)), (np.diag([0.3, 0.4, 0.5]), (0.5, 0.5, 0.5))]
    with pytest.raises(ModelError, match="no similarity"):
        measures.similarity_dimension(ifs(maps, level=2))
    with pytest.raises(ModelError, match="every size"):
        measures.smallest_feature(ifs(maps, level="limit", offset=0.1))
    with pytest.raises(ModelError, match="digit set"):
        measures.smallest_pore(ifs(maps, level=1))


def test_an_exact_boundary_is_named_so_and_exact():
    model = build(load("menger"))
    table = measure(exact_surface(model), model=model)
    exact = measure(model)
    names = ("volume", "surface_area", "porosity", "specific_surface_area", "genus", "components")
    for name in (*names, "euler_number"):
        assert table[name].method == "exact boundary"
        assert table[name].value == pytest.approx(exact[name].value, rel=1e-12)
        assert table[name].uncertainty <= 1e-9 * abs(exact[name].value)


def test_surfaces_that_enclose_nothing_are_refused():
    with pytest.raises(MeshError, match="no triangles"):
        measure(SurfaceMesh(np.zeros((0, 3)), np.zeros((0, 3), int)))
    closed = exact_surface(build(load("menger", set={"model.level": 1})))
    with pytest.raises(MeshError, match="hole"):
        measure(SurfaceMesh(closed.points, closed.triangles[1:]))
    with pytest.raises(MeshError, match="inside out"):
        measure(SurfaceMesh(closed.points, closed.triangles[:, ::-1]))
