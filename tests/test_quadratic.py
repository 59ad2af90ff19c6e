"""Elements with a node in the middle of every edge: numbers, parts, and a solver's patch test."""

import warnings

import meshio
import naive_boundary as naive
import numpy as np
import pytest
import pyvista
import skfem
import systems
from skfem.helpers import dot, grad
from skfem.io.meshio import from_meshio

from porous import formats
from porous.errors import MemoryLimitError, MeshError
from porous.stages import hexahedralize, name_parts, periodic_pairs, quadratic
from porous.values import SHAPES, Block, Box, Frame, Part, VolumeMesh, VoxelGrid
from porous.values.volume_topology import boundary_faces, hung_by_faces, nodes_of

SPACING = (0.5, 0.25, 2.0)


def voxels(solid):
    frame = Frame((1.0, -2.0, 3.0), SPACING, solid.shape, unit="um")
    return hexahedralize(VoxelGrid.of_solid(solid, frame))


def tetrahedra(solid):
    mesh = voxels(solid)
    steps = [(1, 2), (2, 3), (3, 7), (7, 4), (4, 5), (5, 1)]
    tets = [mesh.blocks[0].cells[:, [0, a, b, 6]] for a, b in steps]
    return VolumeMesh(mesh.points, (Block("tet4", np.concatenate(tets)),), unit="um")


MENGER = naive.prefractal(3, systems.MENGER, 1)


@pytest.mark.parametrize("make", [voxels, tetrahedra])
def test_each_edge_has_one_node_in_its_middle(make):
    mesh = make(MENGER)
    result = quadratic(mesh)
    (block,) = result.blocks
    shape = SHAPES[block.shape]
    assert shape.linear == mesh.blocks[0].shape
    ends = mesh.blocks[0].cells[:, shape.edges]
    assert np.array_equal(block.cells[:, : -len(shape.edges)], mesh.blocks[0].cells)
    middles = block.cells[:, -len(shape.edges) :]
    assert np.allclose(result.points[middles], mesh.points[ends].mean(axis=2))
    edges = {frozenset(e) for e in ends.reshape(-1, 2).tolist()}
    assert len(result.points) == len(mesh.points) + len(edges)
    assert len(np.unique(middles)) == len(edges)
    assert np.array_equal(result.points[: len(mesh.points)], mesh.points)
    assert np.allclose(result.volumes, mesh.volumes)
    assert result.unit == "um"


def test_sides_gain_the_middles_that_lie_in_them():
    shape = (2, 3, 4)
    mesh = voxels(np.ones(shape, bool))
    named = name_parts(mesh, Box.of_points(mesh.points))
    result = quadratic(named)
    for axis in range(3):
        a, b = (n for i, n in enumerate(shape) if i != axis)
        for side in (f"{'XYZ'[axis]}MIN", f"{'XYZ'[axis]}MAX"):
            members = result.parts[side].members
            assert len(np.unique(members)) == len(members)
            assert len(members) == (a + 1) * (b + 1) + a * (b + 1) + b * (a + 1)
            assert len(np.unique(result.points[members, axis])) == 1
            faces = result.parts[f"{side}_FACES"]
            assert faces == named.parts[f"{side}_FACES"]
            assert np.isin(nodes_of(result, faces.members), members).all()
    assert result.parts["SOLID"] == named.parts["SOLID"]


def test_a_part_of_nodes_alone_gains_where_whole_faces_lie_in_it():
    mesh = voxels(np.ones((2, 1, 1), bool))
    corners = boundary_faces(mesh)
    face = nodes_of(mesh, corners[:1])[0]
    parts = {
        "FACE": Part("nodes", face),
        "EDGE": Part("nodes", face[:2]),
        "NONE": Part("nodes", np.zeros(0, np.int64)),
    }
    result = quadratic(VolumeMesh(mesh.points, mesh.blocks, {"body": [0, 1]}, parts))
    assert {name: len(part.members) for name, part in result.parts.items()} == {
        "FACE": 8,
        "EDGE": 2,
        "NONE": 0,
    }
    assert result.cell_tags["body"].tolist() == [0, 1]


def test_bodies_that_do_not_touch_in_a_face_share_nothing():
    solid = np.zeros((2, 2, 2), bool)
    solid[0, 0, 0] = solid[1, 1, 0] = True
    result = quadratic(voxels(solid))
    assert len(result.points) == 2 * 20


def test_mixed_shapes_share_the_middles_of_common_edges():
    hexes = voxels(np.ones((1, 1, 2), bool))
    points = np.vstack([hexes.points, [9, 9, 9]])
    tet = Block("tet4", np.array([[*hexes.blocks[0].cells[1][[4, 5, 6]], len(points) - 1]]))
    result = quadratic(VolumeMesh(points, (*hexes.blocks, tet)))
    assert [block.shape for block in result.blocks] == ["hex20", "tet10"]
    assert len(result.points) == 12 + 20 + 1 + 3 + 1  # 20 edges of two boxes, 3 + 1 of the tet
    with pytest.raises(MeshError, match="got cells of shape hex20; wanted tet4 or hex8"):
        quadratic(result)


def test_wedges_are_refused():
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [0, 1, 1.0]])
    with pytest.raises(MeshError, match="wed6"):
        quadratic(VolumeMesh(points, (Block("wed6", np.arange(6)[None]),)))


def test_memory_is_asked_for_first(monkeypatch):
    mesh = voxels(np.ones((2, 3, 4), bool))
    monkeypatch.setattr("porous.memory.available", lambda: 1000)
    with pytest.raises(MemoryLimitError, match="288 edges"):
        quadratic(mesh)


def test_a_mesh_without_cells_stays_one():
    nothing = VolumeMesh(np.zeros((0, 3)), ())
    assert quadratic(nothing) == nothing


@skfem.BilinearForm
def laplace(u, v, _):
    return dot(grad(u), grad(v))


def energy(mesh, kind):
    """Return volume and ∫|∇u|² with u = 0 and 1 on the ends along x, in scikit-fem."""
    theirs = from_meshio(meshio.Mesh(mesh.points, [(kind, mesh.blocks[0].cells)]))
    element = {"tetra": skfem.ElementTetP1, "tetra10": skfem.ElementTetP2}[kind]()
    basis = skfem.Basis(theirs, element)
    volume = skfem.Functional(lambda w: 1.0 + 0 * w.x[0]).assemble(basis)
    stiffness = laplace.assemble(basis)
    x = basis.doflocs[0]
    ends = np.isclose(x, x.min()) | np.isclose(x, x.max())
    u = np.where(np.isclose(x, x.max()), 1.0, 0.0)
    u = skfem.solve(*skfem.condense(stiffness, np.zeros(len(x)), x=u, D=np.flatnonzero(ends)))
    exact = (x - x.min()) / np.ptp(x)
    return volume, u @ stiffness @ u, np.abs(u - exact).max()


def test_a_solver_takes_quadratic_tetrahedra():
    full = tetrahedra(np.ones((2, 3, 2), bool))
    volume, work, error = energy(quadratic(full), "tetra10")
    assert volume == pytest.approx(full.volumes.sum())
    assert error < 1e-12  # the patch test: a linear field is exact
    assert work == pytest.approx(0.75 * 4 / 1.0)  # area / length
    pierced = tetrahedra(MENGER)
    linear, curved = energy(pierced, "tetra"), energy(quadratic(pierced), "tetra10")
    assert curved[0] == pytest.approx(linear[0])
    assert 0.9 < curved[1] / linear[1] < 0.9999  # a larger space has less energy


def test_hexahedra_of_twenty_nodes_interpolate_quadratics():
    """Serendipity functions of the 20 nodes, in Abaqus' order, are exact for x² and its kin."""
    mesh = quadratic(voxels(np.ones((1, 1, 1), bool)))
    nodes = mesh.points[mesh.blocks[0].cells[0]]
    local = 2 * (nodes - nodes[0]) / SPACING - 1
    rng = np.random.default_rng(2)
    at = rng.uniform(-1, 1, (7, 3))
    values = np.array([serendipity(node, at) for node in local])
    assert np.allclose(values.sum(axis=0), 1)
    for power in ([0, 0, 2], [1, 1, 0], [2, 1, 0], [1, 1, 1], [1, 0, 0]):
        assert np.allclose(values.T @ (local**power).prod(axis=1), (at**power).prod(axis=1))
    assert np.allclose(np.array([serendipity(node, local) for node in local]), np.eye(20))


def serendipity(node, at):
    """Return a node's shape function at points: Zienkiewicz' quadratic brick."""
    n = at * node
    if np.count_nonzero(np.isclose(node, 0)):
        free = np.isclose(node, 0)
        return (1 - at[:, free][:, 0] ** 2) * (1 + n[:, ~free]).prod(axis=1) / 4
    return (1 + n).prod(axis=1) * (n.sum(axis=1) - 2) / 8


def test_hung_meshes_keep_their_bodies():
    mesh = hung_by_faces(tetrahedra(MENGER))
    assert len(quadratic(mesh).points) == len(quadratic(tetrahedra(MENGER)).points)


@pytest.mark.parametrize("make", [voxels, tetrahedra])
def test_files_of_vtk_hold_them_and_their_pairs(tmp_path, make):
    mesh = make(np.ones((2, 3, 2), bool))
    mesh = quadratic(periodic_pairs(name_parts(mesh, Box.of_points(mesh.points))))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        formats.write(mesh, tmp_path / "quadratic.vtu")
        assert formats.read(tmp_path / "quadratic.vtu") == mesh
    theirs = pyvista.read(tmp_path / "quadratic.vtu")
    kind = SHAPES[mesh.blocks[0].shape].vtk
    assert set(theirs.celltypes.tolist()) == {kind}
    # VTK's own order of nodes: its shape functions put each cell's middle where it is.
    assert theirs.compute_cell_sizes().cell_data["Volume"].sum() == pytest.approx(
        mesh.volumes.sum()
    )
    pairs = theirs.field_data["pairs:XPAIRS"]
    assert np.allclose(np.ptp(theirs.points[pairs], axis=1), [2 * SPACING[0], 0, 0])
