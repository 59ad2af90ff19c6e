"""Cell meshes and curved bulks through the house: measures, certificate, folder, report."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from bent_cells import BentCells, gauss

from porous import extract_surface, hexahedralize, mesh_cells, voxelize
from porous.certificate import certify
from porous.errors import MeshError, ModelError, ViewError
from porous.formats import read
from porous.measures import euler_number, measure, porosity
from porous.measures._mesh import VolumeCensus, pinched_nodes
from porous.models.model import HasBoundary, HasBulk, HasCells, HasExact, Model
from porous.pipeline import run
from porous.recipe import load, parse
from porous.report._provenance import provenance
from porous.values import FILL, Frame, VoxelGrid
from porous.values.surface_topology import euler_number as surface_euler_number
from porous.workspace import KNOWN, LAST, make


def solid(seed, shape=(2, 3, 4), density=0.7):
    return np.random.default_rng(seed).random(shape) < density


def ring():
    """Return 2 × 3 × 4 cells with one missing, which leaves a hole through the sheet."""
    cells = np.ones((2, 3, 4), bool)
    cells[:, 1, 1:3] = False
    return cells


def grid_of(cells):
    return VoxelGrid.of_solid(cells, Frame((0, 0, 0), (1, 0.9, 0.8), cells.shape))


# --- measures -----------------------------------------------------------------------------------


def test_the_twin_is_a_model_with_cells_and_a_bulk():
    for protocol in (Model, HasCells, HasBulk, HasBoundary, HasExact):
        assert isinstance(BentCells(ring()), protocol)


@pytest.mark.parametrize("seed", range(4))
def test_cells_are_the_body_itself(seed):
    model = BentCells(solid(seed))
    table = measure(mesh_cells(model), model=model)
    volume = gauss(model.nodes[model.cells(model.solid)])
    assert table["volume"].value == pytest.approx(volume, rel=1e-12)
    assert table["porosity"].value == pytest.approx(1 - volume / model.bulk_volume, rel=1e-12)
    for name in ("volume", "porosity", "relative_density"):
        row = table[name]
        assert (row.method, row.kind, row.uncertainty, row.of) == ("cells", "exact", 0, "volume")


def test_a_grid_beside_cells_changes_nothing():
    model = BentCells(ring())
    grid = voxelize(model, voxels=12)
    cells = mesh_cells(model)
    assert measure(cells, model=model, grid=grid) == measure(cells, model=model)
    assert "porosity" not in measure(cells, grid=grid)  # the grid knows the bulk but roughly


def test_an_untagged_mesh_is_of_hexahedra():
    cells = mesh_cells(BentCells(ring()))
    mesh = dataclasses.replace(cells, cell_tags={})
    assert {row.method for row in measure(mesh)} == {"hexahedra"}
    assert measure(mesh)["volume"].kind == "standard"


@pytest.mark.parametrize("seed", range(20))
def test_the_euler_number_is_the_voxels_whether_nodes_are_shared_or_not(seed):
    cells = solid(seed, (4, 5, 6), 0.3 + 0.025 * seed)
    wanted = euler_number(grid_of(cells)).value
    for contacts in ("apart", "shared"):
        model = BentCells(cells, bend=np.asarray, contacts=contacts)
        assert measure(mesh_cells(model))["euler_number"].value == wanted
    assert measure(hexahedralize(grid_of(cells)))["euler_number"].value == wanted


@pytest.mark.parametrize("seed", range(10))
def test_shared_cells_are_the_closed_union(seed):
    cells = solid(seed, (4, 5, 6), 0.3 + 0.05 * seed)
    mesh = mesh_cells(BentCells(cells, contacts="shared"))
    table = measure(grid_of(cells))
    assert measure(mesh)["mesh_euler_number"].value == table["euler_number_26"].value


@pytest.mark.parametrize("seed", range(20))
def test_pinched_nodes_are_what_surfaces_go_round(seed):
    """Voxel faces keep voids apart that meet in a point; half their Euler number says so."""
    grid = grid_of(solid(seed, (5, 6, 7), 0.4 + 0.025 * seed))
    surface = extract_surface(grid, method="voxel-faces")
    pinched = pinched_nodes(VolumeCensus(hexahedralize(grid))).value
    assert surface_euler_number(surface) / 2 - euler_number(grid).value == pinched


def test_two_opposite_holes_pinch_a_node():
    cells = np.ones((4, 4, 4), bool)
    cells[1, 1, 1] = cells[2, 2, 2] = False
    for contacts in ("apart", "shared"):
        table = measure(mesh_cells(BentCells(cells, contacts=contacts)))
        assert table["pinched_nodes"].value == 1
        # One cavity for voxels, two for the closed union.
        assert (table["euler_number"].value, table["mesh_euler_number"].value) == (2, 3)


# --- the bulk -----------------------------------------------------------------------------------


@pytest.mark.parametrize("sampling", ["fill", "centre", "cover"])
def test_the_bulk_is_counted_at_64_points_of_each_voxel(sampling):
    model = BentCells(ring())
    grid = voxelize(model, voxels=20, sampling=sampling)
    masks = model.sample_bulk(grid.frame, FILL)
    counts = np.bitwise_count(masks).astype(int)
    assert np.array_equal(grid.bulk, (255 * counts + 32) // 64)


def test_a_bulk_that_fills_the_frame_needs_no_mask():
    model = BentCells(ring(), bend=np.asarray)
    assert voxelize(model, voxels=8).bulk is None
    assert voxelize(model, voxels=9, cubic=True).bulk is not None


def test_progress_goes_on_through_the_bulk():
    seen = []
    voxelize(BentCells(ring()), voxels=20, progress=lambda _, done: seen.append(done))
    assert seen == sorted(seen)
    assert min(seen) <= 0.5 < max(seen) == 1


@pytest.mark.parametrize("voxels", [12, 19, 30, 47])
def test_porosity_of_a_curved_bulk_is_within_its_uncertainty(voxels):
    model = BentCells(ring())
    exact = measure(model)["porosity"].value
    grid = voxelize(model, voxels=voxels)
    table = measure(grid, model=model)
    for method in ("voxel fill", "voxel count"):
        row = table["porosity", method]
        assert abs(row.value - exact) <= 2 * row.uncertainty
    assert table["porosity", "voxel fill"].uncertainty < 0.4 / voxels
    surface = measure(extract_surface(grid), model=model, grid=grid)
    assert abs(surface["porosity"].value - exact) <= 2 * surface["porosity"].uncertainty
    # The sides of a bent block are no sides of the frame: nobody has told them from its pores.
    assert "interface_area" not in table
    assert "interface_area" not in surface


def test_the_doubt_about_the_bulk_is_counted():
    model = BentCells(np.ones((2, 3, 4), bool))
    grid = voxelize(model, voxels=25)
    known, alone = measure(grid, model=model), measure(grid)
    assert known["porosity"].value == 0
    assert alone["porosity"].value == pytest.approx(0, abs=1e-3)
    volume = known["volume"]
    # Solid and bulk are one body here: the doubt is that of both, √2 of the one.
    relative = 2**0.5 * volume.uncertainty / model.bulk_volume
    assert known["porosity"].uncertainty == pytest.approx(relative, rel=1e-2)
    # Without the model nobody knows that the solid keeps to its bulk within a voxel.
    assert alone["porosity"].uncertainty > 3 * known["porosity"].uncertainty
    assert porosity(grid) == alone["porosity"]
    area = known["specific_surface_area"]
    assert area.uncertainty > alone["specific_surface_area"].uncertainty


def test_a_body_that_outgrows_its_bulk_is_told_by_voxels_alone():
    class Grown(BentCells):
        bulk_volume = 12.0

        def sample_bulk(self, frame, pattern):
            return self.tets(self.solid & (np.arange(4) < 2)).sample(frame, pattern)

    model = Grown(np.ones((2, 3, 4), bool))
    grid = voxelize(model, voxels=25)
    assert "porosity" not in measure(extract_surface(grid), model=model, grid=grid)
    row = measure(grid, model=model)["porosity"]
    assert row.value <= 2 * row.uncertainty


# --- the certificate ----------------------------------------------------------------------------


def verdicts(certificate):
    return {row.quantity: row.verdict for row in certificate.rows}


def test_model_grid_surface_and_cells_agree():
    model = BentCells(ring())
    grid, surface, cells = voxelize(model, voxels=40), model.boundary(), mesh_cells(model)
    rows = measure(model) + measure(grid, model=model)
    rows += measure(surface, model=model) + measure(cells, model=model)
    certificate = certify(model, grid, surface, cells, measures=rows)
    assert set(verdicts(certificate).values()) == {"agree"}
    assert certificate.rows[0].volume == pytest.approx(certificate.rows[0].model, rel=1e-12)


def test_cells_that_lost_a_thousandth_are_found():
    model = BentCells(ring())
    cells = mesh_cells(model)
    wrong = dataclasses.replace(cells, points=cells.points * 1.0003)
    rows = measure(model) + measure(wrong, model=model)
    certificate = certify(model, None, None, wrong, measures=rows)
    assert verdicts(certificate)["volume"] == "differ"
    assert "one is wrong" in certificate.rows[0].remedy


def touching():
    """Return cells with three pinched nodes and two more that touch in an edge alone."""
    cells = np.ones((6, 5, 6), bool)
    cells[1, 1, 1] = cells[2, 2, 2] = cells[1, 3, 3] = cells[2, 2, 4] = False
    cells[4:] = False
    cells[4, 0, 0] = cells[5, 1, 0] = True
    return cells


def euler_check(model, grid, surface, mesh):
    rows = measure(grid) + measure(surface, model=model) + measure(mesh, model=model)
    certificate = certify(model, grid, surface, mesh, measures=rows)
    return next(row for row in certificate.rows if row.quantity == "euler_number")


def test_points_where_voids_meet_reconcile_the_surface_with_the_cells():
    cells = touching()
    model, grid = BentCells(cells), grid_of(cells)
    surface = extract_surface(grid, method="voxel-faces")  # goes round points where voids meet
    told = measure(surface, model=model)
    assert told["surface_euler_number"].value / 2 == told["euler_number"].value + 3
    assert "genus" not in told
    row = euler_check(model, grid, surface, mesh_cells(model))
    assert row.verdict == "agree"
    assert row.surface == row.grid == row.volume == euler_number(grid).value
    assert row.remedy.startswith("at 3 points voids meet")


def test_a_surface_without_pinches_keeps_its_numbers():
    model = BentCells(ring())
    surface = extract_surface(grid_of(ring()), method="voxel-faces")
    assert measure(surface, model=model)["genus"].value == 1
    assert not euler_check(model, grid_of(ring()), surface, mesh_cells(model)).remedy


def test_a_surface_that_is_wrong_differs():
    cells = touching()
    model, grid = BentCells(cells), grid_of(cells)
    wrong = extract_surface(grid_of(ring()), method="voxel-faces")
    assert euler_check(model, grid, wrong, mesh_cells(model)).verdict == "differ"


def test_a_grid_alone_does_not_judge_points_of_contact():
    cells = touching()
    model = BentCells(cells)
    surface = extract_surface(grid_of(cells), method="voxel-faces")
    coarse = grid_of(np.ones((2, 3, 2), bool))
    row = euler_check(model, coarse, surface, mesh_cells(model))
    assert row.verdict == "unknown"
    assert "meet in points or edges alone" in row.remedy
    plain = BentCells(ring())
    surface = extract_surface(grid_of(ring()), method="voxel-faces")
    row = euler_check(plain, coarse, surface, mesh_cells(plain))
    assert row.verdict == "differ"


# --- from a recipe to its folder ----------------------------------------------------------------


@pytest.fixture
def recipe(monkeypatch):
    """Return recipes whose model is the one given; no pictures are drawn."""

    def refuse(*_, **__):
        raise ViewError("not now")

    monkeypatch.setattr("porous.report._report.picture", refuse)

    def of(model, **values):
        monkeypatch.setattr("porous.pipeline._work.build", lambda _: model)
        chosen = {key.replace("__", "."): value for key, value in values.items()}
        return load("menger", set={"voxels.voxels": 20, **chosen})

    return of


def test_auto_takes_the_models_own_cells(recipe):
    result = run(recipe(BentCells(ring())))
    assert result.volume.is_of_cells
    assert result.surface == BentCells(ring()).boundary()
    assert result.measures["volume", "cells"].kind == "exact"
    assert result.certificate.good
    assert set(verdicts(result.certificate).values()) == {"agree"}
    assert not result.notes
    assert result.job.steps


def test_cells_alone_need_neither_voxels_nor_surface(recipe):
    result = run(recipe(BentCells(ring())), only="volume")
    assert result.volume is not None
    assert result.grid is result.surface is None
    assert list(result.times) == ["model", "volume", "measures", "certificate"]
    assert verdicts(result.certificate)["volume"] == "agree"


def test_sides_are_the_models_faces_and_no_planes(recipe):
    volume = run(recipe(BentCells(ring())), only="volume").volume
    on = volume.points[volume.parts["ZMAX"].members]
    assert np.allclose(np.arctan2(on[:, 2], on[:, 0]), 1.0)
    assert np.ptp(on[:, 2]) > 0.5
    assert len(volume.parts["XMIN_FACES"].members) == 10


def test_cells_without_named_sides_get_those_of_their_box(recipe):
    model = BentCells(ring(), bend=np.asarray, sides=False)
    volume = run(recipe(model), only="volume").volume
    assert len(volume.parts["XMIN_FACES"].members) == 10
    assert len(volume.parts["WALL"].members) == 12
    assert volume.is_of_cells


def test_cells_that_are_too_much_are_told_and_voxels_take_over(recipe, monkeypatch):
    class Large(BentCells):
        def cell_mesh(self):
            raise MeshError("level 9 is too much")

    monkeypatch.setattr("porous.pipeline._work.TETWILD_TRIANGLES", 0)
    model = Large(ring())
    result = run(recipe(model), only="volume")
    assert not result.volume.is_of_cells
    assert result.notes[0] == "volume not of the model's cells: level 9 is too much"
    with pytest.raises(MeshError, match="level 9"):
        run(recipe(model, volume__method="cells"))


def test_folded_cells_are_refused_unless_voxels_are_asked_for(recipe):
    class Folded(BentCells):
        def cell_mesh(self):
            raise ModelError("cell 201 is folded")

        def boundary(self):
            raise ModelError("cell 201 is folded")

    model = Folded(ring())
    for only in ("surface", "volume", None):
        with pytest.raises(ModelError, match="cell 201"):
            run(recipe(model), only=only)
    result = run(recipe(model, volume__method="voxel-hex"))
    assert not result.volume.is_of_cells
    assert result.notes[0] == "surface from voxels: cell 201 is folded"


def test_what_has_no_cells_says_what_it_has():
    with pytest.raises(ModelError, match="kind ifs has an exact boundary and voxels"):
        run(load("menger", set={"volume.method": "cells", "model.level": 1}), only="volume")


def test_covers_and_tiles_are_not_the_models_cells(recipe, monkeypatch):
    monkeypatch.setattr("porous.pipeline._work.TETWILD_TRIANGLES", 0)
    model = BentCells(ring())
    for values in ({"voxels__sampling": "cover"}, {"voxels__periodic": [True, False, False]}):
        assert not run(recipe(model, **values), only="volume").volume.is_of_cells
        chosen = recipe(model, **values, volume__method="cells")
        assert run(chosen, only="volume").volume.is_of_cells


def test_the_files_are_called_cells(recipe, tmp_path):
    model = BentCells(ring())
    make(recipe(model, volume__method="cells"), tmp_path)
    names = {path.name for path in tmp_path.iterdir()}
    assert {"cells.vtu", "cells.inp", "surface.stl", "grid.vti"} < names
    assert names - {"recipe.toml", LAST} <= set(KNOWN)
    again = read(tmp_path / "cells.vtu")
    assert again.is_of_cells
    assert measure(again)["volume"].kind == "exact"
    rows = json.loads((tmp_path / LAST).read_text())["measures"]
    assert {"cells", "closed form"} <= {row["method"] for row in rows if row["name"] == "volume"}
    assert "the model's own cells" in (tmp_path / "report.html").read_text().replace("&#39;", "'")


def test_only_the_volume_is_written(recipe, tmp_path):
    make(recipe(BentCells(ring())), tmp_path, only="volume")
    names = {path.name for path in tmp_path.iterdir()}
    wanted = {"recipe.toml", "cells.vtu", "cells.inp", "log.json", "measures.csv", LAST}
    assert names == wanted


def test_the_report_says_whose_cells_they_are(recipe):
    result = run(recipe(BentCells(ring())), only="volume")
    made = dict(provenance(result).made)
    assert made["volume mesh"].startswith("20 hexahedra, the model's own cells, ")


# --- boundary-controlled systems ------------------------------------------------------------------


def block(keep, level, voxels, **model):
    return parse(
        {
            "model": {
                "kind": "bcifs",
                "cell": "hex-8",
                "level": level,
                "digits": {"divisions": 3, "keep": keep},
                **model,
            },
            "voxels": {"voxels": voxels},
        }
    )


@pytest.mark.parametrize("seed", range(8))
def test_any_digit_set_is_certified(seed):
    """Hinges, pinches and pieces: model, grid, boundary and cells have one topology."""
    random = np.random.default_rng(seed)
    keep = random.permutation(np.argwhere(np.ones((3, 3, 3))))[: 10 + 2 * seed].tolist()
    certificate = run(block(keep, 2, 27)).certificate
    verdict = verdicts(certificate)
    assert set(verdict.values()) == {"agree"}
    euler = next(row for row in certificate.rows if row.quantity == "euler_number")
    assert euler.model == euler.grid == euler.surface == euler.volume


def test_the_mosely_sponge_has_its_literature_numbers():
    """Of level 3: 2592 points where voids meet, χ = −2400 for voxels, 384 on the surface."""
    result = run(block("mosely-light", 3, 27))
    table = result.measures
    assert table["pinched_nodes"].value == 2592
    assert table["surface_euler_number"].value == 384
    assert {row.value for row in table.all("euler_number")} == {-2400}
    assert {row.value for row in table.all("euler_number_26")} == {192}
    assert {row.value for row in table.all("mesh_euler_number")} == {192}
    assert verdicts(result.certificate)["euler_number"] == "agree"


@pytest.mark.parametrize("contacts", ["apart", "shared"])
def test_tetrahedra_that_touch_in_points(contacts):
    model = {"kind": "bcifs", "cell": "tetra", "level": 2, "contacts": contacts}
    result = run(parse({"model": model, "voxels": {"voxels": 40}}))
    cells = {row.name: row.value for row in result.measures if row.of == "volume"}
    assert cells["euler_number"] == cells["components"] == 16
    assert cells["mesh_euler_number"] == (16 if contacts == "apart" else 2 - 4**2)
    assert ("euler_number_26" in cells) == (contacts == "shared")
    assert result.certificate.good
    assert {"XMIN", "ZMAX", "F0_FACES"} <= set(result.volume.parts)


CORNERS = [(0, 0, 0), (0.2, 0, 4), (0, 3, 0.3), (0, 3, 3.5), (2, 0, 0), (2.3, 0, 4), (2, 3, 0)]


@pytest.mark.parametrize("voxels", [18, 40])
def test_a_block_with_crooked_corners_is_within_its_uncertainty(voxels):
    controls = [*map(list, CORNERS), [2.2, 3.4, 4]]
    result = run(block("menger", 2, voxels, controls=controls))
    table = result.measures
    assert table["porosity", "cells"].value == pytest.approx(1 - (20 / 27) ** 2, rel=0.1)
    for name in ("porosity", "volume"):
        exact, row = table[name, "cells"].value, table[name, "voxel fill"]
        assert abs(row.value - exact) <= 2 * row.uncertainty
        assert row.uncertainty < 0.9 * exact / voxels
    verdict = verdicts(result.certificate)
    assert verdict["volume"] == verdict["components"] == "agree"
    # Walls of two voxels that lie askew are too thin for their holes to be told apart.
    assert verdict["euler_number"] == ("agree" if voxels == 40 else "differ")
