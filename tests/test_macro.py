"""Bodies of many level-0 cells: one seamless mesh, in whatever frame each cell is named."""

import itertools
import pickle
import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import macro_meshes as meshes
import meshio
import naive_elasticity
import numpy as np
import programs
import pytest

import porous as po
from porous.cli import main
from porous.errors import ModelError, RecipeError
from porous.formats import inp
from porous.guests import ccx
from porous.jobs import compression, material
from porous.models.automaton import cells as expanded
from porous.models.bcifs import bcifs
from porous.models.builders import Options, Texture, build_cell
from porous.models.cell_folds import corner_weights
from porous.models.cell_system import CellSystem
from porous.models.digits import DigitSet, named
from porous.models.macro import MacroMesh, with_middles
from porous.models.macro_frames import Families, Hexahedron, assembled
from porous.models.solve import solve
from porous.values import CENTRE, Block, Box, Frame, VolumeMesh
from porous.values.surface_topology import defects, euler_number
from porous.values.volume_topology import boundary_faces

MENGER = (named("menger"),)
MINUS_CORNER = (
    DigitSet(2, np.array([d for d in itertools.product((0, 1), repeat=3) if d != (1, 1, 1)])),
)
SYMMETRIC = Texture(edge=(0.3, -0.2, 0.3), bump=(0.3, 0.3))
ASYMMETRIC = Texture(edge=(0.3, -0.2, 0.25), bump=(0.5, 0.3))
ROOMY = Box((-6, -6, -6), (6, 6, 6))
"""A domain for bodies whose certified box is not asked for: that takes a second."""

W = np.array([[1, 2, 4, 8], [0, 3, 12, 36], [0, 0, 8, 48], [0, 0, 0, 20]])
"""What vertices, edges, faces and cells of a sponge make of each other."""


def body(controls, cells, *, texture=None, digits=MENGER, level=2, cell="hex-27", domain=ROOMY):
    """Return the model of cells of one kind, each as it is named."""
    brep = build_cell(Options(cell, digits=digits, texture=texture))
    return bcifs(brep, controls=controls, cells=cells, digits=digits, level=level, domain=domain)


@cache
def solved(cell, digits, texture):
    return solve(build_cell(Options(cell, digits=digits, texture=texture)))


def system(controls, cells, *, texture=None, digits=MENGER, level=2, cell="hex-27"):
    """Return the cells of one kind at a level: a model without the checks of one."""
    solution = solved(cell, digits, texture)
    mesh = MacroMesh(cells, (solution.brep.start,) * len(cells))
    return CellSystem(solution, controls, level, ROOMY, macro=mesh)


def framed(controls, cells, textures, digits=MENGER, level=2):
    """Return the model of cells whose axes have textures, in frames that suit these."""
    given = [Hexahedron(tuple(c), digits, own) for c, own in zip(cells, textures, strict=True)]
    found = assembled("hex-27", given)
    return bcifs(found.brep, controls=controls, cells=found.mesh, level=level, domain=ROOMY)


def tear(model):
    """Return how far occurrences of one corner lie apart, by the body's size."""
    lower, upper = np.full((model.counts[0], 3), np.inf), np.full((model.counts[0], 3), -np.inf)
    for placed in expanded(model.automaton, model.level):
        q = model.brep.reached[placed.state]
        (group,) = (g for g in model.complex.cells if g.state == q)
        spots = np.swapaxes(placed.points @ corner_weights(model.solution, q), 1, 2)
        assert (placed.place == group.place).all()
        np.minimum.at(lower, model.complex.vertex_ids(group), spots)
        np.maximum.at(upper, model.complex.vertex_ids(group), spots)
    return np.abs(upper - lower).max() / np.ptp(model.controls, axis=1).max()


def distinct(points):
    return len(np.unique(np.round(points / np.ptp(points, axis=0).max(), 9), axis=0))


def assert_conforms(model):
    """Assert that the mesh of a body has no gaps, no hanging nodes and a closed boundary."""
    mesh, surface = model.cell_mesh(), model.boundary()
    assert (mesh.volumes > 0).all()
    assert distinct(mesh.points) == len(mesh.points)
    assert not defects(surface)
    assert surface.volume == pytest.approx(mesh.volumes.sum(), rel=1e-12)
    assert euler_number(surface) == 2 * (model.counts @ np.array([1, -1, 1, -1]))


# --- frames --------------------------------------------------------------------------------


@pytest.mark.parametrize("texture", [None, SYMMETRIC], ids=["smooth", "rough"])
def test_symmetric_rules_tear_in_no_frame(texture):
    rng = np.random.default_rng(5)
    controls, cells = meshes.o_grid(rng)
    for trial in range(11):
        named_so = meshes.shuffled(cells, rng) if trial else cells
        model = system(controls, named_so, texture=texture)
        assert model.counts == (3752, 10212, 8128, 2000)
        assert distinct(model.places[0]) == 3752
        assert tear(model) < 1e-15


def test_a_rule_that_is_not_its_own_reversal_is_refused_before_there_is_geometry():
    controls, cells = meshes.o_grid()
    model_of = pytest.raises(ModelError, match=r"state face is not symmetric under \(.*\); wanted")
    with model_of as caught:
        body(controls, cells, texture=ASYMMETRIC)
    assert "of cell" in str(caught.value)


def test_it_runs_one_way_along_parallel_edges_instead():
    rng = np.random.default_rng(6)
    controls, cells = meshes.o_grid(rng)
    for trial in range(3):
        named_so = meshes.shuffled(cells, rng) if trial else cells
        model = framed(controls, named_so, [(ASYMMETRIC,) * 3] * 5)
        assert model.counts[0] == distinct(model.places[0]) == 3752
        assert tear(model) < 1e-15


def test_every_class_of_parallel_edges_may_have_a_rule_of_its_own():
    rng = np.random.default_rng(7)
    controls, cells = meshes.o_grid(rng)
    for trial in range(2):
        named_so = meshes.shuffled(cells, rng) if trial else cells
        families = Families.of(named_so)
        assert families.count == 4
        rules = [Texture(rng.uniform(-0.4, 0.4, 3), rng.uniform(0.2, 0.5, 2)) for _ in range(4)]
        textures = [tuple(rules[axis.family] for axis in axes) for axes in families.axes]
        model = framed(controls, named_so, textures)
        assert model.counts[0] == distinct(model.places[0]) == 3752
        assert tear(model) < 1e-15


def test_edges_that_come_back_the_other_way_round_take_symmetric_rules_alone():
    controls, cells = meshes.twisted_ring(8, 2)
    model = framed(*with_middles(controls, cells), [(SYMMETRIC,) * 3] * 8, level=1)
    assert_conforms(model)
    with pytest.raises(ModelError, match=r"state .* is not symmetric under \(.*\); wanted by"):
        framed(*with_middles(controls, cells), [(ASYMMETRIC,) * 3] * 8)


def test_digits_without_symmetry_conform_in_every_frame():
    rng = np.random.default_rng(8)
    controls, cells = meshes.o_grid(rng, width=2)
    for _ in range(12):
        named_so = meshes.shuffled(cells, rng)
        model = system(controls, named_so, digits=MINUS_CORNER, cell="hex-8", level=3)
        assert model.counts[0] == model.complex.count(0) == distinct(model.places[0])
        assert tear(model) < 1e-15


# --- counts --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("mesh", "first"),
    [(meshes.o_grid(width=2), (16, 32, 22, 5)), (meshes.cylinder_12(), (34, 73, 52, 12))],
    ids=["o-grid", "cylinder"],
)
def test_counts_are_powers_of_a_matrix_times_those_of_the_cells(mesh, first):
    wanted = np.array(first)
    for level in range(4):
        model = system(*mesh, cell="hex-8", level=level)
        assert model.counts == tuple(wanted)
        if level < 3:
            assert tuple(model.complex.count(d) for d in range(4)) == model.counts
        wanted = W @ wanted


def test_a_cylinder_of_twelve_cells():
    rng = np.random.default_rng(9)
    controls, cells = meshes.cylinder_12()
    for level, nodes in ((1, 484), (2, 8922)):
        for named_so in (cells, meshes.shuffled(cells, rng)):
            model = system(controls, named_so, cell="hex-8", level=level)
            assert model.counts[0] == distinct(model.places[0]) == nodes
            assert tear(model) < 1e-15
    assert system(controls, cells, cell="hex-8", level=3).counts[0] == 173_884


def test_tetrahedra_share_faces_too():
    apexes = np.array([[0, 0, 0], [1, 0, 0], [0, 1.2, 0], [0, 0, 0.9], [0.8, 0.9, 0.7]]).T
    brep = build_cell(Options("tetra"))
    for order in itertools.permutations((1, 2, 3)):
        model = bcifs(brep, controls=apexes, cells=[(0, 1, 2, 3), (*order, 4)], level=3)
        # They share a gasket: (3⁴ + 3) / 2 corners.
        assert model.counts[0] == 2 * (2 * 4**3 + 2) - 42 == distinct(model.places[0])


# --- bodies --------------------------------------------------------------------------------


def wave(u):
    """Bend a lattice: plane at both ends of z, and nowhere else."""
    x, y, z = u
    return np.array([x + 0.25 * np.sin(z) + 0.03 * y, 1.2 * y + 0.2 * np.cos(0.8 * x), 0.9 * z])


def sixty_four(rng):
    controls, cells = meshes.grid((4, 4, 4), 2, wave)
    return controls, meshes.shuffled(cells, rng)


def test_a_part_of_sixty_four_cells_with_axes_of_their_own():
    rng = np.random.default_rng(10)
    model = body(*sixty_four(rng), cell="hex-8", level=1)
    assert_conforms(model)
    mesh = model.cell_mesh()
    assert len(boundary_faces(mesh)) == len(mesh.parts["SKIN"].members) + len(
        mesh.parts["WALL"].members
    )
    rows = {row.name: row.value for row in model.exact()}
    assert mesh.volumes.sum() == pytest.approx(rows["volume"], rel=1e-12)
    assert {"ZMIN", "ZMAX", "ZMIN_FACES"} <= set(mesh.parts)
    assert "XMIN" not in mesh.parts
    top = mesh.points[mesh.parts["ZMAX"].members, 2]
    assert np.ptp(top) < 1e-14
    assert len(mesh.parts["ZMAX_FACES"].members) == 16 * 8


def test_straight_cells_in_a_row_are_what_they_are_alone():
    controls, cells = meshes.grid((2, 1, 1), 2, lambda u: u * [3.0, 3.0, 5.0])
    model = body(controls, meshes.shuffled(cells, np.random.default_rng(11)), cell="hex-8")
    rows = {row.name: row.value for row in model.exact()}
    assert rows["volume"] == pytest.approx(90 * (20 / 27) ** 2, rel=1e-12)
    assert rows["porosity"] == pytest.approx(1 - (20 / 27) ** 2, rel=1e-12)
    assert model.bulk_volume == pytest.approx(90, rel=1e-12)
    frame = Frame((0, 0, 0), (0.4, 0.2, 0.5), (15, 15, 10))
    masks = model.sample(frame, CENTRE)
    alone = np.zeros_like(masks)
    for cell in cells:
        alone |= body(controls[:, cell], None, cell="hex-8").sample(frame, CENTRE)
    assert np.array_equal(masks, alone)


def test_voxels_of_a_twisted_ring_agree_with_its_cells():
    controls, cells = meshes.twisted_ring(12, 1)
    named_so = meshes.shuffled(cells, np.random.default_rng(12))
    model = body(controls, named_so, cell="hex-8", level=1, domain=None)
    assert_conforms(model)
    exact = 1 - model.cell_mesh().volumes.sum() / model.bulk_volume
    found = po.measures.porosity(po.voxelize(model, voxels=60))
    assert abs(found.value - exact) <= 2 * found.uncertainty
    assert pickle.loads(pickle.dumps(model)) == model


def test_the_limit_of_many_cells_is_that_of_each():
    controls, cells = meshes.o_grid(np.random.default_rng(13), width=2)
    whole = body(controls, cells, cell="hex-8", level="limit")
    frame = Frame((-1.7, -1.7, -0.1), (0.17, 0.17, 0.15), (20, 20, 10))
    marks, bound = whole.cover(frame)
    alone = np.zeros_like(marks)
    for cell in cells:
        found, other = body(controls[:, cell], None, cell="hex-8", level="limit").cover(frame)
        alone |= found
        assert bound == pytest.approx(other)
    # Voxels that are merely touched may be marked by one and not by the other.
    assert (marks != alone).sum() <= 0.01 * alone.sum()
    corners = body(controls, cells, cell="hex-8", level=3).places[0]
    held = np.floor((corners - frame.origin) / frame.spacing).astype(int)
    assert marks[tuple(held.T)].all()


@pytest.mark.judge
@pytest.mark.slow
def test_the_deck_of_a_part_of_sixty_four_cells_runs_as_written(judge):
    model = body(*sixty_four(np.random.default_rng(14)), cell="hex-8", level=1)
    job = compression(model.cell_mesh(), material=material("steel"), pressure=1.0)
    solved = ccx.solve(inp.write(job), program=judge("ccx"))
    energy, load = naive_elasticity.energy(job)
    assert solved.reaction == pytest.approx(load, abs=1e-5 * np.linalg.norm(load))
    assert solved.energy == pytest.approx(energy, rel=1e-5)
    assert solved.volume == pytest.approx(job.mesh.volumes.sum(), rel=1e-5)


# --- recipes -------------------------------------------------------------------------------


def recipe(tmp_path, **model):
    import tomli_w

    roomy = {"lower": list(ROOMY.lower), "upper": list(ROOMY.upper)}
    table = {"kind": "bcifs", "cell": "hex-8", "level": 1, "domain": roomy} | model
    table = {"digits": {"keep": "menger"}} | table
    table = {key: value for key, value in table.items() if value is not None}
    path = tmp_path / "body.toml"
    path.write_text(tomli_w.dumps({"format": 1, "title": "body", "model": table}))
    return po.build(po.load(path))


def in_a_row(count, width=2):
    controls, cells = meshes.grid((count, 1, 1), width, lambda u: u * [1.0, 1.2, 0.9])
    return {"controls": controls.T.tolist(), "cells": cells}


def test_cells_of_other_digits_share_faces_that_are_divided_alike(tmp_path):
    row = in_a_row(3)
    full = {"divisions": 3, "keep": list(itertools.product(range(3), repeat=3))}
    row["cells"][1] = {"controls": row["cells"][1], "digits": full}
    model = recipe(tmp_path, **row)
    mesh = model.cell_mesh()
    assert len(mesh.volumes) == 20 + 27 + 20
    assert mesh.volumes.sum() == pytest.approx(1.08 * (1 + 40 / 27), rel=1e-12)
    assert not defects(model.boundary())
    assert distinct(mesh.points) == len(mesh.points) == model.counts[0]


def test_textures_by_class_in_a_recipe(tmp_path):
    rough = {"edge": [0.3, -0.2, 0.25], "bump": [0.5, 0.3]}
    row = in_a_row(2, 3)
    row["controls"] = (
        np.array(row["controls"]) + np.random.default_rng(3).uniform(-0.03, 0.03, (45, 3))
    ).tolist()
    row["cells"][1] = meshes.relabelled(row["cells"][1], FRAME)
    # Along x the two cells have no edges in common: that makes four classes.
    four = [rough, {"edge": 0.2}, {"edge": -0.1}, {"edge": [0.1, 0.2, 0.3]}]
    model = recipe(tmp_path, **row, cell="hex-27", texture=four)
    assert tear(model) < 1e-15
    with pytest.raises(ModelError, match="texture: got 2; wanted one, or 4"):
        recipe(tmp_path, **row, cell="hex-27", texture=[rough, rough])


FRAME = ((2, 0, 1), (1, 0, 1))


def changed(cell, **places):
    return [places.get(f"at_{i}", index) for i, index in enumerate(cell)]


ROW = in_a_row(2)
FIRST, SECOND = ROW["cells"]
FAR = [[x + 5, y, z] for x, y, z in in_a_row(1)["controls"]]
BAD = {
    "out of range": ({"cells": [FIRST, changed(SECOND, at_7=99)]}, r"cells\[1\]: names control 99"),
    "negative": ({"cells": [FIRST, changed(SECOND, at_7=-1)]}, r"cells\[1\]: names control -1"),
    "twice": (
        {"cells": [FIRST, changed(SECOND, at_7=SECOND[6])]},
        rf"cells\[1\]: names control {SECOND[6]} twice",
    ),
    "too few": ({"cells": [FIRST, SECOND[:7]]}, r"7.*wanted 8"),
    "the same": ({"cells": [FIRST, FIRST[::-1], SECOND]}, r"cells\[1\]: has the controls of"),
    "unused": ({"cells": [FIRST]}, r"controls\[\d+\]: belongs to no cell"),
    "twisted": (
        {"cells": [FIRST, changed(SECOND, at_0=SECOND[1], at_1=SECOND[0])]},
        "of cell 0 and .* of cell 1: faces do not match",
    ),
    "in pieces": (
        {"controls": ROW["controls"] + FAR, "cells": [FIRST, SECOND, list(range(12, 20))]},
        "2 pieces; no chain of common faces joins cell 0 and cell 2",
    ),
    "folded": (
        {"cells": [FIRST, changed(SECOND, at_6=SECOND[7], at_7=SECOND[6])]},
        "level-0 cell 1 is folded",
    ),
    "no controls": ({"controls": None}, "cells: got indices of controls, but no controls"),
    "one point twice": (
        {
            "controls": ROW["controls"] + [ROW["controls"][SECOND[i]] for i in range(4)],
            "cells": [FIRST, [12, 13, 14, 15, *SECOND[4:]]],
        },
        "coincide",
    ),
    "other divisions": (
        {"cells": [FIRST, {"controls": SECOND, "digits": {"divisions": 2, "keep": [[0, 0, 0]]}}]},
        r"of cell 0 and .* of cell 1 are one face, of controls \d+, .* into 9 and 4 pieces",
    ),
    "a table of a beam": (
        {
            "cell": "beam",
            "draw": {"along": ["edges"], "radius": 0.1},
            "cells": [{"controls": FIRST}, SECOND],
        },
        r"cells\[0\]: got a table; wanted the indices alone",
    ),
}


def test_cells_of_other_textures_are_refused_where_they_meet(tmp_path):
    row = in_a_row(2, 3)
    row["cells"][1] = {"controls": row["cells"][1], "texture": {"edge": 0.2}}
    with pytest.raises(ModelError, match=r"of cell 0 and .* of cell 1 .* by other textures"):
        recipe(tmp_path, **row, cell="hex-27", texture={"edge": 0.3})
    # Across the face that they share they may differ: its lines run along y and z.
    row["cells"][1]["texture"] = [{"edge": 0.2}, {"edge": 0.3}, {"edge": 0.3}]
    assert recipe(tmp_path, **row, cell="hex-27", texture={"edge": 0.3}).counts[0] == 2 * 64 - 16


def test_cells_have_the_level_of_their_neighbours(tmp_path):
    row = in_a_row(3)
    cells = row["cells"]
    row["cells"] = [{"controls": cell, "level": 2} for cell in cells]
    model = recipe(tmp_path, **row, level=1)
    assert model.level == 2
    assert model.counts[3] == 3 * 20**2
    row["cells"][2]["level"] = 1
    shared = ", ".join(map(str, sorted(set(cells[1]) & set(cells[2]))))
    wanted = (
        rf"cells: XMAX of cell 1 and XMIN of cell 2 are one face, of controls {shared}, but are "
        "divided to levels 2 and 1; wanted the same level$"
    )
    with pytest.raises(ModelError, match=wanted) as caught:
        recipe(tmp_path, **row)
    assert "\n" not in str(caught.value)
    # Those that say nothing have the level of all.
    row["cells"] = [cells[0], {"controls": cells[1], "level": "limit"}, cells[2]]
    with pytest.raises(ModelError, match=r"of cell 0 and .* levels 1 and limit"):
        recipe(tmp_path, **row)


def half_rings(bulge):
    """Return two cells that make a ring: they share both ends, and the ends of all arcs."""
    points, cells = meshes.Points(), []
    for side in (1, -1):
        arc = ((side, 0), (0, side * bulge), (-side, 0))
        cells.append(
            [points((r * x, r * y, z)) for r in (2, 2.5, 3) for x, y in arc for z in (0, 0.6, 1.1)]
        )
    return points.array, cells


def test_two_half_rings_have_other_arcs_between_the_same_ends():
    controls, cells = half_rings(2.0)
    assert Families.of(cells).count == 4
    for texture in (None, ASYMMETRIC):
        textures = texture and (texture,) * 3
        found = assembled("hex-27", [Hexahedron(tuple(c), MENGER, textures) for c in cells])
        model = CellSystem(solve(found.brep), controls, 0, ROOMY, macro=found.mesh)
        assert model.counts == (8, 16, 10, 2)
        assert replace(model, level=2).counts == tuple(
            np.linalg.matrix_power(W, 2) @ (8, 16, 10, 2)
        )
        assert tear(replace(model, level=2)) < 1e-15


@pytest.mark.parametrize("case", BAD)
def test_bad_meshes_are_refused_in_one_line(case, tmp_path):
    change, text = BAD[case]
    with pytest.raises((ModelError, RecipeError), match=text) as caught:
        recipe(tmp_path, **ROW | change)
    assert "\n" not in str(caught.value)


def test_a_cell_on_the_wrong_side_of_a_face_is_refused(tmp_path):
    # The far end of the second cell is pushed back through the first.
    points = np.array(ROW["controls"])
    points[SECOND[4:], 0] = 0.5
    with pytest.raises(ModelError, match="cells: 0 and 1 lie on the same side of the face"):
        recipe(tmp_path, controls=points.tolist(), cells=ROW["cells"])


def test_a_hanging_corner_is_refused(tmp_path):
    # Two cells one upon the other beside one that is as high as both; a bridge joins them on top.
    boxes = (
        ((0, 0, 0), (1, 1, 1)),
        ((0, 0, 1), (1, 1, 2)),
        ((0, 0, 2), (1, 1, 3)),
        ((1, 0, 2), (2, 1, 3)),
        ((1, 0, 0), (2, 1, 2)),
    )
    points = meshes.Points()
    cells = [
        [points(np.where(u, upper, lower)) for u in itertools.product((0, 1), repeat=3)]
        for lower, upper in boxes
    ]
    with pytest.raises(ModelError, match="is a corner, but lies within an edge of cell 4"):
        recipe(tmp_path, controls=points.array.T.tolist(), cells=cells)


# --- walls of circles ----------------------------------------------------------------------


def arc(t, angle):
    """Return the angle of the point at t of a rational arc of an angle, from its start."""
    weight, far = np.cos(angle / 2), 1 / np.cos(angle / 2)
    ends = (1 - t) ** 2, t**2
    middle = 2 * t * (1 - t) * weight * far
    x = ends[0] + middle * np.cos(angle / 2) + ends[1] * np.cos(angle)
    y = middle * np.sin(angle / 2) + ends[1] * np.sin(angle)
    return np.arctan2(y, x)


def test_a_hollow_cylinder_is_as_round_and_as_heavy_as_its_arcs():
    model = po.build(po.load("menger-cylinder"))
    assert_conforms(model)
    mesh = model.cell_mesh()
    assert model.counts == tuple(np.linalg.matrix_power(W, 2) @ (48, 96, 60, 12))
    # A sponge's cells in radius, angle and height; the angle is what the arc makes of t.
    steps = np.arange(10) / 9
    angles = 12 * np.diff(arc(steps, np.pi / 6))
    sectors = np.diff((6 + 4 * steps) ** 2) / 2
    first = MENGER[0].keep
    places = (3 * first[:, None] + first).reshape(-1, 3)
    volume = (sectors[places[:, 0]] * angles[places[:, 1]]).sum() * 5 / 9
    assert mesh.volumes.sum() == pytest.approx(volume, rel=1e-3)
    radii = np.hypot(mesh.points[:, 0], mesh.points[:, 1])
    assert radii.min() == pytest.approx(6, abs=1e-13)
    assert radii.max() == pytest.approx(10, abs=1e-13)
    assert model.domain.lower == pytest.approx((-10, -10, 0), abs=1e-8)
    assert model.domain.upper == pytest.approx((10, 10, 5), abs=1e-8)
    assert {"ZMIN", "ZMAX"} <= set(mesh.parts)


def test_a_hollow_cylinder_is_the_same_in_other_frames():
    recipe = po.load("menger-cylinder")
    cells = meshes.shuffled(recipe.model.cells, np.random.default_rng(15))
    model = po.build(po.load("menger-cylinder", set={"model.cells": cells}))
    plain = po.build(recipe)
    assert model.counts == plain.counts
    assert_conforms(model)
    assert model.cell_mesh().volumes.sum() == pytest.approx(
        plain.cell_mesh().volumes.sum(), rel=1e-12
    )


# --- meshes of others ----------------------------------------------------------------------

VTK = [0, 4, 6, 2, 1, 5, 7, 3]
"""VTK's corners among those of a cell, x slowest and z fastest."""


PART = """
[model]
kind   = "bcifs"
cell   = "hex-8"
level  = 1
digits = {{ keep = "menger" }}
mesh   = "{}"

[voxels]
voxels = 40

[simulation]
material = "ti-6al-4v"
pressure = 2.5
"""


def part(tmp_path, name="part.vtu", corners=VTK):
    """Write the part of sixty-four cells, each in a frame of its own, as others do."""
    controls, cells = sixty_four(np.random.default_rng(16))
    block = Block("hex8", np.array(cells)[:, corners])
    po.write(VolumeMesh(controls.T, (block,)), tmp_path / name)
    return controls, cells


@pytest.mark.parametrize("name", ["part.vtu", "part.inp"])
def test_a_mesh_of_hexahedra_is_filled(tmp_path, name):
    controls, cells = part(tmp_path, name)
    model = recipe(tmp_path, mesh=name)
    assert_conforms(model)
    plain = body(controls, cells, cell="hex-8", level=1)
    assert model.counts == plain.counts
    volume = plain.cell_mesh().volumes.sum()
    assert model.cell_mesh().volumes.sum() == pytest.approx(volume, rel=1e-9)
    if name == "part.vtu":
        rough = recipe(tmp_path, mesh=name, cell="hex-27", texture={"edge": 0.3})
        assert rough.cell_mesh().volumes.sum() == pytest.approx(volume, rel=1e-9)


def test_a_folder_keeps_the_mesh_that_its_recipe_names(tmp_path):
    part(tmp_path)
    recipe(tmp_path, mesh="part.vtu", level=0)
    made = po.load(tmp_path / "body.toml", set={"voxels.voxels": 12})
    po.make(made, tmp_path / "out", only="voxels")
    again = po.build(po.load(tmp_path / "out" / "recipe.toml"))
    assert again == po.build(made)
    assert (tmp_path / "out" / "mesh.vtu").is_file()


def barrel(rng):
    """Return fifty-four curved cells between two planes, 3 × 3 × 6, their inner corners moved."""

    def place(u):
        x, y, z = u - (1.5, 1.5, 3)
        wide, turn = 1.2 - 0.03 * z**2, 0.12 * z
        moved = rng.uniform(-0.1, 0.1, 3) * (abs(x) < 1 and abs(y) < 1 and abs(z) < 3)
        c, s = np.cos(turn), np.sin(turn)
        return np.array([wide * (c * x - s * y), wide * (s * x + c * y), 1.3 * z]) + moved

    spots = {u: place(np.array(u)) for u in itertools.product(range(4), range(4), range(7))}
    return meshes.grid((3, 3, 6), 2, lambda u: spots[tuple(u.astype(int).tolist())])


def gauss(points, lower, upper):
    """Return the volumes of boxes of trilinear cells (…, 8, 3), by two points along each axis.

    That is exact: the Jacobian of a trilinear cell is of degree two in each coordinate.
    """
    total = 0.0
    for t in itertools.product((0.5 - 12**-0.5, 0.5 + 12**-0.5), repeat=3):
        u = lower + (upper - lower) * np.array(t)
        rows = np.stack([1 - u, u], axis=-1)
        rates = np.broadcast_to([-1.0, 1.0], (*rows.shape[:-2], 2))
        jacobian = [
            np.einsum(
                "...i,...j,...k,...ijkd->...d",
                *(rates if a == axis else rows[..., a, :] for a in range(3)),
                points.reshape(*points.shape[:-2], 2, 2, 2, 3),
            )
            for axis in range(3)
        ]
        total += np.linalg.det(np.stack(jacobian, axis=-1)) / 8
    return total * np.prod(upper - lower, axis=-1)


QUADS = [[0, 4, 7, 3], [1, 2, 6, 5], [0, 1, 5, 4], [3, 7, 6, 2], [0, 3, 2, 1], [4, 5, 6, 7]]
"""The faces of VTK's hexahedron, counter-clockwise from outside."""


@pytest.mark.judge
@pytest.mark.slow
@pytest.mark.parametrize("kind", ["vtu", "gmsh", "gmsh22"])
def test_a_coarse_mesh_of_others_is_filled_and_runs(kind, tmp_path, monkeypatch, judge):
    rng = np.random.default_rng(17)
    controls, cells = barrel(rng)
    assert len(cells) == 54
    # Gmsh wants right-handed cells; those of VTK are turned and mirrored in all 48 ways.
    frames = [f for f in meshes.FRAMES if kind == "vtu" or is_right_handed(f)]
    written = np.array([meshes.relabelled(c, frames[rng.integers(len(frames))]) for c in cells])
    order = rng.permutation(controls.shape[1])
    coarse = meshio.Mesh(controls.T[order], [("hexahedron", np.argsort(order)[written][:, VTK])])
    monkeypatch.chdir(tmp_path)
    name = "part.vtu" if kind == "vtu" else "part.msh"
    meshio.write(name, coarse, file_format=kind)
    (tmp_path / "part.toml").write_text(PART.format(name))
    assert main(["make", "part.toml", "-o", "out"]) == 0

    made = meshio.read("out/cells.vtu")
    assert [block.type for block in made.cells] == ["hexahedron"]
    hexahedra = made.cells[0].data
    assert len(hexahedra) == 54 * 20
    parents = controls.T[np.array(cells)]
    kept = MENGER[0].keep / 3
    volume = sum(gauss(parents, lower, lower + 1 / 3).sum() for lower in kept)
    lowest, highest = np.zeros(3), np.ones(3)
    volumes = gauss(made.points[hexahedra][:, np.argsort(VTK)], lowest, highest)
    assert volumes.sum() == pytest.approx(volume, rel=1e-12)
    assert (volumes > 0).all()
    assert distinct(made.points) == len(made.points)

    quads = hexahedra[:, QUADS].reshape(-1, 4)
    _, first, count = np.unique(
        np.sort(quads, axis=1), axis=0, return_index=True, return_counts=True
    )
    assert set(count) == {1, 2}
    skin = quads[first[count == 1]]
    edges = np.stack([skin, np.roll(skin, -1, axis=1)], axis=-1).reshape(-1, 2)
    assert set(np.unique(np.sort(edges, axis=1), axis=0, return_counts=True)[1]) == {2}
    assert len(np.unique(edges, axis=0)) == len(edges)

    programs.said([judge("ccx"), "-i", "out/cells"], ".")
    said = Path("out/cells.dat").read_text()
    force = np.array(re.search(r"total force.*?\n\s*\n" + 3 * r"\s*(\S+)", said).groups(), float)
    corners = made.points[skin]
    top = corners[(corners[..., 2] > 3.9 - 1e-9).all(axis=1)]
    ways = top[:, 2] - top[:, 0], top[:, 3] - top[:, 1]
    load = 2.5 * np.cross(*ways)[:, 2].sum() / 2
    assert force == pytest.approx([0, 0, load], abs=1e-5 * load)


def is_right_handed(frame):
    order, flips = frame
    return np.linalg.det(np.eye(3)[list(order)]) * (-1) ** sum(flips) > 0


def test_meshes_that_are_none_are_refused(tmp_path):
    part(tmp_path)
    part(tmp_path, "turned.vtu", [4, 0, *VTK[2:]])
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
    po.write(VolumeMesh(points, (Block("tet4", np.array([[0, 1, 2, 3]])),)), tmp_path / "tet.vtu")
    po.write(
        po.exact_surface(po.build(po.load("menger", set={"model.level": 0}))), tmp_path / "s.stl"
    )
    cases = (
        ({"mesh": "part.vtu", **ROW}, "got both mesh and controls"),
        ({"mesh": "part.vtu", "cell": "tetra", "digits": None}, "mesh: got cell = 'tetra'"),
        ({"mesh": "none.vtu"}, r"model\.mesh: not found: .none\.vtu.; wanted a file"),
        ({"mesh": "tet.vtu"}, "mesh: tet.vtu: cells: got 1 tet4; wanted hexahedra"),
        ({"mesh": "s.stl"}, "mesh: s.stl holds a SurfaceMesh; wanted hexahedra"),
        ({"mesh": "turned.vtu"}, "folded|do not match"),
    )
    for model, text in cases:
        with pytest.raises((ModelError, RecipeError), match=text) as caught:
            recipe(tmp_path, **model)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("kept", [(0, 1, 3, 7, 6), (0, 1, 2, 5, 6)])
def test_cells_that_touch_along_an_edge_besides_are_sampled(kept):
    """A chain of common faces joins the cells; two of them meet in an edge as well."""
    points, cells = meshes.grid((2, 2, 2), 2, lambda u: u)
    chosen = [cells[k] for k in kept]
    used = sorted(set(itertools.chain(*chosen)))
    chosen = [[used.index(index) for index in cell] for cell in chosen]
    chain = body(points[:, used], chosen, level=1, cell="hex-8", domain=None)
    grid = po.voxelize(chain, voxels=24)
    assert po.measures.porosity(grid).value == pytest.approx(1 - 20 / 27, abs=1e-3)
    mesh = po.mesh_cells(chain)
    assert mesh.volumes.sum() == pytest.approx(5 * 20 / 27)
    assert grid.fill.sum() / 255 * np.prod(grid.frame.spacing) == pytest.approx(100 / 27, rel=1e-2)
