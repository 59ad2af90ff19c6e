"""3MF: what is written is what lib3mf, ElementTree and we read; others' files are placed right."""

import io
import re
import time
import zipfile
from xml.etree import ElementTree as ET

import hypothesis.extra.numpy as hnp
import numpy as np
import programs
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

import porous as po
from porous import formats
from porous.errors import FormatError, FormatWarning
from porous.formats import threemf
from porous.formats.gate import Source
from porous.values import BeamLattice, Box, SurfaceMesh
from porous.values.units import METRES

CORE = "{http://schemas.microsoft.com/3dmanufacturing/core/2015/02}"
BEAMS = "{http://schemas.microsoft.com/3dmanufacturing/beamlattice/2017/02}"
BALLS = "{http://schemas.microsoft.com/3dmanufacturing/beamlattice/balls/2020/07}"
NAMES = {"um": "MicroMeter", "nm": "MicroMeter", "mm": "MilliMeter", "cm": "CentiMeter"}
NAMES |= {"m": "Meter", "in": "Inch"}

places = st.floats(-1e6, 1e6)


@st.composite
def surfaces(draw):
    points = draw(hnp.arrays(np.float64, st.tuples(st.integers(3, 9), st.just(3)), elements=places))
    corners = st.integers(0, len(points) - 1)
    triangles = draw(hnp.arrays(np.int64, (draw(st.integers(1, 12)), 3), elements=corners))
    return SurfaceMesh(points, triangles, draw(st.sampled_from(sorted(METRES.keys() - {"nm"}))))


def ball(unit="mm", scale=(1.0, 2.0, 3.0)):
    mesh = trimesh.creation.icosphere(subdivisions=2)
    return SurfaceMesh(mesh.vertices * scale, mesh.faces, unit)


def lattice(**changes):
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]], dtype=float)
    parts = {"points": points, "beams": [[0, 1], [3, 2]], "radii": [[0.1, 0.2], [0.3, 0.1]]}
    return BeamLattice(**{**parts, **changes})


def model_of(data):
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        return ET.fromstring(archive.read("3D/3dmodel.model"))


def written(value):
    return b"".join(threemf.write(value))


def read(data):
    return threemf.read(Source("it", data))


# --- what is written ---------------------------------------------------------------------------


@given(surface=surfaces())
@settings(max_examples=60)
def test_surfaces_read_back_with_all_their_digits(surface):
    assert read(written(surface)) == surface


def test_nanometres_are_written_as_microns():
    result = read(written(ball("nm", scale=(1e3, 2e3, 3e3))))
    assert result.unit == "um"
    assert result.volume == pytest.approx(ball().volume)


def test_the_same_value_gives_the_same_bytes_without_a_date():
    assert written(ball()) == written(ball())
    with zipfile.ZipFile(io.BytesIO(written(ball()))) as archive:
        assert archive.testzip() is None
        assert {info.date_time for info in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}
        assert archive.namelist() == ["[Content_Types].xml", "_rels/.rels", "3D/3dmodel.model"]


def test_the_model_says_what_it_is_and_is_built():
    root = model_of(written(ball("cm")))
    assert root.get("unit") == "centimeter"
    assert {row.get("name"): row.text for row in root.iter(f"{CORE}metadata")} == {
        "Title": "porous surface",
        "Application": "porous",
    }
    (item,) = root.iter(f"{CORE}item")
    assert [row.get("id") for row in root.iter(f"{CORE}object")] == [item.get("objectid")]


def numbers(rows, *names):
    return np.array([[float(row.get(name)) for name in names] for row in rows])


@pytest.mark.parametrize("cap", ["sphere", "hemisphere", "butt"])
def test_beams_are_written_with_both_radii(cap):
    value = lattice(cap=cap)
    root = model_of(written(value))
    (head,) = root.iter(f"{BEAMS}beamlattice")
    assert head.get("cap") == cap
    assert 0 < float(head.get("minlength")) < value.lengths.min()
    assert root.get("requiredextensions") == "b"
    beams = list(root.iter(f"{BEAMS}beam"))
    assert np.array_equal(numbers(beams, "v1", "v2"), value.beams)
    assert np.array_equal(numbers(beams, "r1", "r2"), value.radii)
    assert np.array_equal(numbers(root.iter(f"{CORE}vertex"), "x", "y", "z"), value.points)
    assert not list(root.iter(f"{BALLS}ball"))


def test_balls_and_clips_are_written_in_the_model_s_unit():
    value = lattice(
        balls=[2, 0], ball_radii=[500.0, 250.0], unit="nm", clip=Box((0,) * 3, (1,) * 3)
    )
    root = model_of(written(value))
    (head,) = root.iter(f"{BEAMS}beamlattice")
    assert root.get("requiredextensions") == "b bb"
    assert numbers(root.iter(f"{BALLS}ball"), "vindex", "r").tolist() == [[2, 0.5], [0, 0.25]]
    assert (head.get("clippingmode"), head.get("ballmode")) == ("inside", "mixed")
    assert [row.get("objectid") for row in root.iter(f"{CORE}item")] == ["2"]
    clip = next(
        row for row in root.iter(f"{CORE}object") if row.get("id") == head.get("clippingmesh")
    )
    assert numbers(clip.iter(f"{CORE}vertex"), "x", "y", "z").max() == 1e-3


def test_nothing_is_not_written(tmp_path):
    empty = SurfaceMesh(np.zeros((0, 3)), np.zeros((0, 3), np.int64))
    with pytest.raises(FormatError, match=r"a\.3mf: nothing to build: got no triangles"):
        formats.write(empty, tmp_path / "a.3mf")
    none = lattice(beams=np.zeros((0, 2), np.int64), radii=np.zeros((0, 2)))
    with pytest.raises(FormatError, match="got no beams; wanted at least one"):
        formats.write(none, tmp_path / "a.3mf")
    assert list(tmp_path.iterdir()) == []


def test_beams_alone_are_no_surface(tmp_path):
    formats.write(lattice(), tmp_path / "beams.3mf")
    with pytest.raises(FormatError, match="2 beams and no triangles; wanted at least one"):
        formats.read(tmp_path / "beams.3mf")


def test_the_suffix_finds_its_format(tmp_path):
    formats.write(ball(), tmp_path / "BALL.3MF")
    assert po.read(tmp_path / "BALL.3MF") == ball()


# --- lib3mf in strict mode, and trimesh --------------------------------------------------------


@pytest.fixture(scope="module")
def bodies():
    """Surfaces of three presets and one in each unit; contacts, exact bodies and voxels."""
    menger = po.build(po.load("menger"))
    grid = po.voxelize(po.build(po.load("mosely-light", set={"model.level": 2})), voxels=27)
    tree = po.voxelize(po.build(po.load("support-tree")), voxels=48)
    made = {
        "exact": po.exact_surface(menger),
        "contacts": po.extract_surface(grid),
        "tree": po.extract_surface(tree),
    }
    return made | {unit: ball(unit) for unit in METRES}


def test_lib3mf_takes_our_surfaces_in_strict_mode(tmp_path, bodies, ask):
    for name, surface in bodies.items():
        formats.write(surface, tmp_path / f"{name}.3mf")
    said = ask("lib3mf_judge", *sorted(tmp_path.iterdir()))
    for name, surface in bodies.items():
        found = said[str(tmp_path / f"{name}.3mf")]
        assert found["warnings"] == []
        assert found["unit"] == NAMES[surface.unit]
        assert found["names"]["Title"] == "porous surface"
        (mesh,) = found["meshes"]
        assert mesh["built"]
        assert mesh["manifold"]
        assert mesh["points"] == len(surface.points)
        assert mesh["triangles"] == len(surface.triangles)
        scale = 1e-3 if surface.unit == "nm" else 1.0
        assert mesh["volume"] == pytest.approx(surface.volume * scale**3, rel=1e-5)
        assert mesh["lower"] == pytest.approx(np.array(surface.box.lower) * scale, abs=1e-5)
        assert mesh["upper"] == pytest.approx(np.array(surface.box.upper) * scale, rel=1e-6)


def test_lib3mf_takes_our_beams_in_strict_mode(tmp_path, ask):
    models = [po.build(po.load(name)) for name in ("doo-sabin-shell", "support-tree")]
    values = [po.beams(model, alone=True) for model in models]
    more = {"balls": [1, 2], "ball_radii": [0.5, 0.25], "clip": Box((0, 0, 0), (1, 1, 1.5))}
    values += [lattice(cap="hemisphere", unit="in", **more), lattice(cap="butt")]
    paths = [tmp_path / f"{i}.3mf" for i in range(len(values))]
    for value, path in zip(values, paths, strict=True):
        formats.write(value, path)
    said = ask("lib3mf_judge", *paths)
    for value, path in zip(values, paths, strict=True):
        found = said[str(path)]
        assert found["warnings"] == []
        assert found["unit"] == NAMES[value.unit]
        *clips, mesh = found["meshes"]
        assert mesh["built"]
        assert mesh["beams"] == value.beams.tolist()
        assert np.array(mesh["radii"]) == pytest.approx(value.radii, rel=1e-6)
        assert np.array(mesh["places"]) == pytest.approx(value.points, rel=1e-6, abs=1e-6)
        assert mesh["caps"] == [value.cap]
        assert mesh["balls"] == value.balls.tolist()
        assert mesh["ball_radii"] == pytest.approx(value.ball_radii.tolist())
        assert mesh["clip"] == (["none", 0] if value.clip is None else ["inside", 1])
        for clip in clips:
            assert not clip["built"]
            assert clip["manifold"]
            assert clip["volume"] == pytest.approx(value.clip.volume, rel=1e-5)


def test_trimesh_reads_our_surfaces(tmp_path):
    pytest.importorskip("lxml")
    formats.write(ball("um"), tmp_path / "ball.3mf")
    mesh = trimesh.load_mesh(tmp_path / "ball.3mf")
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(ball().volume)


@pytest.mark.parametrize("name", ["exact", "contacts", "tree"])
def test_admesh_has_nothing_to_mend_in_the_same_bodies(tmp_path, bodies, judge, name):
    formats.write(bodies[name], tmp_path / "body.stl")
    said, _ = programs.said([judge("admesh"), tmp_path / "body.stl"])
    for fault in ("Degenerate facets", "Edges fixed", "Facets removed", "Facets added"):
        assert re.search(rf"{fault}\s*:\s*0\b", said), said
    for fault in ("Facets reversed", "Backwards edges", "Normals fixed"):
        assert re.search(rf"{fault}\s*:\s*0\b", said), said
    volume = float(re.search(r"Volume\s*:\s*([-\d.]+)", said)[1])
    assert volume == pytest.approx(bodies[name].volume, rel=1e-4)


# --- what others write -------------------------------------------------------------------------

CORNERS = [(0, 0, 0), (2, 0, 0), (0, 3, 0), (0, 0, 5)]
SIDES = [(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)]
HEAD = '<model unit="{}" xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02">'


def mesh(key, *, name="", corners=CORNERS):
    vertices = "".join(f'<vertex x="{x}" y="{y}" z="{z}" />' for x, y, z in corners)
    triangles = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}" p1="0"/>' for a, b, c in SIDES)
    return (
        f'<object id="{key}" name="{name}"><mesh><vertices>{vertices}</vertices>'
        f"<triangles>{triangles}</triangles></mesh></object>"
    )


def group(key, *parts):
    rows = "".join(
        f'<component objectid="{inner}"' + (f' transform="{given}"' if given else "") + "/>"
        for inner, given in parts
    )
    return f'<object id="{key}"><components>{rows}</components></object>'


def package(resources, items, *, unit="millimeter", head=HEAD):
    model = head.format(unit) + f"<resources>{resources}</resources><build>{items}</build></model>"
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("_rels/.rels", threemf.ROOTS)
        archive.writestr("[Content_Types].xml", threemf.TYPES)
        archive.writestr("3D/3dmodel.model", model)
    return stream.getvalue()


def item(key, transform=""):
    return f'<item objectid="{key}"' + (f' transform="{transform}"' if transform else "") + "/>"


TURN = "0 1 0 -1 0 0 0 0 1 10 20 30"
"""x becomes y, y becomes −x; then moved."""
STRETCH = "2 0 0 0 1 0 0 0 1 0 0 0"
MIRROR = "-1 0 0 0 1 0 0 0 1 0 0 0"


def test_each_object_that_is_built_is_a_part():
    data = package(mesh(1, name="left") + mesh(7), item(1) + item(7, TURN) + item(1, TURN))
    result = read(data)
    assert result.names == ("left", "object 2")
    assert np.bincount(result.labels).tolist() == [8, 4]
    assert result.volume == pytest.approx(15)


def test_an_item_is_placed():
    result = read(package(mesh(1), item(1, TURN)))
    x, y, z = np.array(CORNERS, float).T
    assert result.points == pytest.approx(np.stack([10 - y, 20 + x, 30 + z], axis=1))
    assert result.names == ("WALL",)


def test_components_are_placed_in_their_object_and_that_in_the_build():
    data = package(
        mesh(1) + group(2, ("1", STRETCH), ("1", "")) + group(3, ("2", TURN)), item(3, STRETCH)
    )
    x, y, z = np.array(CORNERS, float).T
    expected = [np.stack([2 * (10 - y), 20 + s * x, 30 + z], axis=1) for s in (2, 1)]
    assert read(data).points == pytest.approx(np.concatenate(expected))


def test_a_mirrored_copy_is_turned_outside_out():
    assert read(package(mesh(1), item(1, MIRROR))).volume == pytest.approx(5)


@pytest.mark.parametrize(
    ("unit", "metres"),
    [
        ("micron", 1e-6),
        ("millimeter", 1e-3),
        ("centimeter", 1e-2),
        ("inch", 0.0254),
        ("foot", 0.3048),
        ("meter", 1),
    ],
)
def test_every_unit_of_the_format_is_known(unit, metres):
    result = read(package(mesh(1), item(1), unit=unit))
    assert result.volume * METRES[result.unit] ** 3 == pytest.approx(5 * metres**3)


def test_what_is_not_built_is_not_read():
    assert len(read(package(mesh(1) + mesh(2), item(2))).triangles) == 4


def test_colours_and_properties_are_passed_over():
    more = (
        '<basematerials id="9"><base name="red" displaycolor="#FF0000"/></basematerials>'
        '<m:colorgroup id="8"><m:color color="#FFF"/></m:colorgroup>'
    )
    head = HEAD[:-1] + (
        ' xmlns:m="http://schemas.microsoft.com/3dmanufacturing/material/2015/02"'
        ' requiredextensions="m">'
    )
    assert read(package(more + mesh(1), item(1), head=head)).volume == pytest.approx(5)


def test_beams_beside_triangles_are_left_out_with_a_warning():
    beams = (
        '<b:beamlattice xmlns:b="http://schemas.microsoft.com/3dmanufacturing/beamlattice/2017/02"'
        ' radius="1" minlength="1"><b:beams><b:beam v1="0" v2="1"/></b:beams></b:beamlattice>'
    )
    data = package(mesh(1).replace("</mesh>", f"{beams}</mesh>"), item(1))
    with pytest.warns(FormatWarning, match="1 beams are left out"):
        assert len(read(data).triangles) == 4


def test_spaces_and_line_ends_are_nothing():
    data = package(mesh(1).replace("><", ">\r\n\t<"), item(1))
    assert read(data).volume == pytest.approx(5)


def torus(count):
    """Return a torus of 2·count² triangles."""
    u, v = np.meshgrid(*[np.arange(count) * (2 * np.pi / count)] * 2, indexing="ij")
    ring = 3 + np.cos(v)
    points = np.stack([ring * np.cos(u), ring * np.sin(u), np.sin(v)], axis=-1).reshape(-1, 3)
    a = np.arange(count**2).reshape(count, count)
    b, d = np.roll(a, -1, 0), np.roll(a, -1, 1)
    c = np.roll(b, -1, 1)
    corners = [np.stack(rows, axis=-1).reshape(-1, 3) for rows in ((a, b, c), (a, c, d))]
    return SurfaceMesh(points, np.concatenate(corners))


def test_many_triangles_are_written_and_read_in_a_second_or_two():
    """A million take 2.5 s and 3 s here, np.savetxt of the same numbers 2 s."""
    surface = torus(250)
    start = time.process_time()
    data = written(surface)
    middle = time.process_time()
    assert read(data) == surface
    end = time.process_time()
    assert middle - start < 4
    assert end - middle < 4
