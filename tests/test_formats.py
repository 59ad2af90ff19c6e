"""What is written reads back, by us and by the programs of others; and the other way round."""

import json
import pickle
import re
import subprocess
import sys
import zipfile
from functools import cache
from pathlib import Path

import hypothesis.extra.numpy as hnp
import meshio
import numpy as np
import programs
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

import porous.formats
from porous import formats
from porous.errors import FormatError, FormatWarning
from porous.formats import _registry, ply, stl
from porous.values import Block, Frame, Part, SurfaceMesh, VolumeMesh, VoxelGrid
from porous.values.units import METRES

EXACT = {
    VoxelGrid: (".vti", ".npz", ".nrrd", ".nhdr", ".mhd", ".mha", ".tif"),
    VolumeMesh: (".vtu",),
    SurfaceMesh: (".ply", ".obj"),
}
"""What reads back equal."""

# --- values of all kinds -----------------------------------------------------------------------

units = st.sampled_from(sorted(METRES))
lengths = st.floats(1e-6, 1e6)
places = st.floats(-1e6, 1e6)
names = st.text(
    st.characters(codec="utf-8", exclude_categories=("C", "Z")), min_size=1, max_size=12
)


@st.composite
def grids(draw):
    shape = draw(st.tuples(*[st.integers(1, 7)] * 3).filter(lambda s: len(set(s)) > 1))
    frame = Frame(
        draw(st.tuples(places, places, places)),
        draw(st.tuples(lengths, lengths, lengths)),
        shape,
        draw(st.tuples(st.booleans(), st.booleans(), st.booleans())),
        draw(units),
        draw(st.tuples(*[st.integers(0, 10**6)] * 3)),
    )
    fills = hnp.arrays(np.uint8, shape)
    sampling = draw(st.sampled_from(["fill", "centre", "cover"]))
    hausdorff = draw(st.none() | st.floats(0, 1e9))
    return VoxelGrid(frame, draw(fills), draw(st.none() | fills), sampling, hausdorff)


@st.composite
def surfaces(draw):
    points = draw(hnp.arrays(np.float64, st.tuples(st.integers(3, 9), st.just(3)), elements=places))
    count = draw(st.integers(1, 12))
    corners = st.integers(0, len(points) - 1)
    triangles = draw(hnp.arrays(np.int64, (count, 3), elements=corners))
    parts = tuple(draw(st.lists(names, min_size=1, max_size=4, unique=True)))
    labels = draw(hnp.arrays(np.int16, count, elements=st.integers(0, len(parts) - 1)))
    return SurfaceMesh(points, triangles, draw(units), labels, parts)


@st.composite
def volumes(draw):
    points = draw(hnp.arrays(np.float64, st.tuples(st.integers(1, 9), st.just(3)), elements=places))
    corners = st.integers(0, len(points) - 1)
    sizes = {"tet4": 4, "hex8": 8, "tet10": 10, "wed6": 6}
    shapes = draw(st.lists(st.sampled_from(sorted(sizes)), max_size=4))
    blocks = [
        Block(s, draw(hnp.arrays(np.int64, (draw(st.integers(0, 4)), sizes[s]), elements=corners)))
        for s in shapes
    ]
    cells = sum(len(block.cells) for block in blocks)
    numbers = st.integers(-(2**63), 2**63 - 1)
    tags = {
        name: draw(hnp.arrays(np.int64, cells, elements=numbers))
        for name in draw(st.lists(names, max_size=3, unique=True))
    }
    parts = {name: draw(members(len(points), cells)) for name in draw(st.sets(names, max_size=4))}
    return VolumeMesh(points, tuple(blocks), tags, parts, draw(units))


@st.composite
def members(draw, points, cells):
    kind = draw(st.sampled_from(["nodes", "faces", "cells", "pairs"]))
    limit = points if kind in ("nodes", "pairs") else cells
    chosen = draw(st.lists(st.integers(0, limit - 1), max_size=5)) if limit else []
    if kind == "faces":  # every shape has four faces or more
        return Part(kind, np.array([(m, draw(st.integers(0, 3))) for m in chosen]).reshape(-1, 2))
    if kind == "pairs":
        return Part(kind, np.array([(m, points - 1 - m) for m in chosen]).reshape(-1, 2))
    return Part(kind, np.array(chosen, dtype=np.int64))


def ball(*, unit="mm", shift=(0.0, 0.0, 0.0), scale=(1.0, 2.0, 3.0)):
    """Return an ellipsoid whose triangles have three parts."""
    mesh = trimesh.creation.icosphere(subdivisions=2)
    labels = (np.arange(len(mesh.faces)) % 3).astype(np.int16)
    parts = ("WALL", "XMIN", "a part")
    return SurfaceMesh(mesh.vertices * scale + np.array(shift), mesh.faces, unit, labels, parts)


def noise(shape=(3, 4, 5), **more):
    rng = np.random.default_rng(1)
    frame = Frame((0.1, -0.2, 1 / 3), (1 / 3, 2.0, 3.5), shape, **more)
    return VoxelGrid(frame, rng.integers(0, 256, shape).astype(np.uint8))


def two_cells():
    """Return a hexahedron with a tetrahedron and a quadratic one upon it, tagged and with parts."""
    points = np.array(
        [
            *([0, 0, 0], [2, 0, 0], [2, 3, 0], [0, 3, 0], [0, 0, 4], [2, 0, 4], [2, 3, 4]),
            *([0, 3, 4], [1, 1, 6], [1, 0, 0], [1, 1.5, 0], [0, 1.5, 0]),
            *([0.5, 0.5, 3], [1.5, 0.5, 3], [0.5, 2, 3]),
        ],
        dtype=float,
    )
    tets = Block("tet4", np.array([[4, 5, 6, 8]]))
    hexes = Block("hex8", np.array([[0, 1, 2, 3, 4, 5, 6, 7]]))
    curved = Block("tet10", np.array([[0, 1, 3, 8, 9, 10, 11, 12, 13, 14]]))
    tags = {"phase": np.array([1, 2, 3]), "body": np.array([-1, 0, 2**60])}
    parts = {
        "ZMIN": Part("nodes", np.array([0, 1, 2, 3])),
        "ZMIN_FACES": Part("faces", np.array([[1, 0]])),
        "SOLID": Part("cells", np.array([0, 1, 2])),
        "NOTHING": Part("cells", np.zeros(0, dtype=np.int64)),
    }
    return VolumeMesh(points, (tets, hexes, curved), tags, parts, "cm")


def round_trip(folder, value, suffix):
    path = folder / f"value{suffix}"
    formats.write(value, path)
    return formats.read(path)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("formats")


# --- the registry ------------------------------------------------------------------------------


def test_every_file_of_the_folder_is_a_format():
    place = Path(porous.formats.__file__).parent
    stems = {path.stem for path in place.glob("*.py")} - {"gate"}
    rows = formats.formats()
    named = {row.suffix[1:].replace(".", "_") for row in rows}
    assert {_registry.SPELLED.get(name, name) for name in named} == {
        stem for stem in stems if not stem.startswith("_")
    }
    assert [row.suffix for row in rows] == sorted(row.suffix for row in rows)
    assert {".stl", ".ply", ".obj", ".vti", ".vtu", ".npz", ".inp", ".msh"} <= {
        row.suffix for row in rows
    }
    for row in rows:
        assert (row.reads is None) == (row.read is None)
        assert bool(row.writes) == (row.write is not None or row.write_files is not None)


def test_the_page_of_formats_lists_each_as_it_is():
    page = Path(__file__).parent.parent / "docs" / "formats.md"
    found = re.findall(
        r"^\| `(\.[\w.]+)` \| (.+?) \| (.+?) \| (.+?) \|", page.read_text("utf-8"), re.M
    )
    assert found == [
        (
            row.suffix,
            row.name,
            row.reads.__name__ if row.reads else "–",
            ", ".join(kind.__name__ for kind in row.writes) or "–",
        )
        for row in formats.formats()
    ]


def test_listing_formats_imports_nothing_heavy():
    program = """
import sys, json, porous.formats as formats
first = sorted(m for m in sys.modules if m.startswith("porous.formats."))
formats.formats()
heavy = {"scipy", "skimage", "numba", "pyvista", "vtk", "pydantic", "pytetwild", "manifold3d"}
print(json.dumps([first, sorted(heavy & set(sys.modules))]))
"""
    done = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        check=True,
        stdin=subprocess.DEVNULL,
        timeout=120,
    )
    first, heavy = json.loads(done.stdout)
    assert first == ["porous.formats._registry", "porous.formats.gate"]
    assert heavy == []


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("scan.raw", r"unknown format '.raw'; there are .*\.npz, .*\.ply, .*\.stl, .*\.vti"),
        ("part.stp", "unknown format '.stp'; did you mean .stl\\? There are"),
        ("part", "the name has no suffix to tell its format; there are"),
        (".stl", "no suffix"),
    ],
)
def test_unknown_formats_list_what_there_is(tmp_path, name, said):
    (tmp_path / name).write_bytes(b"x")
    with pytest.raises(FormatError, match=said):
        formats.read(tmp_path / name)
    with pytest.raises(FormatError, match=said):
        formats.write(noise(), tmp_path / f"new-{name}" if name != ".stl" else tmp_path / name)


def test_a_value_that_the_format_cannot_hold(tmp_path):
    with pytest.raises(
        FormatError, match=r"a \.stl file cannot hold a VoxelGrid; wanted one of .*\.npz, .*\.vti$"
    ):
        formats.write(noise(), tmp_path / "grid.stl")
    with pytest.raises(FormatError, match=r"cannot hold a SurfaceMesh; .*\.obj, \.ply, \.stl$"):
        formats.write(ball(), tmp_path / "ball.vti")
    with pytest.raises(TypeError, match="no format holds a int"):
        formats.write(3, tmp_path / "three.stl")
    assert list(tmp_path.iterdir()) == []


def test_a_format_that_is_only_written(tmp_path, monkeypatch):
    only = _registry.Format("Deck", (".deck",), writes=(VolumeMesh,), write=lambda _: [b"deck"])
    monkeypatch.setattr(_registry, "_stems", lambda: ["deck", "stl"])
    load = _registry._load
    monkeypatch.setattr(_registry, "_load", lambda stem: only if stem == "deck" else load(stem))
    formats.write(two_cells(), tmp_path / "a.deck")
    assert (tmp_path / "a.deck").read_bytes() == b"deck"
    with pytest.raises(FormatError, match=r"\.deck files are written, not read; wanted \.stl$"):
        formats.read(tmp_path / "a.deck")


def test_messages_name_the_suffix_that_was_asked_for(tmp_path):
    """Of two suffixes of a format the first names its module, whoever asks for the second."""
    (tmp_path / "x.nas").write_bytes(b"")
    with pytest.raises(FormatError, match=r"x\.nas: \.nas files are written, not read"):
        formats.read(tmp_path / "x.nas")
    with pytest.raises(FormatError, match=r"a \.nas file cannot hold a SurfaceMesh"):
        formats.write(SurfaceMesh(np.zeros((0, 3)), np.zeros((0, 3), int)), tmp_path / "x.nas")
    with pytest.raises(FormatError, match=r"x\.NAS: \.nas files are written"):
        formats.read(tmp_path / "x.NAS")
    for form in formats.formats():
        for suffix in form.suffixes:
            found = _registry._find(tmp_path / f"x{suffix}")
            assert (found.suffix, set(found.suffixes)) == (suffix, set(form.suffixes))
            assert found.name == form.name


def test_a_second_suffix_finds_its_format(tmp_path, monkeypatch):
    twice = _registry.Format("Stack", (".tif", ".tiff"), VoxelGrid, lambda _: noise())
    monkeypatch.setattr(_registry, "_stems", lambda: ["tif"])
    monkeypatch.setattr(_registry, "_load", lambda _: twice)
    (tmp_path / "a.tiff").write_bytes(b"x")
    assert formats.read(tmp_path / "a.tiff") == noise()


def test_suffixes_in_capitals(tmp_path):
    formats.write(noise(), tmp_path / "GRID.VTI")
    assert formats.read(str(tmp_path / "GRID.VTI")) == noise()


# --- what is written reads back ----------------------------------------------------------------


@pytest.mark.parametrize("suffix", EXACT[VoxelGrid])
@given(grid=grids())
@settings(max_examples=60)
def test_grids_read_back_equal(folder, suffix, grid):
    assert round_trip(folder, grid, suffix) == grid


@given(mesh=volumes())
@settings(max_examples=60)
def test_volume_meshes_read_back_equal(folder, mesh):
    assert round_trip(folder, mesh, ".vtu") == mesh


@pytest.mark.parametrize("suffix", EXACT[SurfaceMesh])
@given(surface=surfaces())
@settings(max_examples=60)
def test_surfaces_read_back_equal(folder, suffix, surface):
    assert round_trip(folder, surface, suffix) == surface


@given(surface=surfaces(), shift=st.tuples(places, places, places))
@settings(max_examples=60)
@pytest.mark.filterwarnings("ignore::porous.errors.FormatWarning")
def test_stl_keeps_seven_digits_of_a_surface_wherever_it_lies(folder, surface, shift):
    moved = SurfaceMesh(surface.points + np.array(shift), surface.triangles, surface.unit)
    size = max(np.ptp(moved.points, axis=0).max(), 1e-30)
    sides = [
        np.linalg.norm(moved.corners[:, i] - moved.corners[:, i - 1], axis=1) for i in range(3)
    ]
    good = np.min(sides, axis=0) > 1e-5 * size  # the others may fall together in seven digits
    kept = SurfaceMesh(moved.points, moved.triangles[good], moved.unit)
    if not good.any():
        return
    result = round_trip(folder, kept, ".stl")
    rounding = 4 * size * 2.0**-23 + 4 * np.abs(moved.points).max() * 2.0**-52
    assert result.corners == pytest.approx(kept.corners, rel=0, abs=rounding)
    assert result.unit == kept.unit
    assert len(np.unique(result.points, axis=0)) == len(result.points)


@pytest.mark.parametrize("row", formats.formats(), ids=lambda row: row.suffix)
def test_the_same_value_gives_the_same_bytes(row):
    mesh = two_cells()
    if row.shapes and "tet10" not in row.shapes:
        mesh = VolumeMesh(mesh.points, mesh.blocks[:2])
    samples = {VoxelGrid: noise((40, 50, 60)), SurfaceMesh: ball(), VolumeMesh: mesh}
    values = [samples[kind] for kind in row.writes if kind in samples]
    assert values or not row.writes
    for value in values:
        first = files_of(row, value)
        assert first == files_of(row, pickle.loads(pickle.dumps(value)))


def files_of(row, value):
    """Return the bytes of each file that a format writes, by its name."""
    if row.write_files is None:
        return {"": b"".join(row.write(value))}
    return {name: b"".join(chunks) for name, chunks in row.write_files(value, f"a{row.suffix}")}


def test_bytes_do_not_depend_on_the_threads(folder):
    program = """
import os, sys, numpy as np, porous.formats as formats
from porous.values import Frame, VoxelGrid
if sys.argv[2] == "1":
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
fill = np.random.default_rng(0).integers(0, 2, (120, 130, 140)).astype(np.uint8) * 255
formats.write(VoxelGrid(Frame((0, 0, 0), (1, 2, 3), fill.shape), fill), sys.argv[1])
"""
    for threads in ("1", "all"):
        command = [sys.executable, "-c", program, folder / f"{threads}.vti", threads]
        subprocess.run(command, check=True, stdin=subprocess.DEVNULL, timeout=120)
    assert (folder / "1.vti").read_bytes() == (folder / "all.vti").read_bytes()


def test_empty_meshes(folder):
    nothing = VolumeMesh(np.zeros((0, 3)), ())
    assert round_trip(folder, nothing, ".vtu") == nothing
    empty = SurfaceMesh(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64))
    assert round_trip(folder, empty, ".ply") == empty
    with pytest.raises(FormatError, match=r"empty\.stl: the surface has no triangles"):
        formats.write(empty, folder / "empty.stl")


def test_names_that_xml_cannot_hold(folder):
    bad = VolumeMesh(np.zeros((1, 3)), (), {}, {"a\0b": Part("nodes", np.array([0]))})
    with pytest.raises(FormatError, match="characters that XML can hold"):
        formats.write(bad, folder / "bad.vtu")
    assert not (folder / "bad.vtu").exists()


# --- STL ---------------------------------------------------------------------------------------


STL = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
TETRAHEDRON = np.array([[0, 0, 0], [2, 0, 0], [0, 3, 0], [0, 0, 5]], dtype=float)
FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])


def binary_stl(facets, *, head=b"", more=b""):
    rows = np.zeros(len(facets), STL)
    rows["corners"] = facets
    return head.ljust(80, b"\0") + np.uint32(len(facets)).tobytes() + rows.tobytes() + more


def text_stl(facets, *, name="part"):
    lines = [f"solid {name}"]
    for corners in facets:
        lines += ["  facet normal 0 0 0", "    outer loop"]
        lines += [f"      vertex {x:e} {y:e} {z:e}" for x, y, z in corners]
        lines += ["    endloop", "  endfacet"]
    return "\n".join([*lines, f"endsolid {name}\n"]).encode()


def read_bytes(folder, data, suffix):
    (folder / f"given{suffix}").write_bytes(data)
    return formats.read(folder / f"given{suffix}")


FACETS = TETRAHEDRON[FACES]


@pytest.mark.parametrize(
    "data",
    [
        binary_stl(FACETS),
        binary_stl(FACETS, head=b"solid that is none"),
        text_stl(FACETS),
        text_stl(FACETS).replace(b"\n", b"\r\n"),
        text_stl(FACETS).upper(),
        text_stl(FACETS, name="facet normal 1 2 3"),
        text_stl(FACETS[:2]) + b"\n" * 600 + text_stl(FACETS[2:], name="another"),
    ],
    ids=["binary", "binary that says solid", "text", "crlf", "capitals", "odd name", "two solids"],
)
def test_stl_of_every_kind(folder, data):
    surface = read_bytes(folder, data, ".stl")
    assert surface.volume == pytest.approx(5.0)
    assert len(surface.points) == 4
    assert np.array_equal(surface.corners, FACETS)
    assert surface.points[surface.triangles[0]].tolist() == FACETS[0].tolist()


def test_stl_joins_corners_in_the_order_of_their_appearance(folder):
    surface = read_bytes(folder, binary_stl(FACETS), ".stl")
    assert surface.triangles.ravel().tolist()[:6] == [0, 1, 2, 0, 2, 3]


def test_stl_knows_minus_zero(folder):
    facets = FACETS.copy()
    facets[1][facets[1] == 0] = -0.0
    assert len(read_bytes(folder, binary_stl(facets), ".stl").points) == 4


def test_stl_far_from_zero_keeps_its_shape(folder):
    near, far = ball(scale=(0.01, 0.02, 0.03)), (1000.0, -2000.1, 3000.7)
    away = ball(scale=(0.01, 0.02, 0.03), shift=far)
    result = round_trip(folder, away, ".stl")
    assert len(result.points) == len(away.points)
    assert result.volume == pytest.approx(near.volume, rel=1e-6)
    assert result.corners == pytest.approx(away.corners, rel=0, abs=1e-8)
    head = (folder / "value.stl").read_bytes()[:80]
    assert re.fullmatch(rb"porous STL unit=mm origin=[-0-9.e]+,[-0-9.e]+,[-0-9.e]+ *", head)
    foreign = trimesh.load(folder / "value.stl")  # others see it at zero, whole
    assert foreign.is_watertight
    assert foreign.volume == pytest.approx(near.volume, rel=1e-5)


def test_stl_near_zero_stays_where_it_is(folder):
    round_trip(folder, ball(unit="um", shift=(3.0, 2.0, 1.0)), ".stl")
    assert (folder / "value.stl").read_bytes()[:80].rstrip() == b"porous STL unit=um"
    assert trimesh.load(folder / "value.stl").bounds[0] == pytest.approx([2, 0, -2], abs=1e-6)


def test_stl_leaves_out_facets_that_fall_together(folder):
    points = np.vstack([TETRAHEDRON, [[2 + 1e-12, 0, 0]]])
    faces = np.array([[0, 2, 4], [0, 1, 3], [1, 2, 3], [0, 3, 2], [0, 4, 1], [1, 4, 2]])
    result = round_trip(folder, SurfaceMesh(points, faces), ".stl")
    assert len(result.triangles) == 4
    assert trimesh.load(folder / "value.stl").is_watertight


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (binary_stl(FACETS, more=b"x" * 17), "17 bytes follow the last of 4 facets"),
        (binary_stl([*FACETS, FACETS[0]]), "1 facets lie on others"),
        (binary_stl([*FACETS, FACETS[0][[0, 0, 1]]]), "1 facets have two corners in one place"),
        (binary_stl(FACETS * 1e-8), "longest edge is 5e-08 mm: is that the unit"),
        (binary_stl(FACETS * 1e9), r"longest edge is 5e\+09 mm: is that the unit"),
    ],
)
def test_stl_that_is_not_as_it_should_be_is_read_with_a_warning(folder, data, said):
    with pytest.warns(FormatWarning, match=f"given.stl: .*{said}"):
        assert len(read_bytes(folder, data, ".stl").triangles) >= 4


# --- PLY and OBJ -------------------------------------------------------------------------------

QUAD_PLY = """ply
format {} 1.0
comment made by hand
obj_info nothing
element material 1
property uchar red
element vertex 5
property float x
property float y
property uchar quality
property double z
element face 5
property short group
property list uchar {} {}
element edge 1
property int vertex1
property int vertex2
end_header
"""
PYRAMID = [(0, 0, 0), (2, 0, 0), (2, 3, 0), (0, 3, 0), (1, 1, 4)]
POLYGONS = [(3, 2, 1, 0), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)]


def pyramid_ply(order, index, *, name="vertex_indices"):
    """Return a pyramid of a quad and four triangles with whatever else PLY allows about it."""
    form = {"int": "i4", "ushort": "u2", "float": "f4"}[index]
    text = QUAD_PLY.format(order, index, name).encode()
    if order == "ascii":
        rows = ["7", *(f"{x} {y} 9 {z}" for x, y, z in PYRAMID)]
        rows += [f"5 {len(p)} {' '.join(map(str, p))}" for p in POLYGONS]
        return text + "\n".join([*rows, "0 1\n"]).encode()
    end = "<" if "little" in order else ">"

    def put(value, kind):
        return np.array(value, dtype=end + kind).tobytes()

    text += put(7, "u1")
    for x, y, z in PYRAMID:
        text += put([x, y], "f4") + put(9, "u1") + put(z, "f8")
    for polygon in POLYGONS:
        text += put(5, "i2") + put(len(polygon), "u1") + put(polygon, form)
    return text + put([0, 1], "i4")


@pytest.mark.parametrize("index", ["int", "ushort", "float"])
@pytest.mark.parametrize("order", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_ply_of_every_kind(folder, order, index):
    surface = read_bytes(folder, pyramid_ply(order, index), ".ply")
    assert np.array_equal(surface.points, PYRAMID)
    assert surface.triangles.tolist() == [[3, 2, 1], [3, 1, 0], *map(list, POLYGONS[1:])]
    assert surface.volume == pytest.approx(8.0)
    assert surface.names == ("WALL",)


def test_ply_faces_by_their_other_name_and_other_line_ends(folder):
    data = pyramid_ply("ascii", "int", name="vertex_index").replace(b"\n", b"\r\n")
    assert len(read_bytes(folder, data, ".ply").triangles) == 6


def test_ply_with_more_than_its_elements_warns(folder):
    for order, what in (("ascii", "2 numbers"), ("binary_big_endian", "3 bytes")):
        with pytest.warns(FormatWarning, match=f"{what} follow the last element"):
            read_bytes(folder, pyramid_ply(order, "int") + b"1 2", ".ply")


PYRAMID_OBJ = """# by hand
mtllib /etc/passwd
o pyramid
v 0 0 0
v 2 0 0 1.0
v 2 3 0 0.5 0.5 0.5
v 0 3 0
vn 0 0 1
vt 0 0
s off
f 4 3 2 1
g sides
usemtl stone
v 1.0 1e0 +4
f 1//1 2//1 5//1
f 2/1 3/1 5/1
f -3/1/1 -2/1/1 \\
 -1/1/1
f 4 1 5 # the last
"""


def test_obj_of_every_kind(folder):
    surface = read_bytes(folder, PYRAMID_OBJ.encode(), ".obj")
    assert np.array_equal(surface.points, PYRAMID)
    assert surface.triangles.tolist() == [[3, 2, 1], [3, 1, 0], *map(list, POLYGONS[1:])]
    assert surface.names == ("pyramid", "sides")
    assert surface.labels.tolist() == [0, 0, 1, 1, 1, 1]
    crlf = PYRAMID_OBJ.replace("\n", "\r\n").encode()
    assert read_bytes(folder, crlf, ".obj") == surface


@pytest.mark.parametrize("suffix", [".stl", ".ply", ".obj"])
def test_trimesh_and_meshio_read_our_surfaces(folder, suffix):
    ours = ball(shift=(1, 1, 1))
    formats.write(ours, folder / f"ours{suffix}")
    theirs = trimesh.load(folder / f"ours{suffix}", process=suffix == ".stl")
    assert theirs.is_watertight
    assert theirs.volume == pytest.approx(ours.volume, rel=1e-6)
    assert theirs.area == pytest.approx(ours.area, rel=1e-6)
    # meshio reads no binary PLY whose faces have more than their corners.
    formats.write(SurfaceMesh(ours.points, ours.triangles), folder / f"ours{suffix}")
    mesh = meshio.read(folder / f"ours{suffix}")
    corners = mesh.points[np.vstack([b.data for b in mesh.cells if b.type == "triangle"])]
    assert corners == pytest.approx(ours.corners, abs=1e-6)


@pytest.mark.parametrize(
    ("suffix", "options"),
    [
        (".stl", {"file_type": "stl"}),
        (".stl", {"file_type": "stl_ascii"}),
        (".ply", {"encoding": "ascii"}),
        (".ply", {"encoding": "binary"}),
        (".obj", {}),
    ],
)
def test_we_read_the_surfaces_of_trimesh(folder, suffix, options):
    ours = ball(shift=(1, 1, 1))
    mesh = trimesh.Trimesh(ours.points, ours.triangles, process=False)
    mesh.export(folder / f"theirs{suffix}", **options)
    result = formats.read(folder / f"theirs{suffix}")
    assert result.corners == pytest.approx(ours.corners, abs=1e-5)
    assert result.volume == pytest.approx(ours.volume, rel=1e-5)


@pytest.mark.parametrize(
    ("suffix", "options"),
    [
        (".stl", {"binary": True}),
        (".stl", {"binary": False}),
        (".ply", {"binary": True}),
        (".ply", {"binary": False}),
        (".obj", {}),
    ],
)
def test_we_read_the_surfaces_of_meshio(folder, suffix, options):
    ours = ball(shift=(1, 1, 1))
    mesh = meshio.Mesh(ours.points, [("triangle", ours.triangles)])
    mesh.write(folder / f"theirs{suffix}", **options)
    result = formats.read(folder / f"theirs{suffix}")
    assert result.corners == pytest.approx(ours.corners, abs=1e-5)


def test_admesh_finds_nothing_to_mend_in_our_stl(folder, judge):
    formats.write(ball(shift=(1000, 2000, 3000), scale=(0.1, 0.2, 0.3)), folder / "judged.stl")
    said, _ = programs.said([judge("admesh"), folder / "judged.stl"])
    assert re.search(r"Number of parts\s*:\s*1\s+Volume\s*:\s*0\.02", said)
    for fault in ("Degenerate facets", "Edges fixed", "Facets reversed", "Normals fixed"):
        assert re.search(rf"{fault}\s*:\s*0\b", said), said
    assert re.search(r"Total disconnected facets\s*:\s*0\s+0", said), said


# --- VTI and VTU, with VTK as the judge --------------------------------------------------------


def vtk_variants():
    """Every way in which VTK writes an array, but for LZ4 and LZMA."""
    for mode in ("ascii", "binary", "raw", "base64"):
        for word in (32, 64):
            for packed in (False, True):
                for big in (False, True):
                    if mode != "ascii" or (word == 32 and not packed):
                        yield pytest.param(
                            (mode, word, packed, big), id=f"{mode}{word}{packed:d}{big:d}"
                        )


def vtk_write(writer, data, path, variant):
    mode, word, packed, big = variant
    writer.SetFileName(str(path))
    writer.SetInputData(data)
    {"ascii": writer.SetDataModeToAscii, "binary": writer.SetDataModeToBinary}.get(
        mode, writer.SetDataModeToAppended
    )()
    writer.SetEncodeAppendedData(mode == "base64")
    (writer.SetHeaderTypeToUInt64 if word == 64 else writer.SetHeaderTypeToUInt32)()
    (writer.SetCompressorTypeToZLib if packed else writer.SetCompressorTypeToNone)()
    (writer.SetByteOrderToBigEndian if big else writer.SetByteOrderToLittleEndian)()
    writer.SetBlockSize(1024)
    assert writer.Write() == 1


@cache
def grid_sample():
    rng = np.random.default_rng(2)
    frame = Frame((0.1, -5, 7), (0.1, 2, 3), (13, 14, 15), (True, False, True), "um", (4, 0, 2))
    fill, bulk = (rng.integers(0, 256, frame.shape).astype(np.uint8) for _ in range(2))
    return VoxelGrid(frame, fill, bulk, "cover", 0.1 + 0.2)


def test_vtk_sees_our_grid(folder):
    import pyvista

    grid = grid_sample()
    formats.write(grid, folder / "ours.vti")
    image = pyvista.read(folder / "ours.vti")
    assert image.cell_data["fill"].dtype == np.uint8
    for name, ours in (("fill", grid.fill), ("bulk", grid.bulk)):
        assert np.array_equal(image.cell_data[name].reshape(grid.frame.shape, order="F"), ours)
    box = grid.frame.box
    seen = np.array(image.bounds).reshape(3, 2)
    assert seen == pytest.approx(np.array([box.lower, box.upper]).T)
    assert image.spacing == grid.frame.spacing
    assert image.field_data["metres_per_unit"].tolist() == [1e-6]
    assert image.field_data["sampling"].tolist() == ["cover"]
    assert image.field_data["hausdorff"].tolist() == [0.1 + 0.2]
    assert image.field_data["periodic"].tolist() == [1, 0, 1]
    assert image.active_scalars_name == "fill"
    # The value beside the point: VTK's own idea of which cell holds it.
    place = np.array([4 + 3.5, 0 + 1.5, 2 + 7.5])
    probe = place * grid.frame.spacing + grid.frame.origin
    assert image.cell_data["fill"][image.find_containing_cell(probe)] == grid.fill[3, 1, 7]


@pytest.mark.parametrize("variant", list(vtk_variants()))
def test_we_read_what_vtk_makes_of_our_grid(folder, variant):
    import pyvista
    from vtkmodules.vtkIOXML import vtkXMLImageDataWriter

    formats.write(grid_sample(), folder / "ours.vti")
    image = pyvista.read(folder / "ours.vti")
    vtk_write(vtkXMLImageDataWriter(), image, folder / "theirs.vti", variant)
    result = formats.read(folder / "theirs.vti")
    # In text VTK keeps eleven digits.
    exact = variant[0] != "ascii"
    assert np.array_equal(result.fill, grid_sample().fill)
    assert result.frame.periodic == (True, False, True)
    assert result.hausdorff == pytest.approx(0.3, rel=1e-9)
    assert result == grid_sample() or not exact


@pytest.mark.parametrize("variant", list(vtk_variants()))
def test_we_read_what_vtk_makes_of_our_volume_mesh(folder, variant):
    import pyvista
    from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridWriter

    formats.write(two_cells(), folder / "ours.vtu")
    grid = pyvista.read(folder / "ours.vtu")
    vtk_write(vtkXMLUnstructuredGridWriter(), grid, folder / "theirs.vtu", variant)
    if variant[0] == "ascii":  # 2^60 is not exact as one of our numbers
        with pytest.raises(FormatError, match="wanted a whole number"):
            formats.read(folder / "theirs.vtu")
    else:
        assert formats.read(folder / "theirs.vtu") == two_cells()


@pytest.mark.parametrize("variant", list(vtk_variants()))
def test_hexahedra_of_every_kind_among_lines_and_faces(folder, variant):
    import pyvista
    from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridWriter

    corners = np.array([*np.ndindex(2, 2, 2)], dtype=float)[:, ::-1] * (2, 3, 4)  # VTK's voxel
    cube = [0, 1, 3, 2, 4, 5, 7, 6]
    extra = np.random.default_rng(3).uniform(1, 2, (19, 3))
    points = np.concatenate([corners, extra])
    more = list(range(8, 27))
    cells = {11: range(8), 9: cube[:4], 12: cube, 25: cube + more[:12], 3: [0, 1]}
    cells |= {33: cube + more[:16], 29: cube + more, 22: more[:6], 7: more[:5], 1: [8]}
    flat = np.concatenate([[len(nodes), *nodes] for nodes in cells.values()])
    grid = pyvista.UnstructuredGrid(flat, list(cells), points)
    grid.cell_data["kind"] = np.array(list(cells))
    vtk_write(vtkXMLUnstructuredGridWriter(), grid, folder / "theirs.vtu", variant)
    with pytest.warns(FormatWarning, match="2 hexahedra of more than 8 nodes are read by their"):
        mesh = formats.read(folder / "theirs.vtu")
    assert [block.shape for block in mesh.blocks] == ["hex8", "hex20"]
    assert mesh.blocks[0].cells.tolist() == [cube] * 4
    assert mesh.blocks[1].cells.tolist() == [cube + more[:12]]
    assert mesh.volumes.tolist() == [24.0] * 5
    assert mesh.cell_tags["kind"].tolist() == [11, 12, 33, 29, 25]
    assert mesh.points == pytest.approx(points, rel=1e-9)


def test_vtk_sees_our_volume_mesh(folder):
    import pyvista

    mesh = two_cells()
    formats.write(mesh, folder / "ours.vtu")
    grid = pyvista.read(folder / "ours.vtu")
    assert np.array_equal(grid.points, mesh.points)
    assert grid.celltypes.tolist() == [10, 12, 24]
    assert grid.cell_data["phase"].tolist() == [1, 2, 3]
    assert grid.cell_data["body"].tolist() == [-1, 0, 2**60]
    assert grid.field_data["faces:ZMIN_FACES"].tolist() == [[1, 0]]
    assert grid.field_data["nodes:ZMIN"].tolist() == [0, 1, 2, 3]
    volumes = grid.extract_cells([0, 1]).compute_cell_sizes().cell_data["Volume"]
    assert volumes == pytest.approx(mesh.volumes[:2])


def foreign_image(shape=(3, 4, 5), **arrays):
    import pyvista

    image = pyvista.ImageData(dimensions=np.array(shape) + 1, spacing=(1, 2, 3), origin=(4, 5, 6))
    for name, values in arrays.items():
        image.cell_data[name] = values
    return image


def test_vti_of_others_with_one_array(folder):
    values = np.arange(60, dtype=np.uint8) * 4
    foreign_image(scan=values, temperature=values * 1.5).save(folder / "theirs.vti")
    grid = formats.read(folder / "theirs.vti")
    assert np.array_equal(grid.fill, values.reshape((3, 4, 5), order="F"))
    assert grid.frame == Frame((4, 5, 6), (1, 2, 3), (3, 4, 5))
    assert (grid.sampling, grid.bulk, grid.hausdorff) == ("fill", None, None)


def test_vti_of_others_with_a_mask(folder):
    mask = (np.arange(60) % 3 == 0).astype(np.uint8)
    foreign_image(mask=mask).save(folder / "theirs.vti")
    grid = formats.read(folder / "theirs.vti")
    assert np.array_equal(grid.solid, mask.reshape((3, 4, 5), order="F") == 1)
    assert set(np.unique(grid.fill)) == {0, 255}
    assert grid.sampling == "centre"


def test_vti_that_leaves_open_which_array(folder):
    foreign_image(a=np.zeros(60, np.uint8), b=np.zeros(60, np.uint8)).save(folder / "theirs.vti")
    with pytest.raises(FormatError, match=r"got 'a \(UInt8\), b \(UInt8\)'; wanted one of type"):
        formats.read(folder / "theirs.vti")
    foreign_image(a=np.zeros(60)).save(folder / "theirs.vti")
    with pytest.raises(FormatError, match=r"got 'a \(Float64\)'; wanted one of type UInt8"):
        formats.read(folder / "theirs.vti")


def test_vtu_of_meshio(folder):
    mesh = two_cells()
    cells = [("tetra", mesh.blocks[0].cells), ("hexahedron", mesh.blocks[1].cells)]
    for options in ({"binary": True}, {"binary": False}):
        meshio.Mesh(mesh.points, cells, cell_data={"phase": [[4], [7]]}).write(
            folder / "theirs.vtu", **options
        )
        result = formats.read(folder / "theirs.vtu")
        assert result.points == pytest.approx(mesh.points)
        assert [block.shape for block in result.blocks] == ["tet4", "hex8"]
        assert np.array_equal(result.blocks[1].cells, mesh.blocks[1].cells)
        assert result.cell_tags["phase"].tolist() == [4, 7]
    formats.write(VolumeMesh(mesh.points, mesh.blocks[:2]), folder / "ours.vtu")
    theirs = meshio.read(folder / "ours.vtu")
    assert [block.type for block in theirs.cells] == ["tetra", "hexahedron"]
    assert np.array_equal(theirs.cells[1].data, mesh.blocks[1].cells)


def test_vtu_of_others_is_sorted_by_shape_with_its_tags(folder):
    import pyvista

    tet, hexa = [4, 5, 6, 8], list(range(8))
    cells = np.array([4, *tet, 8, *hexa, 4, *tet])
    grid = pyvista.UnstructuredGrid(cells, [10, 12, 10], two_cells().points)
    grid.cell_data["part"] = np.array([1, 2, 3], dtype=np.int32)
    grid.cell_data["stress"] = np.array([1.0, 2.0, 3.0])
    grid.save(folder / "theirs.vtu")
    mesh = formats.read(folder / "theirs.vtu")
    assert [(b.shape, len(b.cells)) for b in mesh.blocks] == [("tet4", 2), ("hex8", 1)]
    assert {name: tag.tolist() for name, tag in mesh.cell_tags.items()} == {"part": [1, 3, 2]}
    assert mesh.volumes == pytest.approx([2.0, 2.0, 24.0])


def test_vtu_of_shapes_that_are_not_ours(folder):
    import pyvista

    prism = np.concatenate([np.eye(3), np.eye(3) + 2.0])
    pyvista.UnstructuredGrid(np.array([3, 0, 1, 2]), [5], np.eye(3)).save(folder / "theirs.vtu")
    with pytest.raises(FormatError, match=r"cell types: got '5'; wanted hexahedra \(12, 25\), wed"):
        formats.read(folder / "theirs.vtu")
    pyvista.UnstructuredGrid(np.array([5, *range(5)]), [14], prism).save(folder / "theirs.vtu")
    with pytest.raises(FormatError, match=r"cell types: got '14 pyramid'; wanted hexahedra"):
        formats.read(folder / "theirs.vtu")


# --- NPZ ---------------------------------------------------------------------------------------


def test_numpy_sees_our_grid(folder):
    grid = noise(unit="um")
    formats.write(grid, folder / "ours.npz")
    with np.load(folder / "ours.npz") as arrays:
        assert sorted(arrays) == ["fill", "origin", "sampling", "spacing", "unit"]
        assert np.array_equal(arrays["fill"], grid.fill)
        assert tuple(arrays["spacing"]) == grid.frame.spacing
        assert tuple(arrays["origin"]) == grid.frame.origin
        assert str(arrays["unit"]) == "um"


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_npz_of_numpy(folder, save):
    fill = noise().fill
    frame = Frame((0, 0, 0), (1, 2, 3), fill.shape)
    save(folder / "theirs.npz", fill=np.asfortranarray(fill), spacing=[1, 2, 3])
    assert formats.read(folder / "theirs.npz") == VoxelGrid(frame, fill)
    save(folder / "theirs.npz", fill=fill > 100, spacing=(1.0, 2.0, 3.0), notes=np.zeros(4))
    expected = VoxelGrid.of_solid(fill > 100, frame)
    assert formats.read(folder / "theirs.npz") == expected


def test_npz_members_bear_no_date(folder):
    formats.write(noise(), folder / "ours.npz")
    with zipfile.ZipFile(folder / "ours.npz") as archive:
        assert {info.date_time for info in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}


def test_a_large_grid_comes_through_blocks_of_every_length(folder):
    x, y, z = np.indices((150, 110, 130), sparse=True)
    fill = np.where((x * y + z) % 7 < 3, np.uint8(255), np.uint8(0))  # more than two blocks
    fill[0] = 128
    grid = VoxelGrid(Frame((0, 0, 0), (1, 2, 3), fill.shape), fill)
    for suffix in EXACT[VoxelGrid]:
        assert round_trip(folder, grid, suffix) == grid
        assert (folder / f"value{suffix}").stat().st_size < fill.size / 10


# --- piece by piece ------------------------------------------------------------------------


@pytest.mark.parametrize("size", [1, 7, 1000])
def test_ply_in_pieces_has_the_bytes_of_the_whole(size):
    whole = ball(unit="um")
    t, labels = whole.triangles, whole.labels
    starts = range(0, len(t), size)
    points = [whole.points[a : a + size] for a in range(0, len(whole.points), size)]
    faces = ((t[a : a + size], labels[a : a + size]) for a in starts)
    pieces = ply.stream(whole.unit, whole.names, (len(whole.points), len(t)), points, faces)
    assert b"".join(pieces) == b"".join(ply.write(whole))


@pytest.mark.parametrize("size", [1, 7, 1000])
@pytest.mark.parametrize("shift", [0.0, 1e5])
def test_stl_in_pieces_has_the_bytes_of_the_whole(size, shift):
    whole = ball(unit="um", shift=(shift, 2.0, 1.0))
    starts = range(0, len(whole.triangles), size)
    bounds = whole.points.min(axis=0), whole.points.max(axis=0)
    for count in (None, len(whole.triangles)):
        pieces = stl.stream(
            whole.unit, bounds, lambda: (whole.corners[a : a + size] for a in starts), count
        )
        assert b"".join(pieces) == b"".join(stl.write(whole))


def test_more_points_than_signed_numbers_go_are_counted_without_sign(folder):
    """The header says uint; the file reads back, for the faces there are."""
    half = ball()
    huge = (2**31, len(half.triangles))
    pieces = list(ply.stream("mm", ("WALL",), huge, [half.points], [(half.triangles, half.labels)]))
    head = pieces[0].decode()
    assert "element vertex 2147483648\n" in head
    assert "property list uchar uint vertex_indices\n" in head
    honest = head.replace("2147483648", str(len(half.points))).encode()
    result = read_bytes(folder, honest + b"".join(pieces[1:]), ".ply")
    assert np.array_equal(result.triangles, half.triangles)
    assert np.array_equal(result.points, half.points)


def test_more_than_a_format_can_count_is_refused():
    with pytest.raises(FormatError, match="4294967296 points; wanted at most 4294967295 for PLY"):
        ply.stream("mm", ("WALL",), (2**32, 1), [], [])
    bounds = np.zeros(3), np.ones(3)
    with pytest.raises(FormatError, match=r"at most 4294967295 for STL\. Write PLY"):
        stl.stream("mm", bounds, lambda: iter(()), 2**32)


@given(
    hnp.arrays(np.float64, (40, 3), elements=st.floats(0, 64)),
    st.sampled_from([0.0, 3.0, 1e4, -1e7]),
    st.floats(1e-9, 10),
)
def test_points_said_to_stay_apart_do(points, shift, gap):
    lattice = np.unique(np.round(points) * gap, axis=0) + shift
    bounds = lattice.min(axis=0), lattice.max(axis=0)
    if stl.stay_apart(bounds, np.full(3, gap * 0.99)):
        _, moved = stl._shift(*bounds)
        single = (lattice - moved).astype(np.float32)
        assert len(np.unique(single, axis=0)) == len(lattice)
