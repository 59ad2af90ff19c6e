"""Every preset: what it promises is what comes of it."""

from __future__ import annotations

import subprocess
import sys

import pytest

from porous import presets
from porous.errors import RecipeError
from porous.pipeline import run
from porous.recipe import load

NAMES = {
    "menger",
    "sierpinski-tetrahedron",
    "octahedron-flake",
    "dodecahedron-flake",
    "icosahedron-flake",
    "cantor-dust",
    "cantor-square",
    "sierpinski-triangle",
    "sierpinski-carpet",
    "vicsek-7",
    "vicsek-9",
    "mosely-light",
    "mosely-heavy",
    "jerusalem-cube",
    "cube-minus-centre",
    "fern",
    "rotating",
    "menger-crosses",
    "koch-cube",
    "branching-struts",
    "menger-block",
    "menger-bent",
    "menger-arch",
    "menger-rough",
    "menger-halved",
    "menger-cylinder",
    "menger-twisted",
    "menger-warped",
    "mosely-block",
    "vicsek-block",
    "beam-twisted",
    "sierpinski-lattice",
    "sierpinski-joined",
    "tetra-octa",
    "octa-porous",
    "support-tree",
    "rough-block",
    "doo-sabin-shell",
    "junction-sponge",
    "koch-wall",
}
IN_PIECES = {"cantor-dust", "cantor-square", "sierpinski-lattice"}
POINTED = {"sierpinski-joined"}  # nothing flat on top that could be pressed


def test_the_presets_there_are():
    assert set(presets.names()) == NAMES
    assert "steel" in presets.material_names()


def test_unknown_names_are_given_the_nearest():
    with pytest.raises(RecipeError, match="did you mean 'menger'"):
        presets.path_of("mengr")
    with pytest.raises(RecipeError, match="did you mean 'steel'"):
        presets.material_path("steal")
    with pytest.raises(RecipeError):
        presets.path_of("../presets/menger")


@pytest.mark.parametrize("name", sorted(NAMES))
def test_a_preset_says_what_it_is_and_what_to_expect(name):
    recipe = load(name)
    assert recipe.title
    assert recipe.source
    assert recipe.simulation is not None
    assert "porosity" in recipe.expect
    assert "components" in recipe.expect
    for expected in recipe.expect.values():
        assert expected.tolerance <= 0.01 * max(1.0, abs(expected.value))


@pytest.mark.parametrize(
    "name", [*sorted(NAMES - {"fern"}), pytest.param("fern", marks=pytest.mark.slow)]
)
def test_what_a_preset_expects_comes_true(name):
    recipe = load(name)
    result = run(recipe, only="measures")
    for measure, expected in recipe.expect.items():
        row = result.measures[measure]
        assert abs(row.value - expected.value) <= expected.tolerance, (measure, row)


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(NAMES))
def test_what_is_made_holds_together_and_carries_load(name):
    result = run(load(name))
    assert result.surface is not None
    assert result.volume is not None
    assert (result.volume.volumes > 0).all()
    assert result.job is not None
    if name in IN_PIECES | POINTED:
        assert not result.job.steps
        assert result.job.why_no_step
        assert any(result.job.why_no_step in note for note in result.notes)
    else:
        assert result.job.steps, result.job.why_no_step


def test_presets_lie_beside_the_package_in_a_checkout():
    assert (presets.folder() / "menger.toml").is_file()
    done = subprocess.run(
        [sys.executable, "-c", "from porous import presets; print(len(presets.names()))"],
        capture_output=True,
        text=True,
        check=True,
        cwd="/",
        stdin=subprocess.DEVNULL,
        timeout=120,
    )
    assert int(done.stdout) == len(NAMES)
