"""Every preset of cells with boundaries: voxels and mesh agree, and the deck runs as written."""

from itertools import pairwise

import naive_elasticity
import numpy as np
import pytest

import porous as po
from porous.guests import ccx
from porous.models.model import HasCells
from porous.values.surface_topology import defects

CELLS = (
    "menger-block",
    "menger-bent",
    "menger-arch",
    "menger-rough",
    "menger-halved",
    "menger-cylinder",
    "menger-twisted",
    "mosely-block",
    "vicsek-block",
    "sierpinski-lattice",
    "sierpinski-joined",
    "tetra-octa",
    "octa-porous",
    "junction-sponge",
)
PRESSED = tuple(name for name in CELLS if not name.startswith("sierpinski"))
LONG = ("menger-twisted", "menger-rough", "menger-arch")
"""Those of many cells, beside others of their kind."""
RESOLUTIONS = 30, 60, 120


def test_all_presets_of_cells_are_here():
    from porous import presets

    models = {name: po.load(name) for name in presets.names()}
    cells = {
        name
        for name, recipe in models.items()
        if recipe.model.kind == "bcifs" and isinstance(po.build(recipe), HasCells)
    }
    assert cells == set(CELLS)


@pytest.mark.parametrize("name", CELLS)
def test_voxels_agree_with_the_mesh_ever_more_closely(name):
    model = po.build(po.load(name))
    exact = 1 - model.cell_mesh().volumes.sum() / model.bulk_volume
    stated = []
    for voxels in RESOLUTIONS:
        found = po.measures.porosity(po.voxelize(model, voxels=voxels))
        assert abs(found.value - exact) <= 2 * found.uncertainty + 1e-12
        stated.append(found.uncertainty)
    assert all(fine < coarse for coarse, fine in pairwise(stated))
    assert stated[-1] < stated[0] / 2.5


@pytest.mark.parametrize("name", CELLS)
def test_cells_conform_and_their_boundary_is_closed(name):
    model = po.build(po.load(name))
    mesh, surface = model.cell_mesh(), model.boundary()
    assert (mesh.volumes > 0).all()
    assert not defects(surface)
    assert surface.volume == pytest.approx(mesh.volumes.sum(), rel=1e-12)


@pytest.fixture(scope="module")
def made(request, tmp_path_factory):
    """A preset as it is made, and its folder; tests of one preset share it."""
    folder = tmp_path_factory.mktemp("made") / request.param
    return po.make(po.load(request.param), folder), folder


@pytest.mark.slow
@pytest.mark.parametrize("made", CELLS, indirect=True)
def test_a_made_folder_certifies_itself(made):
    result, folder = made
    assert result.certificate.good, str(result.certificate)
    assert {"cells.inp", "cells.vtu", "surface.stl"} <= {p.name for p in folder.iterdir()}
    assert result.measures["volume", "cells"].uncertainty == 0


@pytest.mark.judge
@pytest.mark.slow
@pytest.mark.parametrize(
    "made",
    [pytest.param(name, marks=[pytest.mark.nightly] if name in LONG else []) for name in PRESSED],
    indirect=True,
)
def test_the_deck_of_a_preset_runs_as_written(made, judge):
    result, folder = made
    deck = (folder / "cells.inp").read_bytes()
    solved = ccx.solve([deck], program=judge("ccx"))
    energy, load = naive_elasticity.energy(result.job)
    assert np.linalg.norm(load) > 0
    assert solved.reaction == pytest.approx(load, abs=1e-5 * np.linalg.norm(load))
    assert solved.energy == pytest.approx(energy, rel=1e-5)
    assert solved.volume == pytest.approx(result.job.mesh.volumes.sum(), rel=1e-5)
