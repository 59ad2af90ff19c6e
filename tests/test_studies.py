"""Every study has its results committed, and still runs."""

import csv
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ANALYSIS = Path(__file__).parent.parent / "analysis"
STUDIES = sorted(ANALYSIS.glob("*.py"))
RESULTS = sorted((ANALYSIS / "results").glob("*.csv"))

each_study = pytest.mark.parametrize("study", STUDIES, ids=lambda p: p.stem)


def rows_of(path):
    with path.open(newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def test_studies_are_numbered():
    assert STUDIES
    assert all(re.fullmatch(r"\d\d_[a-z0-9_]+", study.stem) for study in STUDIES)
    numbers = [study.stem[:2] for study in STUDIES]
    assert len(set(numbers)) == len(numbers)


@each_study
def test_a_study_has_its_results_committed(study):
    rows = rows_of(ANALYSIS / "results" / f"{study.stem}.csv")
    assert rows
    assert all(None not in row and None not in row.values() for row in rows)


def test_no_result_without_its_study():
    assert {path.stem for path in RESULTS} == {study.stem for study in STUDIES}


@each_study
def test_the_index_tells_of_the_study(study):
    assert study.name in (ANALYSIS / "README.md").read_text(encoding="utf-8")


def assert_rasterising_is_fast(rows):
    large = [row for row in rows if row["body"] == "menger 6, aligned"]
    assert {row["sampling"] for row in large} == {"centre", "fill"}
    assert all(row["voxels"] == "729x729x729" for row in large)
    assert all(float(row["ratio_to_fill"]) <= 3 for row in large)


def test_menger_6_is_rasterised_within_three_fills_of_memory():
    assert_rasterising_is_fast(rows_of(ANALYSIS / "results" / "01_rasterise_speed.csv"))


@pytest.mark.slow
@each_study
def test_a_study_runs(study, tmp_path):
    environment = {**os.environ, "POROUS_RESULTS": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, str(study)],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
        env=environment,
    )
    assert done.returncode == 0, done.stderr
    fresh = rows_of(tmp_path / f"{study.stem}.csv")
    committed = rows_of(ANALYSIS / "results" / f"{study.stem}.csv")
    assert len(fresh) == len(committed)
    assert [list(row) for row in fresh] == [list(row) for row in committed]
    if study.stem == "01_rasterise_speed":
        assert_rasterising_is_fast(fresh)
