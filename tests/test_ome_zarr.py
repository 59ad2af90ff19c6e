"""OME-Zarr: what zarr reads, and what the specification's models accept."""

import json
import os
from pathlib import Path

import numpy as np
import programs
import pytest
from image_cases import SHAPE, first_centre, grey_grid

from porous import formats
from porous.errors import FormatError
from porous.formats import ome_zarr
from porous.values import Frame, VoxelGrid

zarr = pytest.importorskip("zarr", minversion="3")


def turned(values):
    return values.transpose(2, 1, 0)


def metadata(folder):
    return json.loads((folder / "zarr.json").read_text())


@pytest.mark.parametrize("chunk", [128, 3, 5])
def test_zarr_reads_it(tmp_path, monkeypatch, chunk):
    monkeypatch.setattr(ome_zarr, "CHUNK", chunk)
    grid = grey_grid(unit="mm")
    path = tmp_path / "part.ome.zarr"
    formats.write(grid, path)
    group = zarr.open_group(path, mode="r")
    assert np.array_equal(group["0"][:], turned(grid.fill))
    assert np.array_equal(group["labels/bulk/0"][:], turned(grid.bulk))
    assert group["0"].shape == SHAPE[::-1]
    assert group["0"].chunks == tuple(min(chunk, n) for n in SHAPE[::-1])
    assert group["0"].metadata.dimension_names == ("z", "y", "x")
    chunks = [-(-n // min(chunk, n)) for n in SHAPE]
    assert len([p for p in (path / "0" / "c").rglob("*") if p.is_file()]) == np.prod(chunks)


@pytest.mark.parametrize(
    ("unit", "name"), [("um", "micrometer"), ("in", "inch"), ("nm", "nanometer")]
)
def test_where_it_lies(tmp_path, unit, name):
    grid = grey_grid(unit=unit)
    formats.write(grid, tmp_path / "part.ome.zarr")
    said = metadata(tmp_path / "part.ome.zarr")["attributes"]["ome"]
    (image,) = said["multiscales"]
    assert said["version"] == "0.5"
    assert [axis["name"] for axis in image["axes"]] == ["z", "y", "x"]
    assert {axis["unit"] for axis in image["axes"]} == {name}
    scale, shift = image["datasets"][0]["coordinateTransformations"]
    assert scale == {"type": "scale", "scale": list(grid.frame.spacing[::-1])}
    assert shift["translation"] == pytest.approx(first_centre(grid.frame)[::-1], rel=1e-15)


def test_our_own_attribute_keeps_the_rest(tmp_path):
    grid = grey_grid()
    formats.write(grid, tmp_path / "part.ome.zarr")
    mark = metadata(tmp_path / "part.ome.zarr")["attributes"]["porous"]
    assert (mark["sampling"], mark["periodic"]) == ("cover", [True, False, True])
    assert (mark["origin"], mark["start"]) == (list(grid.frame.origin), list(grid.frame.start))
    assert (mark["hausdorff"], mark["sampling_error"], mark["unit"]) == (0.25, 0.125, "um")


def test_a_grid_without_bulk_has_no_labels_and_no_empty_chunk_is_left_out(tmp_path):
    frame = Frame((0, 0, 0), (1, 2, 3), (200, 3, 5))
    path = tmp_path / "void.ome.zarr"
    formats.write(VoxelGrid(frame, np.zeros(frame.shape, np.uint8)), path)
    files = sorted(p.relative_to(path).as_posix() for p in path.rglob("*") if p.is_file())
    assert files == ["0/c/0/0/0", "0/c/0/0/1", "0/zarr.json", "zarr.json"]
    (path / "0/c/0/0/1").write_bytes(b"")
    with pytest.raises(Exception):  # noqa: B017, PT011  (zarr's codecs raise what they like)
        zarr.open_group(path, mode="r")["0"][:]


def test_a_folder_that_is_there_stays(tmp_path):
    formats.write(grey_grid(), tmp_path / "a.ome.zarr")
    with pytest.raises(FormatError, match="is there already"):
        formats.write(grey_grid(bulk=False), tmp_path / "a.ome.zarr")
    assert (tmp_path / "a.ome.zarr" / "labels").is_dir()


VALIDATE = """
import sys, zarr
from ome_zarr_models import open_ome_zarr
for path in sys.argv[1:]:
    group = open_ome_zarr(zarr.open_group(path, mode="r"), version="0.5")
    print(type(group).__name__)
"""


@pytest.mark.judge
def test_the_models_of_the_specification_accept_it(tmp_path):
    python = Path(os.environ.get("POROUS_OME_JUDGES", "nowhere"))
    if not python.exists():
        missing = "POROUS_OME_JUDGES names no Python with ome-zarr-models"
        (pytest.fail if os.environ.get("CI") else pytest.skip)(missing)
    path = tmp_path / "part.ome.zarr"
    formats.write(grey_grid(), path)
    command = [python, "-c", VALIDATE, path, path / "labels", path / "labels" / "bulk"]
    printed, _ = programs.said(command, seconds=120)
    assert printed.split() == ["Image", "Labels", "ImageLabel"]
