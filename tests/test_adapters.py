"""Values handed to other packages keep their phase, their axes and their lengths there."""

import importlib.util
import itertools
import json
import os
from pathlib import Path

import numpy as np
import programs
import pytest
import skfem
from scipy.sparse import coo_array
from scipy.sparse.linalg import spsolve
from skfem.helpers import dot, grad

import porous as po
from porous import adapters
from porous.errors import GridError, GuestError, MeshError
from porous.values import SHAPES, Block, Frame, Part, VolumeMesh, VoxelGrid

SHAPE, SPACING = (3, 4, 5), (0.5, 0.25, 0.4)
LENGTHS = np.array(SHAPE) * SPACING


def noise(shape=(6, 7, 9), spacing=(2.0, 2.0, 2.0), unit="um"):
    rng = np.random.default_rng(4)
    frame = Frame((10, -20, 30), spacing, shape, unit=unit)
    return VoxelGrid(frame, rng.integers(0, 256, shape).astype(np.uint8))


def box_of(shape):
    """Return a box of the elements of a shape, its parts named."""
    frame = Frame((1, 2, 3), SPACING, SHAPE, unit="cm")
    hexes = po.hexahedralize(VoxelGrid.of_solid(np.ones(SHAPE, bool), frame))
    cells = hexes.blocks[0].cells
    cut = {"tet4": TETRAHEDRA, "wed6": WEDGES}.get(SHAPES[shape].linear or shape)
    if cut is not None:
        cells = cells[:, cut].reshape(-1, len(cut[0]))
    points, cells = with_middles(hexes.points, cells, shape)
    mesh = VolumeMesh(points, (Block(shape, cells),), unit="cm")
    return po.name_parts(mesh, frame.box)


def around_the_diagonal():
    """The six tetrahedra about a hexahedron's diagonal from node 0 to node 6."""
    ring = (1, 2, 3, 7, 4, 5)
    return [(0, a, b, 6) for a, b in zip(ring, (*ring[1:], ring[0]), strict=True)]


TETRAHEDRA = around_the_diagonal()
WEDGES = [(0, 1, 2, 4, 5, 6), (0, 2, 3, 4, 6, 7)]


def with_middles(points, cells, shape):
    edges = SHAPES[shape].edges
    if not edges:
        return points, cells
    pairs = np.sort(cells[:, np.array(edges)].reshape(-1, 2), axis=1)
    rows, index = np.unique(pairs, axis=0, return_inverse=True)
    more = index.reshape(len(cells), -1) + len(points)
    return np.concatenate([points, points[rows].mean(axis=1)]), np.hstack([cells, more])


# --- PoreSpy and TauFactor ---------------------------------------------------------------------


def test_porespy_gets_pores_as_true_and_metres():
    grid = noise()
    im, size = po.to_porespy(grid)
    assert im.dtype == bool
    assert im.shape == grid.frame.shape
    assert np.array_equal(im, grid.fill < 128)
    assert size == pytest.approx(2e-6)


def test_porespy_gets_no_bricks():
    with pytest.raises(GridError, match=r"voxels of 2 × 2 × 3 um; .* wanted cubic = true"):
        po.to_porespy(noise(spacing=(2, 2, 3)))


def test_porespy_finds_our_porosity_along_each_axis(tmp_path):
    python = os.environ.get("POROUS_PORESPY")
    if not python:
        pytest.skip("POROUS_PORESPY names no Python that has PoreSpy")
    np.savez(tmp_path / "im.npz", im=po.to_porespy(noise()).im)
    judge = Path(__file__).parent / "judges" / "porespy_judge.py"
    printed, _ = programs.said([python, judge, tmp_path / "im.npz"], tmp_path, seconds=120)
    said = json.loads(printed.splitlines()[-1])
    void = noise().fill < 128
    assert said["porosity"] == pytest.approx(void.mean(), abs=1e-12)
    for axis in range(3):
        others = tuple(i for i in range(3) if i != axis)
        assert said["profiles"][axis] == pytest.approx(void.mean(axis=others).tolist())


def effective_diffusivity(image, spacing):
    """Return D_eff/D along the first axis, as TauFactor defines it.

    One unknown in the middle of each voxel that is 1; walls at c = 0 and 1 half a voxel outside;
    no flux through zeros and through the sides.
    """
    number = np.full(image.shape, -1)
    number[image == 1] = np.arange((image == 1).sum())
    rows, columns, values, right = [], [], [], np.zeros((image == 1).sum())
    area = np.prod(spacing) / np.array(spacing)
    for axis in range(3):
        a, b = (np.take(number, range(s, number.shape[axis] - 1 + s), axis) for s in (0, 1))
        both = (a >= 0) & (b >= 0)
        a, b, g = a[both], b[both], area[axis] / spacing[axis]
        rows += [a, b, a, b]
        columns += [a, b, b, a]
        values += [np.full(len(a), v) for v in (g, g, -g, -g)]
    g = 2 * area[0] / spacing[0]
    for end, value in ((number[0], 0.0), (number[-1], 1.0)):
        open_ = end[end >= 0]
        rows, columns, values = [*rows, open_], [*columns, open_], [*values, np.full(len(open_), g)]
        right[open_] += g * value
    n = len(right)
    matrix = coo_array(
        (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=(n, n)
    ).tocsr()
    concentration = spsolve(matrix, right)
    flux = g * (concentration[number[0][number[0] >= 0]]).sum()
    section = area[0] * image.shape[1] * image.shape[2]
    return flux * image.shape[0] * spacing[0] / section


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_taufactor_gets_conducting_pores_with_the_flux_along_the_first_axis(axis):
    """TauFactor itself brings gigabytes of CUDA; its convention is solved here instead."""
    along = "xyz".index(axis)
    solid = np.ones((4, 5, 6), bool)
    channel = [slice(1, 3), slice(1, 4), slice(2, 5)]
    channel[along] = slice(None)
    solid[tuple(channel)] = False
    grid = VoxelGrid.of_solid(solid, Frame((0, 0, 0), (0.5, 1.0, 3.0), solid.shape))
    img, spacing = po.to_taufactor(grid, axis)
    assert img.dtype == np.uint8
    assert img.flags.c_contiguous
    assert set(np.unique(img)) == {0, 1}
    assert spacing[0] == grid.frame.spacing[along]
    assert effective_diffusivity(img, spacing) == pytest.approx(1 - solid.mean())
    for other in set("xyz") - {axis}:
        blocked, _ = po.to_taufactor(grid, other)
        assert not blocked[0].any()


def test_taufactor_gets_a_narrowing_that_slows_diffusion():
    solid = np.zeros((6, 4, 2), bool)
    solid[2:4, 1:, :] = True  # a quarter of the section stays open over a third of the way
    grid = VoxelGrid.of_solid(solid, Frame((0, 0, 0), (1, 1, 1), solid.shape))
    img, spacing = po.to_taufactor(grid)
    found = effective_diffusivity(img, spacing)
    # Bounds of one-dimensional bundles (cut by insulators) and layers (short-circuited).
    assert 0.25 < found < 1 / (2 / 3 + (1 / 3) / 0.25)
    turned = VoxelGrid.of_solid(np.moveaxis(solid, 0, 2), Frame((0, 0, 0), (1, 1, 1), (4, 2, 6)))
    assert effective_diffusivity(*po.to_taufactor(turned, "z")) == pytest.approx(found)


def test_taufactor_has_three_axes():
    with pytest.raises(GridError, match="got axis 'w'; wanted x, y or z"):
        po.to_taufactor(noise(), "w")


# --- trimesh and PyVista -----------------------------------------------------------------------


def ball():
    import trimesh

    mesh = trimesh.creation.icosphere(subdivisions=2)
    labels = (np.arange(len(mesh.faces)) % 3).astype(np.int16)
    return po.SurfaceMesh(mesh.vertices * (1, 2, 3), mesh.faces, "um", labels, ("A", "B", "C"))


def test_trimesh_gets_points_parts_and_unit():
    surface = ball()
    mesh = po.to_trimesh(surface)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume == pytest.approx(surface.volume)
    assert np.array_equal(mesh.vertices, surface.points)
    assert np.array_equal(mesh.face_attributes["part"], surface.labels)
    assert mesh.metadata["parts"] == ["A", "B", "C"]
    mesh.convert_units("millimeters")
    assert mesh.volume == pytest.approx(surface.volume * 1e-9)


@pytest.mark.parametrize("unit", ["nm", "um", "mm", "cm", "m", "in"])
def test_trimesh_knows_each_unit(unit):
    mesh = po.to_trimesh(po.SurfaceMesh(ball().points, ball().triangles, unit))
    mesh.convert_units("meters")
    ratio = po.values.units.METRES[unit]
    assert mesh.bounds[1] == pytest.approx(np.array([1, 2, 3]) * ratio)


def test_pyvista_gets_voxels_where_they_are():
    grid = noise(spacing=(1, 2, 3))
    image = po.to_pyvista(grid)
    assert image.bounds == pytest.approx((10, 16, -20, -6, 30, 57))
    assert image.field_data["unit"][0] == "um"
    where = (11.5, -20 + 2 * 4.5, 30 + 3 * 7.5)
    assert image.cell_data["fill"][image.find_containing_cell(where)] == grid.fill[1, 4, 7]
    solid = image.threshold(127.5, scalars="fill")
    assert solid.volume == pytest.approx(grid.solid.sum() * 6)


def test_pyvista_gets_the_bulk_too():
    grid = noise()
    other = VoxelGrid(grid.frame, grid.fill, 255 - grid.fill)
    assert np.array_equal(po.to_pyvista(other).cell_data["bulk"], 255 - grid.fill.ravel("F"))


def test_pyvista_gets_surfaces_with_parts():
    poly = po.to_pyvista(ball())
    assert poly.volume == pytest.approx(ball().volume)
    assert np.array_equal(poly.cell_data["part"], ball().labels)
    assert list(poly.field_data["parts"]) == ["A", "B", "C"]
    assert poly.n_open_edges == 0


@pytest.mark.parametrize("shape", SHAPES)
def test_pyvista_gets_volume_meshes_with_parts(shape):
    mesh = box_of(shape)
    grid = po.to_pyvista(mesh)
    sizes = grid.compute_cell_sizes(length=False, area=False)
    assert np.abs(sizes.cell_data["Volume"]) == pytest.approx(mesh.volumes)
    skin = grid.extract_surface(algorithm="dataset_surface", nonlinear_subdivision=0)
    assert skin.volume == pytest.approx(np.prod(LENGTHS))
    normals = skin.compute_normals(
        point_normals=False, auto_orient_normals=False, consistent_normals=False
    ).cell_data["Normals"]
    assert (np.einsum("ij,ij->i", normals, skin.cell_centers().points - grid.center) > 0).all()
    low = grid.points[grid.point_data["XMIN"] == 1]
    assert low[:, 0] == pytest.approx(1)
    assert len(low) == len(mesh.parts["XMIN"].members) > 0
    assert np.array_equal(grid.field_data["XMIN_FACES"], mesh.parts["XMIN_FACES"].members)
    assert grid.field_data["unit"][0] == "cm"


def test_pyvista_gets_tags_and_parts_of_cells_of_several_shapes():
    hexes, wedges = box_of("hex8"), box_of("wed6")
    blocks = (hexes.blocks[0], Block("wed6", wedges.blocks[0].cells))
    tags = {"phase": np.arange(hexes.cells + wedges.cells)}
    mesh = VolumeMesh(hexes.points, blocks, tags, {"SOLID": Part("cells", np.array([0, 61]))})
    grid = po.to_pyvista(mesh)
    assert np.flatnonzero(grid.cell_data["SOLID"]).tolist() == [0, 61]
    assert np.array_equal(grid.cell_data["phase"], tags["phase"])
    assert set(grid.celltypes) == {12, 13}


def test_pyvista_gets_no_lists():
    with pytest.raises(TypeError, match="got a list; wanted VoxelGrid"):
        po.to_pyvista([1])


# --- scikit-fem --------------------------------------------------------------------------------


@skfem.BilinearForm
def conduction(u, v, _):
    return dot(grad(u), grad(v))


@skfem.Functional
def one(w):
    return 0 * w.x[0] + 1


def basis_of(mesh, shape):
    """Return a basis; wedges get a rule of their own, for scikit-fem's weights are too small."""
    if shape != "wed6":
        return skfem.Basis(mesh, ELEMENTS[shape]())
    (line, along), (triangle, across) = (
        skfem.quadrature.get_quadrature(kind, 4)
        for kind in (skfem.refdom.RefLine, skfem.refdom.RefTri)
    )
    places = [(*point, height) for point in triangle.T for height in line[0]]
    rule = np.array(places).T, np.outer(across, along).ravel()
    return skfem.Basis(mesh, skfem.ElementWedge1(), quadrature=rule)


ELEMENTS = {
    "tet4": skfem.ElementTetP1,
    "tet10": skfem.ElementTetP2,
    "hex8": skfem.ElementHex1,
    "hex20": skfem.ElementHex2,
    "wed6": skfem.ElementWedge1,
}


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_skfem_solves_the_same_laplace_problem_on_every_kind_of_mesh(shape, axis):
    mesh = box_of(shape)
    basis = basis_of(po.to_skfem(mesh), shape)
    assert one.assemble(basis) == pytest.approx(np.prod(LENGTHS))
    names = [f"{'XYZ'[axis]}{end}_FACES" for end in ("MIN", "MAX")]
    low, high = (basis.get_dofs(name) for name in names)
    u = basis.zeros()
    u[high] = 1.0
    stiffness = conduction.assemble(basis)
    u = skfem.solve(*skfem.condense(stiffness, x=u, D=np.union1d(low.all(), high.all())))
    section = np.prod(LENGTHS) / LENGTHS[axis]
    assert u @ stiffness @ u == pytest.approx(section / LENGTHS[axis])


@pytest.mark.parametrize("shape", ["tet4", "tet10", "hex8", "hex20"])
def test_skfem_gets_boundaries_of_the_right_area(shape):
    theirs = po.to_skfem(box_of(shape))
    for axis, end in itertools.product(range(3), ("MIN", "MAX")):
        name = f"{'XYZ'[axis]}{end}_FACES"
        basis = skfem.FacetBasis(theirs, ELEMENTS[shape](), facets=theirs.boundaries[name])
        assert one.assemble(basis) == pytest.approx(np.prod(LENGTHS) / LENGTHS[axis])


def test_skfem_gets_subdomains():
    mesh = box_of("hex8")
    members = np.array([3, 17, 59])
    named = VolumeMesh(mesh.points, mesh.blocks, {}, {"SOME": Part("cells", members)})
    theirs = po.to_skfem(named)
    basis = skfem.Basis(theirs, skfem.ElementHex1(), elements="SOME")
    assert one.assemble(basis) == pytest.approx(3 * np.prod(SPACING))
    centre = mesh.points[mesh.blocks[0].cells[members]].mean(axis=1)
    found = theirs.p[:, theirs.t[:, members]].mean(axis=1).T
    assert found == pytest.approx(centre)


def serendipity(nodes, places):
    """Return where places (n, 3) of [−1, 1]³ lie in a hexahedron of 20 nodes."""
    corners = np.array(
        [
            *((-1, -1, -1), (1, -1, -1), (1, 1, -1), (-1, 1, -1)),
            *((-1, -1, 1), (1, -1, 1), (1, 1, 1), (-1, 1, 1)),
        ]
    )
    middles = np.array([(corners[a] + corners[b]) / 2 for a, b in SHAPES["hex20"].edges])
    total = 0
    for own, node in zip(np.concatenate([corners, middles]), nodes, strict=True):
        terms = 1 + places * own
        if own.all():
            weight = terms.prod(axis=1) * ((places * own).sum(axis=1) - 2) / 8
        else:
            weight = (1 - (places**2)[:, own == 0][:, 0]) * terms.prod(axis=1) / 4
        total = total + weight[:, None] * node
    return total


def test_skfem_bends_hexahedra_of_twenty_nodes_as_they_are_bent():
    mesh = box_of("hex20")
    rng = np.random.default_rng(7)
    points = mesh.points + rng.uniform(-0.04, 0.04, mesh.points.shape)
    theirs = po.to_skfem(VolumeMesh(points, mesh.blocks))
    places = rng.uniform(0, 1, (3, 9))
    found = theirs.mapping().F(places)
    for cell, nodes in enumerate(mesh.blocks[0].cells):
        expected = serendipity(points[nodes], 2 * places.T - 1)
        assert np.allclose(found[:, cell].T, expected, rtol=0, atol=1e-12)


def test_skfem_bends_tetrahedra_of_ten_nodes_as_they_are_bent():
    mesh = box_of("tet10")
    rng = np.random.default_rng(8)
    points = mesh.points + rng.uniform(-0.02, 0.02, mesh.points.shape)
    theirs = po.to_skfem(VolumeMesh(points, mesh.blocks))
    x, y, z = places = rng.dirichlet((1, 1, 1, 1), 9)[:, :3].T
    lot = np.stack([1 - x - y - z, x, y, z])
    weights = [s * (2 * s - 1) for s in lot]
    weights += [4 * lot[a] * lot[b] for a, b in SHAPES["tet10"].edges]
    found = theirs.mapping().F(places)
    expected = np.einsum("kq,ekd->deq", np.array(weights), points[mesh.blocks[0].cells])
    assert found == pytest.approx(expected, abs=1e-12)


def test_skfem_gets_one_shape_and_only_nodes_that_cells_have():
    hexes, wedges = box_of("hex8"), box_of("wed6")
    both = VolumeMesh(hexes.points, (hexes.blocks[0], wedges.blocks[0]))
    with pytest.raises(MeshError, match="got elements hex8, wed6; wanted one shape"):
        po.to_skfem(both)
    with pytest.raises(MeshError, match="got elements none"):
        po.to_skfem(VolumeMesh(np.zeros((1, 3)), ()))
    more = np.concatenate([np.full((2, 3), 99.0), hexes.points])
    moved = VolumeMesh(more, (Block("hex8", hexes.blocks[0].cells + 2),))
    assert np.array_equal(po.to_skfem(moved).p, hexes.points.T)


@pytest.mark.parametrize(
    ("name", "module", "package"),
    [
        ("to_trimesh", "trimesh", "trimesh"),
        ("to_pyvista", "pyvista", "pyvista"),
        ("to_skfem", "skfem", "scikit-fem"),
    ],
)
def test_a_package_that_is_not_there_is_named(monkeypatch, name, module, package):
    surface = ball()
    find = importlib.util.find_spec
    monkeypatch.setattr(adapters, "find_spec", lambda one: None if one == module else find(one))
    with pytest.raises(GuestError, match=f"{package} is not installed; wanted pip install"):
        getattr(po, name)(surface)


@pytest.mark.parametrize(
    ("adapter", "kind", "maker"),
    [
        ("to_porespy", "VoxelGrid", r"voxelize\("),
        ("to_taufactor", "VoxelGrid", r"voxelize\("),
        ("to_trimesh", "SurfaceMesh", r"extract_surface\(grid\)"),
        ("to_skfem", "VolumeMesh", r"hexahedralize\(grid\)"),
    ],
)
def test_values_of_another_kind_are_refused_in_one_line(adapter, kind, maker):
    grid = noise()
    others = {
        "VoxelGrid": grid,
        "SurfaceMesh": po.extract_surface(grid),
        "VolumeMesh": po.hexahedralize(grid),
        "dict": {},
    }
    for name, value in others.items():
        if name != kind:
            words = rf"^{adapter}: got a {name}; wanted a {kind}: {maker}.* makes one$"
            with pytest.raises(TypeError, match=words):
                getattr(po, adapter)(value)
    with pytest.raises(TypeError, match=r"^to_pyvista: got a dict; wanted VoxelGrid, SurfaceMesh"):
        po.to_pyvista({})
