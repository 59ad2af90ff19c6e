"""What is said of memory, disk and time before the work, held against the work."""

from __future__ import annotations

import json
import math
import subprocess
import sys
import time
import tracemalloc
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from porous.errors import MemoryLimitError, RecipeError
from porous.kernels.surface import Slab
from porous.models.model import HasBoundary
from porous.pipeline import _run, _work
from porous.recipe import build, load
from porous.scale import costs
from porous.scale.estimate import Cost, Estimate, check, estimate, largest
from porous.scale.trial import try_out
from porous.stages import SampledModel, fit_frame

MIB = 1 << 20


def of(preset, *, only=None, out_of_core=False, **change):
    table = {key.replace("__", "."): value for key, value in change.items()}
    return estimate(load(preset, set=table), only=only, out_of_core=out_of_core)


@pytest.fixture(autouse=True)
def no_hurry(request, monkeypatch):
    """Let trials look at all they want to: who else is at work here shall not change numbers."""
    if request.node.name != "test_nothing_large_is_allocated_and_no_time_lost":
        monkeypatch.setattr("porous.scale.trial.SECONDS", 10.0)


def memory(found, stage):
    return next(cost.memory for cost in found.costs if cost.stage == stage)


def test_more_voxels_take_more_of_everything():
    found = [
        of("menger", model__level=3, voxels__voxels=n, voxels__sampling="centre")
        for n in (27, 60, 130, 300, 700, 3000)
    ]
    for coarse, fine in pairwise(found):
        assert coarse.memory < fine.memory
        assert coarse.disk < fine.disk
        assert coarse.seconds < fine.seconds


def test_nothing_large_is_allocated_and_no_time_lost():
    recipe = load("menger", set={"model.level": 3, "voxels.voxels": 20_000})
    estimate(load("menger", set={"model.level": 2, "voxels.voxels": 100}))
    tracemalloc.start()
    begun = time.process_time()  # others may be at work here
    found = estimate(recipe)
    took = time.process_time() - begun
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert took < 3
    assert peak < 100 * MIB
    assert found.memory > 20_000**3


def test_the_largest_resolution_named_fits_and_one_more_does_not(monkeypatch):
    monkeypatch.setenv("POROUS_MAX_MEMORY", "1G")
    change = {"model.level": 3, "surface.method": "marching-cubes"}
    found = estimate(load("menger", set={**change, "voxels.voxels": 700}))
    with pytest.raises(MemoryLimitError) as error:
        check(found)
    named = largest(found)
    assert f"voxels.voxels = {named} or fewer" in str(error.value)
    assert 20 < named < 700
    check(estimate(load("menger", set={**change, "voxels.voxels": named})))
    with pytest.raises(MemoryLimitError):
        check(estimate(load("menger", set={**change, "voxels.voxels": named + 1})))


def test_a_refusal_names_stage_amounts_and_what_would_do(monkeypatch):
    monkeypatch.setenv("POROUS_MAX_MEMORY", "2G")
    found = of("menger", model__level=3, voxels__voxels=1458, only="voxels")
    with pytest.raises(MemoryLimitError) as error:
        check(found)
    text = str(error.value)
    assert text.startswith("voxels of 1458 × 1458 × 1458 voxels would need 3.")
    assert "2 GiB may be used" in text
    assert "Choose voxels.voxels = " in text
    assert "--out-of-core" in text


def test_out_of_core_is_not_offered_where_it_is_or_would_not_do(monkeypatch):
    monkeypatch.setenv("POROUS_MAX_MEMORY", "200M")
    stored = of("menger", model__level=3, voxels__voxels=500, out_of_core=True, only="voxels")
    for found in (stored, replace(stored, out_of_core=False)):
        with pytest.raises(MemoryLimitError) as error:
            check(found)
        assert "--out-of-core" not in str(error.value)


def test_too_many_cells_are_refused_before_they_are_made(monkeypatch):
    monkeypatch.setenv("POROUS_MAX_MEMORY", "1G")
    found = of("menger-bent", model__level=7)
    with pytest.raises(MemoryLimitError, match=r"^[Mm]odel would need .*lower level"):
        check(found)
    assert found.frame is None


def test_an_estimate_reads_like_a_table_with_a_line_below():
    found = of("menger", model__level=3, voxels__voxels=81)
    lines = str(found).splitlines()
    assert lines[0].split() == ["stage", "memory", "disk", "time"]
    assert [line.split()[0] for line in lines[1:-1]] == [cost.stage for cost in found.costs]
    assert lines[-1].startswith("81 × 81 × 81 voxels: ")
    for words in ("of memory at most", "may be used", "on disk", "about", "within a factor of"):
        assert words in lines[-1]
    costs_ = (Cost("model", 100), Cost("voxels", 3 << 30, 5 << 20, 86_400.0))
    told = Estimate(found.frame, costs_, 1 << 30, out_of_core=False)
    assert str(told).splitlines()[2].split() == ["voxels", "3", "GiB", "5", "MiB", "24", "h"]
    assert told.memory == 3 << 30
    assert not told.fits


@pytest.mark.parametrize(
    ("only", "stages"),
    [
        ("model", ["model", "measures", "files"]),
        ("voxels", ["model", "voxels", "measures", "files"]),
        ("surface", ["model", "surface", "measures", "files"]),
        ("volume", ["model", "surface", "volume", "measures", "files"]),
        ("measures", ["model", "voxels", "surface", "measures", "files"]),
        (None, ["model", "voxels", "surface", "volume", "measures", "files", "report"]),
    ],
)
def test_only_what_is_asked_for_costs(only, stages):
    found = of("menger", only=only)
    assert [cost.stage for cost in found.costs] == stages
    assert (found.frame is None) == ("voxels" not in stages)


def test_words_for_only_are_those_of_the_pipeline():
    assert set(costs.WANTED) == set(_run.WANTED)


def test_the_number_of_cells_is_no_matter_where_none_is_made():
    found = of("menger", model__level=7, voxels__voxels=2187, only="voxels", out_of_core=True)
    assert found.frame.shape == (2187, 2187, 2187)
    assert memory(found, "voxels") < 2187**3 / 10
    assert found.disk < 2187**3


@pytest.mark.parametrize("change", [{}, {"voxels__periodic": [True] * 3}])
def test_cells_that_go_on_are_thought_of_as_the_pipeline_does(change):
    """Nobody makes voxels where the cells are the mesh; of pores somebody does."""
    cells = of("menger-block", only="volume", model__level=1, **change)
    assert cells.frame is None
    pores = of("menger-block", only="volume", model__level=1, volume__phase="pore", **change)
    assert pores.frame.shape == (54, 54, 54)
    for found, phase in ((cells, "solid"), (pores, "pore")):
        settings = {"model.level": 1, "voxels.voxels": 6, "volume.phase": phase}
        more = {key.replace("__", "."): value for key, value in change.items()}
        made = _run.run(load("menger-block", set=settings | more), only="volume")
        assert (made.grid is None) == (found.frame is None)


def test_an_unknown_word_for_only_is_refused_by_name():
    with pytest.raises(RecipeError, match="--only: got 'surfaces'"):
        of("menger", only="surfaces")


def test_surfaces_that_are_altered_cost_more():
    plain = of("koch-cube", voxels__voxels=100)
    altered = of("koch-cube", voxels__voxels=100, surface__smooth=5, surface__simplify=0.5)
    assert [cost.stage for cost in plain.costs[2:4]] == ["surface", "volume"]
    assert [cost.stage for cost in altered.costs[2:6]] == [
        "surface", "smooth", "simplify", "volume"
    ]  # fmt: skip
    assert all(cost.seconds > 0 for cost in altered.costs)
    assert memory(altered, "smooth") > memory(plain, "surface")


def test_tetrahedra_are_thought_of_as_the_pipeline_does():
    assert costs.TETWILD_TRIANGLES == _work.TETWILD_TRIANGLES


@pytest.mark.parametrize(
    ("preset", "change"),
    [
        ("menger", {"model.level": 3, "voxels.voxels": 250}),
        ("menger", {"model.level": 5, "voxels.voxels": 243}),
        ("sierpinski-tetrahedron", {"model.level": 6, "voxels.voxels": 250}),
        ("koch-cube", {"voxels.voxels": 200}),
        ("vicsek-9", {"voxels.voxels": 250}),
        pytest.param(
            "menger",
            {"model.level": "limit", "voxels.voxels": 162},
            marks=[pytest.mark.slow, pytest.mark.nightly],
        ),
        pytest.param(
            "fern", {"voxels.spacing": 0.04}, marks=[pytest.mark.slow, pytest.mark.nightly]
        ),
    ],
)
def test_a_trial_tells_solid_voxels_and_triangles(preset, change):
    recipe = load(preset, set=change)
    model, how = build(recipe), recipe.voxels
    frame = fit_frame(model, voxels=how.voxels, spacing=how.spacing, per_feature=how.per_feature)
    found = try_out(model, frame, how.sampling)
    fill = SampledModel(model, frame, how.sampling).fill((0, 0, 0), frame.shape)
    triangles = Slab(fill, len(fill), 0, len(fill) + 1).counts.sum(axis=0)[1]
    room = 1.15 + 2 * found.doubt
    assert 1 <= room * found.triangles / triangles < 3
    assert 1 <= room * found.solid / np.count_nonzero(fill >= 128) < 3


def test_a_small_lattice_is_known_exactly():
    recipe = load("jerusalem-cube", set={"voxels.voxels": 50})
    model = build(recipe)
    frame = fit_frame(model, voxels=50)
    found = try_out(model, frame, "fill")
    fill = SampledModel(model, frame, "fill").fill((0, 0, 0), frame.shape)
    assert found.is_exact
    assert found.solid == np.count_nonzero(fill >= 128)
    assert found.triangles == Slab(fill, len(fill), 0, len(fill) + 1).counts.sum(axis=0)[1]


@pytest.mark.parametrize("preset", ["menger", "sierpinski-tetrahedron", "jerusalem-cube"])
def test_exact_triangles_are_never_more_than_said(preset):
    recipe = load(preset, set={"model.level": 2})
    model = build(recipe)
    assert isinstance(model, HasBoundary)
    work = costs.Work(recipe, model, "surface", out_of_core=False)
    many = len(model.boundary().triangles)
    assert many <= work.exact <= 2 * many


def test_a_boundary_that_is_not_exact_comes_from_voxels():
    for preset in ("koch-cube", "octahedron-flake"):
        recipe = load(preset)
        assert costs.Work(recipe, build(recipe), None, out_of_core=False).exact == 0


def test_the_store_takes_less_memory_and_more_disk_than_voxels_in_memory():
    change = {"voxels__voxels": 1000, "model__level": 4, "surface__method": "marching-cubes"}
    inside, stored = (
        of("menger", only="measures", out_of_core=out, **change) for out in (False, True)
    )
    assert stored.memory < inside.memory / 4
    assert memory(stored, "voxels") < 0.6 * 1000**3
    surface = next(cost for cost in stored.costs if cost.stage == "surface")
    assert surface.disk > 84
    assert math.isclose(surface.disk, inside.costs[-1].disk, rel_tol=0.2)


PEAK = """
import json, sys, tempfile
from pathlib import Path
import porous as po
from porous.recipe import load

def peak():
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1024 * next(int(line.split()[1]) for line in lines if line.startswith("VmHWM"))

def forget():  # the peak so far: compiling kernels takes more than a small run
    Path("/proc/self/clear_refs").write_text("5")
    return peak()

preset, change, small, only = json.loads(sys.argv[1])
with tempfile.TemporaryDirectory() as folder:
    po.make(load(preset, set={**change, **small}), f"{folder}/small", only=only)
    before = forget()
    po.make(load(preset, set=change), f"{folder}/large", only=only)
print(peak() - before)
"""


def peak_of(preset, change, small, only):
    """Return by how much the resident set grows at most, beyond that of a small run."""
    case = json.dumps([preset, change, small, only])
    run = subprocess.run(
        [sys.executable, "-c", PEAK, case],
        capture_output=True,
        text=True,
        check=True,
        stdin=subprocess.DEVNULL,
        timeout=300,
    )
    return int(run.stdout.split()[-1])


CUBES = {"surface.method": "marching-cubes"}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("preset", "change", "small", "only"),
    [
        (
            "menger",
            {"model.level": 3, "voxels.voxels": 81},
            {"voxels.voxels": 20, "model.level": 1},
            None,
        ),
        pytest.param(
            "menger",
            {"model.level": 3, "voxels.voxels": 120},
            {"voxels.voxels": 20, "model.level": 1},
            None,
            marks=pytest.mark.nightly,
        ),
        pytest.param(
            "menger",
            {"model.level": 4, "voxels.voxels": 200, **CUBES},
            {"voxels.voxels": 20, "model.level": 1},
            "measures",
            marks=pytest.mark.nightly,
        ),
        ("menger", {"model.level": 3, "voxels.voxels": 420}, {"voxels.voxels": 20}, "voxels"),
        pytest.param(
            "sierpinski-tetrahedron",
            {"voxels.voxels": 420},
            {"voxels.voxels": 20},
            "measures",
            marks=pytest.mark.nightly,
        ),
        pytest.param(
            "menger-bent",
            {"voxels.voxels": 600},
            {"voxels.voxels": 20},
            "measures",
            marks=pytest.mark.nightly,
        ),
        ("koch-cube", {"voxels.voxels": 200}, {"voxels.voxels": 20}, "measures"),
        pytest.param(
            "fern",
            {"voxels.spacing": 0.04},
            {"voxels.spacing": 0.3},
            "measures",
            marks=pytest.mark.nightly,
        ),
    ],
)
def test_the_peak_of_memory_stays_below_what_is_said(preset, change, small, only):
    said = estimate(load(preset, set=change), only=only)
    found = peak_of(preset, change, small, only)
    assert found <= said.memory
    if said.frame.size > 64 * MIB:
        assert said.memory <= 4 * found


STORED = """
import json, sys, tempfile
from pathlib import Path
from porous.pipeline import run_stored
from porous.recipe import load

def peak():
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1024 * next(int(line.split()[1]) for line in lines if line.startswith("VmHWM"))

def forget():  # the peak so far: compiling kernels takes more than a small run
    Path("/proc/self/clear_refs").write_text("5")
    return peak()

def run(change):
    with tempfile.TemporaryDirectory() as folder:
        recipe = load("koch-cube", set=change)
        run_stored(
            recipe, Path(folder), identity="0" * 64, begin=lambda: None, only="measures"
        )
        return sum(path.stat().st_size for path in Path(folder).rglob("*") if path.is_file())

run({"voxels.voxels": 20})
before = forget()
disk = run({"voxels.voxels": 600})
print(json.dumps([peak() - before, disk]))
"""


@pytest.mark.slow
def test_the_peak_out_of_core_stays_below_what_is_said():
    recipe = load("koch-cube", set={"voxels.voxels": 600})
    said = estimate(recipe, only="measures", out_of_core=True)
    run = subprocess.run(
        [sys.executable, "-c", STORED],
        capture_output=True,
        text=True,
        check=True,
        stdin=subprocess.DEVNULL,
        timeout=300,
    )
    memory_, disk = json.loads(run.stdout.splitlines()[-1])
    assert memory_ <= said.memory <= 4 * memory_
    assert disk <= said.disk <= 4 * disk


def test_a_survey_is_foreseen_where_all_is_measured():
    recipe = load("menger", set={"voxels.voxels": 27, "report.detail": "full"})
    assert "survey" in [cost.stage for cost in estimate(recipe).costs]
    assert "survey" not in [cost.stage for cost in estimate(recipe, only="voxels").costs]
    assert "survey" not in [cost.stage for cost in estimate(load("menger")).costs]
