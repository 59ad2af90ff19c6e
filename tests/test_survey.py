"""A survey: what families share, coarser grids, and that its measures are named and told."""

import numpy as np
import pytest

import porous as po
from porous.errors import GridError
from porous.measures import Sample, Survey, families, local_thickness, survey
from porous.recipe import parse
from porous.values import Curve, Frame, VoxelGrid


def grid(shape=(12, 10, 14), *, periodic=(False, False, False), seed=0):
    fill = np.random.default_rng(seed).integers(0, 256, shape, dtype=np.uint8)
    return VoxelGrid(Frame((1, 2, 3), (0.5, 0.25, 1), shape, periodic), fill)


def test_a_coarse_grid_has_the_means_of_eight_voxels_in_the_same_box():
    fine = grid()
    coarse = Sample(fine).coarse.grid
    assert coarse.frame.box == fine.frame.box
    means = fine.fill.reshape(6, 2, 5, 2, 7, 2).mean(axis=(1, 3, 5))
    assert np.abs(coarse.fill - means).max() <= 0.5


def test_odd_grids_are_halved_where_they_do_not_close_on_themselves():
    assert Sample(grid((13, 10, 14))).coarse.frame.shape == (6, 5, 7)
    assert Sample(grid((13, 10, 14), periodic=(True, False, False))).coarse is None
    assert Sample(grid((7, 10, 14))).coarse is None


def test_a_sample_within_a_number_of_voxels_is_the_first_that_fits():
    sample = Sample(grid((32, 32, 32)))
    assert sample.within(32**3) is sample
    assert sample.within(32**3 - 1).frame.shape == (16, 16, 16)
    assert sample.within(10).frame.shape == (4, 4, 4)


def test_a_sample_keeps_what_it_has_worked_out():
    sample = Sample(grid(), how=Survey(beyond="unknown"))
    assert sample.thickness("solid") is sample.thickness("solid")
    assert sample.thickness("solid") == local_thickness(
        sample.grid, phase="solid", beyond="unknown"
    )


def test_an_unknown_family_is_named_with_the_nearest():
    with pytest.raises(GridError, match="only: got 'sizez'"):
        survey(grid(), only=["sizez"])


def test_progress_is_told_family_by_family_and_may_cancel():
    class Enough(Exception):
        pass

    told = []

    def tell(name, done):
        told.append((name, done))
        if len(told) > 1:
            raise Enough

    if len(families()) > 1:
        with pytest.raises(Enough):
            survey(grid(), progress=tell)
        assert told[0] == (families()[0].name, 0.0)


def test_curves_are_checked():
    with pytest.raises(ValueError, match="shapes"):
        Curve("a", "b", [1, 2], [1], "x", "1", "y", "1", "m")
    with pytest.raises(ValueError, match="neither"):
        Curve("a", "b", [1], [1], "x", "1", "y", "1", "m", low=[0])
    assert Curve("a", "b", [1], [1], "x", "1", "y", "1", "m").y.dtype == np.float64


@pytest.mark.parametrize("phase", ["solid", "void"])
def test_a_body_of_one_phase_gives_no_exception(phase):
    fill = np.full((8, 9, 10), 255 if phase == "solid" else 0, np.uint8)
    survey(VoxelGrid(Frame((0, 0, 0), (1, 1, 1), fill.shape), fill))


@pytest.mark.parametrize("fill", [0, 255])
def test_one_voxel_gives_no_exception(fill):
    survey(VoxelGrid(Frame((0, 0, 0), (1, 1, 1), (1, 1, 1)), np.full((1, 1, 1), fill, np.uint8)))


def test_random_voxels_with_unequal_periodic_axes_give_finite_honest_rows():
    found = survey(grid(periodic=(True, False, True)), how=Survey(probe=0.6, smallest_wall=0.5))
    for row in found.measures:
        assert row.uncertainty >= 0 or np.isnan(row.uncertainty), row
    assert len({(r.name, r.method, r.of) for r in found.measures}) == len(found.measures)


def test_one_seed_gives_one_survey():
    model = po.build(po.load("menger", set={"model.level": 1}))
    body = po.voxelize(model, voxels=9)
    assert survey(body, model=model) == survey(body, model=model)


def test_large_images_are_measured_by_their_voxels_alone(tmp_path, monkeypatch):
    np.savez(tmp_path / "a.npz", fill=grid((8, 9, 10)).fill, spacing=[1.0, 1.0, 1.0])
    table = {"kind": "image", "path": str(tmp_path / "a.npz"), "threshold": 128}
    recipe = parse({"format": 1, "model": table, "report": {"detail": "brief"}})
    assert po.run(recipe, only="measures").surface is not None
    monkeypatch.setattr("porous.pipeline._work.SURFACE_VOXELS", 700)
    result = po.run(recipe, only="measures")
    assert result.surface is None
    assert any(note.startswith("no surface") for note in result.notes)
    assert "surface_area" in result.measures
