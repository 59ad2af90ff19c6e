"""Fewer triangles: the same topology, about the same volume, the same parts."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree
from stepped import (
    blobs,
    cancel,
    crossings,
    gyroid,
    hollow,
    hundred,
    many,
    noise,
    surface_of,
    topology,
)

import porous as po
from porous.certificate import certify
from porous.measures import measure
from porous.stages import _simplify
from porous.values.surface_topology import defects


@pytest.mark.parametrize("keep", [0.7, 0.2, 0.05])
@pytest.mark.parametrize("fill", [gyroid(), hollow()], ids=["gyroid", "hollow"])
def test_fewer_triangles_have_the_same_topology_and_volume(fill, keep):
    before = surface_of(fill)
    after = po.simplify(before, keep=keep)
    assert not defects(after)
    assert topology(after) == topology(before)
    assert abs(after.volume / before.volume - 1) <= _simplify.TOLERANCE
    assert len(after.triangles) >= 0.99 * keep * len(before.triangles)
    assert len(after.triangles) < 0.75 * len(before.triangles)
    assert after.unit == before.unit


@pytest.mark.parametrize(("seed", "grey"), list(itertools.product(range(4), [False, True])))
def test_noise_keeps_its_topology_however_much_is_asked(seed, grey):
    before = surface_of(noise(seed, grey))
    after = po.simplify(before, keep=0.01)
    assert not defects(after)
    assert topology(after) == topology(before)
    assert abs(after.volume / before.volume - 1) <= _simplify.TOLERANCE
    solids = measure(before)["components"].value
    assert measure(after)["components"].value == solids


@pytest.mark.parametrize("seed", range(15))
def test_no_simplified_noise_crosses_itself(seed):
    for grey in (False, True):
        assert crossings(po.simplify(surface_of(noise(seed, grey)), keep=0.7)) == 0


@pytest.mark.parametrize("keep", [0.5, 0.1])
@pytest.mark.parametrize("fill", [blobs(3), blobs(6), gyroid(), hollow()], ids="abcd")
def test_no_simplified_body_crosses_itself(fill, keep):
    assert crossings(po.simplify(surface_of(fill), keep=keep)) == 0


def shell(radius, thickness, n):
    x = np.arange(n) + 0.5 - n / 2
    off = np.abs(np.sqrt(x[:, None, None] ** 2 + x[:, None] ** 2 + x**2) - radius)
    return np.clip(127.5 + 255 * (thickness / 2 - off), 0, 255).astype(np.uint8)


def test_a_shell_would_cross_itself_if_nothing_was_asked(monkeypatch):
    # Its two sides, less than two voxels apart, become polyhedra of a few dozen triangles.
    before = surface_of(shell(9, 1.8, 22), spacing=(1, 1, 1))
    after = po.simplify(before, keep=0.005, tolerance=0.2)
    assert len(after.triangles) < 0.02 * len(before.triangles)
    assert crossings(after) == 0
    monkeypatch.setattr(_simplify, "crossing", lambda _, triangles: np.zeros(len(triangles), bool))
    assert crossings(po.simplify(before, keep=0.005, tolerance=0.2)) > 0


@pytest.mark.slow
@pytest.mark.parametrize("every", [10, pytest.param(1, marks=pytest.mark.nightly)])
def test_none_of_a_hundred_simplified_surfaces_crosses_itself(every):
    bodies = 0
    for before, keep in zip(hundred(every), itertools.cycle([0.5, 0.25, 0.1])):
        assert crossings(po.simplify(before, keep=keep)) == 0
        bodies += 1
    assert bodies >= 100 // every


@pytest.mark.slow
def test_both_steps_leave_no_crossings():
    for before in hundred(10):
        assert crossings(po.simplify(po.smooth(before, iterations=5), keep=0.3)) == 0


def test_a_surface_that_crosses_itself_is_not_held_to_more():
    one, shift = surface_of(gyroid(20)), [3.3, 0.4, 0.3]
    points = np.vstack([one.points, one.points + shift])
    before = po.SurfaceMesh(points, np.vstack([one.triangles, one.triangles + len(one.points)]))
    assert crossings(before) > 0
    assert len(po.simplify(before, keep=0.5).triangles) < 0.6 * len(before.triangles)


@pytest.mark.slow
@pytest.mark.parametrize("grids", [80, pytest.param(400, marks=pytest.mark.nightly)])
def test_hundreds_of_grids_keep_their_topology(grids):
    random = np.random.default_rng(3)
    for index in range(grids):
        shape = tuple(random.integers(3, 9, 3))
        fill = random.integers(0, 256, shape).astype(np.uint8)
        if index % 2:
            fill = np.where(fill < random.integers(60, 200), np.uint8(0), np.uint8(255))
        if fill.max() < 128:
            continue
        before = surface_of(fill)
        after = po.simplify(before, keep=float(random.uniform(0.05, 0.9)), tolerance=0.01)
        assert not defects(after)
        assert topology(after) == topology(before)
        assert abs(after.volume / before.volume - 1) <= 0.01


@pytest.mark.parametrize("voxels", [18, 45])
def test_no_sliver_is_left_in_flat_faces(voxels):
    model = po.build(po.load("menger", set={"model.level": 2}))
    before = po.extract_surface(po.voxelize(model, voxels=voxels))
    after = po.simplify(before, keep=0.4)
    assert len(after.triangles) < 0.5 * len(before.triangles)
    corners = after.corners
    longest = np.linalg.norm(np.roll(corners, 1, axis=1) - corners, axis=2).max(axis=1)
    height = 2 * np.linalg.norm(after.area_vectors, axis=1) / longest
    assert (height > 1e-5 * longest).all()
    assert after.volume == pytest.approx(before.volume, rel=2e-3)


def test_flat_faces_cost_nothing():
    # A box: its flat faces need few triangles, whatever the voxels were.
    fill = np.full((12, 10, 11), 255, np.uint8)
    before = surface_of(fill)
    after = po.simplify(before, keep=0.3)
    assert after.volume == pytest.approx(before.volume, rel=1e-9)
    assert after.area == pytest.approx(before.area, rel=1e-9)


def test_caps_keep_their_names_and_planes():
    # The rim that marching cubes cuts off where a cap meets the wall may come back: up to half a
    # voxel all round.
    before = surface_of(gyroid())
    after = po.simplify(before, keep=0.2)
    assert after.names == before.names
    for label in range(1, 7):
        axis = (label - 1) // 2
        old = np.linalg.norm(before.area_vectors, axis=1)[before.labels == label].sum()
        vectors = after.area_vectors[after.labels == label]
        assert 0.98 * old < np.linalg.norm(vectors, axis=1).sum() < 1.4 * old
        across = np.abs(vectors[:, axis]).sum() / np.linalg.norm(vectors, axis=1).sum()
        assert across > 0.97
        plane = before.points[before.triangles[before.labels == label], axis].mean()
        off = np.abs(after.corners[after.labels == label][:, :, axis] - plane).mean(axis=1)
        assert np.average(off, weights=np.linalg.norm(vectors, axis=1)) < 0.1


def test_the_shape_stays_where_it_was():
    before = surface_of(gyroid())
    after = po.simplify(before, keep=0.3)
    weights = np.random.default_rng(0).dirichlet((1, 1, 1), 4)
    samples = np.einsum("kc,tcx->ktx", weights, before.corners).reshape(-1, 3)
    found = np.einsum("kc,tcx->ktx", weights, after.corners).reshape(-1, 3)
    assert cKDTree(samples).query(found)[0].max() < 1.0  # a voxel
    middle, normals = before.corners.mean(axis=1), before.area_vectors
    near = cKDTree(middle).query(after.corners.mean(axis=1))[1]
    assert (np.einsum("ij,ij->i", normals[near], after.area_vectors) > 0).mean() > 0.99


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_units_and_places_do_not_matter(scale):
    before = surface_of(gyroid())
    there = replace(before, points=scale * (before.points + np.array([100, 200, -300])))
    one, other = po.simplify(before, keep=0.3), po.simplify(there, keep=0.3)
    assert len(one.triangles) == pytest.approx(len(other.triangles), rel=1e-3)
    assert other.volume / scale**3 == pytest.approx(one.volume, rel=1e-4)


def test_the_same_surface_gives_the_same_triangles():
    before = surface_of(gyroid())
    assert po.simplify(before, keep=0.4) == po.simplify(before, keep=0.4)


def test_what_changed_is_owed():
    before = surface_of(gyroid())
    after = po.simplify(before, keep=0.1)
    volume, area = after.altered
    assert volume == pytest.approx(abs(after.volume - before.volume))
    assert area >= abs(after.area - before.area)
    again = po.simplify(after, keep=0.9)
    assert again.altered >= after.altered
    rows = measure(after)
    for name in ("volume", "surface_area", "interface_area"):
        there = measure(before)[name].value
        assert abs(rows[name].value - there) <= rows[name].uncertainty * (1 + 1e-9)


def test_the_certificate_holds_model_grid_and_surface_together():
    model = po.build(po.load("menger", set={"model.level": 2}))
    grid = po.voxelize(model, voxels=45)
    whole = po.extract_surface(grid)
    before, after = certify(model, grid, whole), certify(model, grid, po.simplify(whole, keep=0.2))
    rows = {row.quantity: row for row in after.rows}
    assert rows["euler_number"].surface == rows["euler_number"].model == -80
    assert rows["components"].surface == 1
    assert [row.verdict for row in after.rows] == [row.verdict for row in before.rows]
    assert rows["volume"].verdict == "agree"


def test_an_exact_boundary_is_one_no_more():
    model = po.build(po.load("menger", set={"model.level": 1}))
    exact = po.exact_surface(model)
    fewer = po.simplify(exact, keep=0.9)
    assert 0 < len(fewer.triangles) <= len(exact.triangles)
    shaken = replace(exact, altered=(0.25, 0.5))
    rows = measure(shaken, model=model)
    assert {row.method for row in rows.all("volume")} == {"triangles"}
    assert rows["volume"].uncertainty >= 0.25
    assert rows["surface_area"].uncertainty >= 0.5
    assert rows["porosity"].uncertainty == pytest.approx(0.25 / model.bulk.volume, rel=1e-6)


def test_keeping_all_changes_nothing():
    before = surface_of(hollow())
    assert po.simplify(before, keep=1) is before
    assert po.simplify(before, keep=0.3, tolerance=0).volume == before.volume


def test_progress_is_told_and_may_cancel():
    told = []
    po.simplify(surface_of(hollow()), progress=lambda *given: told.append(given))
    assert told[0] == ("simplify", 0.0)
    assert told[-1] == ("simplify", 1.0)
    with pytest.raises(po.Cancelled):
        po.simplify(surface_of(hollow()), progress=cancel)


@pytest.mark.parametrize("keep", [0, -1, 1.5, float("nan")])
def test_shares_that_are_none(keep):
    with pytest.raises(po.MeshError, match=r"keep: got .*; wanted a share"):
        po.simplify(surface_of(hollow()), keep=keep)


def test_a_tolerance_below_zero():
    with pytest.raises(po.MeshError, match="tolerance: got -1; wanted zero or more"):
        po.simplify(surface_of(hollow()), tolerance=-1)


def test_surfaces_that_enclose_nothing_are_refused():
    whole = surface_of(hollow())
    holed = po.SurfaceMesh(whole.points, whole.triangles[1:])
    with pytest.raises(po.MeshError, match="simplify: the surface has 3 open edges, the first"):
        po.simplify(holed)
    with pytest.raises(po.MeshError, match="no triangles"):
        po.simplify(po.SurfaceMesh(np.zeros((0, 3)), np.zeros((0, 3), np.int64)))
    doubled = po.SurfaceMesh(whole.points, np.vstack([whole.triangles, whole.triangles]))
    with pytest.raises(po.MeshError, match="nonmanifold edges"):
        po.simplify(doubled)


def test_memory_is_asked_for_first(monkeypatch):
    monkeypatch.setenv("POROUS_MAX_MEMORY", "10K")
    with pytest.raises(po.MemoryLimitError, match="simplifying"):
        po.simplify(many(100))


# --- recipes -------------------------------------------------------------------------------


def test_a_recipe_simplifies_and_says_so():
    changed = {"model.level": 2, "voxels.voxels": 45, "surface.simplify": 0.25}
    recipe = po.load("menger", set={**changed, "surface.method": "marching-cubes"})
    result = po.run(recipe, only="measures")
    whole = po.extract_surface(result.grid)
    assert len(result.surface.triangles) == pytest.approx(0.25 * len(whole.triangles), rel=0.01)
    note = next(note for note in result.notes if "simplified" in note)
    assert "of its triangles: volume" in note
    verdicts = {row.quantity: row.verdict for row in result.certificate.rows}
    assert verdicts["volume"] == verdicts["euler_number"] == "agree"
    assert result.times["simplify"] > 0
    row = result.measures["surface_area", "triangles"]
    assert row.uncertainty >= result.surface.altered[1] > 0


def test_a_recipe_that_asks_too_much_is_told():
    changed = {"model.level": 1, "voxels.voxels": 12, "surface.simplify": 0.001}
    recipe = po.load("menger", set={**changed, "surface.method": "marching-cubes"})
    result = po.run(recipe, only="surface")
    assert any("fewer would not keep its topology and volume" in note for note in result.notes)
    assert not defects(result.surface)


@pytest.mark.parametrize("value", [0, 2, "x"])
def test_a_recipe_with_another_share(value):
    with pytest.raises(po.RecipeError, match=r"surface.simplify: got .*; wanted the share"):
        po.load("menger", set={"surface.simplify": value})
