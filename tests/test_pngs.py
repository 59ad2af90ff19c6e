"""Slices as PNG: the pixels are the voxels, whoever reads them, and the sizes are said."""

import json
import struct
import zlib

import imageio.v3 as iio
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from skimage.io import imread

from porous import formats
from porous.errors import FormatError
from porous.formats import pngs
from porous.values import Frame, VoxelGrid


def noise(shape=(7, 5, 3), spacing=(0.05, 0.1, 0.2), unit="mm", start=(0, 0, 0)):
    fill = np.random.default_rng(3).integers(0, 256, shape).astype(np.uint8)
    return VoxelGrid(Frame((1, 2, 3), spacing, shape, unit=unit, start=start), fill)


def stacked(folder, read):
    """Return the voxels of a folder of slices, axes (x, y, z), by what its page says."""
    known = json.loads((folder / "slices.json").read_text())
    assert known["first_row"] == "largest y"
    pictures = np.stack([np.asarray(read(folder / name)) for name in known["slices"]])
    return pictures[:, ::-1].transpose(2, 1, 0)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pngs") / "part.pngs"
    formats.write(noise(), folder)
    return folder


@pytest.mark.parametrize(
    "read", [imread, iio.imread, Image.open], ids=["skimage", "imageio", "PIL"]
)
def test_others_read_the_voxels(written, read):
    assert np.array_equal(stacked(written, read), noise().fill)


def test_the_page_says_all_sizes(written):
    known = json.loads((written / "slices.json").read_text())
    assert known["unit"] == "mm"
    assert (known["pixel_width"], known["pixel_height"]) == (0.05, 0.1)
    assert known["layer_height"] == 0.2
    assert (known["width"], known["height"], known["layers"]) == (7, 5, 3)
    assert known["lower"] == [1, 2, 3]
    assert known["slices"] == [f"slice-0000{i}.png" for i in range(3)]
    assert sorted(path.name for path in written.iterdir()) == [*known["slices"], "slices.json"]


def test_pictures_say_how_large_pixels_are(written):
    with Image.open(written / "slice-00000.png") as picture:
        assert picture.mode == "L"
        assert picture.size == (7, 5)
        assert picture.info["dpi"] == pytest.approx((508, 254), abs=0.02)


def test_pixels_of_a_kilometre_are_not_said():
    files = dict(pngs.write_files(noise(spacing=(1e3, 1e3, 1), unit="m"), "x"))
    assert b"pHYs" not in b"".join(files["slice-00000.png"])
    assert json.loads(b"".join(files["slices.json"]))["pixel_width"] == 1e3


def test_x_runs_to_the_right_and_y_upwards(tmp_path):
    fill = np.zeros((4, 3, 2), np.uint8)
    fill[3, 2, 0] = 255  # largest x and y of the lowest layer
    formats.write(VoxelGrid(Frame((0, 0, 0), (1, 1, 1), fill.shape), fill), tmp_path / "a.pngs")
    picture = imread(tmp_path / "a.pngs" / "slice-00000.png")
    assert np.argwhere(picture).tolist() == [[0, 3]]


def test_a_tile_lies_where_it_lies():
    files = dict(pngs.write_files(noise(start=(10, 0, 5)), "x"))
    assert json.loads(b"".join(files["slices.json"]))["lower"] == [1.5, 2, 4]


@given(st.tuples(*[st.integers(1, 9)] * 3), st.integers(0, 2**32 - 1))
@settings(max_examples=30)
def test_every_picture_is_a_whole_png(shape, seed):
    fill = np.random.default_rng(seed).integers(0, 256, shape).astype(np.uint8)
    grid = VoxelGrid(Frame((0, 0, 0), (1, 2, 3), shape), fill)
    *pictures, (last, _) = pngs.write_files(grid, "x")
    assert last == "slices.json"
    assert len(pictures) == shape[2]
    for layer, (_, pieces) in enumerate(pictures):
        chunks = dict(parted(b"".join(pieces)))
        assert list(chunks) == [b"IHDR", b"pHYs", b"IDAT", b"IEND"]
        width, height = struct.unpack(">II", chunks[b"IHDR"][:8])
        lines = np.frombuffer(zlib.decompress(chunks[b"IDAT"]), np.uint8)
        rows = lines.reshape(height, width + 1)
        assert not rows[:, 0].any()
        assert np.array_equal(rows[::-1, 1:].T, fill[:, :, layer])


def parted(data):
    """Yield the chunks of a PNG, their sums checked."""
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    place = 8
    while place < len(data):
        (size,) = struct.unpack(">I", data[place : place + 4])
        body = data[place + 4 : place + 8 + size]
        (found,) = struct.unpack(">I", data[place + 8 + size : place + 12 + size])
        assert found == zlib.crc32(body)
        yield body[:4], body[4:]
        place += 12 + size


def test_the_same_grid_gives_the_same_bytes():
    first, second = (
        {name: b"".join(pieces) for name, pieces in pngs.write_files(noise(), name)}
        for name in ("a", "b")
    )
    assert first == second


def test_a_folder_that_is_there_stays(written):
    before = (written / "slices.json").read_bytes()
    with pytest.raises(FormatError, match="is there already"):
        formats.write(noise((2, 2, 2)), written)
    assert (written / "slices.json").read_bytes() == before
