"""MetaImage: what ITK takes and gives, in one file and in two."""

import zlib
from dataclasses import replace

import numpy as np
import pytest
from image_cases import (
    CENTRE,
    CORNER,
    SPACING,
    first_centre,
    grey_grid,
    in_file_order,
    on_disk,
    ramp,
)

from porous import formats
from porous.errors import FormatError, FormatWarning
from porous.formats import mhd, nrrd
from porous.formats.gate import open_source

HEAD = {
    "ObjectType": "Image",
    "NDims": "3",
    "BinaryData": "True",
    "BinaryDataByteOrderMSB": "False",
    "CompressedData": "False",
    "TransformMatrix": "1 0 0 0 1 0 0 0 1",
    "Offset": "-2 0.125 7.5",
    "ElementSpacing": "0.25 1.5 3",
    "DimSize": "5 6 7",
    "ElementType": "MET_UCHAR",
    "ElementDataFile": "LOCAL",
}
BODY = np.ascontiguousarray(ramp(np.uint8).transpose(2, 1, 0)).tobytes()


def header(**changes):
    fields = {**HEAD, **changes}
    last = fields.pop("ElementDataFile")
    lines = [f"{name} = {value}" for name, value in fields.items() if value is not None]
    return "\n".join([*lines, f"ElementDataFile = {last}\n"]).encode()


def image_of(tmp_path, data, name="a.mha"):
    return mhd.read_image(open_source(on_disk(tmp_path, name, data)))


@pytest.mark.parametrize("unit", ["mm", "um", "m"])
@pytest.mark.parametrize("suffix", [".mhd", ".mha"])
@pytest.mark.parametrize("bulk", [False, True])
def test_a_grid_reads_back_equal(tmp_path, suffix, bulk, unit):
    grid = grey_grid(bulk=bulk, unit=unit)
    formats.write(grid, tmp_path / f"grid{suffix}")
    assert formats.read(tmp_path / f"grid{suffix}") == grid
    beside = {"grid.mhd", "grid.raw", *(["grid.bulk.raw"] if bulk else [])}
    assert {p.name for p in tmp_path.iterdir()} == (beside if suffix == ".mhd" else {"grid.mha"})


def test_itk_sees_it_in_millimetres(tmp_path, ask):
    grid = grey_grid(unit="um")
    for suffix in (".mhd", ".mha"):
        formats.write(grid, tmp_path / f"grid{suffix}")
    for told in ask("itk", "read", tmp_path / "grid.mhd", tmp_path / "grid.mha"):
        assert told["size"] == list(grid.frame.shape)
        assert told["spacing"] == pytest.approx([h / 1000 for h in grid.frame.spacing], rel=1e-12)
        centre = [c / 1000 for c in first_centre(grid.frame)]
        assert told["origin"] == pytest.approx(centre, rel=1e-12)
        assert told["direction"] == np.eye(3).ravel().tolist()
        assert (told["type"], told["crc32"]) == ("uint8", in_file_order(grid.fill))


def test_what_itk_writes(tmp_path, ask):
    names = ask("itk", "write", tmp_path)
    assert len(names) == 72
    for name in names:
        reader = mhd if name[-4:] in (".mhd", ".mha") else nrrd
        image = reader.read_image(open_source(tmp_path / name))
        assert np.array_equal(image.values, ramp()), name
        assert image.values.dtype == np.dtype(name.split("-")[0])
        assert image.spacing == pytest.approx(SPACING)
        assert image.origin == pytest.approx(CORNER)
        assert image.unit == "mm"


@pytest.mark.parametrize(
    ("changes", "data"),
    [
        ({}, BODY),
        ({"HeaderSize": "3"}, b"abc" + BODY),
        ({"HeaderSize": "-1"}, b"abc" + BODY),
        ({"CompressedData": "True"}, zlib.compress(BODY)),
        ({"Offset": None, "Position": "-2 0.125 7.5"}, BODY),
        ({"ElementSpacing": None, "ElementSize": "0.25 1.5 3"}, BODY),
        ({"DistanceUnits": "um", "Comment": "of a scan"}, BODY),
    ],
)
def test_dialects(tmp_path, changes, data):
    image = image_of(tmp_path, header(**changes) + data)
    assert np.array_equal(image.values, ramp())
    assert (image.spacing, image.origin) == (SPACING, CORNER)
    assert image.unit == changes.get("DistanceUnits", "mm")


def test_big_numbers_first_and_axes_that_run_backwards(tmp_path):
    data = np.ascontiguousarray(ramp(">i2").transpose(2, 1, 0)).tobytes()
    head = header(
        ElementType="MET_SHORT", BinaryDataByteOrderMSB="True", TransformMatrix="1 0 0 0 -1 0 0 0 1"
    )
    image = image_of(tmp_path, head + data)
    assert np.array_equal(image.values, ramp()[:, ::-1])
    assert image.origin == pytest.approx((CORNER[0], CENTRE[1] - 5.5 * 1.5, CORNER[2]))


def test_a_header_that_was_moved_without_its_bulk(tmp_path):
    grid = grey_grid()
    formats.write(grid, tmp_path / "grid.mhd")
    (tmp_path / "grid.bulk.raw").unlink()
    with pytest.warns(FormatWarning, match="the bulk is not in it any more; porosity will refer"):
        assert formats.read(tmp_path / "grid.mhd") == replace(grid, bulk=None)
    (tmp_path / "grid.bulk.raw").symlink_to(tmp_path / "grid.raw")
    with pytest.raises(FormatError, match=r"the bulk: got 'grid\.bulk\.raw'; wanted a file, not a"):
        formats.read(tmp_path / "grid.mhd")


def test_no_place_means_that_the_corner_is_at_zero(tmp_path):
    assert image_of(tmp_path, header(Offset=None) + BODY).origin == (0.0, 0.0, 0.0)


def test_bytes_after_the_voxels(tmp_path):
    on_disk(tmp_path, "a.raw", BODY + b"more")
    path = on_disk(tmp_path, "a.mhd", header(ElementDataFile="a.raw"))
    with pytest.warns(FormatWarning, match="4 bytes after the voxels; passed over"):
        assert np.array_equal(mhd.read_image(open_source(path)).values, ramp())


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"BinaryData": "False"}, "BinaryData: got 'False'; wanted True: voxels in text"),
        ({"ElementNumberOfChannels": "3"}, "ElementNumberOfChannels: got '3'; wanted 1"),
        ({"TransformMatrix": "0 1 0 1 0 0 0 0 1"}, "TransformMatrix: .*along x, y and z"),
        ({"TransformMatrix": "2 0 0 0 1 0 0 0 1"}, "TransformMatrix: .*directions of length 1"),
        ({"ElementDataFile": "LIST"}, "ElementDataFile: got 'LIST'; wanted one file"),
        ({"ElementDataFile": "a%03d.raw 1 7 1"}, "ElementDataFile: .*; wanted one file"),
        ({"DistanceUnits": "ell"}, "DistanceUnits: got 'ell'; wanted a unit of length"),
        ({"ObjectType": "Tube"}, "ObjectType: got 'Tube'; wanted Image"),
        ({"CompressedData": "perhaps"}, "compresseddata: got 'perhaps'; wanted True or False"),
    ],
)
def test_what_is_refused(tmp_path, changes, said):
    path = on_disk(tmp_path, "a.mha", header(**changes) + BODY)
    with pytest.raises(FormatError, match=said):
        formats.read(path)


def test_a_name_that_a_header_cannot_say(tmp_path):
    with pytest.raises(FormatError, match=r"a name: got .*; wanted one of plain letters"):
        formats.write(grey_grid(), tmp_path / "ma\nß.mhd")
    assert list(tmp_path.iterdir()) == []
