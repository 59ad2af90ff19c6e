"""Bad input for what shapes bodies: one clear line, the right code, and nothing left behind."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import meshio
import numpy as np
import pytest
from refusals import refuse

if TYPE_CHECKING:
    from pathlib import Path

BLOCK = "[model]\nkind = 'bcifs'\ncell = '{cell}'\nlevel = 1\n"
MENGER = "digits = { divisions = 3, keep = 'menger' }\n"
CORNERS = np.array(list(itertools.product((0, 1), repeat=3)), float)
TWO = np.vstack([CORNERS, [[2, 0, 0], [2, 0, 1], [2, 1, 0], [2, 1, 1]]])
PAIR = [[0, 1, 2, 3, 4, 5, 6, 7], [4, 5, 6, 7, 8, 9, 10, 11]]


def block(controls, cells=None, cell="hex-8", more="") -> str:
    """Return a recipe of Menger cells."""
    text = BLOCK.format(cell=cell) + MENGER + more
    text += f"controls = {np.asarray(controls).tolist()}\n"
    return text if cells is None else text + f"cells = {cells}\n"


def moved(index: int, point: tuple[float, float, float]) -> list[list[float]]:
    """Return the controls of a pair of cells, one of them elsewhere."""
    controls = TWO.tolist()
    controls[index] = list(point)
    return controls


def weighted(*weights: float) -> list[list[float]]:
    """Return the eight corners with these weights, one where there are too few."""
    return [
        [*p, *w] for p, w in itertools.zip_longest(CORNERS, ([w] for w in weights), fillvalue=[1])
    ]


def tree(more: str) -> str:
    trunk = "branches = [2]\nheights = [0.45]\nlevel = 2\nsize = 10.0\n"
    return f"[model]\nkind = 'tree'\n{trunk}{more}\n"


def warped(offsets: str) -> str:
    sponge = f"[model.model]\nkind = 'ifs'\nlevel = 1\n{MENGER}"
    return f"[model]\nkind = 'warp'\noffsets = [{offsets}]\n{sponge}"


def rough(skin: str, size: str = "[4.0, 4.0, 4.0]") -> str:
    return f"[model]\nkind = 'rough'\nsize = {size}\nskins = [{{ {skin} }}]\n"


def tensor(*curves: str) -> str:
    listed = ", ".join(f"{{ {c} }}" for c in curves)
    return BLOCK.format(cell="tensor") + f"curves = [{listed}]\n"


SKEWED = TWO.copy()
SKEWED[[8, 9]] = SKEWED[[9, 8]]
LONE = np.vstack([CORNERS, CORNERS + 5])
FAR = [PAIR[0], [*range(8, 16)]]
ROUGH_EDGE = "texture = { edge = [0.3, -0.2, 0.25], bump = [0.5, 0.3] }\n"

RECIPES = {
    "inverted cell": (block(moved(9, (-3, 0, 1)), PAIR), "cell"),
    "disconnected cells": (block(LONE, FAR), "cells"),
    "faces that do not match": (
        block(TWO, [PAIR[0], [5, 4, 6, 7, 8, 9, 10, 11]]),
        "faces? .*match|twisted|fold",
    ),
    "cell twice": (block(TWO, [*PAIR, PAIR[1]]), "cell"),
    "index beyond": (block(TWO, [PAIR[0], [4, 5, 6, 7, 8, 9, 10, 12]]), "12"),
    "index below zero": (block(TWO, [PAIR[0], [4, 5, 6, 7, 8, 9, 10, -1]]), "-1"),
    "index above all whole numbers of 64 bits": (
        block(TWO, [[10**20, *PAIR[0][1:]], PAIR[1]]),
        r"cells\[0\]: names control 1000.*; there are 12",
    ),
    "digit above all whole numbers of 64 bits": (
        block(CORNERS).replace("'menger'", "[[0, 0, 0], [100000000000000000000, 0, 0]]"),
        "model.digits.keep: got .*below divisions",
    ),
    "seven corners": (block(TWO, [PAIR[0], PAIR[1][:7]]), "7"),
    "corner twice": (block(TWO, [PAIR[0], [4, 5, 6, 7, 8, 9, 10, 10]]), "10|twice"),
    "control that nobody uses": (block(np.vstack([TWO, [[9, 9, 9]]]), PAIR), "12|control"),
    "controls at one place": (block(moved(9, (2, 0, 0)), PAIR), "control"),
    "cells without controls": (
        BLOCK.format(cell="hex-8") + MENGER + f"cells = {PAIR}\n",
        "controls",
    ),
    "no cells": (block(TWO, []), "cells"),
    "other divisions on a face": (
        block(
            TWO,
            f"[{PAIR[0]}, {{ controls = {PAIR[1]}, digits = {{ keep = 'full-2' }} }}]",
        ),
        "face|divi",
    ),
    "weight zero": (block(weighted(0)), "weight"),
    "weight below zero": (block(weighted(1, -0.5)), "weight"),
    "weight is NaN": (
        block(CORNERS).replace("[0.0, 0.0, 0.0]", "[0.0, 0.0, 0.0, nan]"),
        "controls",
    ),
    "two numbers": (block(CORNERS).replace("[0.0, 0.0, 0.0]", "[0.0, 0.0]"), "controls"),
    "five numbers": (
        block(CORNERS).replace("[0.0, 0.0, 0.0]", "[0.0, 0.0, 0.0, 1.0, 1.0]"),
        "controls",
    ),
    "weights of some": (
        block(CORNERS).replace("[0.0, 0.0, 0.0]", "[0.0, 0.0, 0.0, 2.0]"),
        "weight|controls",
    ),
    "mesh that is not there": (
        BLOCK.format(cell="hex-8") + MENGER + "mesh = 'none.vtu'\n",
        "none.vtu",
    ),
    "mesh that is a surface": (
        BLOCK.format(cell="hex-8") + MENGER + "mesh = 'broken.stl'\n",
        "broken.stl",
    ),
    "mesh of tetrahedra": (BLOCK.format(cell="hex-8") + MENGER + "mesh = 'tets.vtu'\n", "tet"),
    "mesh of an inverted cell": (
        BLOCK.format(cell="hex-8") + MENGER + "mesh = 'folded.vtu'\n",
        "cell",
    ),
    "mesh in pieces": (BLOCK.format(cell="hex-8") + MENGER + "mesh = 'pieces.vtu'\n", "cell"),
    "mesh for splines": (BLOCK.format(cell="spline-2") + "mesh = 'tets.vtu'\n", "hex-8"),
    "mesh and controls": (block(TWO, PAIR, more="mesh = 'tets.vtu'\n"), "mesh"),
    "radius that cannot be printed": (tree("radius = 0.5\nminimum_radius = 0.3"), "minimum_radius"),
    "radius zero": (tree("radius = 0"), "radius"),
    "radius NaN": (tree("radius = nan"), "radius"),
    "no branches": (tree("radius = 0.5").replace("[2]", "[]"), "branches"),
    "height one": (tree("radius = 0.5").replace("0.45", "1.0"), "height"),
    "unknown law": (tree("radius = 0.5\nlaw = 'moon'"), "law"),
    "offset that folds": (
        warped("{ at = [1, 1, 1], by = [0.3, 0.3, 0.3] }"),
        r"cell \[1, 1, 1\] is folded over",
    ),
    "offset that does not contract": (
        warped("{ at = [1, 1, 1], by = [0.49, 0.49, 0.49] }"),
        "keep 0.976 of a difference",
    ),
    "offset of a corner": (warped("{ at = [0, 0, 0], by = [0.1, 0, 0] }"), "corner|at"),
    "offset out of a face": (warped("{ at = [1, 1, 0], by = [0, 0, 0.1] }"), "face|by"),
    "offset NaN": (warped("{ at = [1, 1, 1], by = [nan, 0, 0] }"), "by|nan"),
    "offset nowhere": (warped("{ at = [3, 1, 1], by = [0.1, 0, 0] }"), "at"),
    "dimension two": (rough("faces = ['ZMAX'], dimension = 2.0, amplitude = 0.1"), "dimension"),
    "dimension three": (rough("faces = ['ZMAX'], dimension = 3.0, amplitude = 0.1"), "dimension"),
    "amplitude below zero": (
        rough("faces = ['ZMAX'], dimension = 2.2, amplitude = -0.1"),
        "amplitude",
    ),
    "amplitude above the body": (
        rough("faces = ['ZMAX'], dimension = 2.2, amplitude = 9.0"),
        "amplitude",
    ),
    "unknown face": (rough("faces = ['TOP'], dimension = 2.2, amplitude = 0.1"), "TOP"),
    "face twice": (rough("faces = ['ZMAX', 'ZMAX'], dimension = 2.2, amplitude = 0.1"), "ZMAX"),
    "size of two": (
        rough("faces = ['ZMAX'], dimension = 2.2, amplitude = 0.1", "[4.0, 4.0]"),
        "size",
    ),
    "no curves": (BLOCK.format(cell="tensor"), "curves"),
    "four curves": (tensor(*["curve = 'koch'"] * 4), "curves"),
    "unknown curve": (tensor("curve = 'nurbs'"), "curve"),
    "degree 9": (tensor("curve = 'bezier', degree = 9"), "degree"),
    "knots that decrease": (tensor("curve = 'b-spline', knots = [0, 2, 1, 3]"), "knots"),
    **{
        f"knots up to {far:g}": (
            tensor(f"curve = 'b-spline', knots = [{-far}, 0, 1, {far}]"),
            "knots: got .* at most 1000 times the shortest",
        )
        for far in (1e17, 1e200, 1e308)
    },
    "radius above all": (
        BLOCK.format(cell="spline-2") + "size = 10\ndraw = { along = ['edges'], radius = 1e30 }\n",
        r"draw\.radius: got 1e\+30 mm, but controls extend over 20 mm; wanted at most 10 times",
    ),
    "radius of a beam above all": (
        BLOCK.format(cell="beam") + MENGER + "draw = { along = ['edges'], radius = 1e300 }\n",
        r"draw\.radius: got 1e\+300 mm, but controls extend over 1 mm; .* 10 mm",
    ),
    "radius of a deeper level below zero": (
        BLOCK.format(cell="beam") + MENGER + "draw = { along = ['edges'], radius = [1, 1, -1] }\n",
        "draw: got a radius of -1",
    ),
    "offset above all": (
        block(CORNERS, more="offset = 11\n"),
        r"offset: got 11 mm, but controls extend over 1 mm; .* 10 mm",
    ),
    "contacts above all": (
        block(CORNERS, more="contacts = 'fuse'\ncontact_radius = 1e9\n"),
        r"contact_radius: got 1e\+09 mm",
    ),
    "Takagi that does not contract": (tensor("curve = 'takagi', weight = -1.0"), "weight|edge"),
    "curves of a block": (block(CORNERS, more="curves = [{ curve = 'koch' }]\n"), "curves"),
    "a patch is no body": (tensor("curve = 'koch'", "curve = 'koch'"), "draw"),
    "Doo and Sabin of nine": (BLOCK.format(cell="doo-sabin-9"), "doo-sabin"),
}


@pytest.fixture
def meshes(tmp_path, monkeypatch):
    """Return a folder with meshes that cannot be filled."""
    order = [0, 4, 6, 2, 1, 5, 7, 3]  # the corners as VTK counts them
    folded = [0, 4, 6, 2, 1, 5, 3, 7]
    monkeypatch.chdir(tmp_path)
    (tmp_path / "broken.stl").write_bytes(b"\0" * 80 + (7).to_bytes(4, "little") + b"\0" * 9)
    meshio.Mesh(CORNERS, [("tetra", [[0, 4, 2, 1]])]).write("tets.vtu")
    meshio.Mesh(CORNERS, [("hexahedron", [folded])]).write("folded.vtu")
    apart = np.vstack([CORNERS, CORNERS + 5])
    both = [order, [index + 8 for index in order]]
    meshio.Mesh(apart, [("hexahedron", both)]).write("pieces.vtu")
    return tmp_path


@pytest.mark.parametrize("name", RECIPES)
def test_recipes(name, meshes: Path, capsys):
    text, words = RECIPES[name]
    (meshes / "it.toml").write_text(text, encoding="utf-8")
    refuse(meshes, capsys, ["make", "it.toml", "-o", "a/b/out"], 2, words)
