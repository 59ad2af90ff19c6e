"""Boundary-controlled systems as models: bodies, bulks, closed forms and recipes."""

from itertools import pairwise, product

import numpy as np
import pytest
from rough import koch

import porous as po
from porous.errors import ModelError, RecipeError
from porous.models.bcifs import bcifs
from porous.models.builders import Options, Texture, build_cell
from porous.models.cell_body import CellBody
from porous.models.digits import DigitSet, named
from porous.models.swept_body import Sweep, SweptBody, contacts, swept
from porous.values import CENTRE, FILL, Box, Frame

CUBE = np.array(list(product((0.0, 1.0), repeat=3))).T
LATTICE = np.array(list(product((0.0, 0.5, 1.0), repeat=3))).T
SIDES = np.diag([2.0, 3.0, 5.0])


def bent(points, seed, amount):
    return SIDES @ (points + np.random.default_rng(seed).uniform(-amount, amount, points.shape))


def hexa(digits="menger", *, level=2, cell="hex-8", texture=None, **more):
    sets = (named(digits),) if isinstance(digits, str) else tuple(digits)
    brep = build_cell(Options(cell, digits=sets, texture=texture))
    return bcifs(brep, level=level, digits=sets, **more)


def tetra(level=2, **more):
    return bcifs(build_cell(Options("tetra", keep=more.pop("keep", None))), level=level, **more)


def rows(model):
    return {row.name: row.value for row in model.exact()}


def grid_volume(model, voxels):
    grid = po.voxelize(model, voxels=voxels)
    return grid.fill.astype(float).sum() / 255 * grid.frame.voxel_volume


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("digits", ["menger", "mosely-heavy", "even-parity"])
def test_the_closed_volume_of_bent_blocks_is_that_of_their_cells(digits, seed):
    model = hexa(digits, controls=bent(CUBE, seed, 0.15))
    mesh = model.cell_mesh()
    assert mesh.volumes.sum() == pytest.approx(rows(model)["volume"], rel=1e-12)
    assert model.boundary().volume == pytest.approx(rows(model)["volume"], rel=1e-12)


def test_transient_levels_have_a_closed_volume():
    digits = named("menger"), DigitSet(2, np.array([[0, 0, 0], [1, 0, 0], [1, 1, 1]]))
    for level in range(4):
        model = hexa(digits, level=level, controls=bent(CUBE, 7, 0.1))
        expected = rows(model)["volume"]
        assert model.cell_mesh().volumes.sum() == pytest.approx(expected, rel=1e-12)
        assert model.cell_mesh().cells == (1, 20, 60, 180)[level]


@pytest.mark.parametrize("cell", ["tetra", "tetra-octa"])
@pytest.mark.parametrize("level", [0, 1, 2, 3])
def test_simplicial_volumes_follow_from_ratios(cell, level):
    for keep in (None, {"tetra": ("tetra", "octa")}, {"tetra": ("tetra",)}):
        model = bcifs(build_cell(Options(cell, keep=keep)), level=level)
        found = model.cell_mesh().volumes.sum()
        assert found == pytest.approx(rows(model)["volume"], rel=1e-12)
    assert rows(bcifs(build_cell(Options("tetra")), level=level))["porosity"] == pytest.approx(
        1 - 0.5**level, abs=1e-12
    )


def test_no_volume_is_claimed_where_free_points_move():
    model = hexa(moves={"face.00.3": [0.05, 0.02, 0.0]})
    assert "volume" not in rows(model)
    assert "surface_area" not in rows(model)
    assert rows(model)["genus"] == 81  # the topology is prescribed, whatever moves


def test_a_straight_cube_is_the_sponge_of_the_affine_maps():
    cells, maps = hexa("menger", size=3.0), po.build(po.load("menger", set={"model.size": 3.0}))
    own, theirs = rows(cells), {row.name: row.value for row in maps.exact()}
    assert own.keys() >= {"volume", "porosity", "surface_area", "genus", "euler_number_26"}
    for name in own.keys() & theirs.keys():
        assert own[name] == pytest.approx(theirs[name], rel=1e-12), name
    for voxels in (27, 40):
        first, second = (po.voxelize(model, voxels=voxels) for model in (cells, maps))
        assert np.abs(first.fill.astype(int) - second.fill).max() <= 0 or voxels == 40
        assert abs(first.fill.mean() - second.fill.mean()) < 1e-3 * second.fill.mean()


@pytest.mark.parametrize("name", ["menger", "vicsek-9", "even-parity", "mosely-light"])
def test_topology_by_counting_is_that_of_the_complex(name):
    model = hexa(name, controls=bent(CUBE, 1, 0.1))
    known = rows(model)
    assert known["euler_number_26"] == model.complex.euler_number
    assert known["components_26"] == model.complex.components


def test_the_voxel_route_agrees_with_the_mesh_and_ever_more_closely():
    model = hexa(
        cell="hex-27",
        texture=Texture(edge=(0.3, -0.2, 0.3), bump=(0.5, 0.3)),
        controls=bent(LATTICE, 5, 0.06),
    )
    exact = 1 - model.cell_mesh().volumes.sum() / model.bulk_volume
    stated = []
    for voxels in (20, 40, 80, 160):
        found = po.measures.porosity(po.voxelize(model, voxels=voxels))
        assert abs(found.value - exact) <= 2 * found.uncertainty
        stated.append(found.uncertainty)
    assert all(fine < coarse / 1.7 for coarse, fine in pairwise(stated))


@pytest.mark.parametrize("seed", range(3))
def test_the_body_lies_in_its_bulk_and_both_in_the_domain(seed):
    for model in (
        hexa(cell="hex-27", controls=bent(LATTICE, seed, 0.08)),
        hexa("minus-corner", controls=bent(CUBE, seed, 0.15)),
        tetra(controls=SIDES @ np.array([[0, 1, 0.2, 0.3], [0, 0.1, 1, 0.2], [0, 0, 0.3, 1.0]])),
    ):
        frame = Frame.fit(model.domain, voxels=40, unit="mm")
        solid, bulk = model.sample(frame, FILL), model.sample_bulk(frame, FILL)
        outside = np.bitwise_count(solid & ~bulk).sum() / np.bitwise_count(bulk).sum()
        assert outside < 2e-5  # samples within rounding of the common boundary
        measured = np.bitwise_count(bulk).sum() / 64 * frame.voxel_volume
        assert measured == pytest.approx(model.bulk_volume, rel=5e-3)
        assert model.domain.contains(model.boundary().box, tolerance=1e-9)


def test_the_full_set_fills_its_bulk():
    model = hexa("full-3", cell="hex-27", controls=bent(LATTICE, 2, 0.08), level=1)
    assert model.cell_mesh().volumes.sum() == pytest.approx(model.bulk_volume, rel=1e-12)
    affine = hexa("full-2", controls=bent(CUBE, 2, 0.1))
    assert rows(affine)["porosity"] == pytest.approx(0, abs=1e-12)


def test_a_bulk_of_ones_own():
    box = Box((0, 0, 0), (4, 3, 5))
    model = hexa(controls=SIDES @ CUBE, bulk=box)
    assert model.bulk_volume == 60
    assert rows(model)["porosity"] == pytest.approx(1 - 30 * (20 / 27) ** 2 / 60, rel=1e-12)


@pytest.mark.parametrize("level", [0, 1, 2])
def test_a_wire_lattice_has_every_edge_and_vertex_once(level):
    body = hexa("full-2", cell="beam", level=level, draw=Sweep(("vertices", "edges"), 0.01))
    assert isinstance(body, SweptBody)
    found = swept(body, body.sweep)
    side = 2**level
    assert len(found.capsules) == 3 * side * (side + 1) ** 2
    assert len(found.balls) == (side + 1) ** 3


def test_diagonals_and_faces_of_a_lattice():
    names = ("face-diagonals", "body-diagonals", "faces")
    body = hexa("full-2", level=1, draw=Sweep(names, 0.01))
    found = swept(body, body.sweep)
    assert len(found.capsules) == 2 * 36 + 4 * 8
    assert len(found.plates) == 4 * 36
    lengths = np.linalg.norm(np.diff(found.capsules, axis=1)[:, 0], axis=1)
    assert np.unique(lengths.round(9)) == pytest.approx([np.sqrt(0.5), np.sqrt(0.75)])


def test_one_beam_is_a_capsule():
    body = hexa("full-2", level=0, controls=SIDES @ CUBE, draw=Sweep(("edges",), 0.05))
    r, lengths = 0.05, 4 * (2 + 3 + 5)
    # Beams overlap in their corners alone: there are between the cylinders less and more.
    cylinders = np.pi * r**2 * lengths
    assert cylinders * 0.97 < grid_volume(body, 400) < cylinders * 1.01


def test_grown_cells_and_fused_contacts_are_bodies_without_a_mesh():
    plain, grown = hexa("vicsek-9", level=1), hexa("vicsek-9", level=1, offset=0.02)
    assert isinstance(plain, CellBody)
    assert isinstance(grown, SweptBody)
    assert grown.domain.contains(plain.domain.grown(0.02), tolerance=1e-12)
    assert grid_volume(grown, 60) > grid_volume(plain, 60)
    fused = hexa("vicsek-9", level=1, contacts="fuse", contact_radius=0.05)
    points, edges = contacts(fused)
    assert (len(points), len(edges)) == (8, 0)  # the centre meets the corners in its own eight
    edge_cubes = hexa("edge-cubes", level=1, contacts="fuse")
    assert len(contacts(edge_cubes)[1]) > 0
    grid = po.voxelize(fused, voxels=81)
    assert po.measures.components(grid).value == 1
    assert po.measures.components(po.voxelize(plain, voxels=81)).value == 9


def test_a_grown_bent_cell_grows_by_what_steiner_says():
    model = hexa("full-2", level=0, controls=SIDES @ CUBE, offset=0.2)
    a, b, c, r = 2.0, 3.0, 5.0, 0.2
    steiner = a * b * c + 2 * r * (a * b + b * c + c * a) + np.pi * r**2 * (a + b + c)
    steiner += 4 / 3 * np.pi * r**3
    assert grid_volume(model, 120) == pytest.approx(steiner, rel=1e-3)


def test_centre_and_cover_of_curved_cells():
    model = hexa(cell="hex-27", level=1, controls=bent(LATTICE, 3, 0.08))
    frame = Frame.fit(model.domain, voxels=30, unit="mm")
    marks, bound = model.cover(frame)
    touched = model.sample(frame, FILL) != 0
    assert not (touched & (marks == 0)).any()
    assert frame.diagonal <= bound <= 1.001 * frame.diagonal
    inside = model.sample(frame, CENTRE) != 0
    assert not (inside & ~touched).any() or (inside & ~touched).mean() < 1e-3


def test_eight_corners_serve_a_cell_of_27_controls():
    corners = bent(CUBE, 9, 0.1)
    few, many = hexa(controls=corners), hexa(cell="hex-27", controls=corners)
    assert np.allclose(few.cell_mesh().points, many.cell_mesh().points, atol=1e-12)


def test_size_is_that_of_the_domain():
    model = hexa(controls=SIDES @ CUBE, size=20.0)
    assert max(model.domain.lengths) == pytest.approx(20, rel=1e-12)
    assert rows(model)["volume"] == pytest.approx(30 * 4**3 * (20 / 27) ** 2, rel=1e-12)


def test_printable_levels_and_features():
    model = hexa(controls=SIDES @ CUBE)
    assert model.smallest_feature() == pytest.approx(2 / 9, rel=1e-12)
    assert model.finest_printable_level(0.2) == 2
    assert model.finest_printable_level(0.3) == 1
    assert model.finest_printable_level(2.5) is None
    edge = np.sqrt(2)
    assert tetra(level=0).smallest_feature() == pytest.approx(edge * np.sqrt(2 / 3), rel=1e-12)


def test_coincident_controls_are_named():
    controls = CUBE.copy()
    controls[:, 5] = controls[:, 3]
    with pytest.raises(ModelError, match="controls: 3 and 5 coincide"):
        hexa(controls=controls)


def rough_and_folded():
    """Return a block whose texture is rough enough to fold cells of level 3."""
    texture = Texture(edge=0.7)
    return hexa(cell="hex-27", level=3, texture=texture, controls=bent(LATTICE, 5, 0.06))


def test_a_folded_cell_is_named_and_voxels_still_work():
    model = rough_and_folded()
    with pytest.raises(ModelError, match=r"cell \d{3}\.\d{3}\.\d{3} .*folded"):
        model.cell_mesh()
    assert po.voxelize(model, voxels=20).solid.any()


def test_a_level_0_cell_that_is_folded_is_refused_with_the_order_of_its_controls():
    vtk = CUBE[:, [0, 4, 6, 2, 1, 5, 7, 3]]
    with pytest.raises(ModelError, match=r"controls: .*folded.*x slowest, z fastest"):
        hexa(controls=vtk)


@pytest.mark.parametrize(
    ("change", "wanted"),
    [
        ({"model.cell": "hex-9"}, "no cell 'hex-9'"),
        ({"model.cell": "beam"}, "draw"),
        ({"model.controls": [[0, 0, 0]] * 5}, "wanted 8"),
        ({"model.texture": {"edge": 0.3}}, "texture"),
        ({"model.moves": {"edge.0.7": [1.0]}}, "edge.0.7"),
        ({"model.contacts": "glued"}, "contacts"),
        ({"model.level": -1}, "level"),
        ({"model.level": 40}, "cells|memory|level"),
        ({"model.draw": {"along": ["edge"], "radius": 0.1}}, "along"),
        ({"model.draw": {"along": ["edges"], "radius": -0.1}}, "radius|draw"),
        ({"model.digits": {"divisions": 3, "keep": "mengr"}}, "mengr"),
        ({"model.start": "face9"}, "start"),
    ],
)
def test_recipes_that_cannot_be_are_refused(change, wanted):
    with pytest.raises((ModelError, RecipeError, po.MemoryLimitError), match=wanted):
        po.run(po.load("menger-block", set=change), only="model").model.cell_mesh()


def test_a_texture_that_does_not_contract_is_refused_by_word():
    change = {"model.texture": {"edge": [1.2, 0.2, 0.2], "bump": 0.4}}
    with pytest.raises(ModelError, match=r"contract|spectral|word"):
        po.build(po.load("menger-bent", set=change))


def test_a_slider_with_dots_in_its_name_can_be_set_by_path():
    by_path = po.load("menger-block", set={'model.moves."edge.0.1"': [0.05, 0.0, 0.0]})
    by_table = po.load("menger-block", set={"model.moves": {"edge.0.1": [0.05, 0.0, 0.0]}})
    assert by_path == by_table


DRAW = 'draw = { along = ["edges", "vertices"], radius = 0.01 }\n'
KOCH = koch(f'level = 3\nstart = "curve"\n{DRAW}', voxels=80)


def test_a_koch_curve_in_full_is_a_wire(tmp_path):
    path = tmp_path / "koch.toml"
    path.write_text(KOCH)
    model = po.build(po.load(path))
    assert model.counts == (4**3 + 1, 4**3, 0, 0)
    assert model.betti_numbers == (1, 0, 0)
    wire = swept(model, model.sweep)
    lengths = np.linalg.norm(np.diff(wire.capsules, axis=1)[:, 0], axis=1)
    assert lengths == pytest.approx(np.full(64, 3.0**-3), rel=1e-12)
    assert wire.capsules[..., 1].max() == pytest.approx(np.sqrt(3) / 6, rel=1e-12)
    assert po.voxelize(model, voxels=120).solid.any()


def test_a_curve_without_a_drawing_is_refused(tmp_path):
    path = tmp_path / "koch.toml"
    path.write_text(KOCH.replace(DRAW, ""))
    with pytest.raises(ModelError, match="state curve are of shape edge, no volumes"):
        po.build(po.load(path))


def own_menger():
    """Return the states of a Menger cell, as users may write them."""
    return build_cell(Options("hex-8", digits=(named("menger"),)))


def test_digits_that_the_cells_are_not_are_refused():
    with pytest.raises(
        ModelError, match=r"digits\[0\]: the 20 children of state cell are not the 7"
    ):
        bcifs(own_menger(), digits=(named("vicsek-7"),))
    plain = bcifs(own_menger(), level=1)
    assert "genus" not in rows(plain)
    assert "surface_area" not in rows(plain)
    assert rows(plain)["euler_number_26"] == -4


def test_a_mirrored_block_has_a_positive_volume():
    controls = CUBE.copy()
    controls[0] *= -1
    controls[:, 7] = [-1.3, 1.0, 1.0]
    model = hexa(controls=controls, level=1)
    assert rows(model)["volume"] == pytest.approx(model.cell_mesh().volumes.sum(), rel=1e-12)
    assert rows(model)["volume"] > 0


def test_nothing_exact_is_said_of_folded_cells():
    model = rough_and_folded()
    assert model.exact() == ()
    assert model.smallest_feature() is None
    with pytest.raises(ModelError, match="folded"):
        po.voxelize(model, per_feature=4)


@pytest.mark.parametrize(
    ("options", "wanted"),
    [
        ({"contacts": "sheared"}, "contacts: got 'sheared'"),
        ({"contact_radius": -1.0}, "contact_radius: got -1"),
        ({"size": 0.0}, "size: got 0"),
        ({"offset": -1.0}, "offset: got -1"),
        ({"level": True}, "level: got True"),
        ({"controls": "x"}, "controls: wanted numbers"),
        ({"controls": CUBE * 1e200}, "controls: extend over"),
    ],
)
def test_arguments_that_cannot_be_are_refused(options, wanted):
    with pytest.raises(ModelError, match=wanted):
        bcifs(own_menger(), **options)


def test_a_word_that_does_not_contract_is_named_by_children():
    with pytest.raises(ModelError, match=r"the word is cell\.\d{3}"):
        hexa(moves={"cell.000.7": [3.0, 3.0, 3.0]})


def test_levels_too_deep_for_memory_are_refused_at_once():
    assert hexa("full-2", level=12).bulk_volume == pytest.approx(1, rel=1e-12)  # flat faces
    model = hexa("full-2", level=12, controls=bent(CUBE, 4, 0.1))
    with pytest.raises(po.MemoryLimitError, match="68719476736 cells"):
        _ = model.bulk_volume
    assert model.counts[3] == 8**12


@pytest.mark.parametrize(
    ("more", "served", "refused"),
    [
        ({"level": 2}, 2.0**14, 1e8),
        ({"level": 2, "offset": 0.125}, 2.0**14, 1e8),
        ({"level": "limit"}, 2.0**26, 5e11),
    ],
)
def test_cells_far_from_the_origin_have_the_same_voxels_or_none(more, served, refused):
    near, far = (
        po.voxelize(hexa("even-parity", controls=CUBE + shift, **more), voxels=16, sampling="cover")
        for shift in (0.0, served)
    )
    assert near.fill.any()
    assert np.array_equal(near.fill, far.fill)
    with pytest.raises(ModelError, match="origin"):
        po.voxelize(
            hexa("even-parity", controls=CUBE + refused, **more), voxels=16, sampling="cover"
        )
