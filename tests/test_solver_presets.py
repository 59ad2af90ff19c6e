"""Six presets of six kinds: made, and run in CalculiX as written; their energy is scikit-fem's."""

import json

import naive_elasticity
import numpy as np
import pytest

import porous as po
from porous.guests import ccx

KINDS = {
    "tetrahedra": ("sierpinski-carpet", {"model.level": 1}, "tets", {"tet4"}),
    "voxels": ("octahedron-flake", {"voxels.voxels": 20}, "hexes", {"hex8"}),
    "bent cells": ("menger-bent", {}, "cells", {"hex8"}),
    "wedges": ("junction-sponge", {"model.level": 2}, "cells", {"hex8", "wed6"}),
    "controlled": (
        "koch-cube",
        {"volume.method": "voxel-hex", "voxels.voxels": 17},
        "hexes",
        {"hex8"},
    ),
    "quadratic": ("vicsek-7", {"volume.order": 2}, "tets", {"tet10"}),
}
"""Preset, what is changed so that it is quick, the deck's name, and the shapes in it."""


@pytest.mark.judge
@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_preset_is_solved_as_written(kind, judge, tmp_path):
    program = judge("ccx")
    name, changes, deck, shapes = KINDS[kind]
    result = po.make(po.load(name, set=changes), tmp_path / "out")
    assert {block.shape for block in result.job.mesh.blocks} == shapes

    # ccx.solve raises unless the program ends with 0 and prints no error.
    solved = ccx.solve([(tmp_path / "out" / f"{deck}.inp").read_bytes()], program=program)
    if kind == "quadratic":
        energy = naive_elasticity.curved_energy(result.job)
    else:
        energy, load = naive_elasticity.energy(result.job)
        assert solved.reaction == pytest.approx(load, abs=1e-5 * np.linalg.norm(load))
    assert solved.energy == pytest.approx(energy, rel=1e-5)
    assert solved.volume == pytest.approx(result.job.mesh.volumes.sum(), rel=1e-5)
    assert "nonpositive" not in solved.log

    rows = json.loads((tmp_path / "out" / "measures.json").read_text())["measures"]
    (angle,) = [row["value"] for row in rows if row["name"] == "smallest_dihedral_angle"]
    assert 5 < angle <= 90
