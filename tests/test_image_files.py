"""Images in several files: folders of slices, headers with voxels beside them, and what is kept."""

import shutil
import struct
import zlib

import imageio.v3 as iio
import numpy as np
import pytest
import pyvista
import tifffile
from PIL import Image as Picture

from porous import formats, workspace
from porous.errors import FormatError, RecipeError
from porous.kernels.unfilter import unfilter
from porous.pipeline import run
from porous.recipe import load
from porous.values import Frame, VoxelGrid
from porous.workspace import is_whole, make, make_stored, resume
from porous.workspace._make import _identity

GREY = np.random.default_rng(8).integers(0, 65536, (9, 7, 5)).astype(np.uint16)
SMOOTH = np.indices((40, 30, 4)).sum(axis=0).astype(np.uint8) * 3  # what filters are good for


def slices(folder, values, suffix=".png", first=0):
    folder.mkdir(exist_ok=True)
    for k in range(values.shape[2]):
        name = folder / f"scan_{k + first}{suffix}"
        (tifffile.imwrite if suffix == ".tif" else iio.imwrite)(name, values[:, :, k].T)
    return folder


@pytest.mark.parametrize("suffix", [".png", ".tif"])
@pytest.mark.parametrize(
    "values", [GREY, (GREY >> 8).astype(np.uint8), SMOOTH], ids=["16", "8", "smooth"]
)
@pytest.mark.filterwarnings("ignore:.*no voxel size")
def test_slices_are_layers_in_the_order_of_their_numbers(tmp_path, suffix, values):
    folder = slices(tmp_path / "scan", values, suffix, first=8)  # 9 comes before 10
    (folder / "notes.txt").write_text("not a picture")
    read = formats.read_image(folder)
    assert np.array_equal(read.values, values)
    assert read.values.dtype == values.dtype
    assert read.spacing == (1, 1, 1)
    assert len(formats.members(folder)) == values.shape[2]


def test_a_missing_voxel_size_is_said_once(tmp_path):
    folder = slices(tmp_path / "scan", GREY)
    with pytest.warns(match="no voxel size") as said:
        formats.read_image(folder)
    assert len(said) == 1


@pytest.mark.filterwarnings("ignore:.*no voxel size")
def test_masks_of_one_bit(tmp_path):
    mask = GREY > 30000
    (tmp_path / "scan").mkdir()
    for k in range(5):
        Picture.fromarray(mask[:, :, k].T).save(tmp_path / "scan" / f"{k}.png", bits=1)
    read = formats.read_image(tmp_path / "scan")
    assert read.values.dtype == bool
    assert np.array_equal(read.values, mask)


def test_what_porous_writes_comes_back_with_its_sizes(tmp_path):
    frame = Frame((1, 2, 3), (0.05, 0.1, 0.2), SMOOTH.shape, unit="um")
    formats.write(VoxelGrid(frame, SMOOTH), tmp_path / "part.pngs")
    read = formats.read_image(tmp_path / "part.pngs")
    assert np.array_equal(read.values, SMOOTH)
    assert (read.spacing, read.origin, read.unit) == ((0.05, 0.1, 0.2), (1, 2, 3), "um")


def naive_unfilter(lines, step):
    rows, before = [], [0] * (len(lines[0]) - 1)
    for kind, *line in lines.tolist():
        row = []
        for j, value in enumerate(line):
            a, c = (row[j - step], before[j - step]) if j >= step else (0, 0)
            b = before[j]
            paeth = min((abs(b - c), 0, a), (abs(a - c), 1, b), (abs(a + b - 2 * c), 2, c))[2]
            row.append((value + (0, a, b, (a + b) // 2, paeth)[kind]) % 256)
        rows.append(row)
        before = row
    return np.array(rows)


@pytest.mark.parametrize("step", [1, 2])
def test_every_filter_is_taken_off(step):
    rng = np.random.default_rng(step)
    lines = rng.integers(0, 256, (50, 1 + 12 * step)).astype(np.uint8)
    lines[:, 0] = rng.integers(0, 5, 50)
    assert np.array_equal(unfilter(lines, step), naive_unfilter(lines, step))
    lines[7, 0] = 5
    assert unfilter(lines, step) is None


def cut(folder):
    path = folder / "scan_3.png"
    path.write_bytes(path.read_bytes()[:-20])


def flip(folder):
    path = folder / "scan_3.png"
    data = bytearray(path.read_bytes())
    data[60] ^= 4
    path.write_bytes(bytes(data))


BAD = {
    "a number is missing": (
        lambda folder: (folder / "scan_2.png").unlink(),
        "slice 2 is missing: after scan_1.png comes scan_3.png",
    ),
    "another size": (
        lambda folder: iio.imwrite(folder / "scan_4.png", GREY[:, :6, 0].T),
        "scan_4.png: got '9 × 6 of uint16'; wanted 9 × 7 of uint16 as in scan_0.png",
    ),
    "another type": (
        lambda folder: iio.imwrite(folder / "scan_4.png", GREY[:, :, 0].T.astype(np.uint8)),
        "scan_4.png: got '9 × 7 of uint8'",
    ),
    "colours": (
        lambda folder: iio.imwrite(folder / "scan_0.png", np.zeros((7, 9, 3), np.uint8)),
        "scan_0.png: pixels: got '8 bits, colour type 2'; wanted 1, 8 or 16 bits of grey",
    ),
    "two series": (
        lambda folder: shutil.copy(folder / "scan_0.png", folder / "other_9.png"),
        "slices: got 'other_….png, scan_….png'; wanted pictures of one name",
    ),
    "a number twice": (
        lambda folder: shutil.copy(folder / "scan_0.png", folder / "scan_00.png"),
        "slices: got 'scan_0.png and scan_00.png'; wanted each number once",
    ),
    "no number": (
        lambda folder: shutil.copy(folder / "scan_0.png", folder / "preview.png"),
        "a slice: got 'preview.png'; wanted a number before the suffix",
    ),
    "none": (lambda folder: [p.unlink() for p in folder.iterdir()], "slices: got 'none'; wanted"),
    "cut": (cut, "scan_3.png: a chunk would take"),
    "a bit that flips": (flip, "scan_3.png: a chunk: got 'IDAT'; wanted one whose sum is right"),
    "a link": (
        lambda folder: (folder / "scan_5.png").symlink_to(folder / "scan_0.png"),
        "a slice: got 'scan_5.png'; wanted a file, not a link to one",
    ),
    "no PNG": (
        lambda folder: (folder / "scan_0.png").write_bytes(b"GIF89a and more"),
        "scan_0.png: its beginning: got",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_folders(tmp_path, name):
    spoil, said = BAD[name]
    folder = slices(tmp_path / "scan", GREY)
    spoil(folder)
    with pytest.raises(FormatError, match=said):
        formats.read_image(folder)


# --- what a folder of results keeps ------------------------------------------------------------


def recipe(path, **more):
    return load(path, set={"model.threshold": 30000, "model.spacing": 0.5, **more})


@pytest.mark.parametrize("name", ["scan.mhd", "scan.nhdr", "scan"])
def test_results_keep_all_files_of_an_image(tmp_path, name):
    source = tmp_path / "given"
    source.mkdir()
    if name == "scan":
        slices(source / name, GREY)
    else:
        fill = (GREY >> 8).astype(np.uint8)
        formats.write(VoxelGrid(Frame((0, 0, 0), (1, 1, 1), GREY.shape), fill), source / name)
    keys = {} if name == "scan" else {"model.threshold": 117}
    made = make(recipe(source / name, **keys), tmp_path / "out", only="voxels")
    shutil.rmtree(source)
    again = make(load(tmp_path / "out" / "recipe.toml"), tmp_path / "again", only="voxels")
    assert again.grid == made.grid
    assert np.array_equal(made.grid.solid, GREY >= 30000) or name != "scan"
    assert formats.read(tmp_path / "out" / "grid.vti") == made.grid


def test_every_file_of_an_image_is_of_its_identity(tmp_path):
    folder = slices(tmp_path / "scan", GREY)
    before = _identity(recipe(folder))
    iio.imwrite(folder / "scan_3.png", GREY[:, :, 0].T)
    assert _identity(recipe(folder)) != before
    fill = (GREY >> 8).astype(np.uint8)
    formats.write(VoxelGrid(Frame((0, 0, 0), (1, 1, 1), GREY.shape), fill), tmp_path / "a.mhd")
    before = _identity(recipe(tmp_path / "a.mhd"))
    raw = bytearray((tmp_path / "a.raw").read_bytes())
    raw[7] ^= 1
    (tmp_path / "a.raw").write_bytes(bytes(raw))
    assert _identity(recipe(tmp_path / "a.mhd")) != before


def test_slices_of_an_earlier_run_do_not_stay(tmp_path):
    make(recipe(slices(tmp_path / "scan", GREY)), tmp_path / "out", only="voxels")
    fewer = slices(tmp_path / "other", GREY[:, :, :3])
    make(recipe(fewer), tmp_path / "out", only="voxels")
    names = sorted(path.name for path in (tmp_path / "out" / "path").iterdir())
    assert names == ["scan_0.png", "scan_1.png", "scan_2.png"]
    assert make(load(tmp_path / "out" / "recipe.toml"), tmp_path / "b", only="voxels").grid


def test_voxels_under_a_name_that_porous_needs_are_refused(tmp_path):
    fill = (GREY >> 8).astype(np.uint8)
    formats.write(VoxelGrid(Frame((0, 0, 0), (1, 1, 1), GREY.shape), fill), tmp_path / "a.mhd")
    (tmp_path / "a.raw").rename(tmp_path / "grid.vti")
    head = (tmp_path / "a.mhd").read_text().replace("= a.raw", "= grid.vti")
    (tmp_path / "a.mhd").write_text(head)
    with pytest.raises(FormatError, match=r"its voxels are in grid.vti; wanted another name"):
        workspace.make(recipe(tmp_path / "a.mhd"), tmp_path / "out", only="voxels")
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["scan.mhd", "scan"])
def test_images_of_several_files_are_made_out_of_core_and_resumed(tmp_path, name):
    if name == "scan":
        slices(tmp_path / name, GREY)
    else:
        frame = Frame((0, 0, 0), (1, 1, 1), GREY.shape)
        formats.write(VoxelGrid(frame, (GREY >> 8).astype(np.uint8)), tmp_path / name)
    keys = {} if name == "scan" else {"model.threshold": 117}
    taken = recipe(tmp_path / name, **keys)
    stored = make_stored(taken, tmp_path / "out", only="voxels", chunk=4)
    assert stored.grid.to_grid() == run(taken, only="voxels").grid
    assert is_whole(tmp_path / "out")
    (tmp_path / "out" / "grid.zarr" / "manifest.json").unlink(missing_ok=True)
    (tmp_path / "out" / "measures.json").unlink()
    assert resume(tmp_path / "out").grid.to_grid() == stored.grid.to_grid()
    inner = tmp_path / "out" / ("path/scan_1.png" if name == "scan" else "scan.raw")
    inner.write_bytes(inner.read_bytes() + b"x")
    with pytest.raises(RecipeError):
        is_whole(tmp_path / "out")


# --- grey values of single files ---------------------------------------------------------------


def test_points_of_vtk_are_centres_of_voxels(tmp_path):
    data = pyvista.ImageData(dimensions=GREY.shape, spacing=(0.5, 1, 2), origin=(1, 2, 3))
    data.point_data["ct"] = GREY.ravel(order="F")
    data.save(tmp_path / "scan.vti")
    read = formats.read_image(tmp_path / "scan.vti")
    assert np.array_equal(read.values, GREY)
    assert (read.spacing, read.origin) == ((0.5, 1, 2), (0.75, 1.5, 2))
    data.point_data["mask"] = GREY.ravel(order="F")
    data.save(tmp_path / "scan.vti")
    with pytest.raises(FormatError, match="arrays of grey values: got 'ct, mask'; wanted one"):
        formats.read_image(tmp_path / "scan.vti")


def test_arrays_of_numpy_by_any_name(tmp_path):
    np.savez(tmp_path / "scan.npz", ct=GREY[::-1], spacing=[1, 2, 3], unit="cm", origin=[4, 5, 6])
    read = formats.read_image(tmp_path / "scan.npz")
    assert np.array_equal(read.values, GREY[::-1])
    assert (read.spacing, read.origin, read.unit) == ((1, 2, 3), (4, 5, 6), "cm")
    for bad, said in ({"a": GREY, "b": GREY}, "got 'a, b'"), ({"a": GREY[0]}, "numbers on three"):
        np.savez(tmp_path / "scan.npz", **bad)
        with pytest.raises(FormatError, match=said):
            formats.read_image(tmp_path / "scan.npz")


def test_files_that_hold_no_image_are_refused(tmp_path):
    (tmp_path / "part.stl").write_bytes(b"solid")
    with pytest.raises(FormatError, match=r"a .stl file holds no image; wanted one of .*\.tif"):
        formats.read_image(tmp_path / "part.stl")


def test_a_picture_of_more_pixels_than_its_bytes_can_be(tmp_path):
    folder = slices(tmp_path / "scan", GREY)
    head = struct.pack(">II5B", 60000, 60000, 8, 0, 0, 0, 0)
    body = b"".join(
        struct.pack(">I", len(part)) + kind + part + struct.pack(">I", zlib.crc32(kind + part))
        for kind, part in ((b"IHDR", head), (b"IDAT", zlib.compress(bytes(999))), (b"IEND", b""))
    )
    (folder / "scan_0.png").write_bytes(b"\x89PNG\r\n\x1a\n" + body)
    with pytest.raises(FormatError, match="its pixels would take 3600060000 bytes"):
        formats.read_image(folder)
