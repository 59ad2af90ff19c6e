"""Coarse meshes of hexahedra: the value, and files of others from which it comes."""

import pickle
import re
from pathlib import Path

import meshio
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from porous import formats
from porous.cli import main
from porous.errors import FormatError, FormatWarning, MeshError
from porous.values import Block, HexMesh, VolumeMesh

CORNERS = np.array(
    [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]]
)
"""A cube's corners in VTK's order."""


def brick(shape=(2, 3, 4), spacing=(1.0, 0.5, 0.25), *, seed=0):
    """Return hexahedra in a brick whose inner and outer points are moved a little."""
    counts = np.array(shape) + 1
    lattice = np.stack(np.indices(counts), axis=-1).reshape(-1, 3)
    rng = np.random.default_rng(seed)
    points = (lattice + rng.uniform(-0.1, 0.1, lattice.shape)) * spacing
    cells = np.stack(np.indices(shape), axis=-1).reshape(-1, 1, 3) + CORNERS
    return HexMesh(points, np.ravel_multi_index(np.moveaxis(cells, -1, 0), counts))


def cubes(mesh):
    """Return each cell's corner coordinates: what does not depend on how points are numbered."""
    return mesh.points[mesh.hexahedra]


# --- the value ---------------------------------------------------------------------------------


def test_a_mesh_is_a_value():
    mesh = brick()
    assert mesh == pickle.loads(pickle.dumps(mesh)) == HexMesh(mesh.points, mesh.hexahedra)
    assert mesh != brick(seed=1)
    assert not mesh.points.flags.writeable
    assert (mesh.points.dtype, mesh.hexahedra.dtype) == (np.float64, np.int64)


@pytest.mark.parametrize(
    ("points", "cells", "said"),
    [
        (CORNERS, np.zeros((0, 8), int), "no hexahedra; wanted at least one"),
        (CORNERS, [[0, 1, 2, 3, 4, 5, 6]], r"hexahedra: got shape \(1, 7\); wanted \(n, 8\)"),
        (CORNERS, [[0, 1, 2, 3, 4, 5, 6, 8]], "run from 0 to 8; there are 8 points"),
        (CORNERS, [[0, 1, 2, 3, 4, 5, 6, -1]], "run from -1 to 6"),
        (
            CORNERS,
            [list(range(8)), [0, 1, 2, 3, 4, 5, 6, 2]],
            r"hexahedron 1: got corners \[0, .* 2\];",
        ),
        (CORNERS, [[0.0, 1, 2, 3, 4, 5, 6, 7]], "hexahedra: got float64; wanted whole numbers"),
        (CORNERS[:, :2], [range(8)], r"points: got shape \(8, 2\); wanted \(n, 3\)"),
        (np.where(CORNERS == 0, np.nan, 1), [range(8)], "point 0 is .*nan"),
        (np.where(CORNERS == 0, np.inf, 1), [range(8)], "point 0 is .*inf"),
    ],
)
def test_what_is_no_mesh_is_refused(points, cells, said):
    with pytest.raises(MeshError, match=said):
        HexMesh(points, np.array(cells))


def test_the_hexahedra_of_a_volume_mesh():
    mesh = brick()
    lonely = np.concatenate([[[9.0, 9, 9]], mesh.points, [[7.0, 7, 7]]])
    blocks = (Block("hex8", mesh.hexahedra[:5] + 1), Block("hex8", mesh.hexahedra[5:] + 1))
    volume = VolumeMesh(lonely, (*blocks, Block("tet4", np.zeros((0, 4), int))), unit="cm")
    assert HexMesh.of_volume(volume) == mesh


def test_a_volume_mesh_with_other_cells_has_no_hexahedral_mesh():
    tets = Block("tet4", np.array([[0, 1, 2, 4], [1, 2, 3, 4]]))
    with pytest.raises(MeshError, match=r"got 2 tet4; wanted hexahedra \(hex8\) only"):
        HexMesh.of_volume(VolumeMesh(CORNERS, (tets, Block("hex8", np.arange(8)[None]))))
    with pytest.raises(MeshError, match="no hexahedra"):
        HexMesh.of_volume(VolumeMesh(CORNERS, ()))


# --- files that Gmsh made ----------------------------------------------------------------------

GMSH = Path(__file__).parent / "gmsh"
BENT = ("hexahedra-27.msh",)
STRAIGHT = ("text-2.msh", "binary-2.msh", "text-4.msh", "binary-4.msh", "parametric-4.msh")
STRAIGHT += ("groups.msh", "bricks.inp", "hexahedra-20.inp", "hexahedra-20.msh")


def expected_bricks():
    """Return the corner sets of the two bricks' cells, as ``gmsh/make.py`` divides them."""
    sides = [np.array([0, 2, 3]), np.linspace(0, 3, 3), np.linspace(0, 1, 4)]
    at = [np.stack([side[:-1], side[1:]], axis=1) for side in sides]
    return {
        tuple(sorted((x, y, round(z, 9)) for x in a for y in b for z in c))
        for a in at[0].tolist()
        for b in at[1].tolist()
        for c in at[2].tolist()
    }


def found_bricks(mesh):
    return {tuple(sorted(map(tuple, cell.round(9).tolist()))) for cell in cubes(mesh)}


@pytest.mark.parametrize("name", STRAIGHT + BENT)
@pytest.mark.filterwarnings("ignore:.*are read by their corners:porous.errors.FormatWarning")
@pytest.mark.filterwarnings("ignore:.*1 parts select nothing.*X_MIN$:porous.errors.FormatWarning")
def test_bricks_of_gmsh(name):
    volume = formats.read(GMSH / name)
    mesh = HexMesh.of_volume(volume)
    assert (len(mesh.points), len(mesh.hexahedra)) == (36, 12)
    assert found_bricks(mesh) == expected_bricks()
    assert volume.volumes == pytest.approx(np.where(cubes(mesh)[..., 0].max(axis=1) > 2, 0.5, 1.0))


@pytest.mark.parametrize("name", BENT)
def test_curved_hexahedra_are_read_by_their_corners_and_it_is_said(name):
    with pytest.warns(FormatWarning, match="12 hexahedra of more than 8 nodes are read by their c"):
        formats.read(GMSH / name)


def test_curved_tetrahedra_of_gmsh_have_their_midpoints_in_our_order():
    mesh = formats.read(GMSH / "tetrahedra-10.msh")
    assert mesh.volumes.sum() == pytest.approx(9.0)
    corners = mesh.points[mesh.blocks[0].cells]
    for middle, (a, b) in enumerate(((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)), 4):
        assert corners[:, middle] == pytest.approx((corners[:, a] + corners[:, b]) / 2)
    with pytest.raises(MeshError, match="got 72 tet10; wanted hexahedra"):
        HexMesh.of_volume(mesh)


@pytest.mark.parametrize("name", ["prisms.msh", "prisms-2.msh"])
def test_prisms_of_gmsh_are_wedges_and_no_hexahedra(name):
    mesh = formats.read(GMSH / name)
    assert [(block.shape, len(block.cells)) for block in mesh.blocks] == [("wed6", 24)]
    assert np.sort(mesh.volumes) == pytest.approx(np.repeat([0.25, 0.5], 12))
    with pytest.raises(MeshError, match="got 24 wed6; wanted hexahedra"):
        HexMesh.of_volume(mesh)


# --- files that meshio makes -------------------------------------------------------------------

WRITERS = {
    "gmsh22, text": (".msh", {"file_format": "gmsh22", "binary": False}),
    "gmsh22, binary": (".msh", {"file_format": "gmsh22", "binary": True}),
    "gmsh, text": (".msh", {"file_format": "gmsh", "binary": False}),
    "gmsh, binary": (".msh", {"file_format": "gmsh", "binary": True}),
    "abaqus": (".inp", {"file_format": "abaqus"}),
    "vtu, text": (".vtu", {"file_format": "vtu", "binary": False}),
    "vtu, packed": (".vtu", {"file_format": "vtu", "binary": True}),
    "vtu, unpacked": (".vtu", {"file_format": "vtu", "binary": True, "compression": None}),
}


@st.composite
def meshes(draw):
    """Return hexahedra with points that no cell uses, in any order, and quadrangles before."""
    mesh = brick(draw(st.tuples(*[st.integers(1, 3)] * 3)), seed=draw(st.integers(0, 99)))
    order = draw(st.permutations(range(len(mesh.points) + 2)))
    points = np.zeros((len(order), 3))
    points[order[2:]] = mesh.points
    cells = np.array(order[2:])[mesh.hexahedra]
    return mesh, meshio.Mesh(points, [("quad", cells[:2, :4]), ("hexahedron", cells)])


@pytest.mark.parametrize("name", WRITERS)
@given(pair=meshes())
@settings(max_examples=15)
def test_hexahedra_of_meshio(tmp_path_factory, name, pair):
    suffix, options = WRITERS[name]
    mesh, theirs = pair
    path = tmp_path_factory.mktemp("meshio") / f"theirs{suffix}"
    if options["file_format"] == "gmsh":  # it wants to be told of what entities quadrangles are
        theirs.cells = theirs.cells[1:]
    theirs.write(path, **options)
    ours = HexMesh.of_volume(formats.read(path))
    assert len(ours.points) == len(mesh.points)
    assert cubes(ours) == pytest.approx(cubes(mesh), rel=0, abs=1e-10)  # text has eleven digits


@pytest.mark.parametrize(
    ("name", "nodes"),
    [(name, nodes) for name in WRITERS for nodes in (20, 27) if (name, nodes) != ("abaqus", 27)],
)
def test_curved_hexahedra_of_meshio(tmp_path, name, nodes):
    suffix, options = WRITERS[name]
    rng = np.random.default_rng(nodes)
    points = np.concatenate([CORNERS * [1.0, 2, 3], rng.uniform(0, 1, (nodes - 8, 3))])
    cells = [(f"hexahedron{nodes}", np.arange(nodes)[None])]
    meshio.Mesh(points, cells).write(tmp_path / f"theirs{suffix}", **options)
    if nodes == 20:
        mesh = formats.read(tmp_path / f"theirs{suffix}")
        assert mesh.blocks == (Block("hex20", np.arange(20)[None]),)
        ours = HexMesh.of_volume(mesh)
    else:
        with pytest.warns(FormatWarning, match="1 hexahedra of more than 8 nodes"):
            ours = HexMesh.of_volume(formats.read(tmp_path / f"theirs{suffix}"))
    assert ours == HexMesh(points[:8], np.arange(8)[None])


@pytest.mark.parametrize("name", [name for name in WRITERS if not name.startswith("vtu")])
def test_wedges_of_meshio(tmp_path, name):
    """meshio leaves the order of nodes as it is, and only VTK's is another one."""
    suffix, options = WRITERS[name]
    wedge = np.array([[0, 1, 3, 4, 5, 7]])
    meshio.Mesh(CORNERS * [1.0, 2, 3], [("wedge", wedge)]).write(tmp_path / f"a{suffix}", **options)
    mesh = formats.read(tmp_path / f"a{suffix}")
    assert mesh.blocks == (Block("wed6", np.arange(6)[None]),)
    assert mesh.volumes == pytest.approx([3.0])


@pytest.mark.parametrize("name", [name for name in WRITERS if name != "abaqus"])
def test_pyramids_of_meshio_are_refused(tmp_path, name):
    suffix, options = WRITERS[name]
    path = tmp_path / f"theirs{suffix}"
    meshio.Mesh(CORNERS[:5] * 2.0, [("pyramid", np.arange(5)[None])]).write(path, **options)
    with pytest.raises(FormatError, match=r"pyramid'; wanted hexahedra"):
        formats.read(path)


# --- the names of elements ---------------------------------------------------------------------

DECK = "*NODE\n" + "".join(f"{i}, {x}, {y}, {z}\n" for i, (x, y, z) in enumerate(CORNERS, 1))
DECK += "*ELEMENT, TYPE=C3D8\n1, 1, 2, 3, 4, 5, 6, 7, 8\n"


@pytest.mark.parametrize("kind", ["C3D8R", "c3d8i", "C3D8H", "C3D8RH", "C3D8T", "DC3D8", "C3D8P"])
def test_the_kin_of_a_hexahedron(tmp_path, kind):
    (tmp_path / "deck.inp").write_text(DECK.replace("C3D8", kind))
    assert formats.read(tmp_path / "deck.inp").volumes == pytest.approx([1.0])


FLAT = "S3 S4R S8R5 STRI65 DS4 M3D4R CPS4 CPE8R CPEG4 CAX4 CGAX4 SAX1 DC2D4 DCAX4 T3D2 T2D2 B31 B23"
FLAT += " PIPE31 R3D4 RAX2 SFM3D4 CONN3D2 SPRINGA DASHPOT1 MASS ROTARYI GAPUNI ELBOW31 FRAME3D"


@pytest.mark.parametrize("kind", FLAT.split())
def test_what_has_no_volume_is_passed_over(tmp_path, kind):
    more = f"*ELEMENT, TYPE={kind}, ELSET=More\n2, whatever, it says\n"
    (tmp_path / "deck.inp").write_text(DECK + more)
    assert formats.read(tmp_path / "deck.inp").volumes == pytest.approx([1.0])


@pytest.mark.parametrize(
    "kind", ["C3D5", "C3D15", "C3D13", "SC8R", "CSS8", "COH3D8", "AC3D8", "U1"]
)
def test_what_has_a_volume_of_another_kind_is_refused(tmp_path, kind):
    (tmp_path / "deck.inp").write_text(DECK + f"*ELEMENT, TYPE={kind}\n2, 1, 2\n")
    with pytest.raises(FormatError, match=rf"ELEMENT TYPE: got '{kind}'; wanted C3D8, C3D20"):
        formats.read(tmp_path / "deck.inp")


# --- from the command line ---------------------------------------------------------------------


def test_a_coarse_mesh_is_converted_and_measured(tmp_path, capsys):
    assert main(["convert", str(GMSH / "hexahedra-27.msh"), str(tmp_path / "bricks.inp")]) == 0
    assert "12 hexahedra of more than 8 nodes are read by their corners" in capsys.readouterr().err
    assert main(["convert", str(tmp_path / "bricks.inp"), str(tmp_path / "bricks.vtu")]) == 0
    assert main(["measure", str(tmp_path / "bricks.vtu")]) == 0
    assert re.search(r"^volume +9 .*mm³ +hexahedra", capsys.readouterr().out, re.MULTILINE)
    mesh = HexMesh.of_volume(formats.read(tmp_path / "bricks.vtu"))
    assert found_bricks(mesh) == expected_bricks()


def test_a_mesh_of_pyramids_ends_in_one_line(tmp_path, capsys):
    pyramid = meshio.Mesh(CORNERS[:5].astype(float), [("pyramid", np.arange(5)[None])])
    pyramid.write(tmp_path / "pyramid.msh", file_format="gmsh")
    assert main(["convert", str(tmp_path / "pyramid.msh"), str(tmp_path / "pyramid.vtu")]) != 0
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "element type: got '7 pyramid'; wanted hexahedra or tetrahedra" in said
    assert not (tmp_path / "pyramid.vtu").exists()
