"""Images that are no good, from the command line: one line, exit code 2, nothing is lost."""

import importlib.util
import json
import os
import re
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
import tifffile
from scipy import ndimage
from skimage.filters import threshold_otsu

from porous.cli import main

GREY = np.random.default_rng(4).integers(0, 4000, (6, 7, 8)).astype(np.uint16)
RECIPE = """
format = 1
[model]
kind = "image"
path = "{name}"
{more}
"""
OTSU = 'threshold = "otsu"'


def stack(values, path):
    tifffile.imwrite(path, values)
    return path.read_bytes()


def mhd(size, kind="MET_USHORT"):
    return (
        f"ObjectType = Image\nNDims = 3\nDimSize = {size}\nElementSpacing = 1 1 1\n"
        f"ElementType = {kind}\nElementDataFile = LOCAL\n"
    ).encode()


def bomb():
    """A TIFF of a few kilobytes that says it is 20 000 × 20 000 pixels, and packs 3 GB of them."""
    packed = zlib.compress(bytes(3_000_000), 9)
    tags = [(256, 4, 20000), (257, 4, 20000), (258, 3, 8), (259, 3, 8), (262, 3, 1)]
    tags += [(273, 4, 8), (277, 3, 1), (278, 4, 20000), (279, 4, len(packed))]
    place = 8 + len(packed)
    body = b"".join(struct.pack("<HHII", tag, kind, 1, value) for tag, kind, value in tags)
    return b"II*\0" + struct.pack("<I", place) + packed + struct.pack("<H", 9) + body + bytes(4)


def as_is(values):
    return lambda path: stack(values, path)


CASES = {
    "truncated": (
        lambda path: stack(GREY, path)[:-100],
        OTSU,
        "a directory would take .*; the file has",
    ),
    "cut in its head": (lambda path: stack(GREY, path)[:6], OTSU, "a directory would take"),
    "empty": (lambda _: b"", OTSU, "is empty"),
    "no image at all": (lambda _: b"hello", OTSU, "its beginning: got .*hell"),
    "all one phase": (
        as_is(np.full_like(GREY, 7)),
        OTSU,
        "all grey values are 7; there is nothing",
    ),
    "all one value": (as_is(np.full_like(GREY, 7)), "", "all of its voxels hold 7; wanted two"),
    "one voxel": (as_is(GREY[:1, :1, :1]), OTSU, "got 1 × 1 × 1 voxels, which is flat"),
    "a 2-D image": (as_is(GREY[0]), OTSU, "got 8 × 7 × 1 voxels, which is flat; wanted a stack"),
    "nothing but NaN": (as_is(np.full(GREY.shape, np.nan, "f4")), OTSU, "none of 336 is a finite"),
    "NaN in a mask": (
        as_is(np.where(GREY > 999, 1, np.nan).astype("f4")),
        "",
        "voxels hold no number: that is no image of two values",
    ),
    "no threshold": (as_is(GREY), "", 'got none for an image of .* wanted threshold = "otsu"'),
    "a threshold above": (as_is(GREY), "threshold = 5000", "got 5000, which selects none of 336"),
    "a threshold below": (as_is(GREY), "threshold = -1", "got -1, which selects all of 336"),
    "limits outside": (as_is(GREY), "threshold = [4000, 5e3]", r"got \[4000.0, 5000.0\], which"),
    "a region outside": (
        as_is(GREY),
        f"{OTSU}\nregion = {{ lower = [0, 0, 0], upper = [9, 7, 6] }}",
        r"region: got voxels \[0, 0, 0\] to \[9, 7, 6\]; wanted .* \[8, 7, 6\]",
    ),
    "a flat region": (
        as_is(GREY),
        f"{OTSU}\nregion = {{ lower = [0, 0, 2], upper = [8, 7, 3] }}",
        "got 8 × 7 × 1 voxels, which is flat",
    ),
    "a bomb": (lambda _: bomb(), OTSU, "did not decompress to 400000000 bytes|would take"),
    "colours": (
        as_is(np.zeros((6, 7, 3), np.uint8)),
        OTSU,
        "numbers of a voxel: got 3; wanted one grey value",
    ),
    "raw that is too short": (lambda _: mhd("8 7 6") + GREY.tobytes()[:-1], OTSU, "672.*671"),
    "raw of another type": (
        lambda _: mhd("8 7 6", "MET_FLOAT") + GREY.tobytes(),
        OTSU,
        "1344.*672",
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_a_bad_image(name, tmp_path, monkeypatch, capsys):
    make, more, said = CASES[name]
    monkeypatch.chdir(tmp_path)
    file = "scan.mha" if name.startswith("raw") else "scan.tif"
    (tmp_path / file).write_bytes(make(tmp_path / "made.tif"))
    (tmp_path / "scan.toml").write_text(RECIPE.format(name=file, more=more))
    there = {"mine.txt": b"stays"}
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine.txt").write_bytes(there["mine.txt"])
    assert main(["make", "scan.toml", "-o", "out"]) == 2
    complaint = capsys.readouterr().err
    assert complaint.count("\n") == 1
    assert "scan." in complaint
    assert re.search(said, complaint), complaint
    assert {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir()} == there


def test_holes_between_levels_do_no_harm(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    few = np.random.default_rng(1).choice([0, 16, 32, 65520], GREY.shape).astype(np.uint16)
    tifffile.imwrite("scan.tif", few)
    told = ["--set", "model.threshold=otsu", "--set", "model.spacing=0.01", "--only", "model"]
    assert main(["make", "scan.tif", "-o", "out", *told]) == 0
    assert "threshold by Otsu at 32776" in capsys.readouterr().out


def test_measuring_a_grey_image_says_what_to_do(tmp_path, capsys):
    tifffile.imwrite(tmp_path / "scan.tif", GREY)
    assert main(["measure", str(tmp_path / "scan.tif")]) == 2
    complaint = capsys.readouterr().err.splitlines()[-1]
    assert "grey levels, from" in complaint
    assert "porous make FILE --set model.threshold=otsu -o FOLDER" in complaint


@pytest.mark.slow
def test_snow_goes_from_tiff_to_report(tmp_path, monkeypatch, capsys):
    """X-ray tomography of snow, as the package spam ships it: ice in one piece, air in another."""
    spam = importlib.util.find_spec("spam")
    places = list(spam.submodule_search_locations or ()) if spam else []
    places.append(os.environ.get("POROUS_SPAM", tmp_path))
    known = [Path(place) / "data" / "snow" / "snow.tif" for place in places]
    snow = next((path for path in known if path.is_file()), None)
    if snow is None:
        pytest.skip("the package spam is not here, nor is POROUS_SPAM where it lies unpacked")
    monkeypatch.chdir(tmp_path)
    told = ["model.threshold=otsu", "model.spacing=15.0", "model.unit=um", "clean.islands=50"]
    told += ["model.region={lower=[0,0,0],upper=[44,40,36]}", "volume.method=none"]
    told = [word for value in told for word in ("--set", value)]
    assert main(["make", str(snow), "-o", "out", *told]) == 0
    values = tifffile.imread(snow)[:36, :40, :44]
    levels, counts = np.unique(values, return_counts=True)
    n, total = np.cumsum(counts)[:-1], np.cumsum(counts * levels.astype(float))
    apart = (total[-1] / values.size - total[:-1] / n) ** 2 * n / (values.size - n)
    ice = values > levels[apart.argmax()]
    # scikit-image reckons with 24 bits, so its own threshold is a few levels off.
    assert ice.mean() == pytest.approx((values > threshold_otsu(values)).mean(), abs=1e-4)
    labels, count = ndimage.label(ice)
    sizes = np.bincount(labels.ravel())[1:]
    small = int((sizes < 50).sum())
    assert f"clean.islands: {small} of {count} pieces of solid" in capsys.readouterr().out
    rows = json.loads(Path("out/measures.json").read_text())["measures"]
    rows = {(row["name"], row["method"]): row for row in rows}
    share = rows["porosity", "voxel count"]
    kept = ice.sum() - sizes[sizes < 50].sum()
    assert share["value"] == pytest.approx(1 - kept / ice.size, rel=1e-12)
    assert rows["components", "voxel count"]["value"] == count - small
    assert rows["through_porosity_z", "voxel count"]["value"] > 0.99 * share["value"]
    assert rows["volume", "voxel count"]["value"] == pytest.approx(kept * 15**3)
    assert rows["volume", "voxel count"]["unit"] == "um³"
    page = Path("out/report.html").read_text()
    assert "threshold by Otsu" in page
    assert "clean.islands" in page
