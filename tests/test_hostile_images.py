"""Images that are damaged, lie, or are made to harm: the right answer, or one line of why."""

import gzip
import io
import re
import struct
import subprocess
import sys
import warnings
import zlib
from dataclasses import replace

import numpy as np
import pytest
import tifffile
from hypothesis import given, settings
from hypothesis import strategies as st
from image_cases import SHAPE, grey_grid, ramp
from PIL import Image as Picture
from test_hostile import BYTES, SECONDS, attempt

from porous import formats
from porous.errors import MemoryLimitError
from porous.formats import mhd, nrrd, tif
from porous.kernels.lzw import lzw, packbits
from porous.values import Frame, VoxelGrid

MASK = ramp(np.uint8) > 60
BINARY = np.where(MASK, np.uint8(255), np.uint8(0))
BODY = np.ascontiguousarray(BINARY.transpose(2, 1, 0)).tobytes()
GRID = grey_grid()
PLAIN = VoxelGrid(Frame((0.1, 0.2, 0.3), (1, 2, 3), SHAPE), grey_grid().fill)

# --- good files, in every dialect --------------------------------------------------------------


def nrrd_of(body=BODY, *, head=b"", **changes):
    fields = {
        "type": "uint8",
        "dimension": "3",
        "sizes": "5 6 7",
        "space dimension": "3",
        "space directions": "(0.25,0,0) (0,1.5,0) (0,0,3)",
        "space origin": "(0,0,0)",
        "encoding": "raw",
        **{name.replace("_", " "): value for name, value in changes.items()},
    }
    lines = [f"{name}: {value}\n" for name, value in fields.items() if value is not None]
    return b"NRRD0005\n" + head + "".join(lines).encode() + b"\n" + body


def mhd_of(body=BODY, *, head=b"", **changes):
    fields = {
        "ObjectType": "Image",
        "NDims": "3",
        "BinaryData": "True",
        "ElementSpacing": "0.25 1.5 3",
        "DimSize": "5 6 7",
        "ElementType": "MET_UCHAR",
        **changes,
    }
    last = fields.pop("ElementDataFile", "LOCAL")
    lines = [f"{name} = {value}\n" for name, value in fields.items() if value is not None]
    return head + "".join(lines).encode() + f"ElementDataFile = {last}\n".encode() + body


SIZES = {1: "B", 2: "B", 3: "H", 4: "I", 5: "I", 16: "Q"}


def tiff_of(pages=({},), *, order="<", strips=None, last=0):
    """Return a classic TIFF of grey pages, 5 × 6 of uint8, but for the tags that are changed.

    A page is a dictionary of tags to pairs of a type and a list of values, or of a type, a count
    and a value that stands for itself. ``last`` is where the last directory says the next one is.
    """
    strips = strips or [BODY[30 * k : 30 * k + 30] for k in range(len(pages))]
    data = (b"II" if order == "<" else b"MM") + struct.pack(order + "HI", 42, 0)
    link = 4
    for page, strip in zip(pages, strips, strict=True):
        place = len(data)
        data += strip + b"\0" * (len(strip) % 2)
        numbers = (5, 6, place, 6, len(strip))
        tags = {
            **dict(zip((256, 257, 273, 278, 279), ((4, [n]) for n in numbers), strict=True)),
            **dict(zip((258, 259, 262, 277), ((3, [n]) for n in (8, 1, 1, 1)), strict=True)),
            **page,
        }
        entries = b""
        for tag in sorted(tag for tag, value in tags.items() if value is not None):
            kind, *said = tags[tag]
            if len(said) == 2:
                entries += struct.pack(order + "HHII", tag, kind, *said)
                continue
            form = f"{order}{len(said[0])}{SIZES[kind]}"
            value = struct.pack(form, *said[0])
            if len(value) > 4:
                where = struct.pack(order + "I", len(data))
                data += value + b"\0" * (len(value) % 2)
            else:
                where = value.ljust(4, b"\0")
            count = len(said[0]) // (2 if kind == 5 else 1)
            entries += struct.pack(order + "HHI", tag, kind, count) + where
        data = data[:link] + struct.pack(order + "I", len(data)) + data[link + 4 :]
        data += struct.pack(order + "H", len(entries) // 12) + entries
        link = len(data)
        data += struct.pack(order + "I", last)
    return data


def by_tifffile(**more):
    stream = io.BytesIO()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        pages = np.ascontiguousarray(BINARY.transpose(2, 1, 0))
        tifffile.imwrite(stream, pages, **more)
    return stream.getvalue()


def by_pillow(compression):
    stream = io.BytesIO()
    first, *others = (Picture.fromarray(np.ascontiguousarray(p)) for p in BINARY.transpose(2, 1, 0))
    first.save(stream, "TIFF", save_all=True, append_images=others, compression=compression)
    return stream.getvalue()


def ours(form, suffix, grid=GRID):
    if form.FORMAT.write_files is None:
        return {f"a{suffix}": b"".join(form.write(grid))}
    files = form.write_files(grid, f"a{suffix}")
    return {name: b"".join(chunks) for name, chunks in files}


IMAGEJ = {"imagej": True, "metadata": {"axes": "ZYX", "unit": "mm", "spacing": 3.0}}
GOOD = {
    "nrrd-ours": ours(nrrd, ".nrrd"),
    "nhdr-ours": ours(nrrd, ".nhdr"),
    "mhd-ours": ours(mhd, ".mhd"),
    "mha-ours": ours(mhd, ".mha"),
    "tif-ours": ours(tif, ".tif"),
    "nrrd-raw": {"a.nrrd": nrrd_of()},
    "nrrd-text": {"a.nrrd": nrrd_of(" ".join(map(str, BODY)).encode() + b"\n", encoding="text")},
    "mha-raw": {"a.mha": mhd_of()},
    "mhd-zlib": {
        "a.mhd": mhd_of(b"", CompressedData="True", ElementDataFile="a.zraw"),
        "a.zraw": zlib.compress(BODY),
    },
    "tif-plain": {"a.tif": tiff_of([{}] * 7, order=">")},
    "tif-imagej": {"a.tif": by_tifffile(**IMAGEJ, resolution=(4, 2 / 3))},
    "tif-tiles": {"a.tif": by_tifffile(bigtiff=True, tile=(16, 16), compression="zlib")},
    "tif-lzw": {"a.tif": by_pillow("tiff_lzw")},
    "tif-packbits": {"a.tif": by_pillow("packbits")},
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    lzw(b"\x80", 1)  # compiling a kernel is not the file's doing
    packbits(b"\x80", 1)
    return tmp_path_factory.mktemp("images")


def main_of(files):
    """Return the name of the file that is read: the header."""
    return next(n for n in files if n.endswith((".nrrd", ".nhdr", ".mhd", ".mha", ".tif")))


def judged(folder, files):
    for name, data in files.items():
        (folder / name).write_bytes(data)
    outcome, spent, peak = attempt(folder / main_of(files))
    for name in files:
        (folder / name).unlink()
    assert spent < SECONDS
    assert peak < BYTES + 40 * sum(map(len, files.values()))
    return outcome


@pytest.mark.parametrize("name", GOOD)
def test_the_good_files_are_good(folder, name):
    grid = judged(folder, GOOD[name])
    if name.endswith("ours"):
        assert grid == GRID
    else:
        assert np.array_equal(grid.solid, MASK)


# --- the classes -------------------------------------------------------------------------------

BOMB = gzip.compress(bytes(2**27), 9)
ZBOMB = zlib.compress(bytes(2**27), 9)
OFFSETS = struct.pack("<300000I", *range(300000))

NRRD = {
    "sizes of 1e15": (nrrd_of(sizes="100000 100000 100000"), "an image of .* would take 10{15} by"),
    "sizes of 1e30": (nrrd_of(sizes=" ".join(["1" + "0" * 30] * 3)), "would take"),
    "a negative size": (nrrd_of(sizes="5 -6 7"), "sizes: got '5 -6 7'; wanted three numbers of"),
    "no voxels": (nrrd_of(sizes="5 0 7"), "sizes: got '5 0 7'"),
    "a size of words": (nrrd_of(sizes="5 six 7"), "sizes: got 'six'; wanted a whole number"),
    "dimension of two": (nrrd_of(dimension="2"), "dimension and sizes: got '2 and 5 6 7'"),
    "900 axes": (nrrd_of(dimension="900", sizes="1 " * 900), "sizes: got .* wanted three numbers"),
    "four axes": (nrrd_of(dimension="4", sizes="1 5 6 7"), "dimension and sizes.* three axes"),
    "a bomb for few voxels": (nrrd_of(BOMB, encoding="gzip"), "did not decompress to 210 bytes"),
    "a bomb for many voxels": (
        nrrd_of(BOMB[:3000], encoding="gzip", sizes="1000 1000 1000"),
        "would take 1000000000 bytes",
    ),
    "short": (nrrd_of(BODY[:-1]), "would take 210 bytes; the file has 209 left"),
    "no voxels at all": (nrrd_of(b""), "would take 210 bytes; the file has 0 left"),
    "short text": (nrrd_of(b"1 2 3 " * 35, encoding="text"), "would take 210 numbers"),
    "long text": (nrrd_of(b"1 2 3 " * 90, encoding="text"), "more than the 210 numbers"),
    "text too large": (nrrd_of(b"256 " * 210, encoding="text"), "the voxels: got '256 to 256'"),
    "text of nan": (nrrd_of(b"nan " * 210, encoding="text"), "got nan; wanted a whole number"),
    "damaged gzip": (nrrd_of(gzip.compress(BODY)[:-9], encoding="gzip"), "did not decompress"),
    "wrong sum": (nrrd_of(gzip.compress(BODY)[:-8] + bytes(8), encoding="gzip"), "are damaged"),
    "a file elsewhere": (nrrd_of(data_file="/etc/passwd"), "data file: got '/etc/passwd'; wanted"),
    "a file above": (nrrd_of(data_file="../secret.raw"), "data file: got '../secret.raw'; wanted"),
    "a folder": (nrrd_of(data_file=".."), "data file: got '..'; wanted the name of a file"),
    "a link": (nrrd_of(data_file="link.raw"), "data file: got 'link.raw'; wanted a file, not a li"),
    "a long name": (nrrd_of(data_file="x" * 300), "data file: x+: cannot be opened: file name too"),
    "a list": (nrrd_of(data_file="LIST"), "data file: LIST: cannot be opened"),
    "itself": (nrrd_of(data_file="a.nrrd"), "two grey|grey levels"),
    "spacing of nan": (
        nrrd_of(space_directions="(nan,0,0) (0,1,0) (0,0,1)"),
        "space directions: got .*wanted three directions, finite and not zero",
    ),
    "singular": (nrrd_of(space_directions="(0,0,0) (0,1,0) (0,0,1)"), "finite and not zero"),
    "spacing of zero": (
        nrrd_of(space_directions=None, spacings="1 0 1"),
        "image spacing: got .*; wanted three positive lengths",
    ),
    "two directions": (nrrd_of(space_directions="(1,0,0) (0,1,0)"), "3 of three numbers, as in"),
    "no directions": (nrrd_of(space_directions="none none none"), "3 of three numbers"),
    "an origin of two": (nrrd_of(space_origin="(1,2)"), "space origin: got .*three numbers"),
    "an origin of nan": (nrrd_of(space_origin="(nan,0,0)"), "image origin: got"),
    "skip from the end, packed": (
        nrrd_of(gzip.compress(BODY), encoding="gzip", byte_skip="-1"),
        "byte skip: got -1; wanted zero or more, or -1 for raw voxels",
    ),
    "a skip of -2": (nrrd_of(byte_skip="-2"), "byte skip: got -2"),
    "a skip of 1e30": (nrrd_of(byte_skip="1" + "0" * 30), "the voxels would take"),
    "a skip of lines": (nrrd_of(line_skip="9999"), "line skip: got 9999; wanted lines"),
    "a skip of 1e9 lines": (nrrd_of(line_skip="1000000000"), "line skip would take"),
    "a skip before zero": (nrrd_of(line_skip="-1"), "line skip would take|line skip: got -1"),
    "unknown type": (nrrd_of(type="quad"), "type: got 'quad'; wanted one of"),
    "a block": (nrrd_of(type="block"), "type: got 'block'"),
    "unknown order": (nrrd_of(type="short", endian="middle"), "endian: got 'middle'; wanted one"),
    "unknown encoding": (nrrd_of(encoding="bz2"), "encoding: got 'bz2'; wanted one of raw"),
    "a line of a megabyte": (nrrd_of(head=b"#" * 2**20 + b"\n"), "no end of the header within"),
    "a header without end": (b"NRRD0004\n" + b"# x\n" * 10**5, "no end of the header within"),
    "a field twice": (nrrd_of(head=b"sizes: 1 2 3\n"), "the header: got 'sizes'; wanted each fi"),
    "no colon": (nrrd_of(head=b"rubbish\n"), "a line of the header: got 'rubbish'"),
    "no sizes": (nrrd_of(sizes=None), "fields of the header: got .*; wanted sizes as well"),
    "two units": (nrrd_of(space_units='"mm" "um" "mm"'), "units: got .*; wanted one unit for all"),
    "unknown unit": (nrrd_of(space_units='"ell"'), "units: got 'ell'; wanted a unit of length"),
    "another beginning": (b"NRRD0009\n", "its beginning: got .*; wanted NRRD0001"),
    "no text": (b"NRRD0005\n" + bytes(range(256)) * 9, "a line of the header|no end|fields of"),
    "floats of nan": (
        nrrd_of(np.where(MASK, np.nan, 0).astype("<f4").tobytes(), type="float", endian="little"),
        r"grey values: \d+ of them are not finite; wanted numbers",
    ),
}
MHD = {
    "sizes of 1e15": (mhd_of(DimSize="100000 100000 100000"), "an image of .* would take 10{15} b"),
    "a negative size": (mhd_of(DimSize="5 6 -7"), "DimSize: got '5 6 -7'"),
    "no voxels": (mhd_of(DimSize="5 6 0"), "DimSize: got '5 6 0'"),
    "four sizes": (mhd_of(DimSize="5 6 7 8"), "DimSize: got '5 6 7 8'; wanted three numbers"),
    "a million sizes": (mhd_of(DimSize="5 " * 20000), "DimSize: got .* wanted three numbers"),
    "99 axes": (mhd_of(NDims="99"), "NDims: got '99'; wanted 3"),
    "short": (mhd_of(BODY[:-1]), "would take 210 bytes; the file has 209 left"),
    "a file elsewhere": (mhd_of(ElementDataFile="/etc/passwd"), "ElementDataFile: got '/etc/pas"),
    "a file above": (mhd_of(ElementDataFile="../secret.raw"), "ElementDataFile: got '../secret"),
    "a link": (mhd_of(ElementDataFile="link.raw"), "ElementDataFile: .*wanted a file, not a link"),
    "a bulk elsewhere": (
        mhd_of(head=b'Porous = {"porous":1,"bulk":1,"beside":"../secret.raw"}\n'),
        "the bulk: got '../secret.raw'; wanted the name of a file in the same folder",
    ),
    "a list": (mhd_of(ElementDataFile="LIST"), "ElementDataFile: got 'LIST'; wanted one file"),
    "a list of lists": (mhd_of(ElementDataFile="LIST 3D"), "ElementDataFile: got 'LIST 3D'"),
    "nothing": (mhd_of(ElementDataFile=""), "ElementDataFile: got ''; wanted the name"),
    "not there": (mhd_of(ElementDataFile="b.raw"), "ElementDataFile: b.raw: cannot be opened"),
    "spacing of zero": (mhd_of(ElementSpacing="1 0 1"), "ElementSpacing: got '1 0 1'; wanted thr"),
    "spacing of nan": (mhd_of(ElementSpacing="1 nan 1"), "image spacing: got"),
    "spacing of inf": (mhd_of(ElementSpacing="1 inf 1"), "image spacing: got"),
    "spacing of one": (mhd_of(ElementSpacing="1"), "ElementSpacing: got '1'; wanted 3 numbers"),
    "spacing of words": (mhd_of(ElementSpacing="a b c"), "ElementSpacing: got 'a'; wanted a numb"),
    "an offset of nan": (mhd_of(Offset="nan 0 0"), "image origin: got"),
    "turned": (mhd_of(TransformMatrix="0 1 0 1 0 0 0 0 1"), "TransformMatrix: .*resample what is"),
    "a singular matrix": (
        mhd_of(TransformMatrix="0 0 0 0 0 0 0 0 0"),
        "TransformMatrix: .*not zero",
    ),
    "packed size too small": (
        mhd_of(zlib.compress(BODY), CompressedData="True", CompressedDataSize="20"),
        "CompressedDataSize: got 20; wanted",
    ),
    "packed size too large": (
        mhd_of(zlib.compress(BODY), CompressedData="True", CompressedDataSize="99999"),
        "CompressedDataSize would take 99999 bytes",
    ),
    "packed size negative": (
        mhd_of(zlib.compress(BODY), CompressedData="True", CompressedDataSize="-1"),
        "CompressedDataSize: got -1",
    ),
    "a bomb for few voxels": (mhd_of(ZBOMB, CompressedData="True"), "did not decompress to 210 by"),
    "a bomb for many voxels": (
        mhd_of(ZBOMB[:3000], CompressedData="True", DimSize="1000 1000 1000"),
        "would take 1000000000 bytes",
    ),
    "not packed": (mhd_of(CompressedData="True"), "are damaged"),
    "unknown type": (mhd_of(ElementType="MET_OTHER"), "ElementType: got 'MET_OTHER'; wanted one"),
    "a head of 1e30": (mhd_of(HeaderSize="1" + "0" * 30), "HeaderSize would take"),
    "a head of -2": (mhd_of(HeaderSize="-2"), "HeaderSize: got -2"),
    "a line of a megabyte": (
        mhd_of(head=b"Comment = " + b"x" * 2**20),
        "a line of the header: got",
    ),
    "a header without end": (
        b"Comment = x\nA = 1\n" * 9999,
        "a line of the header|each field once",
    ),
    "a field twice": (
        mhd_of(head=b"NDims = 3\n"),
        "the header: got 'NDims'; wanted each field once",
    ),
    "no type": (
        mhd_of(ElementType=None),
        "fields of the header: got .*; wanted elementtype as well",
    ),
    "no text": (b"\0\xff" * 99, "a line of the header: got"),
}
TIFF = {
    "pages in a circle": (tiff_of([{}] * 3, last=38), "its pages run in a circle: after 3 comes"),
    "a page that is itself": (tiff_of(last=38), "its pages run in a circle: after 1 comes"),
    "2^31 by 2^31": (
        tiff_of([{256: (4, [2**31]), 257: (4, [2**31]), 278: (4, [2**31])}]),
        "an image of 2147483648 × 2147483648 × 1 voxels would take",
    ),
    "65529 samples": (tiff_of([{277: (3, [65529])}]), "numbers of a voxel: got 65529; wanted one"),
    "a colour table": (tiff_of([{262: (3, [3])}]), "colours: got 'a colour table'"),
    "a deflate bomb": (
        tiff_of([{259: (3, [8])}], strips=[ZBOMB]),
        "did not decompress to 30 bytes",
    ),
    "a deflate bomb for many voxels": (
        tiff_of(
            [{259: (3, [8]), 256: (4, [60000]), 257: (4, [60000]), 278: (4, [60000])}],
            strips=[ZBOMB[:3000]],
        ),
        "would take 3600000000 bytes",
    ),
    "damaged deflate": (
        tiff_of([{259: (3, [8])}], strips=[zlib.compress(BODY[:30])[:-2]]),
        "did not decompress to 30 bytes",
    ),
    "LZW of nothing": (
        tiff_of([{259: (3, [5])}], strips=[b"\x80\x00\xff\xff"]),
        "its packed bytes are damaged after 1 of 30",
    ),
    "LZW for many voxels": (
        tiff_of(
            [{259: (3, [5]), 256: (4, [60000]), 257: (4, [60000]), 278: (4, [60000])}],
            strips=[b"\x80" * 99],
        ),
        "would take 3600000000 bytes",
    ),
    "LZW of old": (
        tiff_of([{259: (3, [5])}], strips=[b"\x00\x03\x04"]),
        "compression: got 'LZW of before 1992'",
    ),
    "PackBits cut": (
        tiff_of([{259: (3, [32773])}], strips=[b"\x1dabc"]),
        "its packed bytes are damaged after 3 of 30",
    ),
    "JPEG": (tiff_of([{259: (3, [7])}]), "compression: got 7; wanted none .1., LZW"),
    "a strip past the end": (tiff_of([{273: (4, [10**6])}]), "a strip or tile: got 'at 1000000'"),
    "a strip past 2^32": (
        tiff_of([{273: (4, [2**32 - 1]), 279: (4, [2**32 - 1])}]),
        "a strip or tile: got 'at 4294967295'",
    ),
    "a short strip": (tiff_of([{279: (4, [29])}]), "would take 30 bytes; the file has 29 left"),
    "no strips": (tiff_of([{273: None, 279: None}]), "offsets and lengths .*: got '0 and 0'"),
    "too many strips": (tiff_of([{273: (4, [8] * 3)}]), "offsets and lengths .*: got '3 and 1'"),
    "none wide": (tiff_of([{256: (4, [0])}]), "page 1: width and height: got '0 × 6'"),
    "none high": (tiff_of([{257: (4, [0])}]), "width and height: got '5 × 0'"),
    "no rows in a strip": (tiff_of([{278: (4, [0])}]), "rows of a strip: got 0"),
    "2^32 - 1 values": (
        tiff_of([{273: (4, 2**32 - 1, 8)}]),
        "tag 273 would take|its directories lie over each other",
    ),
    "2^32 - 1 letters": (tiff_of([{270: (2, 2**32 - 1, 8)}]), "tag 270 would take"),
    "2^63 tags": (
        b"II+\0\x08\0\0\0" + struct.pack("<QQ", 16, 2**63) + bytes(64),
        "a directory would take 9223372036854775808 tags",
    ),
    "65535 tags": (b"II*\0\x08\0\0\0\xff\xff" + bytes(64), "a directory would take 65535 tags"),
    "a directory past the end": (b"II*\0\xff\xff\xff\xff", "a directory would take"),
    "no directory": (b"II*\0\0\0\0\0", "no image in it"),
    "too many pages": (
        b"II*\0\x08\0\0\0"
        + b"".join(struct.pack("<HHHIII", 1, 305, 3, 1, 0, 26 + 18 * k) for k in range(17000)),
        "the stack would take 16385 pages",
    ),
    "no tags": (b"II*\0\x08\0\0\0" + bytes(6), "a directory: got 'no tags'"),
    "tags twice": (
        tiff_of().replace(struct.pack("<HHI", 277, 3, 1), struct.pack("<HHI", 273, 3, 1)),
        "tags of a page: got 273; wanted each tag once",
    ),
    "pages that share a megabyte": (
        tiff_of(
            [{273: (4, 300000, 8), 279: (4, 300000, 8)}] * 9, strips=[OFFSETS] + [b"a" * 30] * 8
        ),
        "its directories lie over each other: they are longer than the file",
    ),
    "pages that share their strips": (
        tiff_of([{273: (4, [8]), 279: (4, [1000])}] * 9, strips=[bytes(1000)] + [b"a" * 30] * 8),
        "the strips of all pages would take 9000 bytes",
    ),
    "pages unlike each other": (
        tiff_of([{}, {257: (4, [5]), 278: (4, [5])}, {258: (3, [16]), 257: (4, [3])}]),
        "pages 2, 3 of 3 are not like the first: page 2 is 5 × 5 of uint8",
    ),
    "values of many bits": (tiff_of([{258: (3, [12])}]), "bits and sample format: got '12 and 1'"),
    "unlike bits": (tiff_of([{258: (3, [8, 16])}]), "tag 258: got .8, 16.; wanted one whole"),
    "bits of a text": (tiff_of([{258: (5, [8, 1])}]), "tag 258: got|bits and sample"),
    "no bits": (tiff_of([{258: (3, [])}]), "tag 258: got .*; wanted one whole number"),
    "an unknown type": (tiff_of([{258: (99, 1, 8)}]), "type of tag 258: got 99; wanted one of"),
    "a predictor for floats": (
        tiff_of([{317: (3, [2]), 258: (3, [32]), 339: (3, [3])}], strips=[bytes(120)]),
        "predictor: got 2; wanted none",
    ),
    "predictor 3": (tiff_of([{317: (3, [3])}]), "predictor: got 3"),
    "bits from below": (tiff_of([{266: (3, [2])}]), "order of bits: got 2; wanted 1"),
    "white is zero and signed": (tiff_of([{262: (3, [0]), 339: (3, [2])}]), "photometric: got"),
    "a tile of nothing": (
        tiff_of([{322: (4, [0]), 323: (4, [16]), 324: (4, [8]), 325: (4, [30])}]),
        "size of a tile: got '0 × 16'",
    ),
    "a tile of 2^31": (
        tiff_of([{322: (4, [2**31]), 323: (4, [16]), 324: (4, [8]), 325: (4, [30])}]),
        "size of a tile: got",
    ),
    "a tile beyond its bytes": (
        tiff_of([{322: (4, [2**20]), 323: (4, [2**20]), 324: (4, [8]), 325: (4, [30])}]),
        "a strip or tile would take 1099511627776 bytes",
    ),
    "images that are not there": (
        tiff_of([{270: (2, list(b"ImageJ=1.53\nimages=999999999\n\0"))}]),
        "an image of 5 × 6 × 999999999 voxels would take",
    ),
    "images of words": (
        tiff_of([{270: (2, list(b"ImageJ=1.53\nimages=-7\n\0"))}]),
        "images: got '-7'; wanted a whole number",
    ),
    "packed images after one page": (
        tiff_of(
            [{270: (2, list(b"ImageJ=1.53\nimages=7\n\0")), 259: (3, [8])}],
            strips=[zlib.compress(BODY)],
        ),
        "the stack: got 'one page for 7 images'; wanted a page for each",
    ),
    "a bulk that is a bomb": (
        tiff_of(
            [
                {
                    270: (2, list(b'ImageJ=1\nporous={"porous":1,"bulk":1}\n\0')),
                    65110: (1, list(ZBOMB[:9999])),
                }
            ]
        ),
        "the bulk: did not decompress to 30 bytes",
    ),
    "another beginning": (b"GIF89a", "its beginning: got .*; wanted II or MM"),
    "offsets of four bytes in a BigTIFF": (
        b"II+\0\x04\0\0\0" + bytes(24),
        "bytes of an offset: got",
    ),
    "four bytes": (b"II*\0", "a directory would take 8 bytes; the file has 4 left"),
}
CASES = {
    f"{suffix[1:]}, {name}": ({f"a{suffix}": data}, expected)
    for suffix, cases in {".nrrd": NRRD, ".mha": MHD, ".tif": TIFF}.items()
    for name, (data, expected) in cases.items()
}


@pytest.mark.parametrize("name", CASES)
def test_hostile_images(folder, name):
    files, expected = CASES[name]
    secret = folder.parent / "secret.raw"
    secret.write_bytes(BODY)
    if not (folder / "link.raw").is_symlink():
        (folder / "link.raw").symlink_to(secret)
    outcome = judged(folder, files)
    assert isinstance(outcome, str), "it was accepted"
    assert re.search(expected, outcome), outcome


@pytest.mark.parametrize("form", ["uint8", "float"])
def test_a_raw_file_that_is_too_long_is_said_to_be(tmp_path, form):
    kind = {"uint8": "MET_UCHAR", "float": "MET_FLOAT"}[form]
    body = BODY if form == "uint8" else (BINARY.T.astype("<f4")).tobytes()
    (tmp_path / "a.mha").write_bytes(mhd_of(body + b"more", ElementType=kind))
    with pytest.warns(match="4 bytes after the voxels"), pytest.warns(match="two grey values"):
        assert np.array_equal(formats.read(tmp_path / "a.mha").solid, MASK)


def test_an_image_that_would_not_fit_is_refused(tmp_path, monkeypatch):
    shape = (300, 310, 320)  # 30 MB of nothing in 30 kB
    grid = VoxelGrid(Frame((0, 0, 0), (1, 2, 3), shape), np.zeros(shape, np.uint8))
    for suffix in (".nrrd", ".mha", ".tif"):
        formats.write(grid, tmp_path / f"grid{suffix}")
    monkeypatch.setattr("porous.memory.available", lambda: 20_000_000)
    for suffix in (".nrrd", ".mha", ".tif"):
        with pytest.raises(MemoryLimitError, match=r"an image of .* would need .* MiB of memory"):
            formats.read(tmp_path / f"grid{suffix}")


@pytest.mark.parametrize("suffix", [".nrrd", ".mhd", ".tif"])
def test_a_terabyte_of_nothing_is_refused(tmp_path, suffix):
    with (tmp_path / f"sparse{suffix}").open("wb") as stream:
        stream.truncate(2**40)
    with pytest.raises(MemoryLimitError, match="its bytes would need 2 TiB"):
        formats.read(tmp_path / f"sparse{suffix}")
    (tmp_path / "a.mhd").write_bytes(mhd_of(b"", ElementDataFile=f"sparse{suffix}"))
    with pytest.raises(MemoryLimitError, match="its bytes would need 2 TiB"):
        formats.read(tmp_path / "a.mhd")


# --- no other file, little address space -------------------------------------------------------


def test_no_file_is_opened_but_those_that_are_named(tmp_path):
    (tmp_path / "secret.raw").write_bytes(BODY)
    cases = {**{name: files for name, (files, _) in CASES.items()}, **GOOD}
    for number, (name, files) in enumerate(cases.items()):
        place = tmp_path / "batch" / f"{number:03}-{'good' if name in GOOD else 'bad'}"
        place.mkdir(parents=True)
        (place / "link.raw").symlink_to(tmp_path / "secret.raw")
        for file, data in files.items():
            (place / file).write_bytes(data)
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", BATCH, tmp_path / "batch"],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
        stdin=subprocess.DEVNULL,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert int(done.stdout) >= len(cases)


BATCH = """
import os, pathlib, resource, sys
import psutil
from porous import formats
from porous.errors import FormatError
from porous.kernels.lzw import lzw, packbits
formats.formats()
lzw(b"a", 1), packbits(b"a", 1)
opened = []
def watch(event, arguments):
    if event in ("open", "os.exec", "subprocess.Popen", "socket.connect", "pickle.find_class"):
        opened.append(arguments[0])
places = sorted(pathlib.Path(sys.argv[1]).iterdir())
mains = (".nrrd", ".nhdr", ".mhd", ".mha", ".tif")
def all_of_them():
    for place in places:
        (path,) = [path for path in sorted(place.iterdir()) if path.suffix in mains]
        verdict = "good"
        try:
            formats.read(path)
        except FormatError:
            verdict = "bad"
        assert place.name.endswith(verdict), path
used = psutil.Process().memory_info().vms
resource.setrlimit(resource.RLIMIT_AS, (used + 192 * 2**20,) * 2)
all_of_them()  # which loads the modules that Python loads late
sys.addaudithook(watch)
all_of_them()
opened = [str(name) for name in opened if not isinstance(name, int)]  # what is open already
ours = [name for name in opened if name.startswith(sys.argv[1]) and not name.endswith("link.raw")]
system = ("/proc/", "/sys/fs/cgroup/")  # how much memory there is
assert all(name in ours or name.startswith(system) for name in opened), opened
print(len(ours))
"""


# --- files that are cut short, and bits that flip ----------------------------------------------

PIECES = [
    pytest.param(name, file, marks=() if name.endswith("ours") else pytest.mark.slow)
    for name, files in GOOD.items()
    for file in files
]


@pytest.mark.parametrize(("name", "file"), PIECES)
def test_files_that_are_cut_short(folder, name, file):
    files = GOOD[name]
    whole = judged(folder, files)
    between = files[file].rfind(b"\x1f\x8b\x08\0\0\0\0\0")
    for stop in np.linspace(0, len(files[file]), 64, endpoint=False).astype(int).tolist():
        outcome = judged(folder, {**files, file: files[file][:stop]})
        # Where it ends between fill and bulk, the fill is whole, and a warning says what is not.
        rest = replace(whole, bulk=None) if stop == between else whole
        assert isinstance(outcome, str) or outcome == rest, f"cut at {stop}"


@pytest.mark.parametrize(("name", "file"), PIECES)
def test_bits_that_flip(folder, name, file):
    files = GOOD[name]
    rng = np.random.default_rng(zlib.crc32(name.encode()))
    refused = 0
    for turn in range(40):
        damaged = bytearray(files[file])
        # Every other flip hits the head, where the sizes stand.
        place = int(rng.integers(len(damaged) if turn % 2 else min(len(damaged), 400)))
        damaged[place] ^= 1 << int(rng.integers(8))
        refused += isinstance(judged(folder, {**files, file: bytes(damaged)}), str)
    assert refused > 0


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in GOOD if name.endswith("ours")])
def test_no_flip_changes_the_voxels_of_what_we_wrote(folder, name):
    files = GOOD[name]
    for file, data in files.items():
        for place in range(0, len(data), 7):
            damaged = bytearray(data)
            damaged[place] ^= 1 << place % 8
            outcome = judged(folder, {**files, file: bytes(damaged)})
            if not isinstance(outcome, str):
                assert np.array_equal(outcome.fill, GRID.fill), (file, place)
                assert outcome.bulk is None or np.array_equal(outcome.bulk, GRID.bulk)


WORDS = (b"", b"0", b"-1", b"0.5", b"nan", b"inf", b"1e12", b"1e400", b"9" * 40, b"1_0", b"\xff")
WORDS += tuple(str(2**power).encode() for power in (31, 32, 53, 63, 64))


@pytest.mark.parametrize("name", ["nrrd-ours", "nrrd-text", "mhd-ours", "mha-raw"])
@given(changes=st.lists(st.tuples(st.floats(0, 0.999), st.sampled_from(WORDS)), min_size=1))
@settings(max_examples=25)
def test_words_that_are_exchanged(folder, name, changes):
    files = GOOD[name]
    data = files[main_of(files)]
    head, mark, rest = data.partition(b"ElementDataFile" if name[0] == "m" else b"\n\n")
    words = re.split(rb"([\s,:]+)", head)
    for place, word in changes:
        words[int(place * len(words)) // 2 * 2] = word
    judged(folder, {**files, main_of(files): b"".join(words) + mark + rest})


@given(
    tag=st.sampled_from([254, 256, 257, 258, 259, 262, 266, 270, 273, 277, 278, 279, 282, 322]),
    kind=st.integers(0, 19),
    count=st.sampled_from([0, 1, 2, 30, 2**16, 2**31, 2**32 - 1]),
    value=st.sampled_from([0, 1, 2, 5, 8, 30, 255, 2**16, 2**31, 2**32 - 1]),
)
@settings(max_examples=100)
def test_tags_that_say_anything(folder, tag, kind, count, value):
    page = {tag: (kind, count, value)}
    judged(folder, {"a.tif": tiff_of([{}, page])})


@pytest.mark.slow
@pytest.mark.parametrize("name", GOOD)
def test_many_bits_and_bytes_at_once(folder, name):
    files = GOOD[name]
    file = main_of(files)
    rng = np.random.default_rng(len(name))
    for _ in range(100):
        damaged = bytearray(files[file])
        for _ in range(int(rng.integers(1, 6))):
            place, width = int(rng.integers(len(damaged))), int(rng.integers(1, 9))
            kind = rng.integers(3)
            if kind == 0:
                damaged[place : place + width] = rng.bytes(width)
            elif kind == 1:
                del damaged[place : place + width]
            else:
                damaged[place:place] = damaged[place - width : place] * int(rng.integers(1, 4))
        judged(folder, {**files, file: bytes(damaged)})
