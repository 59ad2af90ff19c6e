"""DAMASK grids, loaded by DAMASK's own library and by VTK."""

import re

import numpy as np
import pytest
import pyvista
from image_cases import grey_grid

from porous import formats
from porous.formats import damask_vti
from porous.values import Frame, VoxelGrid


def materials(grid):
    return (grid.fill >= 128).astype(int)


def test_damask_loads_what_was_meant(tmp_path, ask):
    grid = grey_grid(unit="um")
    formats.write(grid, tmp_path / "a.damask.vti")
    told = ask("damask", tmp_path / "a.damask.vti", tmp_path)
    frame = grid.frame
    assert told["cells"] == list(frame.shape)
    assert told["size"] == pytest.approx([1e-6 * v for v in frame.box.lengths], rel=1e-9)
    assert told["origin"] == pytest.approx([1e-6 * v for v in frame.box.lower], rel=1e-9)
    assert told["material"] == materials(grid).ravel(order="F").tolist()
    assert (told["type"], told["more"]) == ("int32", [])
    assert told["same"]


@pytest.mark.parametrize("block", [12, 24, 3 << 18])
def test_blocks_of_any_number(tmp_path, monkeypatch, block):
    monkeypatch.setattr(damask_vti, "BLOCK", block)
    shape = (7, 5, 9)
    fill = (np.indices(shape).sum(axis=0) % 3 * 100).astype(np.uint8)
    grid = VoxelGrid(Frame((1, 2, 3), (0.5, 1, 2), shape, unit="m"), fill)
    path = tmp_path / "a.damask.vti"
    formats.write(grid, path)
    seen = pyvista.read(path)
    assert seen.dimensions == (8, 6, 10)
    assert seen.origin == (1, 2, 3)
    assert seen.spacing == (0.5, 1, 2)
    assert seen["material"].tolist() == materials(grid).ravel(order="F").tolist()


def test_what_the_solver_asks_of_the_lines(tmp_path):
    """DAMASK reads line by line: the base64 stands alone, extents begin at zero."""
    formats.write(grey_grid(), tmp_path / "a.damask.vti")
    lines = (tmp_path / "a.damask.vti").read_text().splitlines()
    image = next(line for line in lines if "<ImageData" in line)
    assert 'WholeExtent="0 5 0 6 0 7"' in image
    assert 'Direction="1 0 0 0 1 0 0 0 1"' in image
    place = next(k for k, line in enumerate(lines) if "<DataArray" in line)
    assert 'format="binary"' in lines[place]
    assert 'type="Int32" Name="material"' in lines[place]
    assert re.fullmatch("[A-Za-z0-9+/]+=*[A-Za-z0-9+/]+=*", lines[place + 1])
    assert lines[place + 2].strip() == "</DataArray>"


def test_a_vti_of_another_name_is_ours(tmp_path):
    formats.write(grey_grid(), tmp_path / "damask.vti")
    assert formats.read(tmp_path / "damask.vti") == grey_grid()
