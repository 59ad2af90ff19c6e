"""XDMF and its HDF5 file, as VTK's reader takes them."""

from xml.etree import ElementTree as ET

import h5py
import neutral_meshes as meshes
import numpy as np
import pytest
import pyvista
from vtkmodules.vtkIOXdmf2 import vtkXdmfReader

from porous import formats
from porous.errors import FormatError
from porous.formats import xdmf
from porous.values import SHAPES, Block, Job, VolumeMesh


def put(folder, name, mesh):
    formats.write(mesh, folder / f"{name}.xdmf")
    return folder / f"{name}.xdmf"


def seen(path):
    """Return the grids that VTK finds, by name."""
    reader = vtkXdmfReader()
    reader.SetFileName(str(path))
    reader.UpdateInformation()
    reader.Update()
    grids = pyvista.wrap(reader.GetOutputDataObject(0))
    if isinstance(grids, pyvista.UnstructuredGrid):  # there is only one
        return {"mesh": grids}
    return {name: grids[name] for name in grids.keys()}  # noqa: SIM118  (no dictionary)


def told(path, grid="mesh"):
    """Return what the pieces of information of a grid say."""
    found = ET.parse(path).find(f"./Domain/Grid[@Name='{grid}']")
    return {one.get("Name"): one.get("Value") for one in found.findall("Information")}


@pytest.mark.parametrize("kind", meshes.KINDS)
def test_vtk_sees_cells_and_facets_with_their_parts(tmp_path, kind):
    mesh = meshes.body(kind)
    shapes, sets = meshes.counts(mesh)
    path = put(tmp_path, kind, mesh)
    found = seen(path)
    cells, facets = found["mesh"], found["facets"]
    assert np.array_equal(cells.points, mesh.points)
    vtk_types, numbers = np.unique(cells.celltypes, return_counts=True)
    wanted = {SHAPES[shape].vtk: count for shape, count in shapes.items()}
    assert dict(zip(vtk_types.tolist(), numbers.tolist(), strict=True)) == wanted
    nodes = cells.cells_dict
    for shape in shapes:
        rows = np.concatenate([b.cells for b in mesh.blocks if b.shape == shape])
        assert np.array_equal(nodes[SHAPES[shape].vtk], rows)
    sizes = cells.compute_cell_sizes(length=False, area=False)["Volume"]
    assert sizes == pytest.approx(mesh.volumes, rel=1e-10)
    assert sizes.sum() == pytest.approx(meshes.VOLUME, rel=1e-12)
    assert np.array_equal(cells.cell_data["phase"], mesh.cell_tags["phase"])
    for name in sets["cells"]:
        assert np.array_equal(
            np.flatnonzero(cells.cell_data[name]), np.sort(mesh.parts[name].members)
        )
    for name, count in sets["nodes"].items():
        assert cells.point_data[name].sum() == count
    for name, count in sets["faces"].items():
        assert facets.cell_data[name].sum() == count
    areas = facets.compute_cell_sizes(length=False, volume=False)["Area"]
    x, y, z = meshes.LENGTHS
    assert areas[facets["SKIN"] == 1].sum() == pytest.approx(2 * (x * y + y * z + z * x), rel=1e-9)


@pytest.mark.parametrize("kind", meshes.KINDS)
def test_leading_parts_are_numbered_and_named(tmp_path, kind):
    mesh = meshes.body(kind)
    path = put(tmp_path, kind, mesh)
    found = seen(path)
    assert {name: told(path)[name] for name in ("SOLID", "PORE")} == {"SOLID": "1", "PORE": "2"}
    cells, facets = found["mesh"], found["facets"]
    assert np.array_equal(cells["leading"], 2 - cells["SOLID"])
    numbers = told(path, "facets")
    assert set(numbers) == {n for n in meshes.counts(mesh)[1]["faces"] if n != "SKIN"}
    for name, number in numbers.items():
        assert np.array_equal(facets["leading"] == int(number), facets[name] == 1)
    assert {*map(next, map(iter, (cells.cell_data, facets.cell_data)))} == {"leading"}


def test_facets_are_seen_from_outside(tmp_path):
    facets = seen(put(tmp_path, "wedges", meshes.body("wed6")))["facets"]
    total = 0.0
    for i in np.flatnonzero(facets["SKIN"] + facets["WALL"]):
        points = facets.get_cell(int(i)).points
        fan = np.cross(points[1:-1] - points[0], points[2:] - points[0]).sum(axis=0) / 2
        total += points.mean(axis=0) @ fan
    assert total == pytest.approx(3 * meshes.VOLUME, rel=1e-12)


def test_blocks_of_one_shape_are_one_table():
    mesh = meshes.body("hex8")
    cells = mesh.blocks[0].cells
    halves = VolumeMesh(mesh.points, (Block("hex8", cells[:20]), Block("hex8", cells[20:])))
    whole = VolumeMesh(mesh.points, mesh.blocks)
    first = {name: b"".join(chunks) for name, chunks in xdmf.write_files(halves, "a.xdmf")}
    assert {n: b"".join(chunks) for n, chunks in xdmf.write_files(whole, "a.xdmf")} == first
    assert list(first) == ["a.h5", "a.xdmf"]


def test_pairs_and_unit_are_said(tmp_path):
    mesh = meshes.body("hex8", "um")
    path = put(tmp_path, "pairs", mesh)
    said = told(path)
    assert said.pop("unit") == "um"
    for name in ("SOLID", "PORE"):
        said.pop(name)
    with h5py.File(path.with_suffix(".h5")) as file:
        for name, place in said.items():
            beside, _, inner = place.partition(":")
            assert beside == "pairs.h5"
            assert np.array_equal(file[inner][()], mesh.parts[name].members)
    assert set(said) == {"XPAIRS", "YPAIRS", "ZPAIRS"}


def test_strange_names_of_parts_and_files(tmp_path):
    names = ["a part", "quo\"te's", "<Grid/>&", "Größe\n", "x" * 300]
    path = put(tmp_path, "so: eine <Datei>", meshes.renamed(names))
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "so%3A%20eine%20%3CDatei%3E.h5",
        "so: eine <Datei>.xdmf",
    ]
    assert path.read_bytes().isascii()
    cells = seen(path)["mesh"]
    short = ["a part", "quo\"te's", "<Grid/>&", "Gr__e_", "x" * 255]
    assert list(cells.cell_data) == ["leading", *short]
    assert [cells[name].sum() for name in short] == [1] * 5


@pytest.mark.parametrize("names", [("é", "è"), ("x" * 255, "x" * 256), ("leading", "other")])
def test_two_names_that_would_be_one_are_refused(tmp_path, names):
    with pytest.raises(FormatError, match=r"would both be .* in XDMF; wanted names that differ"):
        put(tmp_path, "twice", meshes.renamed(names))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("shape", meshes.KINDS[:-1])
def test_one_cell_without_parts(tmp_path, shape):
    cells = seen(put(tmp_path, shape, meshes.one_cell(shape)))["mesh"]
    volume = cells.compute_cell_sizes(length=False, area=False)["Volume"]
    assert volume == pytest.approx(meshes.one_cell(shape).volumes, rel=1e-10)
    assert list(cells.cell_data) == []


def test_the_same_mesh_gives_the_same_bytes():
    def both():
        return [b"".join(c) for _, c in xdmf.write_files(meshes.body("mixed"), "a.xdmf")]

    assert both() == both()


def test_what_is_no_mesh_is_refused(tmp_path):
    with pytest.raises(FormatError, match=r"\.xdmf file cannot hold a Job; wanted one of .*\.inp"):
        put(tmp_path, "job", Job("a body", meshes.body("hex8")))
    with pytest.raises(FormatError, match="the mesh has no cells"):
        put(tmp_path, "empty", VolumeMesh(np.zeros((2, 3)), ()))
    assert list(tmp_path.iterdir()) == []
