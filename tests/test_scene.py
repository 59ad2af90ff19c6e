"""What a page shows in three dimensions is what it says, as near as it says."""

import base64
import json
import re
import zlib
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from porous.kernels.nearest import Nearest
from porous.measures import LocalThickness
from porous.pipeline import Result
from porous.recipe import load
from porous.report import _mesh_data, _packed, _scene
from porous.report._colours import colours
from porous.report._greys import packed_greys, pooled, shades
from porous.report._mesh_data import boundary_of, shown, split
from porous.report._scene import diameters_at, scene, scene_html
from porous.stages import extract_surface
from porous.values import Block, Frame, SurfaceMesh, VolumeMesh, VoxelGrid
from porous.values.surface_topology import defects

ORIGIN = (-3.0, 100.0, 7.0)


def naive_distances(places, points, triangles):
    """Return the distances of points from triangles, by their planes and sides."""
    found = np.full(len(places), np.inf)
    for a, b, c in points[triangles]:
        sides = [(a, b), (b, c), (c, a)]
        for p, q in sides:
            square = max((q - p) @ (q - p), 1e-300)
            t = np.clip((places - p) @ (q - p) / square, 0, 1)
            found = np.minimum(found, np.linalg.norm(places - p - t[:, None] * (q - p), axis=1))
        normal = np.cross(b - a, c - a)
        if normal @ normal > 0:
            inside = np.all([np.cross(q - p, places - p) @ normal >= 0 for p, q in sides], axis=0)
            height = np.abs((places - a) @ normal) / np.linalg.norm(normal)
            found = np.where(inside, np.minimum(found, height), found)
    return found


def wavy(shape=(11, 16, 13), periodic=(False, False, False), spacing=(0.5, 0.4, 0.3)):
    """Return a grid of a body of channels that reach its sides."""
    x, y, z = np.meshgrid(*(np.arange(n) + 0.5 for n in shape), indexing="ij")
    wave = np.sin(x / 3) * np.cos(y / 4) + np.sin(y / 3) * np.cos(z / 4) + np.sin(z / 3)
    fill = np.clip(127.5 + 200 * (wave + 0.2), 0, 255).astype(np.uint8)
    return VoxelGrid(Frame(ORIGIN, spacing, shape, periodic, "um"), fill)


@pytest.fixture(scope="module")
def grid():
    return wavy()


@pytest.fixture(scope="module")
def surface(grid):
    return extract_surface(grid)


def local(grid, phase, diameters):
    """Return local thickness as if it had been measured."""
    sizes, counts = np.unique(diameters[diameters > 0], return_counts=True)
    shares = counts / counts.sum()
    return LocalThickness(grid.frame, diameters, phase, sizes, shares, float(sizes[0]), 0.5)


@pytest.fixture(scope="module")
def maps(grid):
    random = np.random.default_rng(0)
    wide = {phase: random.random(grid.fill.shape).astype(np.float32) for phase in ("pore", "solid")}
    wide["pore"][grid.solid] = 0
    wide["solid"][~grid.solid] = 0
    return {phase: local(grid, phase, diameters) for phase, diameters in wide.items()}


# --- distances ------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(3))
def test_distances_are_those_of_the_slow_way(seed):
    random = np.random.default_rng(seed)
    points = random.random((40, 3)) * (1, 2, 0.5) + ORIGIN
    triangles = random.integers(0, 40, (90, 3))  # some without area, some crossing
    places = random.random((200, 3)) * 3 - 1 + ORIGIN
    near = Nearest(points, triangles)
    wanted = naive_distances(places, points, triangles)
    assert near.distances(places) == pytest.approx(wanted, abs=1e-9)
    assert near.farthest(places) == pytest.approx(wanted.max(), abs=1e-9)
    middle = float(np.median(wanted)) + 1e-7
    assert np.array_equal(near.beyond(places, middle), wanted > middle)


def test_one_triangle_is_near_to_what_is_on_it():
    points = np.array([[0, 0, 0], [3, 0, 0], [0, 4, 0.0]])
    near = Nearest(points, np.array([[0, 1, 2]]))
    places = np.array([[1, 1, 0], [1, 1, -2], [-3, -4, 0], [3, 4, 0.0]])
    assert near.distances(places) == pytest.approx([0, 2, 5, 2.4])
    assert near.farthest(places[:0]) == 0


# --- fewer triangles ------------------------------------------------------------------------


def test_a_small_surface_is_shown_whole_walls_first(surface):
    part = shown(surface)
    assert (part.full, part.away, part.missed) == (len(surface.triangles), 0, 0)
    names = np.array(surface.names)[surface.labels]
    assert part.walls == (names == "WALL").sum() < len(names)
    walls = surface.triangles[names == "WALL"]
    assert np.array_equal(part.triangles[: part.walls], walls)
    assert sorted(map(tuple, part.triangles)) == sorted(map(tuple, surface.triangles))


@pytest.mark.parametrize("most", [1200, 400])  # edges alone collapse; corners are gathered first
def test_fewer_triangles_are_as_near_as_is_said(surface, most):
    assert (len(surface.triangles) > _mesh_data.EASY * most) == (most == 400)
    part = shown(surface, most)
    assert most / 2 < len(part.triangles) <= most
    assert part.full == len(surface.triangles)
    off = naive_distances(part.points, surface.points, surface.triangles)
    assert 0 < off.max() <= part.away + 1e-9
    back = naive_distances(surface.points[::3], part.points, part.triangles)
    # All corners are asked of so small a surface; every third says about the same of them.
    assert (back > part.away).mean() == pytest.approx(part.missed, abs=0.02)
    assert np.quantile(back, 0.9) <= part.away < 2 * max(_spacing(surface, most))


def _spacing(surface, most):
    """Return the edges of triangles if there were ``most`` of them, all alike."""
    return [np.sqrt(4 / np.sqrt(3) * surface.area / most)]


@pytest.mark.parametrize("easy", [3, 1])
def test_caps_stay_in_their_sides(surface, grid, easy, monkeypatch):
    monkeypatch.setattr(_mesh_data, "EASY", easy)
    part = shown(surface, 1800)
    box = np.array([grid.frame.box.lower, grid.frame.box.upper])
    caps = part.points[part.triangles[part.walls :]]
    assert len(caps)
    off = np.abs(caps[:, :, None] - box).min(axis=2)  # of each corner, along each axis
    shape = SurfaceMesh(part.points, part.triangles).corners
    edge = np.sqrt(((shape - np.roll(shape, 1, axis=1)) ** 2).sum(axis=2).mean())
    assert off.max(axis=1).min(axis=1).max() <= 0.1 * edge
    areas = np.linalg.norm(np.cross(caps[:, 1] - caps[:, 0], caps[:, 2] - caps[:, 0]), axis=1) / 2
    off = np.abs(surface.corners[:, :, None] - box).min(axis=2).max(axis=1).min(axis=1)
    sizes = np.linalg.norm(surface.area_vectors, axis=1)
    assert areas.sum() == pytest.approx(sizes[off <= 0.1 * edge].sum(), rel=0.1)


def test_the_distance_to_some_triangles_is_no_less(surface, grid, monkeypatch):
    exact = shown(surface, 400)
    monkeypatch.setattr(_mesh_data, "MANY", len(surface.triangles) // 3)
    monkeypatch.setattr(_mesh_data, "SLAB", 500)
    part = shown(surface, 400)
    assert np.array_equal(part.points, exact.points)
    assert exact.away < part.away < exact.away + grid.frame.diagonal


def test_dust_is_shown_in_part():
    solid = np.zeros((15, 18, 21), bool)
    solid[1::3, 1::3, 1::3] = True
    grains = extract_surface(VoxelGrid.of_solid(solid, Frame(ORIGIN, (1, 1, 1), solid.shape)))
    count = len(grains.triangles)
    part = shown(grains, count // 40)
    assert (part.full, part.away) == (count, pytest.approx(0, abs=1e-9))
    assert len(part.triangles) <= count // 40
    assert part.missed > 0.5  # and that is said


@pytest.mark.parametrize("length", [3.0, 0.7])
def test_halved_edges_change_no_shape(length):
    cube = extract_surface(
        VoxelGrid.of_solid(np.ones((1, 1, 1), bool), Frame(ORIGIN, (2, 3, 4), (1, 1, 1))),
        method="voxel-faces",
    )
    part = split(shown(cube), length)
    fine = SurfaceMesh(part.points, part.triangles)
    edges = fine.corners - np.roll(fine.corners, 1, axis=1)
    assert np.linalg.norm(edges, axis=2).max() <= length
    assert fine.area == pytest.approx(52)
    assert fine.volume == pytest.approx(24)
    found = defects(fine)
    assert not found  # closed, oriented, 2-manifold: no edge was halved from one side alone


def test_halved_edges_stop_where_there_are_enough(surface):
    whole = shown(surface)
    count = len(whole.triangles)
    assert split(whole, 1e-3, most=count) is not whole
    assert len(split(whole, 1e-3, most=count).triangles) == count
    finer = split(whole, 1e-3, most=3 * count)
    assert count < len(finer.triangles) <= 3 * count
    walls = SurfaceMesh(finer.points, finer.triangles[: finer.walls]).area
    assert walls == pytest.approx(SurfaceMesh(whole.points, whole.triangles[: whole.walls]).area)


# --- what is packed -------------------------------------------------------------------------


def unplaned(content, count, size):
    """Return numbers whose low bytes all come first: as the page does it, byte by byte."""
    planes = [content[count * k : count * (k + 1)] for k in range(size)]
    return [sum(plane[i] << (8 * k) for k, plane in enumerate(planes)) for i in range(count)]


def unpacked_corners(content, count):
    columns = []
    for axis in range(3):
        steps = unplaned(content[2 * count * axis :], count, 2)
        columns.append(np.cumsum(steps) % 65536)
    return np.stack(columns, axis=1)


def unpacked_triangles(content, count):
    first, second, third = (unplaned(content[4 * count * k :], count, 4) for k in range(3))
    start = np.cumsum(first) % 2**32
    return np.stack([start, start + second, start + third], axis=1)


@given(st.integers(0, 2**32 - 1), st.integers(1, 40))
def test_what_is_packed_comes_out_again(seed, count):
    random = np.random.default_rng(seed)
    places = random.integers(0, 65536, (count, 3)).astype(np.uint16)
    assert np.array_equal(unpacked_corners(_packed.of_corners(places), count), places)
    triangles = np.array([random.permutation(count + 2)[:3] for _ in range(count)])
    walls = int(random.integers(0, count + 1))
    ordered = _packed.in_order(triangles, walls)
    content = _packed.of_triangles(ordered.astype(np.uint32))
    assert np.array_equal(unpacked_triangles(content, count), ordered)
    for part, whole in ((ordered[:walls], triangles[:walls]), (ordered[walls:], triangles[walls:])):
        turns = {min(tuple(np.roll(t, -k)) for k in range(3)) for t in whole.tolist()}
        assert set(map(tuple, part.tolist())) == turns


def test_the_curve_keeps_neighbours_together():
    places = np.stack(np.meshgrid(*[np.arange(8)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    order = _packed.curve(places.astype(np.uint16))
    assert sorted(order) == list(range(512))
    eighth = places[order][:64]
    assert (eighth < 4).all()


def data_of(html):
    return json.loads(re.search(r'id="view-data">(.*?)</script>', html, re.S)[1])


def test_the_page_holds_what_the_scene_is(grid, surface, maps):
    made = scene(Result(None, grid=grid, surface=surface, maps=maps))
    data = data_of(scene_html(made))

    def content(text):
        return zlib.decompress(base64.b64decode(text))

    count = data["corners"]["count"]
    places = unpacked_corners(content(data["corners"]["bytes"]), count)
    assert np.array_equal(places, made.places)
    triangles = unpacked_triangles(content(data["triangles"]["bytes"]), data["triangles"]["count"])
    assert np.array_equal(triangles, made.triangles)
    assert data["triangles"]["walls"] == made.walls
    for phase, values in made.values.items():
        found = unplaned(content(data["values"][phase]["bytes"]), count, 2)
        assert np.array_equal(found, values)
    greys = np.frombuffer(content(data["greys"]["bytes"]), np.uint8)
    assert np.array_equal(greys.reshape(data["greys"]["shape"]), grid.fill)
    assert data["unit"] == "um"


# --- scenes ---------------------------------------------------------------------------------


def test_corners_are_as_near_as_is_said(surface, grid):
    made = scene(Result(None, grid=grid, surface=surface))
    assert made.full == len(made.triangles) == len(surface.triangles)
    off = naive_distances(made.points[::9], surface.points, surface.triangles)
    assert 0 < off.max() <= made.error < 1e-3 * min(grid.frame.spacing)
    back = np.abs(made.points[:, None] - surface.points[::9]).max(axis=2).min(axis=0)
    assert back.max() <= made.error  # and no corner is missing
    extent = np.array(made.high) - made.low
    assert made.error == pytest.approx(np.linalg.norm(extent) / 65535 / 2)


def test_what_is_thinned_says_so_and_is_within_it(surface, grid, monkeypatch):
    monkeypatch.setattr(_scene, "shown", lambda value: shown(value, 1000))
    made = scene(Result(None, grid=grid, surface=surface))
    off = naive_distances(made.points, surface.points, surface.triangles)
    assert off.max() <= made.error
    assert len(made.triangles) <= 1000 < made.full
    said = made.caption.replace("\u202f", "")
    assert f"{len(made.triangles)} of {made.full} triangles" in said
    assert float(re.search(r"within ([\d.]+) um", said)[1]) >= made.error


def test_sides_of_a_periodic_body_are_caps():
    grid = wavy(periodic=(False, True, False))
    made = scene(Result(None, grid=grid, surface=extract_surface(grid)))
    caps = made.points[made.triangles[made.walls :].astype(int)]
    box = np.array([grid.frame.box.lower, grid.frame.box.upper])
    flat = np.abs(caps[:, :, None] - box).min(axis=2).max(axis=1).min(axis=1)
    assert len(caps)
    assert flat.max() <= made.error
    normals = np.cross(caps[:, 1] - caps[:, 0], caps[:, 2] - caps[:, 0])
    assert (np.abs(normals[:, 1]) > 0.99 * np.linalg.norm(normals, axis=1)).any()


def plates():
    """Return plates, 4 and 8 voxels of 0.5 mm thick, and a gap of 6 voxels between them."""
    solid = np.zeros((26, 12, 16), bool)
    solid[4:8] = solid[14:22] = True
    return VoxelGrid.of_solid(
        solid, Frame(ORIGIN, (0.5, 0.75, 1.0), solid.shape, (False, True, True))
    )


def test_colours_are_the_thickness_of_walls_and_gaps():
    grid = plates()
    wide = np.zeros(grid.fill.shape, np.float32)
    wide[4:8], wide[14:22] = 2.0, 4.0
    gaps = np.where(grid.solid, 0, 4.5).astype(np.float32)
    gaps[8:14] = 3.0
    maps = {"pore": local(grid, "pore", gaps), "solid": local(grid, "solid", wide)}
    recipe = load("menger", set={"report.smallest_wall": 2.5, "report.smallest_gap": 1.0})
    made = scene(Result(recipe, grid=grid, surface=extract_surface(grid), maps=maps))
    low, high = made.ranges["solid"]
    assert (low, high) == pytest.approx((2.0, 4.0))
    known = low + (made.values["solid"].astype(float) - 1) / 65534 * (high - low)
    x = made.points[:, 0] - ORIGIN[0]
    wanted = np.where(x < 5, 2.0, 4.0)
    assert (made.values["solid"] > 0).all()
    assert np.abs(known - wanted).max() <= (high - low) / 65534
    low, high = made.ranges["pore"]
    between = (x > 3.7) & (x < 7.3)  # the gap, seen from its two sides
    gap = low + (made.values["pore"][between].astype(float) - 1) / 65534 * (high - low)
    assert gap == pytest.approx(3.0, abs=1e-4)
    assert made.limits == {"solid": 2.5, "pore": 1.0}
    html = scene_html(made)
    assert "walls thinner than 2.5 mm" in html
    assert "gaps narrower than 1 mm" in html
    assert data_of(html)["values"]["solid"]["limit"] == 2.5


def test_a_corner_asks_the_nearest_voxel_of_the_phase(maps, grid, surface):
    random = np.random.default_rng(0)
    points = surface.points[random.permutation(len(surface.points))[:60]]
    seen = 0
    for local in maps.values():
        wide = np.stack(np.nonzero(local.diameters), axis=1)
        centres = grid.frame.origin + (wide + 0.5) * grid.frame.spacing
        found = diameters_at(local, points)
        for point, size in zip(points, found, strict=True):
            far = np.linalg.norm(centres - point, axis=1)
            nearest = wide[far <= far.min() * (1 + 1e-9)]
            own = np.floor((point - grid.frame.origin) / grid.frame.spacing)
            steps = np.abs(nearest - own)
            if (steps * grid.frame.spacing <= max(grid.frame.spacing)).all():
                assert size == local.diameters[tuple(nearest.T)].max()
                seen += 1
    assert seen > 60


def test_far_from_the_phase_nothing_is_known(maps):
    assert diameters_at(maps["solid"], np.array([[1e3, 0, 0.0]])) == 0


def test_a_body_without_a_mesh_shows_the_surface_of_its_voxels(grid, surface):
    made = scene(Result(None, grid=grid))
    assert made == scene(Result(None, grid=grid, surface=surface))
    assert made.unit == "um"
    assert made.box == grid.frame.box


def test_a_mesh_without_voxels_has_no_slices(surface):
    made = scene(Result(None, surface=surface))
    assert made.greys is None
    assert made.box == surface.box
    html = scene_html(made)
    assert "greys" not in data_of(html)
    assert "Cuts" in html


def test_a_volume_mesh_shows_its_boundary():
    points = np.array([[x, y, z] for x in (0, 2) for y in (0, 3) for z in (0, 5)], float)
    hexa = VolumeMesh(points, (Block("hex8", [[0, 4, 6, 2, 1, 5, 7, 3]]),), unit="cm")
    whole = boundary_of(hexa)
    assert (whole.volume, whole.area) == pytest.approx((30, 62))
    made = scene(Result(None, volume=hexa))
    assert (len(made.triangles), made.unit, made.greys) == (12, "cm", None)
    tetra = VolumeMesh(points[[0, 1, 2, 4]], (Block("tet4", [[0, 1, 2, 3]]),))
    assert len(scene(Result(None, volume=tetra)).triangles) == 4


def test_nothing_is_shown_of_nothing():
    assert scene(Result(None)) is None
    void = VoxelGrid(Frame(ORIGIN, (1, 1, 1), (3, 4, 5)), np.zeros((3, 4, 5), np.uint8))
    assert scene(Result(None, grid=void)) is None
    assert _scene.NOTHING.endswith(".")


def stored(grid):
    """Return a grid that is seen a box at a time only."""
    return SimpleNamespace(
        frame=grid.frame, block=grid.block, sampling="fill", sampling_error=0.0, hausdorff=None
    )


def test_a_stored_grid_is_pooled_or_sampled_anew(grid, monkeypatch):
    monkeypatch.setattr(_scene, "pooled", lambda value, most=8: pooled(value, most))
    made = scene(Result(None, grid=stored(grid)))
    assert made.greys.frame.shape == (6, 8, 7)
    assert "of voxels of 1 um" in made.caption
    whole = extract_surface(grid)
    off = naive_distances(made.points, whole.points, whole.triangles)
    assert off.max() < 2 * grid.frame.diagonal  # of voxels twice as large


def test_a_stored_grid_of_a_model_is_sampled_anew(monkeypatch):
    from porous.recipe import build

    monkeypatch.setattr(_scene, "FINEST", 27)
    model = build(load("menger", set={"model.level": 2}))
    fine = stored(
        VoxelGrid(Frame((0, 0, 0), (1 / 81,) * 3, (81,) * 3), np.zeros((81,) * 3, np.uint8))
    )
    made = scene(Result(None, model=model, grid=fine))
    assert made.greys.frame.shape == (27, 27, 27)
    assert "sampled anew with 27 voxels along its longest edge" in made.caption
    assert made.greys.solid.sum() == 400 * 27


# --- greys and colours ----------------------------------------------------------------------


@pytest.mark.parametrize("whole", [True, False])
@pytest.mark.parametrize("most", [16, 8, 5, 1])
def test_coarser_voxels_are_means(grid, most, whole, monkeypatch):
    monkeypatch.setattr("porous.report._greys.SLAB", 500)
    coarse = pooled(grid if whole else stored(grid), most)
    step = -(-16 // most)
    assert max(coarse.frame.shape) <= most
    assert coarse.frame.spacing == pytest.approx([step * h for h in grid.frame.spacing])
    assert coarse.frame.box.lower == grid.frame.box.lower
    for place in ((0, 0, 0), tuple(n - 1 for n in coarse.frame.shape)):
        box = tuple(slice(step * i, step * (i + 1)) for i in place)
        assert abs(coarse.fill[place] - grid.fill[box].mean()) <= 0.5


@pytest.mark.parametrize("step", [1, 8, 16, 32])
def test_shades_are_even_and_keep_none_and_full(step):
    fill = np.arange(256, dtype=np.uint8)
    found = shades(fill, step)
    assert (found[0], found[255]) == (0, 255)
    assert len(set(found.tolist())) == round(255 / step) + 1
    assert np.abs(found.astype(int) - fill).max() <= step / 2 + 1
    assert (np.diff(found.astype(int)) >= 0).all()


def test_greys_that_are_heavy_have_fewer_shades(monkeypatch):
    fill = np.random.default_rng(0).integers(0, 256, (30, 20, 25)).astype(np.uint8)
    monkeypatch.setattr("porous.report._greys.HEAVY", 9_000)
    deflated, step = packed_greys(fill)
    assert step == 16
    assert len(deflated) <= 9_000
    assert zlib.decompress(deflated) == shades(fill, step).tobytes()
    assert packed_greys(np.zeros((9, 9, 9), np.uint8))[1] == 1


def lightness(rgb):
    """Return Oklab's lightness of colours of a screen, the way there (Ottosson 2020)."""
    share = rgb / 255
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    cones = linear @ np.array(
        [
            [0.4122214708, 0.2119034982, 0.0883024619],
            [0.5363325363, 0.6806995451, 0.2817188376],
            [0.0514459929, 0.1073969566, 0.6299787005],
        ]
    )
    return np.cbrt(cones) @ (0.2104542553, 0.7936177850, -0.0040720468)


def test_colours_grow_lighter_in_equal_steps():
    table = colours(64)
    light = lightness(table.astype(float))
    assert light[[0, -1]] == pytest.approx([0.3, 0.9], abs=0.01)
    assert np.diff(light) == pytest.approx(0.6 / 63, abs=0.005)
    steps = np.abs(np.diff(table.astype(int), axis=0))
    assert steps.max() <= 14  # nowhere a seam


# --- what stands in the page ----------------------------------------------------------------


def test_the_piece_of_a_page_needs_nothing_else(grid, surface):
    html = scene_html(scene(Result(None, grid=grid, surface=surface)))
    assert "://" not in html
    assert not re.search(r"\b(src|href)=", html)
    assert html.count("<script>") == 2
    assert 'id="viewer"' in html
    assert 'id="view"' in html
    for text in ("Arrow keys turn it", "×", "um", "Shown: all"):
        assert text in html


def test_the_same_body_gives_the_same_page(grid, surface, maps, monkeypatch):
    result = Result(None, grid=grid, surface=surface, maps=maps)
    first = scene_html(scene(result))
    monkeypatch.setenv("POROUS_THREADS", "1")
    assert scene_html(scene(result)) == first


@pytest.mark.parametrize(
    ("length", "said"),
    [(0.0123, "0.013"), (0.5, "0.50"), (12.0, "12"), (3e-12, "3.0e-12"), (0, "0")],
)
def test_lengths_are_rounded_up(length, said):
    assert _scene._plain(length) == said
