"""The page of measures says what the code does: every name, unit and method, and no others."""

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from porous import measures as known
from porous.measures import finest_printable_level, hausdorff_distance, measure
from porous.models.ifs import ifs
from porous.models.rough import Rough, Skin
from porous.recipe import build, load
from porous.stages import exact_surface, extract_surface, hexahedralize, voxelize
from porous.values import Block, Box, Frame, VolumeMesh, VoxelGrid
from porous.values.measure import ORDER

PAGE = (Path(__file__).parent.parent / "docs" / "measures.md").read_text(encoding="utf-8")
NOT_MEASURES = {"COUNTED", "Census", "Journal", "box_counts", "fold", "measure", "tiles_of"}
NOT_MEASURES |= {"Family", "Findings", "Sample", "Survey", "families", "survey"}
NOT_MEASURES |= {"MercuryIntrusion", "mercury_intrusion", "percolation_diameters"}
NOT_MEASURES |= {"PoreNetwork", "betti_numbers", "geometric_tortuosity", "pore_network"}
NOT_MEASURES |= {"cupped_volume", "islands", "overhangs"}
NOT_MEASURES |= {
    "ChordLengths",
    "Chords",
    "HeightMap",
    "Intercepts",
    "LinealPath",
    "LocalThickness",
    "OverBlocks",
    "TwoPoint",
    "Variogram",
    "chord_curves",
    "chord_lengths",
    "chords",
    "correlation_curves",
    "fabric",
    "intercepts",
    "size_curves",
    "sizes",
    "generalised_dimensions",
    "gliding_boxes",
    "height_map",
    "line_probes",
    "local_thickness",
    "over_blocks",
    "roughness",
    "roughness_of_sides",
    "succolarity",
    "thicknesses",
    "two_point",
    "variogram",
}
UNEQUAL = [(np.diag([1 / 2, 1 / 3, 1 / 2]), np.full(3, shift)) for shift in (0.0, 0.5)]
TETRAHEDRON = np.array([[0, 0, 0], [2, 0, 0], [0, 3, 0], [0, 0, 5.0]])


def table():
    """Unit and methods of each name on the page."""
    rows = re.findall(r"^\| `(\w+)` \| (\S+) \| .+ \| ([^|]+) \|$", PAGE, re.M)
    assert len({name for name, _, _ in rows}) == len(rows)
    return {name: (unit, set(methods.split(", "))) for name, unit, methods in rows}


@pytest.fixture(scope="module")
def taken():
    """Every kind of measure, taken of small bodies."""
    model = build(load("menger", set={"model.level": 1, "model.unit": "cm"}))
    grid = voxelize(model, voxels=9)
    hexes = hexahedralize(grid)
    skin, rough = exact_surface(model), extract_surface(grid)
    tets = VolumeMesh(TETRAHEDRON, (Block("tet4", [[0, 1, 2, 3]]),), unit="cm")
    both = VolumeMesh(
        np.vstack([hexes.points, TETRAHEDRON + 9]),
        (*hexes.blocks, Block("tet4", np.arange(4)[None] + len(hexes.points))),
        unit="cm",
    )
    rows = [*measure(model), *measure(grid), *measure(skin, model=model)]
    cells = replace(hexes, cell_tags={"address": np.arange(hexes.cells)})
    rows += [*measure(cells, model=model)]
    rows += [*measure(rough, grid=grid), *measure(hexes, grid=grid), *measure(tets, model=model)]
    rows += [*measure(both), *measure(ifs(UNEQUAL, level=1, unit="cm"))]
    rows += [*measure(hexahedralize(grid, phase="both"), grid=grid)]
    rows += [*measure(replace(tets, cell_tags={"phase": np.zeros(1, np.int64)}))]
    bumpy = Rough(Box((0, 0, 0), (6, 7, 3)), (Skin("ZMAX", 2.2, 0.1, bumps=1),), "cm")
    rows += [*measure(bumpy), *measure(voxelize(bumpy, voxels=48), model=bumpy)]
    rows += [finest_printable_level(model, feature=0.1)]
    rows += known.line_probes(model, lines=50)
    rows += known.survey(grid, only=["fractal"]).measures
    rows += [known.pore_chord_mean(grid), known.wall_chord_mean(grid)]
    for phase in ("pore", "solid"):
        rows += [*known.thicknesses(known.local_thickness(grid, phase=phase))]
        rows += [*known.chords(known.chord_lengths(grid, phase=phase))]
    frame = Frame((0, 0, 0), (1, 1, 1), (16, 18, 20), unit="cm")
    squares = [((frame.centres(a) - n / 2) / n) ** 2 for a, n in enumerate((16, 18, 20))]
    ball = (4 * squares[0])[:, None, None] + (2 * squares[1])[:, None] + squares[2] < 0.2
    cut_out = known.Survey(beyond="unknown")
    for body in (grid, VoxelGrid.of_solid(ball, frame)):
        rows += known.survey(body, how=cut_out, only=["sizes", "statistics"]).measures
    how = known.Survey(probe=0.4, smallest_wall=0.4, smallest_gap=0.4)
    rows += known.survey(grid, model=model, how=how, only=["printability"]).measures
    for survey in (known.Survey(), cut_out):
        found = known.survey(grid, model=model, how=survey, only=["topology", "tortuosity"])
        rows += found.measures
    joined = np.pad(np.zeros((7, 3, 3), bool), 1, constant_values=True)
    joined[4], joined[4, 2, 2] = True, False
    cavities = VoxelGrid.of_solid(joined, Frame((0, 0, 0), (1, 1, 1), joined.shape, unit="cm"))
    rows += known.survey(cavities, only=["network"]).measures
    rows += [known.trapped_volume(grid)]
    rows += known.survey(grid, how=known.Survey(probe=0.4), only=["access"]).measures
    rows += [hausdorff_distance(grid, grid), hausdorff_distance(skin, rough, resolution=0.1)]
    return rows


def test_every_name_is_on_the_page_and_no_other(taken):
    assert set(table()) == {row.name for row in taken}
    functions = {name for name in known.__all__ if name not in NOT_MEASURES}
    assert functions <= set(table())


def test_units_are_as_the_page_says(taken):
    for row in taken:
        assert row.unit == table()[row.name][0].replace("L", "cm"), row.name


def test_methods_are_as_the_page_says(taken):
    found = {}
    for row in taken:
        found.setdefault(row.name, set()).add(row.method)
    assert {name: methods for name, (_, methods) in table().items()} == found


def test_every_method_is_explained(taken):
    cells = re.findall(r"^\| ([^|`]+) \| [^|]+ \|$", PAGE, re.M)
    explained = {method for cell in cells for method in cell.split(", ")} - {"method", "---"}
    assert explained == {row.method for row in taken}


def test_the_order_of_methods_is_the_one_in_force():
    said = re.search(r"the first of these methods that is there: (.*?)\. It is", PAGE, re.S)
    assert said is not None
    assert " ".join(said[1].split()).split(", ") == list(ORDER)


def test_twice_the_euler_number_is_that_of_the_surface(taken):
    of_surface = {row.name: row.value for row in taken if row.method == "exact boundary"}
    assert of_surface["surface_euler_number"] == 2 * of_surface["euler_number"]


def test_a_measure_that_is_infinite_or_nan_is_not_hidden(taken):
    assert all(math.isfinite(row.value) for row in taken)
