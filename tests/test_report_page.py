"""The page on the report says what a recipe may ask for, and what was noted is kept."""

import re
from pathlib import Path

import numpy as np
import pytest

from porous import workspace
from porous.measures import Family, Findings, Survey
from porous.models.stage_sections import ReportSection
from porous.pipeline import Result, _survey, examine
from porous.toml import parse_value
from porous.values import Frame, SurfaceMesh, VoxelGrid

PAGE = (Path(__file__).parent.parent / "docs" / "report.md").read_text(encoding="utf-8")


def test_every_key_of_the_report_is_on_the_page_with_its_default_and_no_other():
    table = dict(re.findall(r"^\| `(\w+)` \| (.+?) \| .+ \|$", PAGE, re.M))
    assert set(table) == set(ReportSection.model_fields)
    settled = ReportSection()
    for key in set(table) - {"detail"}:
        default = table[key].strip("`")
        wanted = None if default == "none" else parse_value(default, key)
        assert getattr(settled, key) == wanted, key


def test_what_a_survey_notes_is_in_the_record():
    result = Result(None, notes=("made so",), findings=Findings(notes=("best built along +z",)))
    assert workspace.record(result)["notes"] == ["made so", "best built along +z"]


def test_surfaces_in_full_detail_are_not_called_out_of_core():
    corners = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    surface = SurfaceMesh(corners, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    (note,) = examine(surface, detail="full").notes
    assert note.startswith("full detail is measured of voxels; of a surface")


@pytest.mark.parametrize("is_round", [True, False])
def test_what_is_missing_for_want_of_a_box_is_noted(is_round, monkeypatch):
    family = Family("none", "None", 1, lambda _: Findings())
    monkeypatch.setattr(_survey, "families", lambda: (family,))
    fill = np.zeros((4, 4, 4), np.uint8)
    bulk = np.full(fill.shape, 255, np.uint8)
    bulk[0, 0] = 0
    grid = VoxelGrid(Frame((0, 0, 0), (1, 1, 1), fill.shape), fill, bulk if is_round else None)
    notes = _survey.surveyed(grid, None, None, Survey(), None).findings.notes
    assert [note.partition(":")[0] for note in notes] == ["the bulk is no box"] * is_round
