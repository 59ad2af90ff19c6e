"""The pipeline: what runs for what is asked, what is decided on the way, how it is stopped."""

from __future__ import annotations

import pickle

import pytest

from porous.errors import Cancelled, GridError, ModelError, RecipeError
from porous.pipeline import WANTED, run
from porous.pipeline._rehearsal import rehearse
from porous.recipe import load, parse
from porous.values.surface_topology import euler_number

COARSE = {"model.level": 1, "voxels.voxels": 9, "volume.method": "voxel-hex"}


def test_menger_from_end_to_end():
    result = run(load("menger", set={"voxels.per_feature": 1}))
    exact = 1 - (20 / 27) ** 2
    assert result.measures["porosity", "closed form"].value == pytest.approx(exact, abs=1e-15)
    assert result.measures["porosity", "voxel count"].value == pytest.approx(exact, abs=1e-15)
    assert result.measures["genus"].value == 81
    assert result.surface.volume == pytest.approx(1 - exact, abs=1e-12)
    assert (result.volume.volumes > 0).all()
    assert result.volume.volumes.sum() == pytest.approx(result.surface.volume, rel=1e-3)
    assert result.job.steps[0].pressed[0].pressure == 1.0
    assert list(result.times)[:4] == ["model", "voxels", "surface", "volume"]
    assert all(seconds >= 0 for seconds in result.times.values())
    assert pickle.loads(pickle.dumps(result)) == result


@pytest.mark.parametrize("only", sorted(set(WANTED) - {"all"}))
def test_no_more_runs_than_is_needed(only):
    result = run(load("menger", set=COARSE), only=only)
    made = {name for name in ("grid", "surface", "volume", "job") if getattr(result, name)}
    assert (
        made
        == {
            "model": set(),
            "voxels": {"grid"},
            "surface": {"surface"},
            "volume": {"grid", "volume"},
            "simulation": {"grid", "volume", "job"},
            "measures": {"grid", "surface"},
        }[only]
    )
    assert len(result.measures)


def test_only_what_is_known():
    with pytest.raises(RecipeError, match="'voxel'; did you mean 'voxels'"):
        run(load("menger"), only="voxel")


def test_progress_names_every_stage_and_ends_each():
    seen = []
    run(load("menger", set=COARSE), progress=lambda stage, done: seen.append((stage, done)))
    stages = list(dict.fromkeys(stage for stage, _ in seen))
    assert stages == ["model", "voxels", "surface", "volume", "measures", "certificate"]
    for stage in stages:
        shares = [done for name, done in seen if name == stage]
        assert shares[0] == 0
        assert shares[-1] == 1
        assert all(0 <= share <= 1 for share in shares)


@pytest.mark.parametrize("stage", ["model", "voxels", "surface", "volume", "measures"])
def test_raising_in_progress_cancels(stage):
    def stop(name, done):
        if name == stage and done > 0:
            raise Cancelled("enough")

    with pytest.raises(Cancelled, match="enough"):
        run(load("menger", set=COARSE), progress=stop)


@pytest.mark.parametrize("method", ["marching-cubes", "voxel-faces", "lewiner"])
def test_surfaces_of_voxels(method):
    result = run(load("menger", set={**COARSE, "surface.method": method}), only="surface")
    assert result.grid is not None
    assert result.surface.volume == pytest.approx(20 / 27, rel=0.1)


def test_what_has_no_exact_boundary_is_taken_from_voxels_and_said(monkeypatch):
    def refuse(_):
        raise ModelError("its topology would not be certain")

    monkeypatch.setattr("porous.stages.exact_surface", refuse)
    result = run(load("menger", set=COARSE), only="surface")
    assert result.notes == ("surface from voxels: its topology would not be certain",)
    assert result.surface.volume == pytest.approx(20 / 27, rel=0.1)
    with pytest.raises(ModelError, match="certain"):
        run(load("menger", set={**COARSE, "surface.method": "exact"}))


def test_large_surfaces_are_filled_with_hexahedra_and_it_is_said(monkeypatch):
    monkeypatch.setattr("porous.pipeline._work.TETWILD_TRIANGLES", 10)
    result = run(load("menger", set={**COARSE, "volume.method": "auto"}), only="volume")
    assert result.volume.blocks[0].shape == "hex8"
    assert "one hexahedron per solid voxel" in result.notes[0]
    assert "10" in result.notes[0]


def test_no_volume_is_no_job():
    result = run(load("menger", set={**COARSE, "volume.method": "none"}))
    assert result.volume is None
    assert result.job is None


def test_no_simulation_is_no_job():
    model = {"kind": "ifs", "level": 1, "digits": {"divisions": 3, "keep": "menger"}}
    recipe = parse({"model": model, "voxels": {"voxels": 3}, "volume": {"method": "voxel-hex"}})
    result = run(recipe)
    assert result.volume is not None
    assert result.job is None


def test_an_empty_grid_has_no_surface():
    model = {"kind": "ifs", "level": 9, "digits": {"divisions": 2, "keep": [[1, 1, 1]]}}
    recipe = parse(
        {"model": model, "voxels": {"voxels": 2}, "surface": {"method": "marching-cubes"}}
    )
    assert not run(recipe, only="voxels").grid.solid.any()
    with pytest.raises(GridError, match="none of the 8 voxels is solid"):
        run(recipe)


def test_a_model_that_moves_is_measured_alike():
    """The same digits in another order give the same grid and the same measures."""
    keep = [[0, 0, 0], [1, 0, 0], [0, 1, 1]]
    tables = [
        {"model": {"kind": "ifs", "level": 2, "digits": {"divisions": 2, "keep": order}}}
        for order in (keep, keep[::-1])
    ]
    first, second = (run(parse(table), only="voxels") for table in tables)
    assert first.grid == second.grid
    assert first.measures == second.measures


def test_a_surface_may_enclose_the_volume_of_the_fills():
    """What marching cubes cut off comes back; triangles and topology stay."""
    settings = {"voxels.voxels": 40, "surface.method": "marching-cubes", "model.level": 1}
    plain = run(load("sierpinski-tetrahedron", set=settings), only="measures")
    fitted = run(
        load("sierpinski-tetrahedron", set={**settings, "surface.volume": "fills"}),
        only="measures",
    )
    fills = plain.measures["volume", "voxel fill"].value
    assert plain.surface.volume < 0.985 * fills
    assert fitted.surface.volume == pytest.approx(fills, 1e-9)
    assert euler_number(fitted.surface) == euler_number(plain.surface)
    assert len(fitted.surface.triangles) == len(plain.surface.triangles)
    assert any(note.startswith("surface moved to the volume of the fills") for note in fitted.notes)


def test_an_exact_boundary_encloses_its_own_volume():
    with pytest.raises(RecipeError, match="volume: an exact boundary encloses its own"):
        load("menger", set={"surface.method": "exact", "surface.volume": "fills"})


MATERIAL = 'title = "mine"\nsource = "me"\n'


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"analysis": "flow", "material": "steel"}, "material steel: has no viscosity"),
        ({"decks": ["k"]}, "a .k file cannot hold a pressure on faces of quadratic elements"),
        ({"analysis": "flow", "material": "water"}, r"a \.foam file cannot hold elements hex20"),
        ({"material": 'youngs_modulus = "210"'}, r"mine\.toml: youngs_modulus: got '210'"),
        ({"material": 'youngs_modulus = "210 m"'}, r"mine\.toml: youngs_modulus: got '210 m'"),
        ({"material": 'density = "-1 kg/m3"'}, r"mine\.toml: .*density = .*more than zero"),
        ({"material": 'density = "1 kg/m3"'}, "material mine: has no youngs_modulus"),
        ({"material": "steel", "decks": ["k"], "strain": 0.1, "analysis": "modal"}, "strain"),
        ({"analysis": "homogenisation"}, "has no pairs of nodes XPAIRS"),
    ],
)
def test_what_cannot_be_simulated_is_refused_before_anything_is_made(
    given, words, tmp_path, monkeypatch
):
    monkeypatch.setattr("porous.pipeline._work.build", lambda _: pytest.fail("work was done"))
    if "=" in str(given.get("material")):
        path = tmp_path / "mine.toml"
        path.write_text(MATERIAL + given["material"])
        given = {**given, "material": str(path)}
    with pytest.raises(RecipeError, match=words):
        run(
            load(
                "menger",
                set=COARSE | {"volume.order": 2} | {f"simulation.{k}": v for k, v in given.items()},
            )
        )
    with pytest.raises(pytest.fail.Exception, match="work was done"):
        run(load("menger", set=COARSE))


@pytest.mark.parametrize("method", ["auto", "cells", "tetwild", "voxel-hex"])
def test_what_can_be_simulated_in_one_way_is_not_refused(method):
    # One of tetrahedra and boxes has pairs; a strain is no pressure on a curved face.
    for values in (
        {"simulation.strain": 0.1, "simulation.decks": ["k", "bdf", "cdb", "feb"]},
        {"simulation.analysis": "modal", "simulation.decks": ["bdf"]},
        {"simulation.analysis": "conduction", "volume.phase": "auto"},
    ):
        rehearse(load("menger", set={"volume.method": method, "volume.order": 2, **values}))
    wanted = {"simulation.analysis": "homogenisation", "voxels.periodic": [True] * 3}
    if method != "tetwild":
        rehearse(load("menger", set={"volume.method": method, **wanted}))
