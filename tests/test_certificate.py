"""The certificate: what agrees, what differs, what is not known, and what would mend it."""

import dataclasses
import json
import pickle

import numpy as np
import pytest

from porous import build, exact_surface, extract_surface, hexahedralize, load, voxelize
from porous.certificate import Certificate, certify
from porous.measures import measure
from porous.values import Frame, Measures, VoxelGrid


@pytest.fixture(scope="module")
def menger():
    return build(load("menger"))


@pytest.fixture(scope="module")
def grid(menger):
    return voxelize(menger, voxels=27)


def row(certificate, quantity):
    return next(check for check in certificate.rows if check.quantity == quantity)


def verdicts(certificate):
    return {check.quantity: check.verdict for check in certificate.rows}


def test_an_exact_chain_agrees(menger, grid):
    surface, volume = exact_surface(menger), hexahedralize(grid)
    rows = measure(menger, grid=grid) + measure(grid)
    rows += measure(surface, model=menger) + measure(volume, grid=grid)
    certificate = certify(menger, grid, surface, volume, measures=rows)
    assert set(verdicts(certificate).values()) == {"agree"}
    assert certificate.good
    assert not any(check.remedy for check in certificate.rows)
    euler = row(certificate, "euler_number")
    assert (euler.model, euler.grid, euler.surface, euler.volume) == (-80,) * 4
    assert row(certificate, "surface_area").volume is None


def test_marching_cubes_differ_from_the_closed_form_and_the_remedy_works(menger, grid):
    certificate = certify(menger, grid, extract_surface(grid))
    assert verdicts(certificate) == {
        "volume": "agree",
        "surface_area": "differ",
        "components": "agree",
        "euler_number": "agree",
    }
    assert not certificate.good
    area = row(certificate, "surface_area")
    assert 'surface.method = "exact"' in area.remedy
    needed = int(area.remedy.split("about ")[1].split()[0])
    finer = voxelize(menger, voxels=needed)
    assert row(certify(menger, finer, extract_surface(finer)), "surface_area").verdict == "agree"


@pytest.mark.parametrize(
    ("name", "voxels"),
    # 1, 2 and 3 voxels across the smallest feature, on the lattice and off it.
    [("menger", 9), ("menger", 13), ("menger", 18), ("vicsek-7", 9), ("vicsek-7", 27)],
)
def test_features_too_thin_for_marching_cubes_are_refused_and_both_remedies_work(name, voxels):
    model = build(load(name))
    grid = voxelize(model, voxels=voxels)
    certificate = certify(model, grid, extract_surface(grid))
    assert not certificate.good
    volume = row(certificate, "volume")
    assert volume.verdict == "differ"
    assert volume.remedy.startswith('surface.method = "exact" takes the boundary from the model')
    assert row(certify(model, None, exact_surface(model)), "volume").verdict == "agree"
    needed = int(volume.remedy.split("about ")[1].split()[0])
    assert needed % 9 == 0
    finer = voxelize(model, voxels=needed)
    assert row(certify(model, finer, extract_surface(finer)), "volume").verdict == "agree"


def test_where_no_lattice_fits_the_exact_boundary_does():
    model = build(load("jerusalem-cube", set={"model.level": 1}))
    grid = voxelize(model, voxels=17)
    volume = row(certify(model, grid, extract_surface(grid)), "volume")
    assert volume.verdict == "differ"
    assert 'surface.method = "exact"' in volume.remedy
    assert "multiple" not in volume.remedy
    assert row(certify(model, None, exact_surface(model)), "volume").verdict == "agree"


def test_without_a_closed_form_nothing_is_claimed(grid):
    certificate = certify(None, grid, extract_surface(grid))
    area = row(certificate, "surface_area")
    assert area.verdict == "unknown"
    assert area.remedy.startswith("about ")
    assert verdicts(certificate)["components"] == "agree"


def test_a_surface_that_lost_volume_differs_from_its_grid():
    solid = np.random.default_rng(0).random((9, 10, 11)) < 0.3
    grid = VoxelGrid.of_solid(solid, Frame((0, 0, 0), (1, 1, 1), solid.shape), sampling="fill")
    certificate = certify(None, grid, extract_surface(grid))
    assert row(certificate, "volume").verdict == "differ"
    assert row(certificate, "volume").remedy.startswith("about ")
    assert verdicts(certificate)["euler_number"] == "agree"


def test_one_subject_alone_is_not_certified(grid):
    certificate = certify(None, grid)
    assert set(verdicts(certificate).values()) == {"unknown"}
    assert all("nothing to compare" in check.remedy for check in certificate.rows)


def test_topology_must_be_equal(menger):
    grid = voxelize(menger, voxels=10)  # too coarse: walls and pores of 1/9 are lost
    certificate = certify(menger, grid)
    assert row(certificate, "euler_number").verdict == "differ"
    assert "20 voxels" in row(certificate, "euler_number").remedy


def test_a_mesh_that_departs_from_its_surface_is_found(menger):
    surface = exact_surface(menger)
    wrong = dataclasses.replace(surface, points=surface.points * 1.1)
    rows = measure(menger) + measure(wrong, model=menger)
    certificate = certify(menger, None, wrong, measures=rows)
    assert verdicts(certificate)["volume"] == verdicts(certificate)["surface_area"] == "differ"
    assert verdicts(certificate)["euler_number"] == "agree"


def test_periodic_bodies_are_held_by_their_interface():
    fill = np.zeros((6, 8, 10), np.uint8)
    fill[:, 2:6, 3:8] = 255
    grid = VoxelGrid(Frame((0, 0, 0), (1, 1, 1), fill.shape, (True, False, False)), fill)
    certificate = certify(None, grid, extract_surface(grid, method="voxel-faces"))
    area = row(certificate, "surface_area")
    assert area.surface == pytest.approx(108)
    assert row(certificate, "euler_number").surface is None
    assert row(certificate, "volume").verdict == "agree"


def test_a_boundary_around_points_of_contact_is_that_of_the_closed_union():
    model = build(load("mosely-light", set={"model.level": 2}))
    grid, surface = voxelize(model, voxels=18), exact_surface(model)
    rows = measure(model) + measure(grid) + measure(surface, model=model)
    certificate = certify(model, grid, surface, measures=rows)
    assert set(verdicts(certificate).values()) - {"unknown"} == {"agree"}
    six, all26 = row(certificate, "euler_number"), row(certificate, "euler_number_26")
    assert (six.model, six.grid, six.surface) == (-132, -132, None)
    assert (all26.model, all26.grid, all26.surface) == (12, 12, 12)


def test_nothing_to_certify():
    assert certify() == Certificate()
    assert certify(measures=Measures()).good


def test_it_is_a_value_that_json_knows_and_people_read(menger, grid):
    certificate = certify(menger, grid, extract_surface(grid))
    assert pickle.loads(pickle.dumps(certificate)) == certificate
    rows = [dataclasses.asdict(check) for check in certificate.rows]
    assert json.loads(json.dumps(rows, allow_nan=False)) == rows
    text = str(certificate).splitlines()
    assert text[0].split()[:3] == ["certificate", "model", "grid"]
    assert text[0].split()[3:] == ["surface", "volume", "tolerance", "verdict"]
    assert text[-1].startswith("surface_area: ")
    assert len(text) == 6
