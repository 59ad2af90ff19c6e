"""NRRD: what ITK and pynrrd take and give; marks, units and axes."""

import gzip
import json

import numpy as np
import pytest
from image_cases import (
    CORNER,
    SHAPE,
    SPACING,
    first_centre,
    grey_grid,
    in_file_order,
    on_disk,
    ramp,
)

from porous import formats
from porous.errors import FormatError, FormatWarning
from porous.formats import nrrd
from porous.formats.gate import open_source
from porous.values import Frame, VoxelGrid

MASK = ramp(np.uint8) > 60
HEAD = {
    "type": "uint8",
    "dimension": "3",
    "space dimension": "3",
    "sizes": "5 6 7",
    "space directions": "(0.25,0,0) (0,1.5,0) (0,0,3)",
    "space origin": "(-2,0.125,7.5)",
    "encoding": "raw",
}


def header(*, more="", **changes):
    fields = {**HEAD, **{name.replace("_", " "): value for name, value in changes.items()}}
    lines = [f"{name}: {value}" for name, value in fields.items() if value is not None]
    return ("\n".join(["NRRD0004", "# made by a test", *lines]) + f"\n{more}\n").encode()


def body(values):
    return np.ascontiguousarray(np.asarray(values).transpose(2, 1, 0)).tobytes()


def image_of(tmp_path, data, name="a.nrrd"):
    return nrrd.read_image(open_source(on_disk(tmp_path, name, data)))


@pytest.mark.parametrize("suffix", [".nrrd", ".nhdr"])
@pytest.mark.parametrize("bulk", [False, True])
def test_a_grid_reads_back_equal_and_others_see_it(tmp_path, ask, suffix, bulk):
    grid = grey_grid(bulk=bulk)
    path = tmp_path / f"grid{suffix}"
    formats.write(grid, path)
    assert formats.read(path) == grid
    (itk,) = ask("itk", "read", path)
    assert itk["size"] == list(grid.frame.shape)
    assert itk["spacing"] == pytest.approx(grid.frame.spacing, rel=1e-14)
    assert itk["origin"] == pytest.approx(first_centre(grid.frame), rel=1e-14)
    assert itk["direction"] == np.eye(3).ravel().tolist()
    assert (itk["type"], itk["crc32"]) == ("uint8", in_file_order(grid.fill))
    (said,) = ask("nrrd", "read", path)
    assert said["size"] == list(grid.frame.shape)
    assert np.diag(said["directions"]) == pytest.approx(grid.frame.spacing, rel=1e-14)
    assert said["origin"] == pytest.approx(first_centre(grid.frame), rel=1e-14)
    assert (said["units"], said["crc32"]) == (["um"] * 3, in_file_order(grid.fill))


def test_what_pynrrd_writes(tmp_path, ask):
    names = ask("nrrd", "write", tmp_path)
    assert len(names) == 57
    for name in names:
        source = open_source(tmp_path / name)
        if "bzip2" in name:
            with pytest.raises(FormatError, match="encoding: got 'bzip2'; wanted one of raw, gz"):
                nrrd.read_image(source)
            continue
        image = nrrd.read_image(source)
        flipped = ramp()[::-1, :, ::-1] if name == "flipped.nrrd" else ramp()
        assert np.array_equal(image.values, flipped), name
        assert image.values.dtype.itemsize == (8 if "-" not in name else int(name[1]))
        assert (image.spacing, image.unit) == (SPACING, "um")
        low = (-2.0 - 4.5 * 0.25, -0.625, 7.5 - 6.5 * 3) if name == "flipped.nrrd" else CORNER
        assert image.origin == pytest.approx(low, abs=1e-12)
    with pytest.raises(FormatError, match=r"space directions: .*along x, y and z; resample"):
        formats.read(tmp_path / "turned.nrrd")
    plain = nrrd.read_image(open_source(tmp_path / "spacings.nrrd"))
    assert (plain.spacing, plain.origin, plain.unit) == (SPACING, (0.0, 0.0, 0.0), "mm")


@pytest.mark.parametrize(
    ("values", "said"),
    [
        (MASK, "two grey values, 0 and 1"),
        (MASK * np.uint8(255), "two grey values, 0 and 255"),
        (MASK * 1.5 - 2, "two grey values, -2.0 and -0.5"),
        (MASK * 900 + 7, "two grey values, 7 and 907"),
    ],
)
def test_of_two_values_the_larger_is_solid(tmp_path, values, said):
    values = np.asarray(values, values.dtype if values.dtype != bool else np.uint8)
    names = {"u1": "uchar", "f8": "double", "i8": "longlong"}
    kind = names[values.dtype.str[1:]]
    path = on_disk(tmp_path, "a.nrrd", header(type=kind, endian="little") + body(values))
    with pytest.warns(FormatWarning, match=f"{said}; the larger is taken as solid"):
        grid = formats.read(path)
    assert np.array_equal(grid.solid, MASK)
    frame = Frame(CORNER, SPACING, SHAPE)
    assert grid == VoxelGrid.of_solid(MASK, frame)


@pytest.mark.parametrize(("value", "solid"), [(0, False), (1, True), (255, True)])
def test_an_image_of_one_value(tmp_path, value, solid):
    path = on_disk(tmp_path, "a.nrrd", header() + body(np.full(SHAPE, value, np.uint8)))
    with pytest.warns(FormatWarning, match=f"all voxels hold {value}; taken as all"):
        assert (formats.read(path).solid == solid).all()


def test_grey_levels_want_a_threshold(tmp_path):
    path = on_disk(tmp_path, "a.nrrd", header() + body(ramp(np.uint8)))
    levels = len(np.unique(ramp()))
    with pytest.raises(
        FormatError,
        match=rf"got {levels} grey levels, from 0 to \d+; wanted a segmented image of two values",
    ):
        formats.read(path)
    assert np.array_equal(nrrd.read_image(open_source(path)).values, ramp())


@pytest.mark.parametrize(
    ("said", "unit"),
    [('"mm" "mm" "mm"', "mm"), ('"µm" "µm" "µm"', "um"), ('"" "" ""', "mm"), ('"Meter" ""', "m")],
)
def test_units(tmp_path, said, unit):
    image = image_of(tmp_path, header(space_units=said) + body(ramp(np.uint8)))
    assert image.unit == unit


@pytest.mark.parametrize(
    ("changes", "data", "values"),
    [
        ({"byte_skip": "5"}, b"junk!" + body(ramp(np.uint8)), ramp()),
        ({"byte_skip": "-1"}, b"junk" + body(ramp(np.uint8)), ramp()),
        ({"line_skip": "2"}, b"a\nb\n" + body(ramp(np.uint8)), ramp()),
        (
            {"encoding": "gz", "line_skip": "1", "byte_skip": "3"},
            b"a\n" + gzip.compress(b"xyz" + body(ramp(np.uint8))),
            ramp(),
        ),
        ({"sizes": "1 2 3", "encoding": "text"}, b"1 2 3 4 5 255\n", [[[1, 3, 5], [2, 4, 255]]]),
    ],
    ids=["bytes", "from the end", "lines", "both", "text"],
)
def test_what_is_skipped_before_the_voxels(tmp_path, changes, data, values):
    image = image_of(tmp_path, header(**changes) + data)
    assert np.array_equal(image.values, values)


def test_windows_lines_old_names_and_data_beside(tmp_path):
    on_disk(tmp_path, "voxels.bin", body(ramp(np.uint8)))
    head = header(datafile="voxels.bin").rstrip(b"\n").replace(b"\n", b"\r\n")
    assert np.array_equal(image_of(tmp_path, head, "a.nhdr").values, ramp())


@pytest.mark.parametrize("suffix", [".nrrd", ".mha"])
def test_what_another_program_changed_is_not_what_we_wrote(tmp_path, ask, suffix):
    ours = grey_grid(unit="mm")
    formats.write(ours, tmp_path / f"ours{suffix}")
    ask("itk", "change", tmp_path / f"ours{suffix}", tmp_path)
    with pytest.warns(FormatWarning, match="the bulk is not in it any more"):
        same = formats.read(tmp_path / f"same{suffix}")
    plain = VoxelGrid(ours.frame, ours.fill, None, ours.sampling, ours.hausdorff, 0.125)
    assert same == plain
    with (
        pytest.warns(FormatWarning, match="voxels are not those that porous wrote"),
        pytest.raises(FormatError, match=r"grey levels, from .*segmented image"),
    ):
        formats.read(tmp_path / f"cropped{suffix}")
    with (
        pytest.warns(FormatWarning, match="voxels are not those that porous wrote"),
        pytest.warns(FormatWarning, match="two grey values, 0 and 1; the larger"),
    ):
        binary = formats.read(tmp_path / f"binary{suffix}")
    assert np.array_equal(binary.solid, ours.solid)
    assert binary.sampling == "centre"


def test_what_the_fields_say_counts_more_than_the_mark(tmp_path):
    grid = grey_grid(bulk=False)
    formats.write(grid, tmp_path / "a.nrrd")
    data = (tmp_path / "a.nrrd").read_bytes()
    old = str(first_centre(grid.frame)[0]).encode()
    assert data.count(old) == 1
    moved = formats.read(on_disk(tmp_path, "b.nrrd", data.replace(old, b"100.0")))
    assert moved.frame.origin[0] == pytest.approx(100 - 1 / 6)
    assert moved.frame.start == (0, 0, 0)
    assert np.array_equal(moved.fill, grid.fill)
    assert moved.frame.periodic == grid.frame.periodic


def test_a_bulk_that_was_changed_is_refused(tmp_path):
    grid = grey_grid()
    formats.write(grid, tmp_path / "a.nhdr")
    packed = tmp_path / "a.raw.gz"
    first = len(gzip.compress(b""))
    data = packed.read_bytes()
    start = data.index(data[:4], first)
    other = gzip.compress(body(255 - grid.bulk))
    on_disk(tmp_path, "a.raw.gz", data[:start] + other)
    with pytest.raises(FormatError, match="the bulk is damaged: it is not what porous wrote"):
        formats.read(tmp_path / "a.nhdr")


@pytest.mark.parametrize("text", ["{", "[" * 3000, "1", '{"porous":2}', "x" * 5000])
def test_a_mark_that_says_nothing_is_none(tmp_path, text):
    mask = body(MASK * np.uint8(1))
    path = on_disk(tmp_path, "a.nrrd", header(more=f"porous:={text}\n") + mask)
    with pytest.warns(FormatWarning, match="two grey values, 0 and 1"):
        assert np.array_equal(formats.read(path).solid, MASK)


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("origin", [1, 2], "frame origin: got .1, 2.; wanted three numbers"),
        ("unit", 7, "unit: got '7'"),
        ("sampling", [], "sampling: got"),
        ("hausdorff", "far", "porous' mark: "),
        ("spacing", None, "frame spacing: got None"),
        ("periodic", [0, 1, 2], "frame periodic"),
    ],
)
def test_a_mark_that_lies(tmp_path, name, value, said):
    grid = grey_grid(bulk=False)
    formats.write(grid, tmp_path / "a.nrrd")
    data = (tmp_path / "a.nrrd").read_bytes()
    start = data.index(b"porous:=") + 8
    stop = data.index(b"\n", start)
    entries = {**json.loads(data[start:stop]), name: value}
    changed = data[:start] + json.dumps(entries).encode() + data[stop:]
    with pytest.raises(FormatError, match=said):
        formats.read(on_disk(tmp_path, "b.nrrd", changed))
    del entries[name]
    missing = data[:start] + json.dumps(entries).encode() + data[stop:]
    with pytest.raises(FormatError, match=f"porous' mark: .*; wanted {name} as well"):
        formats.read(on_disk(tmp_path, "b.nrrd", missing))


def test_a_name_that_a_header_cannot_say(tmp_path):
    with pytest.raises(FormatError, match=r"a name: got .*; wanted one of plain letters"):
        formats.write(grey_grid(), tmp_path / "maß.nhdr")
    assert list(tmp_path.iterdir()) == []
    formats.write(grey_grid(), tmp_path / "maß.nrrd")
    assert formats.read(tmp_path / "maß.nrrd") == grey_grid()
