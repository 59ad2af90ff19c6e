"""Printing and cleaning: closed forms of overhangs, islands, cups and what a probe cannot reach."""

import math
from itertools import product

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, label

import porous as po
from porous.errors import GridError, MemoryLimitError
from porous.kernels.drain import held
from porous.kernels.drain_paths import lengths_out
from porous.kernels.layers import hanging
from porous.kernels.reached import held_by_balls
from porous.kernels.spans import spans
from porous.measures import (
    Sample,
    Survey,
    accessible_porosity,
    cupped_volume,
    drain_path_length,
    islands,
    narrow_gap_share,
    overhangs,
    survey,
    thin_wall_share,
    trapped_volume,
)
from porous.measures._build import DIRECTIONS, Direction
from porous.measures._overhangs import OFF, _inclined, surface_overhangs
from porous.measures._printability import _best
from porous.stages import extract_surface
from porous.values import Frame, Measure, Measures, SurfaceMesh, VoxelGrid

WAYS = [f"{axis}_{way}" for axis in "xyz" for way in ("up", "down")]
SPACING = (0.5, 0.4, 0.25)
FREE = (False, False, False)
BELOW_45 = 1 - math.sqrt(0.5)


def grid_of(solid, spacing=SPACING, periodic=FREE, bulk=None):
    frame = Frame((1, 2, 3), spacing, solid.shape, periodic)
    return VoxelGrid(frame, np.where(solid, np.uint8(255), np.uint8(0)), bulk)


def values(rows):
    return {row.name: row.value for row in rows}


def boxes(shape, *solids):
    """Voxels of boxes, each of three pairs of first and last index, the last not within."""
    solid = np.zeros(shape, bool)
    for box in solids:
        solid[tuple(slice(*pair) for pair in box)] = True
    return solid


def sampled(inside, shape, spacing):
    """The grid of a body with 64 samples a voxel; ``inside`` is asked of places."""
    counts = np.zeros(shape, np.int64)
    for offsets in product((np.arange(4) + 0.5) / 4, repeat=3):
        at = [(np.arange(n) + s) * h for n, s, h in zip(shape, offsets, spacing, strict=True)]
        counts += inside(*np.meshgrid(*at, indexing="ij", sparse=True))
    return VoxelGrid(Frame((0, 0, 0), spacing, shape), ((255 * counts + 32) // 64).astype(np.uint8))


def moved(name, order, flipped):
    """The name of a direction once axes are permuted, ``order`` of them, and some turned round."""
    what, axis, way = name.rsplit("_", 2)
    new = order.index("xyz".index(axis))
    if new in flipped:
        way = {"up": "down", "down": "up"}[way]
    return f"{what}_{'xyz'[new]}_{way}"


# --- slow twins ----------------------------------------------------------------------------


def wrapped(place, shape, periodic):
    """A place that may lie beyond a side: where it is, or None where that is nowhere."""
    around = zip(place, shape, periodic, strict=True)
    place = tuple(int(at % n) if wraps else int(at) for at, n, wraps in around)
    return place if all(0 <= at < n for at, n in zip(place, shape, strict=True)) else None


def pieces(layer, periodic):
    """The pieces of a layer, sets of places, by walking from pixel to pixel."""
    left = {tuple(map(int, place)) for place in np.argwhere(layer)}
    while left:
        piece = [left.pop()]
        for j, k in piece:
            for beside in ((j + 1, k), (j - 1, k), (j, k + 1), (j, k - 1)):
                found = wrapped(beside, layer.shape, periodic)
                if found in left:
                    left.remove(found)
                    piece.append(found)
        yield piece


def naive_hanging(solid, reach, periodic):
    """Ask of each piece of each layer, voxel by voxel, what is below."""
    result, below, stands = np.zeros((len(solid), 3), int), set(), set()
    for i, layer in enumerate(solid):
        ground = set()
        for piece in pieces(layer, periodic):
            steps = [(j + a, k + b) for j, k in piece for a, b in reach]
            under = {wrapped(step, layer.shape, periodic) for step in steps}
            island = not under & below and solid[:i].any()
            flying = not under & stands and solid[:i].any()
            result[i] += [island, island * len(piece), flying * len(piece)]
            ground |= set() if flying else set(piece)
        below, stands = {tuple(map(int, place)) for place in np.argwhere(layer)}, ground
    return result


def naive_held(kinds, connectivity, periodic):
    """Flood each level of its own from outside: what is below it, between void all round."""

    def reached(levels, *, top):
        around = [(1, 1), *((0, 0) if wraps else (1, 1) for wraps in periodic)]
        wide = np.pad(kinds[:levels], around, constant_values=2)
        wide[-1] = 2 if top else 0
        wide = np.tile(wide, [1, *(3 if wraps else 1 for wraps in periodic)])
        shape = np.ones((3, 3, 3)) if connectivity == 26 else None
        labels = label(wide > 0, shape)[0]
        free = np.isin(labels, labels[wide == 2])[1:-1]
        for axis, wraps in enumerate(periodic, 1):
            n = kinds.shape[axis]
            free = np.moveaxis(free, axis, 0)
            free = np.moveaxis(free[n : 2 * n] if wraps else free[1:-1], 0, axis)
        return free

    ever = reached(len(kinds), top=True)
    return [
        np.count_nonzero((kinds[i] == 1) & ever[i] & ~reached(i + 1, top=False)[i])
        for i in range(len(kinds))
    ]


def lows_beside(lengths, place, spacing, periodic):
    """The less of the lengths beside a place along each axis, ascending, with the axes' edges."""
    lows = []
    for axis, step in enumerate(np.eye(3, dtype=int)):
        near = (wrapped(place + way * step, lengths.shape, periodic) for way in (-1, 1))
        lows.append((min(lengths[at] for at in near if at), spacing[axis]))
    return sorted(lows)


def upwind(lows):
    """The root of Σ (T − low)²/h² = 1 over as many lows as lie below it."""
    for used in (1, 2, 3):
        a, h = np.array(lows[:used]).T
        w, wa, waa = (1 / h**2).sum(), (a / h**2).sum(), (a**2 / h**2).sum()
        root = (wa + math.sqrt(max(0.0, wa**2 - w * (waa - 1)))) / w
        if used == 3 or root <= lows[used][0]:
            return root
    return None


def naive_lengths(void, spacing, periodic):
    """Sweep over all voxels again and again until nothing becomes shorter."""
    lengths = np.full(void.shape, np.inf)
    for axis in (a for a in range(3) if not periodic[a]):
        for end in (0, -1):
            side = np.moveaxis(lengths, axis, 0)[end]
            np.minimum(side, spacing[axis] / 2, out=side)
    lengths[~void] = np.inf
    before = None
    while not np.array_equal(before, lengths):
        before = lengths.copy()
        for place in np.argwhere(void):
            lows = lows_beside(lengths, place, spacing, periodic)
            if lows[0][0] < np.inf:
                at = tuple(place)
                lengths[at] = min(lengths[at], upwind(lows))
    return lengths


@pytest.fixture(scope="module")
def noise():
    """Random masks of several shares and shapes, with the axes along which they go on."""
    draws = []
    for seed in range(16):
        rng = np.random.default_rng(seed)
        shape = tuple(rng.integers(1, 10, 3))
        periodic = tuple(bool(b) for b in rng.integers(0, 2, 2)) if seed % 2 else (False, False)
        draws.append((rng.random(shape) < rng.uniform(0.2, 0.98), periodic))
        if seed < 6:
            field = gaussian_filter(rng.random((8, 9, 10)), 1)
            draws.append((field < np.quantile(field, 0.8), periodic))
    return draws


def lying(layers, n):
    """Return layers whose spans are those of a grid in which they lie along some axis."""
    axis, up = n % 3, n % 2 == 0
    grid = (layers if up else layers[::-1]).transpose(((0, 1, 2), (1, 0, 2), (1, 2, 0))[axis])
    return spans(grid.view(np.uint8), (2, 2, 1)[axis]).layers(axis, up=up)


@pytest.mark.parametrize("reach", [[(0, 0)], [(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1), (0, 2)]])
def test_what_hangs_is_what_a_slow_twin_finds(noise, reach):
    found = 0
    for n, (solid, periodic) in enumerate(noise):
        told = hanging(lying(solid, n), np.array(reach), periodic=periodic)
        assert np.array_equal(told, naive_hanging(solid, reach, periodic))
        found += told.sum()
    assert found > 10


@pytest.mark.parametrize("connectivity", [6, 26])
def test_what_is_held_is_what_a_slow_twin_finds(noise, connectivity):
    found = 0
    for seed, (solid, periodic) in enumerate(noise):
        kinds = np.where(solid, 0, 1).astype(np.uint8)
        beyond = np.random.default_rng(seed).random(solid.shape) < 0.02
        kinds[beyond & (kinds > 0)] = 2
        told = held(lying(kinds, seed), connectivity, periodic=periodic)
        assert told.tolist() == naive_held(kinds, connectivity, periodic)
        found += told.sum()
    assert found > 3


@pytest.mark.parametrize("periodic", [FREE, (True, False, True)])
def test_balls_hold_what_a_slow_twin_finds(periodic):
    rng = np.random.default_rng(5)
    weights = np.array([1, 1.69, 0.49])
    for shape in ((7, 9, 8), (1, 5, 12)):
        squares = np.where(rng.random(shape) < 0.05, rng.uniform(0, 12, shape), 0)
        wanted = np.zeros(shape, bool)
        for place in np.argwhere(squares):
            square = np.zeros(shape)
            for axis, (at, n) in enumerate(zip(place, shape, strict=True)):
                step = np.abs(np.indices(shape)[axis] - at)
                step = np.minimum(step, n - step) if periodic[axis] else step
                square += weights[axis] * step**2
            wanted |= square < squares[tuple(place)]
        found = held_by_balls(squares.astype(np.float32), weights, periodic=periodic)
        assert np.array_equal(found, wanted)


@pytest.mark.parametrize("periodic", [FREE, (False, True, True)])
def test_ways_out_are_those_of_a_slow_twin(periodic):
    void = np.random.default_rng(3).random((7, 6, 8)) < 0.6
    found = lengths_out(void, SPACING, periodic=periodic)
    wanted = naive_lengths(void, SPACING, periodic)
    assert np.array_equal(np.isinf(found), np.isinf(wanted))
    known = np.isfinite(wanted)
    assert found[known] == pytest.approx(wanted[known], abs=1e-4)


# --- overhangs -----------------------------------------------------------------------------


def test_a_cube_on_the_plate_has_no_overhang():
    rows = overhangs(grid_of(boxes((24, 26, 28), ((6, 18), (7, 19), (8, 20)))))
    assert set(values(rows)) == {f"overhang_{of}_{way}" for of in ("area", "share") for way in WAYS}
    assert all(row.value == 0 for row in rows)


def stick(n):
    """A cube of edge 1 on a stick of edge 1/4 and height 1/2, voxels of 1/n, 1/n and 1/(2n)."""
    shape = (n + n // 2, n + n // 2, 4 * n)
    low, mid = n // 4, n // 4 + n * 3 // 8
    head = ((low, low + n), (low, low + n), (n, 3 * n))
    foot = ((mid, mid + n // 4), (mid, mid + n // 4), (0, n))
    return grid_of(boxes(shape, head, foot), (1 / n, 1 / n, 0.5 / n))


def test_a_cube_on_a_stick_hangs_over_around_it():
    exact, errors = 1 - 1 / 16, []
    for n in (16, 32):
        rows = overhangs(stick(n))
        area = rows["overhang_area_z_up"]
        assert abs(area.value - exact) <= area.uncertainty
        assert rows["overhang_area_z_down"].value == 0  # the head's other side is on the plate
        # Lying on a side of the head, the stick's side hangs over.
        assert rows["overhang_area_x_up"].value == pytest.approx(1 / 8, abs=0.07)
        errors.append(abs(area.value - exact))
    assert errors[1] < 0.65 * errors[0]


@pytest.mark.parametrize("limit", [30.0, 45.0, 60.0])
def test_a_ball_hangs_over_below_a_latitude(limit):
    n, spacing, radius = (28, 34, 46), (1 / 12, 1 / 15, 1 / 20), 1.0
    middle = [k * h / 2 for k, h in zip(n, spacing, strict=True)]
    grid = sampled(
        lambda *at: sum((x - m) ** 2 for x, m in zip(at, middle, strict=True)) < radius**2,
        n,
        spacing,
    )
    rows = overhangs(grid, overhang=limit)
    cap = 2 * math.pi * radius**2 * (1 - math.cos(math.radians(limit)))
    for way in WAYS:
        area, share = rows[f"overhang_area_{way}"], rows[f"overhang_share_{way}"]
        assert abs(area.value - cap) <= area.uncertainty
        assert share.uncertainty < 0.1
        # What is missing lies in the lowest layer: 2πRh of it, or less.
        layer = 2 * math.pi * radius * spacing["xyz".index(way[0])]
        assert cap - 1.1 * layer <= area.value <= 1.01 * cap
        assert share.value == pytest.approx(area.value / (4 * math.pi), rel=0.01)


def tilted(angle, n=40):
    """A plate of thickness 0.4 that is tilted about y, in a box of 2 by 1 by 3."""
    slope, cosine = math.tan(math.radians(angle)), math.cos(math.radians(angle))
    return sampled(
        lambda x, y, z: (np.abs((z - 1.5 - slope * (x - 1)) * cosine) < 0.2) & (y > 0),
        (n, n // 2, 3 * n // 2),
        (2 / n, 2 / n, 2 / n),
    )


@pytest.mark.parametrize("angle", [20, 30, 40])
def test_a_tilted_plate_hangs_over_at_less_than_its_angle(angle):
    grid, slope = tilted(angle), math.tan(math.radians(angle))
    each = 1 / math.cos(math.radians(angle))
    area, lowest = 2 * each, 0.05 / slope * each  # what of it is in a layer as high as a voxel
    few, many = (
        overhangs(grid, overhang=a, beyond="unknown")["overhang_area_z_up"]
        for a in (angle - 3, angle + 3)
    )
    # Beyond sides the fills go on as they are, so that normals near these are bent.
    assert few.value <= min(0.1 * area, few.uncertainty)
    assert area - 1.5 * lowest - 0.01 <= many.value <= 1.01 * area


@pytest.mark.parametrize("binary", [False, True])
@pytest.mark.parametrize("normal", [(1, 0, 2), (1, 2, 2), (2, 1, 3), (3, 1, 1)])
def test_normals_of_planes_are_off_by_what_is_said(normal, binary):
    n, (a, b, c) = 40, normal
    grid = sampled(lambda x, y, z: (a * x + b * y + c * z) % n < n / 2, (n, n, n), (1, 1, 1))
    fill = np.where(grid.solid, np.uint8(255), np.uint8(0)) if binary else grid.fill
    frame = Frame((0, 0, 0), (1, 1, 1), grid.frame.shape, (True, True, True))
    found = _inclined(Sample(VoxelGrid(frame, fill)))
    length = math.sqrt(a * a + b * b + c * c)
    assert found.total == pytest.approx(2 * length * n * n, rel=0.005)
    middles = (found.angles[1:] + found.angles[:-1]) / 2
    for areas, axis in zip(found.areas, np.repeat(normal, 2), strict=True):
        angle = math.degrees(math.acos(axis / length))
        if angle < 85:
            square = (areas * (middles - angle) ** 2).sum() / areas.sum()
            assert square <= OFF[not binary] ** 2 + 0.5**2  # classes are a degree wide
            assert areas.sum() == pytest.approx(found.total / 2 * (1 - 1 / n), rel=0.006)


@pytest.mark.parametrize("angle", [25, 35])
def test_binary_voxels_know_angles_to_some_degrees(angle):
    smooth = tilted(angle)
    grid = VoxelGrid.of_solid(smooth.solid, smooth.frame)
    area = 2 / math.cos(math.radians(angle))
    few, some, many = (
        overhangs(grid, overhang=a, beyond="unknown")["overhang_area_z_up"]
        for a in (angle - 10, angle, angle + 10)
    )
    assert few.value <= 0.1 * area
    assert many.value >= 0.92 * area
    assert some.uncertainty > 0.3 * area


def test_just_at_the_limit_nobody_knows():
    area = math.sqrt(2) * 2
    row = overhangs(tilted(45), overhang=45, beyond="unknown")["overhang_area_z_up"]
    assert abs(row.value - area / 2) <= area / 2
    assert row.uncertainty >= 0.45 * area


def test_an_overhanging_t_is_known_from_its_faces():
    solid = boxes((9, 8, 7), ((0, 9), (2, 5), (5, 7)), ((3, 6), (2, 5), (0, 5)))
    grid = grid_of(solid)
    surface = extract_surface(grid, method="voxel-faces")
    rows = overhangs(surface)
    x, y, z = SPACING
    assert rows["overhang_area_z_up"].value == pytest.approx(6 * 3 * x * y)
    assert rows["overhang_area_z_down"].value == 0
    assert rows["overhang_area_x_up"].value == pytest.approx(3 * 5 * y * z)
    assert rows["overhang_area_y_up"].value == 0
    assert rows["overhang_share_z_up"].value == pytest.approx(18 * x * y / surface.area)
    assert {(r.method, r.kind, r.of) for r in rows} == {("triangles", "exact", "surface")}


def test_a_wedge_of_triangles_hangs_over_strictly_below_its_angle():
    box = extract_surface(grid_of(np.ones((4, 5, 6), bool), (1, 1, 1)), method="voxel-faces")
    sheared = box.points.copy()
    sheared[:, 0] += sheared[:, 2]  # the side at low x now looks up, that at high x down, at 45°
    wedge = SurfaceMesh(sheared, box.triangles)
    assert overhangs(wedge, overhang=45)["overhang_area_z_up"].value == 0
    found = overhangs(wedge, overhang=45.001)["overhang_area_z_up"].value
    assert found == pytest.approx(5 * 6 * math.sqrt(2))


def test_a_model_with_a_boundary_is_known_exactly():
    model = po.build(po.load("menger", set={"model.level": 1, "model.size": 3.0}))
    grid = po.voxelize(model, voxels=36)
    rows = survey(grid, model=model, only=["printability"]).measures
    for way in WAYS:
        exact = rows[f"overhang_area_{way}", "exact boundary"]
        assert exact.value == pytest.approx(4)  # of six ceilings in tunnels one in the middle open
        seen = rows[f"overhang_area_{way}", "voxel normals"]
        assert abs(seen.value - 4) <= seen.uncertainty
    assert rows["overhang_share_z_up", "exact boundary"].value == pytest.approx(4 / 72)


def test_what_is_known_exactly_decides_and_is_drawn():
    model = po.build(po.load("menger", set={"model.level": 1, "model.size": 3.0}))
    found = survey(po.voxelize(model, voxels=9), model=model, only=["printability"])
    drawn = [c for c in found.curves if c.name == "overhang_by_angle"]
    assert len(drawn) == 6
    for curve in drawn:
        assert curve.method == "exact boundary"
        assert curve.y[0] == 0
        np.testing.assert_allclose(curve.y[1:], 4)  # all ceilings are flat
    assert any(note.startswith("no direction to build in is better") for note in found.notes)


def fake(**areas):
    """Rows of overhang areas: value and uncertainty of each direction."""
    return Measures(
        tuple(
            Measure(f"overhang_area_{way}", value, "mm²", method, doubt, "standard", "grid")
            for way, several in areas.items()
            for method, value, doubt in several
        )
    )


def test_exact_areas_count_more_than_those_of_voxels():
    voxels = "voxel normals"
    (note,) = _best(
        fake(
            x_up=[(voxels, 1.0, 0.1), ("exact boundary", 9.0, 0.0)],
            y_up=[(voxels, 2.0, 0.1), ("exact boundary", 8.0, 0.0)],
        ),
        (Direction(0, True), Direction(1, True)),
    )
    assert note.startswith("best built along +y, of 2 directions")


def test_directions_within_their_doubt_are_not_called_best():
    rows = {way: [("voxel normals", 2.0, 0.5)] for way in WAYS}
    rows["x_up"] = [("voxel normals", 9.0, 0.5)]
    (note,) = _best(fake(**rows), DIRECTIONS)
    assert note.startswith("built worse along +x by the least")
    assert note.endswith("which of −x, +y, −y, +z and −z is best is not told apart")


def test_walls_of_two_voxels_are_in_doubt():
    model = po.build(po.load("menger-bent"))
    exact = surface_overhangs(model.boundary(), 45.0, "exact boundary", "model")
    rows = overhangs(po.voxelize(model, voxels=96))
    for row in exact:
        assert abs(rows[row.name].value - row.value) <= 2 * rows[row.name].uncertainty, row.name


def test_directions_go_with_the_axes():
    fill = gaussian_filter(np.random.default_rng(8).random((20, 18, 16)), 2)
    fill = np.clip(128 + 4000 * (fill - fill.mean()), 0, 255).astype(np.uint8)
    order, flipped = (2, 0, 1), (0, 2)
    turned = np.flip(fill.transpose(order), flipped)
    told = []
    for body, spacing in ((fill, SPACING), (turned, tuple(SPACING[a] for a in order))):
        grid = VoxelGrid(Frame((0, 0, 0), spacing, body.shape), body)
        told.append(overhangs(grid) + islands(grid) + cupped_volume(grid))
    here, there = map(values, told)
    assert len(here) == 30
    for name, value in here.items():
        assert there[moved(name, order, flipped)] == pytest.approx(value, rel=1e-4, abs=1e-9)
    assert len(set(here.values())) > 15


# --- islands -------------------------------------------------------------------------------


def stalactite():
    """A gate of two posts and a beam, with something that hangs from the beam and is 5 high."""
    return boxes(
        (16, 8, 12),
        ((0, 3), (0, 8), (0, 12)),
        ((13, 16), (0, 8), (0, 12)),
        ((0, 16), (0, 8), (10, 12)),
        ((7, 9), (2, 6), (5, 10)),
    )


def test_what_hangs_down_is_printed_in_the_air():
    rows = values(islands(grid_of(stalactite())))
    voxel = math.prod(SPACING)
    assert rows["unsupported_islands_z_up"] == 1
    assert rows["unsupported_volume_z_up"] == pytest.approx(2 * 4 * 5 * voxel)
    # On its head the gate is a plate with posts, on a side all of a layer hangs together.
    others = {row: value for row, value in rows.items() if not row.endswith("z_up")}
    assert set(others.values()) == {0.0}
    assert len(others) == 10


def test_bridges_and_mushrooms_are_no_islands():
    gate = boxes((16, 8, 12), ((0, 3), (0, 8), (0, 12)), ((0, 16), (0, 8), (10, 12)))
    mushroom = boxes((16, 8, 12), ((6, 9), (3, 5), (0, 8)), ((1, 15), (0, 8), (8, 12)))
    for solid in (gate, mushroom):
        rows = values(islands(grid_of(solid), direction="z_up"))
        assert rows == {"unsupported_islands_z_up": 0, "unsupported_volume_z_up": 0}


@pytest.mark.parametrize(("angle", "carried"), [(26.0, True), (27.0, False)])
def test_a_stair_is_carried_as_far_as_the_angle_reaches(angle, carried):
    # Each step goes on where the one below ends: a voxel to the side, twice as wide as high.
    solid = np.zeros((10, 3, 10), bool)
    for step in range(10):
        solid[step, :, step] = True
    rows = values(islands(grid_of(solid, (1, 1, 0.5)), direction="z_up", overhang=angle))
    assert rows["unsupported_islands_z_up"] == (0 if carried else 9)
    assert rows["unsupported_volume_z_up"] == pytest.approx(0 if carried else 9 * 3 * 0.5)


def test_the_plate_is_where_the_body_begins():
    solid = np.pad(stalactite(), ((0, 0), (0, 0), (3, 2)))
    rows = values(islands(grid_of(solid), direction="z_up"))
    assert rows["unsupported_islands_z_up"] == 1


# --- what stays in it ----------------------------------------------------------------------


def cup(walls=2):
    """A box of 9 by 8 by 7 voxels inside, open at the high end of z, half of which has a lid."""
    shape = (9 + 2 * walls, 8 + 2 * walls, 7 + 2 * walls)
    solid = np.ones(shape, bool)
    solid[walls:-walls, walls:-walls, walls:-walls] = False
    lidded = solid.copy()
    solid[walls:-walls, walls:-walls, -walls:] = False
    lidded[walls + 4 : -walls, walls:-walls, -walls:] = False
    return solid, lidded


def test_a_cup_holds_what_is_in_it():
    solid, lidded = cup()
    voxel = math.prod(SPACING)
    for body in (solid, lidded):
        rows = values(cupped_volume(grid_of(body)))
        wanted = dict.fromkeys((f"cupped_volume_{way}" for way in WAYS), 0.0)
        # The opening's walls are part of the cup: two layers more where nothing covers it.
        above = 9 * 8 if body is solid else 5 * 8
        wanted["cupped_volume_z_up"] = (9 * 8 * 7 + 2 * above) * voxel
        if body is lidded:
            wanted["cupped_volume_x_up"] = 4 * 8 * 7 * voxel
        assert rows == pytest.approx(wanted)


def test_closed_pores_are_trapped_and_no_cups():
    solid = np.ones((12, 11, 10), bool)
    solid[3:6, 4:8, 2:7] = False
    grid = grid_of(solid)
    assert set(values(cupped_volume(grid)).values()) == {0.0}
    assert trapped_volume(grid).value == pytest.approx(3 * 4 * 5 * math.prod(SPACING))
    solid[4, 5, :2] = False
    assert trapped_volume(grid_of(solid)).value == 0
    # Only the hole in its bottom lets it drain, if it is held with that down.
    rows = values(cupped_volume(grid_of(solid)))
    assert rows["cupped_volume_z_up"] == 0
    assert rows["cupped_volume_z_down"] == pytest.approx(62 * math.prod(SPACING))


def hollow(hole):
    """A ball of 30 voxels with a cavity of 20, and a hole of a diameter through its wall."""
    x, y, z = (np.arange(32) - 15.5 for _ in range(3))
    square = x[:, None, None] ** 2 + y[:, None] ** 2 + z**2
    solid = (square < 15**2) & (square >= 10**2)
    tube = (x[:, None, None] ** 2 + y[:, None] ** 2 < (hole / 2) ** 2) & (z > 0)
    return grid_of(solid & ~tube, (0.1, 0.1, 0.1)), np.count_nonzero(square < 10**2) * 1e-3


def test_a_probe_gets_through_a_hole_that_is_wider_than_it():
    closed, cavity = hollow(0)
    assert trapped_volume(closed).value == pytest.approx(cavity)
    assert trapped_volume(closed, probe=0.3).value == pytest.approx(cavity)
    pierced, _ = hollow(5)
    assert trapped_volume(pierced).value == 0
    free, shut = (trapped_volume(pierced, probe=probe) for probe in (0.4, 0.7))
    assert free.value <= 0.02 * cavity
    assert shut.value >= 0.99 * cavity
    # Near the hole's width a voxel decides.
    assert trapped_volume(pierced, probe=0.5).uncertainty > 0.5 * cavity


def test_a_wide_probe_touches_no_bottom_of_a_narrow_pit():
    solid = np.ones((20, 22, 24), bool)
    solid[6:14, 7:15, 12:] = False
    row = trapped_volume(grid_of(solid, (0.1, 0.1, 0.1)), probe=1.2)
    # A ball that lies on the pit's edges sags into it by a cap of radius 0.4.
    sag = 0.6 - math.sqrt(0.6**2 - 0.4**2)
    cap = math.pi * sag**2 * (0.6 - sag / 3)
    assert abs(row.value - (8 * 8 * 12 * 1e-3 - cap)) <= row.uncertainty
    # A small ball leaves edges and corners.
    row = trapped_volume(grid_of(solid, (0.1, 0.1, 0.1)), probe=0.2)
    edges = (1 - math.pi / 4) * 0.1**2 * (4 * 1.1 + 4 * 0.6)
    assert 0 < abs(row.value - edges - 4 * 0.1**3 * (1 - math.pi / 6)) < row.uncertainty
    assert row.uncertainty < 0.03 * 8 * 8 * 12 * 1e-3


def test_pores_beyond_the_bulk_are_outside():
    solid, _ = cup()
    bulk = np.full(solid.shape, 255, np.uint8)
    closed = np.ones(solid.shape, bool)
    closed[3:8, 3:8, 3:8] = False
    assert trapped_volume(grid_of(closed, bulk=bulk)).value > 0
    bulk[5, 5, 5] = 0
    assert trapped_volume(grid_of(closed, bulk=bulk)).value == 0
    # A ball in it leaves its edges, among voxels half as wide as it.
    left = trapped_volume(grid_of(closed, bulk=bulk), probe=0.5)
    assert left.value < min(0.25 * 5**3 * math.prod(SPACING), left.uncertainty)
    rows = values(cupped_volume(grid_of(closed, bulk=bulk)))
    assert rows["cupped_volume_z_up"] == pytest.approx(2 * 25 * math.prod(SPACING))
    assert len(drain_path_length(grid_of(closed, bulk=bulk))) == 2


def test_a_sponge_holds_nothing_back():
    model = po.build(po.load("menger", set={"model.level": 2}))
    grid = po.voxelize(model, voxels=36)
    assert set(values(cupped_volume(grid)).values()) == {0.0}
    assert {v for n, v in values(islands(grid)).items() if "islands" in n} == {0.0}
    assert trapped_volume(grid).value == 0


# --- ways out ------------------------------------------------------------------------------


def test_ways_out_of_bent_tubes_are_as_long_as_they_are():
    solid = np.ones((12, 13, 14), bool)
    solid[3, 4, 2:] = False
    rows = drain_path_length(grid_of(solid))
    assert rows["drain_path_length"].value == pytest.approx(11.5 * SPACING[2])
    solid[3, 4:10, 2] = False
    rows = drain_path_length(grid_of(solid))
    longest = 11.5 * SPACING[2] + 5 * SPACING[1]
    assert rows["drain_path_length"].value == pytest.approx(longest)
    # Of 17 voxels the way of the second last is 95 % of the volume's.
    assert rows["drain_path_length_p95"].value == pytest.approx(longest)
    assert all(row.uncertainty > 0 for row in rows)


def test_ways_around_a_hole_come_closer_with_more_voxels():
    errors = []
    for n in (10, 20, 40):
        solid = np.ones((n + 2, n + 2, n + 2), bool)
        solid[1:-1, 1:-1, 1:-1] = False
        solid[1, 1, 0] = False
        lengths = lengths_out(~solid, (1 / n,) * 3)
        exact = math.sqrt(3) * (n - 1) / n + 1 / n
        errors.append(lengths[n, n, n] - exact)
        row = drain_path_length(grid_of(solid, (1 / n,) * 3))["drain_path_length"]
        assert row.value == lengths[n, n, n]
        assert abs(row.value - exact) <= row.uncertainty
    # It is h log(1/h), as about every point that ways go around: 1.9, 2.3 and 2.6 voxels.
    assert errors == pytest.approx([1.9 / 10, 2.26 / 20, 2.64 / 40], rel=0.01)


def test_no_way_out_is_no_row():
    solid = np.ones((8, 9, 10), bool)
    solid[3:5, 3:5, 3:5] = False
    assert len(drain_path_length(grid_of(solid))) == 0
    assert len(drain_path_length(grid_of(~solid, periodic=(True, True, True)))) == 0


# --- walls, and the whole ------------------------------------------------------------------


def test_shares_of_thin_walls_and_narrow_gaps():
    solid = boxes((20, 8, 8), ((2, 4), (0, 8), (0, 8)), ((8, 14), (0, 8), (0, 8)))
    grid = grid_of(solid, (0.1, 0.1, 0.1), (True, True, True))
    walls, gaps = thin_wall_share(grid, width=0.4), narrow_gap_share(grid, width=0.41)
    assert walls.value == pytest.approx(2 / 8)
    assert walls.uncertainty == 0  # no wall is a voxel more or less than 0.4 wide
    assert gaps.value == pytest.approx(4 / 12)
    assert gaps.uncertainty == pytest.approx(4 / 12)


def test_a_survey_says_which_way_to_build():
    how = Survey(smallest_wall=0.5, smallest_gap=0.1)
    found = survey(grid_of(stalactite()), how=how, only=["printability"])
    assert any(note.startswith("built worse along +z by") for note in found.notes)
    assert any(note.startswith("walls thinner than 0.5 mm make up") for note in found.notes)
    assert {c.name for c in found.curves} == {
        "overhang_by_angle",
        "islands_by_layer",
        "drain_path_lengths",
    }
    cube = survey(grid_of(np.ones((8, 8, 8), bool), (1, 1, 1)), only=["printability"])
    assert any(note.startswith("no direction to build in is better") for note in cube.notes)


def test_a_probe_that_is_wider_than_the_body_gives_no_row():
    wide = survey(grid_of(stalactite()), how=Survey(probe=50.0), only=["printability"])
    assert "trapped_volume" not in wide.measures
    assert "drain_path_length" in wide.measures


@pytest.mark.parametrize("edge", [1.0, 0.5])
def test_a_probe_leaves_the_edges_of_a_cup(edge):
    n = round(40 / edge)
    x = (np.stack(np.indices((n, n, n)), -1) + 0.5) * edge
    solid, room = (
        np.all((x >= low) & (x < high), -1)
        for low, high in (((8, 8, 8), (32, 32, 32)), ((12, 12, 12), (28, 28, 40)))
    )
    grid = grid_of(solid & ~room, (edge,) * 3)
    for probe in (1, 2, 3, 4, 5, 8, 12, 15):
        row, r = trapped_volume(grid, probe=probe), probe / 2
        edges = (1 - math.pi / 4) * r**2 * (4 * (20 - r) + 4 * (16 - 2 * r))
        exact = edges + 4 * (1 - math.pi / 6) * r**3
        assert abs(row.value - exact) < 1.1 * row.uncertainty, probe
        assert probe < 8 or row.value == pytest.approx(exact, rel=0.12)
        assert row.uncertainty < 0.1 * 16 * 16 * 20


def test_what_a_probe_leaves_is_what_it_does_not_reach():
    grid = hollow(6)[0]
    for probe in (0.3, 0.6, 0.7):
        left = trapped_volume(grid, probe=probe)
        open_part = accessible_porosity(grid, probe=probe)
        whole = (~grid.solid).sum() * 1e-3
        # But for what balls beyond the sides touch.
        assert open_part.value * grid.frame.size * 1e-3 + left.value == pytest.approx(
            whole, rel=0.05 if probe < 0.7 else 0.3
        )
        assert open_part.uncertainty > 0 < left.uncertainty


def test_a_probe_that_needs_too_much_memory_gives_no_row_but_a_note():
    grid = grid_of(stalactite(), (1.0, 1000.0, 1e-3))
    found = survey(grid, how=Survey(probe=2000.0), only=["printability"])
    assert "trapped_volume" not in found.measures
    assert "drain_path_length" in found.measures
    assert any(
        note.startswith("what a probe of 2000 mm leaves is not told") for note in found.notes
    )


def test_bodies_without_end_stand_on_no_plate():
    grid = grid_of(stalactite(), periodic=(True, False, True))
    rows = survey(grid, only=["printability"]).measures
    directions = {name for name in rows.names if name.startswith("overhang_area")}
    assert directions == {"overhang_area_y_up", "overhang_area_y_down"}
    endless = grid_of(stalactite(), periodic=(True, True, True))
    found = survey(endless, only=["printability"])
    assert found.measures.names == ()
    assert [note.partition(":")[0] for note in found.notes] == ["periodic along x, y and z"]
    assert trapped_volume(endless).value == math.inf


def test_what_cannot_be_asked_is_said():
    grid = grid_of(stalactite(), periodic=(True, False, False))
    with pytest.raises(GridError, match="direction: got 'z-up'"):
        islands(grid, direction="z-up")
    with pytest.raises(GridError, match="not periodic"):
        cupped_volume(grid, direction="x_up")
    for angle in (0, 90, math.nan):
        with pytest.raises(GridError, match="overhang: got"):
            overhangs(grid, overhang=angle)
    with pytest.raises(GridError, match="beyond: got"):
        overhangs(grid, beyond="air")
    for probe in (0.0, math.nan, 100.0):
        with pytest.raises(GridError, match="probe: got"):
            trapped_volume(grid, probe=probe)
    with pytest.raises(GridError, match="width: got"):
        thin_wall_share(grid, width=-1)


def test_work_is_told_and_may_be_cancelled():
    class Enough(Exception):
        pass

    told = []

    def tell(name, done):
        assert 0 <= done <= 1
        told.append(name)

    grid = grid_of(stalactite())
    survey(Sample(grid, how=Survey(probe=0.5), progress=tell), only=["printability"])
    names = {"printability", "overhangs", "islands", "cupped volume", "trapped volume"}
    assert set(told) == {*names, "drain paths", "local thickness"}

    def stop(*_):
        raise Enough

    for take in (overhangs, islands, cupped_volume, drain_path_length):
        with pytest.raises(Enough):
            take(grid, progress=stop)
    with pytest.raises(Enough):
        trapped_volume(grid, probe=0.5, progress=stop)


def test_memory_is_asked_for_first(monkeypatch):
    monkeypatch.setenv("POROUS_MAX_MEMORY", "1K")
    grid = grid_of(stalactite())
    with pytest.raises(MemoryLimitError, match="as a probe reaches"):
        trapped_volume(grid, probe=0.5)
    for take in (overhangs, islands, cupped_volume, drain_path_length):
        with pytest.raises(MemoryLimitError, match="16 × 8 × 12 voxels would need"):
            take(grid)
