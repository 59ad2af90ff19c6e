"""HDF5 of voxels, read by h5py."""

import sys
import zlib

import numpy as np
import pytest
from image_cases import SHAPE, grey_grid, in_file_order

from porous import formats
from porous.errors import FormatError
from porous.values import Frame, VoxelGrid


@pytest.fixture(autouse=True)
def library():
    pytest.importorskip("h5py")


def test_what_h5py_reads(tmp_path, ask):
    full, plain = grey_grid(), grey_grid(bulk=False, unit="in")
    plain = VoxelGrid(plain.frame, plain.fill)
    formats.write(full, tmp_path / "full.h5")
    formats.write(plain, tmp_path / "plain.hdf5")
    told, other = ask("h5", tmp_path / "full.h5", tmp_path / "plain.hdf5")
    frame = full.frame
    assert told["spacing"] == list(frame.spacing)
    assert told["origin"] == list(frame.origin)
    assert (told["start"], told["periodic"]) == ([3, 0, 4], [1, 0, 1])
    assert (told["unit"], told["sampling"]) == ("um", "cover")
    assert (told["hausdorff"], told["sampling_error"]) == (0.25, 0.125)
    assert sorted(told["sets"]) == ["bulk", "fill"]
    for name, data in told["sets"].items():
        assert (data["shape"], data["type"]) == ([7, 6, 5], "uint8")
        assert data["labels"] == ["z", "y", "x"]
        assert data["element_size_um"] == list(frame.spacing[::-1])
        assert data["crc32"] == in_file_order(getattr(full, name))
    assert list(other["sets"]) == ["fill"]
    inches = [h * 25400 for h in frame.spacing[::-1]]
    assert other["sets"]["fill"]["element_size_um"] == pytest.approx(inches)
    assert "hausdorff" not in other


def test_larger_than_a_chunk(tmp_path, ask):
    shape = (70, 3, 130)
    fill = (np.indices(shape).sum(axis=0) % 7 < 3) * np.uint8(255)
    grid = VoxelGrid(Frame((0, 0, 0), (1, 2, 3), shape), fill)
    formats.write(grid, tmp_path / "a.h5")
    first = (tmp_path / "a.h5").read_bytes()
    formats.write(grid, tmp_path / "a.h5")
    assert (tmp_path / "a.h5").read_bytes() == first
    (told,) = ask("h5", tmp_path / "a.h5")
    data = told["sets"]["fill"]
    assert (data["shape"], data["chunks"]) == ([130, 3, 70], [64, 3, 64])
    assert data["crc32"] == zlib.crc32(np.ascontiguousarray(fill.transpose(2, 1, 0)))


def test_without_the_library_it_is_said_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "h5py", None)
    monkeypatch.setattr("porous.formats._registry.find_spec", lambda _: None)
    with pytest.raises(FormatError, match=r"\.h5 files need h5py; wanted pip install 'porous\[io"):
        formats.write(grey_grid(), tmp_path / "a.h5")
    assert list(tmp_path.iterdir()) == []


def test_it_is_written_not_read(tmp_path):
    formats.write(grey_grid(), tmp_path / "a.h5")
    with pytest.raises(FormatError, match=r"\.h5 files are written, not read"):
        formats.read(tmp_path / "a.h5")
    assert grey_grid().frame.shape == SHAPE
