"""Scaling: lacunarity, succolarity, dimensions of all orders, and how surely they are told."""

import math
import time
from itertools import product

import numpy as np
import pytest
from scipy import ndimage

import porous as po
from porous.errors import GridError
from porous.measures import (
    Sample,
    box_dimension,
    generalised_dimensions,
    gliding_boxes,
    lacunarity,
    succolarity,
    survey,
)
from porous.models.digits import DigitSet
from porous.models.ifs import ifs
from porous.models.primitive import Primitive, named
from porous.values import FILL, Frame, VoxelGrid

KEPT = {
    "menger": [d for d in product(range(3), repeat=3) if d.count(1) < 2],
    "vicsek": [d for d in product(range(3), repeat=3) if d.count(1) >= 2],
    "cantor": [d for d in product(range(3), repeat=3) if 1 not in d],
}
DIMENSION = {name: math.log(len(kept)) / math.log(3) for name, kept in KEPT.items()}


def cells(name, level):
    """The cells of a level, True, each one voxel."""
    one = np.zeros((3, 3, 3), bool)
    one[tuple(np.transpose(KEPT[name]))] = True
    body = np.ones((1, 1, 1), bool)
    for _ in range(level):
        body = np.kron(body, one)
    return body.astype(bool)


def grid_of(solid, *, periodic=(False, False, False), spacing=(0.5, 0.25, 1.0), bulk=None):
    fill = np.where(solid, 255, 0).astype(np.uint8)
    whole = None if bulk is None else np.where(bulk, 255, 0).astype(np.uint8)
    return VoxelGrid(Frame((1, 2, 3), spacing, solid.shape, periodic), fill, whole)


def random_solid(shape, seed, share=0.4):
    return np.random.default_rng(seed).random(shape) < share


# --- boxes that glide ---------------------------------------------------------------------------


@pytest.mark.parametrize(("level", "wanted"), [(1, 1.35), (2, 1.8225), (3, 2.460375)])
def test_boxes_of_one_voxel_have_one_over_the_solid_part(level, wanted):
    body = np.kron(cells("menger", level), np.ones((2, 1, 3), bool)).astype(bool)
    found = gliding_boxes(grid_of(body))
    assert found.sizes[0] == 1
    assert found.solid[0] == pytest.approx(wanted, rel=1e-13)
    assert found.pore[0] == pytest.approx(1 / (1 - 1 / wanted), rel=1e-13)


@pytest.mark.parametrize("periodic", [(False, False, False), (True, False, True)])
@pytest.mark.parametrize("bulked", [False, True])
def test_boxes_glide_over_every_place(periodic, bulked):
    solid = random_solid((12, 14, 13), 3)
    bulk = random_solid(solid.shape, 4, 0.97) if bulked else None
    found = gliding_boxes(grid_of(solid, periodic=periodic, bulk=bulk))
    for size, *values in zip(*found, strict=True):
        held = []
        begins = [
            range(n if w else n - size + 1) for n, w in zip(solid.shape, periodic, strict=True)
        ]
        for place in product(*begins):
            box = np.ix_(
                *((a + np.arange(size)) % n for a, n in zip(place, solid.shape, strict=True))
            )
            if bulk is None or bulk[box].all():
                held.append(solid[box].sum())
        held = np.array(held, float)
        for masses, value in zip((held, size**3 - held), values, strict=True):
            wanted = (masses**2).mean() / masses.mean() ** 2 if masses.any() else math.nan
            assert value == pytest.approx(wanted, rel=1e-12, nan_ok=True)


def test_what_is_alike_everywhere_has_lacunarity_one():
    layers = np.zeros((24, 20, 30), bool)
    layers[:, ::2] = True
    found = gliding_boxes(grid_of(layers, periodic=(False, True, False)))
    even = found.sizes % 2 == 0
    np.testing.assert_allclose(found.solid[even], 1)
    # Of an odd size half of the boxes hold (r + 1)/2 layers, and half (r − 1)/2.
    np.testing.assert_allclose(found.solid[~even], 1 + 1 / found.sizes[~even] ** 2)


def test_lacunarity_is_told_at_a_tenth_of_the_shortest_edge_and_held_against_half_the_voxels():
    solid = np.kron(random_solid((16, 10, 13), 5), np.ones((2, 2, 2), bool)).astype(bool)
    fine = grid_of(solid)
    row = lacunarity(fine)
    found = gliding_boxes(fine)
    assert row.value == found.at("solid", 2) == found.solid[list(found.sizes).index(2)]
    coarse = gliding_boxes(Sample(fine).coarse.grid)
    assert row.uncertainty == pytest.approx(abs(row.value - coarse.at("solid", 1)))
    assert lacunarity(fine, phase="pore").name == "pore_lacunarity"
    assert lacunarity(grid_of(solid[:7, :7, :7])).uncertainty == math.inf
    with pytest.raises(GridError, match="phase"):
        lacunarity(fine, phase="wood")


def test_lacunarity_is_that_of_the_same_boxes_at_any_resolution():
    solid = random_solid((27, 27, 27), 5)
    rows = [lacunarity(grid_of(np.kron(solid, np.ones((k, k, k), bool)))) for k in (2, 3, 4)]
    values = [row.value for row in rows]
    # Of 5.4, 8.1 and 10.8 voxels.
    for row, value in zip(rows[:2], values[1:], strict=True):
        assert abs(row.value - value) < row.uncertainty
    assert abs(values[2] - values[1]) < abs(values[1] - values[0]) < 0.01
    fine = grid_of(np.kron(solid, np.ones((2, 2, 2), bool)))
    found = gliding_boxes(fine)
    five, six = (found.solid[list(found.sizes).index(n)] for n in (5, 6))
    share = math.log(5.4 / 5) / math.log(6 / 5)
    assert rows[0].value == pytest.approx(five ** (1 - share) * six**share, rel=1e-12)
    notes = survey(fine, only=["fractal"]).notes
    # The edge of a cube as large as a voxel of ½ × ¼ × 1 is ½.
    assert "lacunarity: of boxes of 5.4 voxels (2.7 mm) along each edge" in notes


# --- fluid that comes in ------------------------------------------------------------------------


def naive_succolarity(solid, axis, structure):
    labels, _ = ndimage.label(~solid, structure)
    labels = np.moveaxis(labels, axis, 0)
    total = 0.0
    for turned in (labels, labels[::-1]):
        flooded = np.isin(turned, np.unique(turned[0][turned[0] > 0]))
        pressure = np.arange(len(turned)) + 0.5
        total += (flooded.sum(axis=(1, 2)) * pressure).sum() / (pressure.sum() * turned[0].size)
    return total / 2


@pytest.mark.parametrize("seed", range(3))
def test_fluid_goes_where_labels_lead(seed):
    solid = random_solid((13, 10, 16), seed, 0.75)
    for row, axis in zip(succolarity(grid_of(solid)), range(3), strict=True):
        wide = naive_succolarity(solid, axis, np.ones((3, 3, 3)))
        narrow = naive_succolarity(solid, axis, None)
        assert row.value == pytest.approx(wide, rel=1e-12)
        assert row.uncertainty >= wide - narrow - 1e-12 > 0
        assert row.name == f"succolarity_{'xyz'[axis]}"


def test_channels_and_dead_ends_have_their_closed_form():
    solid = np.ones((20, 12, 16), bool)
    solid[:, 3:5, 4:8] = False  # a channel along x, 1/24 of the area
    solid[:8, 8:10, 10:14] = False  # and a dead end of 8 of 20, as wide
    x, y, z = succolarity(grid_of(solid))
    share = 8 / (12 * 16)
    assert x.value == pytest.approx(share + share * (8 / 20) ** 2 / 2)
    assert y.value == z.value == 0
    assert [row.value for row in succolarity(grid_of(np.zeros((8, 9, 10), bool)))] == [1, 1, 1]


def test_fluid_goes_on_across_periodic_sides_but_not_its_own():
    solid = np.ones((10, 8, 12), bool)
    solid[:5, 0, 3] = False  # from XMIN half way, at the side YMIN …
    solid[4:, 7, 3] = False  # … and on to XMAX at the side YMAX
    part = 1 / (8 * 12)
    apart = part * (0.25 / 2 + 0.36 / 2)
    x = succolarity(grid_of(solid))["succolarity_x"].value
    assert x == pytest.approx(apart)
    x = succolarity(grid_of(solid, periodic=(True, True, False)))["succolarity_x"].value
    # All from both sides: one voxel each, and at x = 4 two, where pressures are 4.5 and 5.5 of 50.
    joined = part * (1 + (4.5 + 5.5) / 2 / 50)
    assert x == pytest.approx(joined)


def test_a_bulk_that_is_no_box_has_no_succolarity():
    solid = random_solid((8, 9, 10), 1)
    body = grid_of(solid, bulk=random_solid(solid.shape, 2, 0.9))
    with pytest.raises(GridError, match="bulk"):
        succolarity(body)
    assert "succolarity_x" not in survey(body, only=["fractal"]).measures


# --- dimensions of all orders -------------------------------------------------------------------


@pytest.mark.parametrize("name", KEPT)
def test_a_body_that_is_alike_everywhere_has_one_dimension(name):
    found = generalised_dimensions(grid_of(cells(name, 4)))
    np.testing.assert_allclose(found.dimension, DIMENSION[name], atol=1e-9)
    np.testing.assert_allclose(found.alpha, DIMENSION[name], atol=1e-9)
    np.testing.assert_allclose(found.f, DIMENSION[name], atol=1e-9)
    assert found.doubt.max() < 1e-9


def test_a_cascade_of_weights_has_its_closed_form():
    weights = np.array([1, 2, 1, 1, 2, 2, 1, 2]).reshape(2, 2, 2)
    fill = np.ones((1, 1, 1), np.int64)
    for _ in range(6):
        fill = np.kron(fill, weights)
    grid = VoxelGrid(Frame((0, 0, 0), (1, 2, 3), fill.shape), fill.astype(np.uint8))
    # Half a byte is no solid for counts of boxes: what fits is asked for by its base.
    whole = VoxelGrid(grid.frame, (fill * 3).astype(np.uint8))
    found = generalised_dimensions(whole, base=2)
    p = np.repeat([1 / 12, 2 / 12], 4)
    q = found.order[:, None]
    partition = (p**q).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        wanted = np.log2(partition) / (1 - found.order)
    wanted[found.order == 1] = -(p * np.log2(p)).sum()
    np.testing.assert_allclose(found.dimension, wanted, rtol=1e-9)
    alpha = -(p**q * np.log2(p)).sum(axis=1) / partition
    np.testing.assert_allclose(found.alpha, alpha, rtol=1e-9)
    np.testing.assert_allclose(found.f, found.order * alpha + np.log2(partition), atol=1e-9)
    assert found.dimension[0] > found.dimension[-1] + 0.5
    assert (np.diff(found.dimension) < 0).all()


def test_where_boxes_do_not_fit_dimensions_say_so():
    found = generalised_dimensions(grid_of(cells("menger", 4)), base=2)
    assert (np.abs(found.dimension - DIMENSION["menger"]) <= 1.96 * found.doubt)[10:].all()
    assert found.doubt.min() > 0.01


# --- how surely a box dimension is told ---------------------------------------------------------


def turned(seed):
    q = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    return q * np.sign(np.linalg.det(q))


def sampled(name, level, voxels, *, shift=0.0, turn=None):
    """A level on voxels that do not fit it: other numbers, moved or turned."""
    if turn is None:
        model = ifs(DigitSet(3, KEPT[name]), level=level)
    else:
        cube = named("cube")
        solid = Primitive("mesh", (cube.points - 0.5) @ turn.T + 0.5, cube.triangles, convex=True)
        middle = np.full(3, 0.5)
        moves = [np.array(d) / 3 + middle / 3 - middle for d in KEPT[name]]
        maps = [(np.eye(3) / 3, middle - middle / 3 + turn @ move) for move in moves]
        model = ifs(maps, level=level, primitive=solid)
    if not shift:
        return po.voxelize(model, voxels=voxels)
    h = 1 / voxels
    shape = (voxels + 2 * math.ceil(shift) + 1,) * 3
    frame = Frame((-shift * h, -shift * h / 2, -1.7 * shift * h), (h, h, h), shape)
    points = np.bitwise_count(model.sample(frame, FILL)).astype(np.int64)
    return VoxelGrid(frame, ((255 * points + 32) // 64).astype(np.uint8))


def is_told(grid, name):
    row = box_dimension(grid)
    assert row.uncertainty < 1.5
    return abs(row.value - DIMENSION[name]) <= 1.96 * row.uncertainty + 1e-9


@pytest.mark.parametrize("name", KEPT)
@pytest.mark.parametrize("level", [4, pytest.param(5, marks=pytest.mark.slow)])
def test_boxes_on_a_bodys_lattice_have_its_dimension(name, level):
    row = box_dimension(grid_of(cells(name, level)))
    assert row.value == pytest.approx(DIMENSION[name], abs=1e-9)
    assert row.uncertainty < 1e-9


@pytest.mark.parametrize("name", KEPT)
@pytest.mark.parametrize(("voxels", "shift"), [(100, 0), (128, 0), (100, 2.6), (128, 7.3)])
def test_boxes_off_it_hold_it_in_their_interval(name, voxels, shift):
    assert is_told(sampled(name, 4, voxels, shift=shift), name)


@pytest.mark.slow
@pytest.mark.nightly
@pytest.mark.parametrize("name", KEPT)
def test_bodies_that_are_turned_have_their_dimension_in_the_interval(name):
    told = [is_told(sampled(name, 4, 200), name), is_told(sampled(name, 4, 200, shift=3.4), name)]
    for voxels in (128, 200):
        told += [is_told(sampled(name, 4, voxels, turn=turned(seed)), name) for seed in range(8)]
    assert np.mean(told) >= 0.94  # at most one in eighteen
    assert all(told[:2])


# --- in a survey --------------------------------------------------------------------------------


def test_a_survey_draws_the_counts_and_names_the_window():
    found = survey(grid_of(cells("menger", 3), spacing=(0.5, 0.25, 0.125)), only=["fractal"])
    curves = {(c.name, c.series): c for c in found.curves}
    boxes, fit = curves["box_counts", "boxes with solid"], curves["box_counts", "line fitted"]
    np.testing.assert_array_equal(boxes.y, [8000, 400, 20, 1])
    np.testing.assert_allclose(boxes.x, 0.25 * 3.0 ** np.arange(4))
    np.testing.assert_allclose(fit.y, [8000, 400, 20])
    assert any("3 sizes of boxes, 1 to 9 voxels" in note for note in found.notes)
    assert found.measures["correlation_dimension"].value == pytest.approx(DIMENSION["menger"])
    assert found.measures["information_dimension"].uncertainty < 1e-9
    assert {"lacunarity", "generalised_dimensions", "multifractal_spectrum"} < {
        c.name for c in found.curves
    }
    assert found.measures["lacunarity"].value > 1


def test_a_survey_names_no_dimension_that_cannot_be():
    model = po.build(po.load("menger"))
    notes = survey(po.voxelize(model, voxels=36), model=model, only=["fractal"]).notes
    (interval,) = [note for note in notes if "95 %" in note]
    low, high = (float(interval.split(word)[1].split()[0].rstrip(",")) for word in ("from", " to"))
    assert 0 <= low <= DIMENSION["menger"] <= high == 3
    assert any("3 of 8 sizes of boxes are finer than the smallest feature" in n for n in notes)
    single = np.zeros((20, 20, 20), bool)
    single[3, 4, 5] = True
    notes = survey(grid_of(single), only=["fractal"]).notes
    assert any("with 95 % from 0.0000 to 0.0000" in note for note in notes)


@pytest.mark.parametrize(("n", "off"), [(10, 0.04), (97, 0.01)])
def test_blocks_in_grids_of_any_size_have_dimension_three_of_all_orders(n, off):
    found = generalised_dimensions(grid_of(np.ones((n, n, n), bool)))
    late = found.order >= 0
    np.testing.assert_allclose(found.dimension[late], 3, atol=off)
    assert (np.abs(found.dimension - 3) <= 1.96 * found.doubt + 1e-9).all()


def test_bodies_of_one_phase_have_the_lacunarity_of_that():
    rows = survey(grid_of(np.ones((9, 10, 12), bool)), only=["fractal"]).measures
    assert rows["lacunarity"].value == 1
    assert "pore_lacunarity" not in rows
    assert rows["succolarity_x"].value == 0
    rows = survey(grid_of(np.zeros((9, 10, 12), bool)), only=["fractal"]).measures
    assert rows["pore_lacunarity"].value == 1
    assert {"lacunarity", "correlation_dimension"}.isdisjoint(rows.names)
    assert rows["succolarity_z"].value == 1


@pytest.mark.slow
@pytest.mark.nightly
def test_a_survey_of_256_voxels_takes_less_than_five_seconds():
    body = grid_of(ndimage.uniform_filter(random_solid((256, 256, 256), 0).astype(float), 9) > 0.4)
    survey(grid_of(random_solid((20, 20, 20), 0)), only=["fractal"])
    taken = []
    for _ in range(2):
        start = time.perf_counter()
        survey(body, only=["fractal"])
        taken.append(time.perf_counter() - start)
    assert min(taken) < 5
