"""Exodus II as VTK's reader, which is ParaView's, and netCDF's own library take it."""

import neutral_meshes as meshes
import numpy as np
import pytest
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkIOExodus import vtkExodusIIReader

from porous import formats
from porous.errors import FormatError
from porous.formats import exo
from porous.formats._netcdf import Classic
from porous.values import SHAPES, Job, VolumeMesh

TYPES = {"tet4": "TETRA4", "tet10": "TETRA10", "hex8": "HEX8", "hex20": "HEX20", "wed6": "WEDGE"}
BLOCK, SIDE, NODE = (
    vtkExodusIIReader.ELEM_BLOCK,
    vtkExodusIIReader.SIDE_SET,
    vtkExodusIIReader.NODE_SET,
)


def put(folder, name, mesh, suffix=".exo"):
    formats.write(mesh, folder / f"{name}{suffix}")
    return folder / f"{name}{suffix}"


def seen(path):
    """Return what VTK sees: by kind and name, points (single precision) and cells by VTK type."""
    reader = vtkExodusIIReader()
    reader.SetFileName(str(path))
    reader.UpdateInformation()
    found = {}
    for kind in (BLOCK, SIDE, NODE):
        for i in range(reader.GetNumberOfObjects(kind)):
            reader.SetObjectStatus(kind, i, 1)
    reader.Update()
    output = reader.GetOutput()
    for place, kind in ((0, BLOCK), (4, SIDE), (7, NODE)):
        group = output.GetBlock(place)
        for i in range(group.GetNumberOfBlocks() if group else 0):
            name = group.GetMetaData(i).Get(group.NAME())
            found[kind, name] = cells_of(group.GetBlock(i))
    return found


def cells_of(grid):
    points = vtk_to_numpy(grid.GetPoints().GetData()).astype(float)
    starts = vtk_to_numpy(grid.GetCells().GetOffsetsArray())
    nodes = vtk_to_numpy(grid.GetCells().GetConnectivityArray())
    types = [grid.GetCellType(i) for i in range(grid.GetNumberOfCells())]
    return points, [(t, nodes[a:b]) for t, a, b in zip(types, starts, starts[1:], strict=False)]


def flux(points, cells):
    """Integrate x · n over flat faces, by their corners."""
    total = 0.0
    for kind, nodes in cells:
        corners = points[nodes[: {5: 3, 22: 3, 9: 4, 23: 4}[kind]]]
        fan = np.cross(corners[1:-1] - corners[0], corners[2:] - corners[0]).sum(axis=0) / 2
        total += corners.mean(axis=0) @ fan
    return total


@pytest.mark.parametrize("kind", meshes.KINDS)
def test_vtk_sees_blocks_sides_and_nodes(tmp_path, kind):
    mesh = meshes.body(kind)
    shapes, sets = meshes.counts(mesh)
    found = seen(put(tmp_path, kind, mesh))
    for key, kind_of in ((SIDE, "faces"), (NODE, "nodes")):
        assert {n: len(c) for (k, n), (_, c) in found.items() if k == key} == sets[kind_of]
    blocks = {name: value for (key, name), value in found.items() if key == BLOCK}
    parts = ("SOLID", "PORE")
    if kind == "mixed":
        assert set(blocks) == {f"{part}_{TYPES[shape]}" for part in parts for shape in shapes}
    else:
        assert {n: len(c) for n, (_, c) in blocks.items()} == {p: sets["cells"][p] for p in parts}
    types = {SHAPES[shape].vtk for shape in shapes}
    assert {t for _, cells in blocks.values() for t, _ in cells} == types
    outer = sum(flux(*found[SIDE, name]) for name in ("SKIN", "WALL"))
    assert outer == pytest.approx(3 * meshes.VOLUME, rel=1e-5)
    for axis in "XYZ":
        low, high = (flux(*found[SIDE, f"{axis}{end}_FACES"]) for end in ("MIN", "MAX"))
        assert low + high == pytest.approx(np.prod(meshes.LENGTHS), rel=1e-5)


@pytest.mark.parametrize("shape", ["tet10", "hex20"])
def test_nodes_upon_edges_are_where_vtk_wants_them(tmp_path, shape):
    for (key, _), (points, cells) in seen(put(tmp_path, shape, meshes.body(shape))).items():
        for _, nodes in cells if key == BLOCK else ():
            ends = points[nodes[np.array(SHAPES[shape].edges)]]
            corners = len(nodes) - len(SHAPES[shape].edges)
            assert points[nodes[corners:]] == pytest.approx(ends.mean(axis=1), abs=1e-6)
        for kind, nodes in cells if key == SIDE else ():
            corners = {22: 3, 23: 4}[kind]
            ring = points[nodes[:corners]]
            middle = (ring + np.roll(ring, -1, axis=0)) / 2
            assert points[nodes[corners:]] == pytest.approx(middle, abs=1e-6)


@pytest.mark.judge
def test_netcdf_finds_every_shape_with_its_parts(tmp_path, ask):
    paths = [put(tmp_path, kind, meshes.body(kind, "um")) for kind in meshes.KINDS]
    for kind, found in zip(meshes.KINDS, ask("exodus", *paths), strict=True):
        mesh = meshes.body(kind)
        shapes, sets = meshes.counts(mesh)
        assert (found["model"], found["word"]) == ("NETCDF3_64BIT_OFFSET", "float64")
        assert (found["nodes"], found["said"]) == (len(mesh.points), ["lengths in um"])
        assert found["volume"] == pytest.approx(meshes.VOLUME, rel=1e-12)
        assert found["least"] > 0
        blocks = found["blocks"].values()
        assert {s: sum(n for t, n in blocks if t == TYPES[s]) for s in shapes} == shapes
        assert sorted(found["map"]) == list(range(1, mesh.cells + 1))
        assert len(set(found["ids"])) == len(sets["faces"]) + len(sets["nodes"])
        assert (found["face_sets"], found["node_sets"]) == (sets["faces"], sets["nodes"])
        told = sets["cells"] if kind == "mixed" else {"WORD_00": sets["cells"]["WORD_00"]}
        assert found["cell_sets"] == told


@pytest.mark.judge
def test_one_cell_and_strange_names(tmp_path, ask):
    shapes = meshes.KINDS[:-1]
    names = ["a part", 'quo"te', "Größe\n", "x" * 100]
    paths = [put(tmp_path, shape, meshes.one_cell(shape)) for shape in shapes]
    kinds = ("cells", "faces", "nodes")
    paths += [put(tmp_path, kind, meshes.renamed(names, kind)) for kind in kinds]
    *ones, cells, faces, nodes = ask("exodus", *paths)
    for shape, found in zip(shapes, ones, strict=True):
        assert found["blocks"] == {"CELLS": [TYPES[shape], 1]}
        assert found["volume"] == pytest.approx(meshes.one_cell(shape).volumes.sum(), rel=1e-12)
        assert found["node_sets"] == found["face_sets"] == found["cell_sets"] == {}
    short = ["a_part", "quo_te", "Gr__e_", "x" * 32]
    assert faces["face_sets"] == nodes["node_sets"] == dict.fromkeys(short, 1)
    assert cells["blocks"] == {"a_part": ["HEX8", 1], "CELLS": ["HEX8", 58]}
    assert cells["cell_sets"] == dict.fromkeys(short[1:], 1)


def test_all_its_suffixes_are_the_same_file(tmp_path):
    mesh = meshes.body("mixed")
    first = put(tmp_path, "a", mesh).read_bytes()
    assert put(tmp_path, "a", mesh, ".e").read_bytes() == first
    assert put(tmp_path, "a", mesh, ".EX2").read_bytes() == first


@pytest.mark.parametrize("kind", ["cells", "faces", "nodes"])
@pytest.mark.parametrize("names", [("a b", "a_b"), ("x" * 32, "x" * 33)])
def test_two_names_that_would_be_one_are_refused(kind, names):
    mesh = meshes.renamed([*names, "SOLID"], kind)
    with pytest.raises(FormatError, match=r"would both be .* in Exodus; wanted names that differ"):
        list(exo.write(mesh))


def test_what_is_too_large_for_the_format_is_refused():
    huge = np.broadcast_to(np.float64(0.0), 2**29)
    with pytest.raises(FormatError, match="4294967296 bytes; wanted at most 4294967292 in netCDF"):
        Classic({}).put("coordx", huge, "num_nodes")


def test_what_is_no_mesh_is_refused(tmp_path):
    with pytest.raises(FormatError, match=r"\.e file cannot hold a Job; wanted one of .*\.inp"):
        put(tmp_path, "job", Job("a body", meshes.body("hex8")), ".e")
    with pytest.raises(FormatError, match="the mesh has no cells"):
        put(tmp_path, "empty", VolumeMesh(np.zeros((2, 3)), ()))
    assert list(tmp_path.iterdir()) == []
