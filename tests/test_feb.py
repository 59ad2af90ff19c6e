"""FEBio models: what pyfebio's schema reads, and a text that is XML whatever parts are called."""

from xml.etree import ElementTree as ET

import numpy as np
import pytest
from deck_meshes import SHAPED, STEEL, base, counts, written, zoo, zoo_job
from test_inp import voxel_job

from porous import formats
from porous.formats import feb
from porous.values import Job, Material


@pytest.fixture(scope="module")
def models():
    """Every kind of value that a model is made of, by the name of its file."""
    voxels = voxel_job(np.ones((3, 2, 4), bool), (0.1, 0.25, 1 / 3), unit="cm")
    alone = {shape: zoo_job(shapes=(shape,)) for shape in SHAPED}
    si = zoo_job(system="m-SI", unit="in")
    return {"static": zoo_job(), "bare": zoo(unit="nm"), "si": si, "voxels": voxels} | alone


@pytest.mark.judge
def test_pyfebio_reads_what_was_written(models, ask, tmp_path):
    for name, value in models.items():
        formats.write(value, tmp_path / f"{name}.feb")
    said = ask("febio", *(tmp_path / f"{name}.feb" for name in models))
    found = dict(zip(models, said, strict=True))
    for name, value in models.items():
        mesh, got = getattr(value, "mesh", value), found[name]
        scale = {"bare": 1e-6, "si": 0.0254, "voxels": 10.0}.get(name, 1.0)
        assert np.allclose(got["points"], mesh.points * scale, rtol=3e-16, atol=0)
        assert got["elements"] == {b.shape: len(b.cells) for b in mesh.blocks}
        assert got["volume"] == pytest.approx(mesh.volumes.sum() * scale**3, rel=1e-12)
        assert got["off_middle"] <= 1e-15 * scale
        names = {"3 odd/é name": "N_3_ODD___NAME"}
        for kind, sets in (("nodes", "node_sets"), ("cells", "cell_sets"), ("faces", "face_sets")):
            assert got[sets] == {names.get(n, n): c for n, c in counts(mesh)[kind].items()}
        numbers = sorted(number for cells in got["cells"].values() for number in cells)
        assert numbers == list(range(1, mesh.cells + 1))
    check_steps(found)


def check_steps(found):
    assert found["si"]["units"] == "SI"
    assert found["static"]["units"] == "mm-N-s"
    static, si, bare = (found[name] for name in ("static", "si", "bare"))
    assert static["control"] == ["STATIC", 1, 1.0]
    assert static["curve"] == [["0,0", "1,1"]]
    assert static["held"] == [
        ["zero displacement", "ZMIN", 1, 1, 0],
        ["prescribed displacement", "ZMIN", "z", 1, -0.125],
    ]
    assert static["pressed"] == [["ZMIN_FACES", 1, 1, 2.5]]
    assert si["pressed"] == [["ZMIN_FACES", 1, 1, 2.5e6]]
    assert si["held"][1][4] == pytest.approx(-1.25e-4, rel=1e-15)
    assert static["materials"]["SOLID"] == [STEEL.youngs_modulus, 0.3, STEEL.density]
    assert si["materials"]["PORE"] == pytest.approx([1.23456789e9, 0.45, 1250.0], rel=1e-14)
    assert list(static["domains"].values()) == ["SOLID"] * 3 + ["PORE"] * 2
    # A pressure acts against the faces' normals, which point outwards: all of a body make none.
    for name, area in (("static", base()), *((s, base((s,))) for s in SHAPED)):
        assert found[name]["areas"]["ZMIN_FACES"] == pytest.approx([0, 0, -area])
        assert found[name]["areas"]["N_3_ODD___NAME"] == pytest.approx([0, 0, 0], abs=1e-14)
    assert (bare["materials"], bare["domains"], bare["control"]) == ({}, {}, None)


def test_a_model_is_xml_in_the_order_that_febio_needs():
    root = ET.fromstring(written(feb, zoo_job(title='--> <x a="b"> & é\n*')))
    assert root.get("version") == "4.0"
    sections = [child.tag for child in root]
    assert sections[0] == "Module"
    assert sections.index("Material") < sections.index("Mesh") < sections.index("MeshDomains")
    assert sections.index("Mesh") < sections.index("Loads")
    names = [part.get("name") for part in root.iter("Elements")]
    assert len(set(names)) == len(names)
    assert [domain.get("name") for domain in root.iter("SolidDomain")] == names


def test_a_material_that_is_not_elastic_makes_no_domain():
    job = Job("job", zoo(), {"SOLID": STEEL, "PORE": Material("x", conductivity=1.0)})
    root = ET.fromstring(written(feb, job))
    assert [m.get("name") for m in root.iter("material")] == ["SOLID"]
    assert {d.get("mat") for d in root.iter("SolidDomain")} == {"SOLID"}
