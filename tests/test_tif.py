"""TIFF stacks: what tifffile, Pillow, scikit-image and ITK take and give, and what unpacks them."""

import itertools
import struct
import zlib

import numpy as np
import pytest
import tifffile
from hypothesis import given
from hypothesis import strategies as st
from image_cases import SHAPE, grey_grid, in_file_order, on_disk, ramp
from PIL import Image as Picture
from skimage import io

from porous import formats
from porous.errors import FormatError, FormatWarning
from porous.formats import tif
from porous.formats.gate import open_source
from porous.kernels.lzw import lzw, packbits
from porous.values import Frame, VoxelGrid

PAGES = ramp(np.uint8).transpose(2, 1, 0)
MASK = ramp(np.uint8) > 60


def image_of(path):
    return tif.read_image(open_source(path))


def quiet(path):
    """Read an image that says no voxel size."""
    with pytest.warns(FormatWarning, match="no voxel size; taken as 1 mm"):
        return image_of(path)


# --- what we write -----------------------------------------------------------------------------


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("bulk", [False, True])
def test_others_see_our_stack(tmp_path, monkeypatch, big, bulk):
    if big:
        monkeypatch.setattr(tif._Layout, "__init__", big_layout)
    grid = grey_grid(bulk=bulk)
    path = tmp_path / "grid.tif"
    formats.write(grid, path)
    assert formats.read(path) == grid
    with tifffile.TiffFile(path) as file:
        assert (file.is_bigtiff, file.is_imagej, len(file.pages)) == (big, True, 7)
        assert np.array_equal(file.asarray().transpose(2, 1, 0), grid.fill)
        said = file.imagej_metadata
        tags = file.pages[0].tags
        across = [np.divide(*tags[name].value) for name in ("XResolution", "YResolution")]
    assert (said["images"], said["slices"], said["unit"]) == (7, 7, "um")
    assert said["spacing"] == grid.frame.spacing[2]
    assert across == pytest.approx([3.0, 0.5], rel=1e-9)
    corner = [-said[f"{a}origin"] * h for a, h in zip("xyz", grid.frame.spacing, strict=True)]
    assert corner == pytest.approx(grid.frame.box.lower)
    assert np.array_equal(io.imread(path).transpose(2, 1, 0), grid.fill)
    with Picture.open(path) as picture:
        for layer in range(7):
            picture.seek(layer)
            assert np.array_equal(np.asarray(picture).T, grid.fill[:, :, layer])


def big_layout(self, big):  # noqa: ARG001
    self.big, self.word, self.start = True, "Q", 16


def test_a_stack_that_may_outgrow_its_offsets_is_a_bigtiff(monkeypatch):
    assert b"".join(tif.write(grey_grid()))[:4] == b"II*\0"
    monkeypatch.setattr(tif, "LARGEST", 4000)
    frame = Frame((0, 0, 0), (1, 2, 4), SHAPE)
    plain = VoxelGrid(frame, ramp(np.uint8))
    assert b"".join(tif.write(plain))[:4] == b"II+\0"


def test_itk_reads_the_voxels(tmp_path, ask):
    grid = grey_grid()
    formats.write(grid, tmp_path / "grid.tif")
    (told,) = ask("itk", "read", tmp_path / "grid.tif")
    assert told["size"] == list(SHAPE)
    assert told["crc32"] == in_file_order(grid.fill)


@pytest.mark.parametrize(("unit", "number"), [("in", 2), ("cm", 3), ("nm", 1)])
def test_units_that_the_format_knows(tmp_path, unit, number):
    grid = grey_grid(unit=unit)
    formats.write(grid, tmp_path / "grid.tiff")
    assert formats.read(tmp_path / "grid.tiff") == grid
    with tifffile.TiffFile(tmp_path / "grid.tiff") as file:
        assert file.pages[0].tags["ResolutionUnit"].value == number


def test_extreme_spacings(tmp_path):
    for h in (1e-9, 1e-6, 1 / 3, 1e6, 4e9):
        grid = VoxelGrid(Frame((0, 0, 0), (h, h, h), SHAPE), ramp(np.uint8))
        formats.write(grid, tmp_path / "a.tif")
        assert formats.read(tmp_path / "a.tif") == grid
    far = VoxelGrid(Frame((0, 0, 0), (1e-12, 1, 1), SHAPE), ramp(np.uint8))
    with pytest.raises(FormatError, match=r"spacing: got 1e-12; wanted between 2.3e-10 and 4.3e"):
        formats.write(far, tmp_path / "far.tif")
    assert not (tmp_path / "far.tif").exists()


# --- what others write -------------------------------------------------------------------------

FORMS = ("u1", "i1", "u2", "i2", "u4", "i4", "u8", "f4", "f8")
KINDS = {
    "plain": {},
    "deflate": {"compression": "zlib"},
    "predicted": {"compression": "zlib", "predictor": 2},
    "strips": {"rowsperstrip": 4, "compression": "zlib"},
    "tiles": {"tile": (16, 32), "compression": "zlib"},
    "plain tiles": {"tile": (16, 32)},
    "big": {"bigtiff": True},
    "white is zero": {"photometric": "miniswhite"},
}
WIDE = np.random.default_rng(7).integers(0, 120, (2, 37, 41))


@pytest.mark.parametrize("kind", KINDS)
def test_what_tifffile_writes(tmp_path, kind):
    path = tmp_path / "a.tif"
    for form, order in itertools.product(FORMS, "<>"):
        more = KINDS[kind]
        if form[0] == "f" and "predictor" in more:
            continue
        values = WIDE.astype(form)
        stack = values
        if kind == "white is zero":
            if form[0] != "u":
                continue
            stack = np.iinfo(form).max - values
        tifffile.imwrite(path, stack, byteorder=order, metadata=None, **more)
        image = quiet(path)
        assert np.array_equal(image.values, values.transpose(2, 1, 0)), (form, order)
        assert image.values.dtype == np.dtype(form)


@pytest.mark.parametrize("packed", ["raw", "tiff_lzw", "packbits", "tiff_adobe_deflate"])
@pytest.mark.parametrize("form", ["u1", "b1", "u2", "i4", "f4"])
def test_what_pillow_writes(tmp_path, packed, form):
    values = (WIDE > 60) if form == "b1" else WIDE.astype(form)
    if packed == "raw" or form != "u2":
        pictures = [Picture.fromarray(layer) for layer in values]
        pictures[0].save(
            tmp_path / "a.tif", save_all=True, append_images=pictures[1:], compression=packed
        )
        assert np.array_equal(quiet(tmp_path / "a.tif").values, values.transpose(2, 1, 0))


@pytest.mark.parametrize("order", "<>")
def test_imagej_stacks_with_one_page_for_all(tmp_path, order):
    values = ramp(">u2").transpose(2, 1, 0)
    path = tmp_path / "a.tif"
    more = {
        "resolution": (4, 2 / 3),
        "metadata": {"spacing": 3.0, "unit": "\\u00B5m", "axes": "ZYX"},
    }
    tifffile.imwrite(path, values, imagej=True, byteorder=order, **more)
    whole = image_of(path)
    with tifffile.TiffFile(path) as file:
        page = file.pages[0]
        start = page.dataoffsets[0]
        following = page.offset + 2 + 12 * len(page.tags)
    data = bytearray(path.read_bytes())
    data[following : following + 4] = bytes(4)  # as ImageJ ends a stack beyond 4 GiB
    path.write_bytes(data[: start + values.nbytes])
    for image in (whole, image_of(path)):
        assert np.array_equal(image.values, ramp())
        assert image.spacing == pytest.approx((0.25, 1.5, 3.0))
        assert image.unit == "um"
    path.write_bytes(data[: start + values.nbytes - 1])
    with pytest.raises(FormatError, match="an image of 5 × 6 × 7 voxels would take 420 bytes"):
        image_of(path)


def test_what_tifffile_leaves_out(tmp_path):
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, np.ascontiguousarray(PAGES), truncate=True)
    with tifffile.TiffFile(path) as file:
        assert len(file.pages) == 1
    assert np.array_equal(quiet(path).values, ramp())


@pytest.mark.parametrize(
    ("more", "spacing", "unit"),
    [
        ({"resolution": (200, 100), "resolutionunit": "CENTIMETER"}, (0.005, 0.01), "cm"),
        ({"resolution": (300, 400), "resolutionunit": "INCH"}, (1 / 300, 1 / 400), "in"),
    ],
)
def test_voxel_sizes_of_pictures(tmp_path, more, spacing, unit):
    tifffile.imwrite(tmp_path / "a.tif", PAGES, metadata=None, **more)
    with pytest.warns(FormatWarning, match="no distance of layers; taken as that of columns"):
        image = image_of(tmp_path / "a.tif")
    assert image.spacing == pytest.approx((*spacing, spacing[0]))
    assert image.unit == unit


@pytest.mark.parametrize(
    "more",
    [
        {"resolution": (72, 72), "resolutionunit": "INCH"},
        {"resolution": (96, 96), "resolutionunit": "INCH"},
        {"resolution": (4, 4), "resolutionunit": "NONE"},
        {"resolution": (4, 4), "imagej": True, "metadata": {"unit": "pixel", "axes": "ZYX"}},
    ],
)
def test_voxel_sizes_that_say_nothing(tmp_path, more):
    tifffile.imwrite(tmp_path / "a.tif", np.ascontiguousarray(PAGES), **{"metadata": None, **more})
    assert quiet(tmp_path / "a.tif").spacing == (1.0, 1.0, 1.0)


def test_two_values_and_more(tmp_path):
    path = tmp_path / "a.tif"
    mask = MASK.transpose(2, 1, 0)
    tifffile.imwrite(
        path, np.where(mask, np.uint8(9), np.uint8(4)), imagej=True, resolution=(4, 2 / 3),
        metadata={"spacing": 3.0, "unit": "mm", "axes": "ZYX"},
    )  # fmt: skip
    with pytest.warns(FormatWarning, match="two grey values, 4 and 9; the larger"):
        grid = formats.read(path)
    assert np.array_equal(grid.solid, MASK)
    assert grid.frame.spacing == pytest.approx((0.25, 1.5, 3.0))
    tifffile.imwrite(path, PAGES, metadata=None)
    with (
        pytest.warns(FormatWarning, match="no voxel size"),
        pytest.raises(FormatError, match=r"grey levels, from 0 to .*; wanted a segmented image"),
    ):
        formats.read(path)


@pytest.mark.parametrize(("given", "unit"), [("µm", "um"), ("nm", "nm"), ("mm", "mm")])
def test_the_voxel_size_of_ome(tmp_path, given, unit):
    steps = dict(zip("XYZ", (0.25, 1.5, 3.0), strict=True))
    said = {f"PhysicalSize{axis}": step for axis, step in steps.items()}
    said |= {f"PhysicalSize{axis}Unit": given for axis in "XYZ"}
    path = tmp_path / "a.ome.tif"
    tifffile.imwrite(path, PAGES, ome=True, metadata={"axes": "ZYX", **said})
    image = image_of(path)
    assert np.array_equal(image.values, ramp())
    assert (image.spacing, image.unit) == ((0.25, 1.5, 3.0), unit)
    tifffile.imwrite(path, PAGES, ome=True, metadata={"axes": "ZYX", "PhysicalSizeX": 0.25})
    assert quiet(path).spacing == (1.0, 1.0, 1.0)


def test_layers_that_are_called_channels(tmp_path):
    tifffile.imwrite(tmp_path / "a.tif", np.ascontiguousarray(PAGES), imagej=True)
    with (
        pytest.warns(FormatWarning, match="says 7 channels, 1 frames, 1 slices; taken as layers"),
        pytest.warns(FormatWarning, match="no voxel size"),
    ):
        image = image_of(tmp_path / "a.tif")
    assert np.array_equal(image.values, ramp())


def test_a_resolution_of_nothing_by_nothing(tmp_path):
    tifffile.imwrite(tmp_path / "a.tif", PAGES, metadata=None, resolution=(7, 9))
    data = (tmp_path / "a.tif").read_bytes()
    path = on_disk(tmp_path, "b.tif", data.replace(struct.pack("<II", 7, 1), bytes(8)))
    assert quiet(path).spacing == (1.0, 1.0, 1.0)


def test_one_layer_and_thumbnails(tmp_path):
    with tifffile.TiffWriter(tmp_path / "a.tif") as file:
        file.write(PAGES[0], metadata=None)
        file.write(PAGES[0, :2, :2], metadata=None, subfiletype=1)
    assert np.array_equal(quiet(tmp_path / "a.tif").values, ramp()[:, :, :1])


@pytest.mark.parametrize(
    ("values", "more", "said"),
    [
        (np.zeros((4, 6, 5, 3), "u1"), {"photometric": "rgb"}, "page 1: numbers of a voxel: got 3"),
        (
            np.zeros((4, 6, 5), "u1"),
            {"photometric": "palette", "colormap": np.zeros((3, 256), "u2")},
            "colours: got 'a colour table'; wanted grey values; save it as an 8-bit grey image",
        ),
        (
            np.zeros((4, 6, 5), "c8"),
            {"photometric": "minisblack"},
            "bits and sample format: got '64 and 6'",
        ),
        (
            np.zeros((4, 6, 5), "f2"),
            {"photometric": "minisblack"},
            "bits and sample format: got '16 and 3'",
        ),
        (
            np.zeros((2, 4, 6, 5), "u1"),
            {"imagej": True, "metadata": {"axes": "ZCYX"}},
            "the stack: got '4 channels, 1 frames, 2 slices'; wanted layers of one channel",
        ),
    ],
)
@pytest.mark.filterwarnings("ignore::porous.errors.FormatWarning")
def test_what_is_refused(tmp_path, values, more, said):
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, values, **{"metadata": None, **more})
    with pytest.raises(FormatError, match=said):
        formats.read(path)


def test_pages_that_differ_are_listed(tmp_path):
    with tifffile.TiffWriter(tmp_path / "a.tif") as file:
        for layer in (PAGES[0], PAGES[1], PAGES[2, :4], PAGES[3], PAGES[4].astype("u2")):
            file.write(np.ascontiguousarray(layer), metadata=None)
    said = "pages 3, 5 of 5 are not like the first: page 3 is 5 × 4 of uint8, .*wanted 5 × 6 of"
    with pytest.raises(FormatError, match=said):
        formats.read(tmp_path / "a.tif")


# --- what unpacks ------------------------------------------------------------------------------


def naive_lzw(data, *, clear=3800):
    """Return bytes packed by LZW as TIFF 6.0 says, in words: the dictionary holds byte strings."""
    codes, table, word = [256], {bytes([b]): b for b in range(256)}, b""
    widths, fresh = [9], 258
    for k in range(len(data)):
        byte = data[k : k + 1]
        if word + byte in table:
            word += byte
            continue
        codes.append(table[word])
        widths.append(max(9, fresh.bit_length()))
        table[word + byte] = fresh
        fresh += 1
        word = byte
        if fresh > clear:
            codes.append(256)
            widths.append(max(9, fresh.bit_length()))
            table, fresh = {bytes([b]): b for b in range(256)}, 258
    codes += [table[word], 257] if word else [257]
    widths += [max(9, fresh.bit_length()), max(9, (fresh + 1).bit_length())] if word else [9]
    text = "".join(f"{code:0{width}b}" for code, width in zip(codes, widths, strict=True))
    text += "0" * (-len(text) % 8)
    return bytes(int(text[k : k + 8], 2) for k in range(0, len(text), 8))


def naive_packbits(packed):
    result, i = b"", 0
    while i < len(packed):
        head = packed[i]
        if head < 128:
            result += packed[i + 1 : i + 2 + head]
            i += 2 + head
        elif head == 128:
            i += 1
        else:
            result += packed[i + 1 : i + 2] * (257 - head)
            i += 2
    return result


@pytest.mark.parametrize(
    "data",
    [b"a", b"ab" * 9, b"a" * 9000, bytes(range(256)) * 20, np.random.default_rng(1).bytes(20000)],
    ids=["one", "pairs", "one byte", "ramp", "noise"],
)
def test_lzw_gives_back_what_was_packed(data):
    packed = naive_lzw(data)
    assert lzw(packed, len(data)).tobytes() == data
    assert lzw(packed, len(data) + 5).tobytes() == data
    assert lzw(packed, len(data) // 2).tobytes() == data[: len(data) // 2]


@given(data=st.binary(min_size=1, max_size=300), size=st.integers(0, 5000))
def test_whatever_is_unpacked_stays_within_its_room(data, size):
    assert len(lzw(data, size)) <= size
    assert packbits(data, size).tobytes() == naive_packbits(data)[:size]


# --- by hand -----------------------------------------------------------------------------------


def test_a_stack_by_hand(tmp_path):
    """Two pages in the order of Motorola, the first with its voxels after the second's."""
    tags = [(256, 3, 1, 2 << 16), (257, 3, 1, 1 << 16), (258, 3, 1, 8 << 16), (262, 3, 1, 1 << 16)]

    def page(offset, following):
        more = [(273, 4, 1, offset), (279, 4, 1, 2)]
        rows = b"".join(struct.pack(">HHII", *row) for row in tags + more)
        return struct.pack(">H", 6) + rows + struct.pack(">I", following)

    data = b"MM\0*" + struct.pack(">I", 8) + page(170, 86) + page(168, 0)
    path = on_disk(tmp_path, "a.tif", data.ljust(168, b"\0") + bytes([3, 4, 1, 2]))
    assert quiet(path).values.tolist() == [[[1, 3]], [[2, 4]]]


def test_a_bulk_that_is_damaged(tmp_path):
    grid = grey_grid()
    data = b"".join(tif.write(grid))
    bulk = np.ascontiguousarray(grid.bulk.transpose(2, 1, 0)).tobytes()
    start = data.index(zlib.compress(bulk, 3))
    path = on_disk(tmp_path, "a.tif", data[: start + 40] + b"\x55\xaa" + data[start + 42 :])
    with pytest.raises(FormatError, match="the bulk"):
        formats.read(path)
