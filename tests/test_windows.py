"""Windows: the packed kernel against counting by hand, and what its functionals mean."""

from itertools import pairwise, product

import naive_measures
import numpy as np
import pytest
from skimage.measure import euler_number

from porous.kernels.windows import (
    CROSSINGS,
    DIRECTIONS,
    FUNCTIONALS,
    block_histogram,
    layer_windows,
    window_histogram,
)
from porous.measures._census import Census
from porous.values import Frame, VoxelGrid

PERIODIC = list(product((False, True), repeat=3))
SHAPES = [(5, 4, 3), (1, 2, 7), (3, 1, 1), (2, 3, 64), (2, 2, 65), (3, 2, 63), (2, 1, 130)]


def grid(shape, seed, density=0.5):
    solid = np.random.default_rng(seed).random(shape) < density
    return solid, np.where(solid, 128 + 50 * solid, 127).astype(np.uint8)


def tell(histogram, name):
    return int(histogram @ FUNCTIONALS[name])


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("periodic", PERIODIC)
def test_histogram_is_that_of_looking_at_each_window(shape, periodic):
    solid, fill = grid(shape, seed=sum(shape))
    expected = naive_measures.histogram(solid, periodic)
    np.testing.assert_array_equal(window_histogram(fill, periodic=periodic), expected)


@pytest.mark.parametrize("periodic", PERIODIC)
@pytest.mark.parametrize("density", [0.1, 0.5, 0.9])
def test_functionals_are_counts(periodic, density):
    solid, fill = grid((5, 6, 7), seed=3, density=density)
    counted = window_histogram(fill, periodic=periodic)
    vefc = [tell(counted, name) for name in ("vertices", "edges", "faces", "cells")]
    assert vefc == naive_measures.complex_counts(solid, periodic)
    faces = [tell(counted, name) for name in ("faces_x", "faces_y", "faces_z")]
    assert faces == naive_measures.faces(solid, periodic)
    assert tell(counted, "euler_number") == naive_measures.euler_number_6(solid, periodic)
    assert tell(counted, "euler_number_26") == np.dot(vefc, (1, -1, 1, -1))


@pytest.mark.parametrize("seed", range(10))
def test_euler_numbers_equal_scikit_image(seed):
    solid, fill = grid((9, 8, 11), seed, density=(seed + 1) / 11)
    counted = window_histogram(fill)
    assert tell(counted, "euler_number") == euler_number(solid, connectivity=1)
    assert tell(counted, "euler_number_26") == euler_number(solid, connectivity=3)


def test_euler_numbers_of_the_phases_are_dual_on_a_torus():
    # Solid and void share a closed surface; in a closed 3-manifold each has half its χ.
    for seed in range(5):
        _, fill = grid((6, 5, 7), seed)
        one = window_histogram(fill, periodic=(True, True, True))
        other = window_histogram(255 - fill, periodic=(True, True, True))
        np.testing.assert_array_equal(one, other[::-1])
        assert tell(one, "euler_number_26") == tell(other, "euler_number")


def test_every_pair_of_neighbours_crosses_once():
    solid, fill = grid((6, 5, 7), seed=1)
    counted = window_histogram(fill)
    wide = np.pad(solid, 2)
    for direction, crossings in zip(DIRECTIONS, CROSSINGS, strict=True):
        moved = np.roll(wide, direction, axis=(0, 1, 2))
        assert counted @ crossings == (wide != moved).sum()
    assert len({tuple(np.sign(d)) for d in DIRECTIONS} | {tuple(-d) for d in DIRECTIONS}) == 26


@pytest.mark.parametrize("periodic", PERIODIC)
def test_tiles_add_up(periodic):
    _, fill = grid((7, 9, 70), seed=5)
    cuts = ([0, 1, 4, 7], [0, 5, 9], [0, 3, 64, 70])
    total = np.zeros(256, int)
    for tile in product(*(list(pairwise(c)) for c in cuts)):
        block, below, above = fill, [], []
        for axis, (start, stop) in enumerate(tile):
            halo = start > 0 or periodic[axis]
            block = block.take(range(start - halo, stop), axis=axis, mode="wrap")
            below.append("nothing" if halo else "void")
            above.append("void" if stop == fill.shape[axis] and not periodic[axis] else "nothing")
        total += block_histogram(block, below=below, above=above)
    np.testing.assert_array_equal(total, window_histogram(fill, periodic=periodic))


@pytest.mark.parametrize("shape", SHAPES)
def test_a_layer_once_again_is_a_layer(shape):
    _, fill = grid(shape, seed=9)
    longer = np.pad(fill, [(0, 1)] * 3, mode="edge")
    nothing = ("nothing",) * 3
    np.testing.assert_array_equal(
        block_histogram(fill, below=nothing, above=("again",) * 3),
        block_histogram(longer, below=nothing, above=nothing),
    )


def test_a_tiled_period_counts_as_often_as_it_is_tiled():
    _, fill = grid((4, 5, 6), seed=8)
    wraps = (True, True, True)
    once = window_histogram(fill, periodic=wraps)
    np.testing.assert_array_equal(
        window_histogram(np.tile(fill, (2, 3, 2)), periodic=wraps), 12 * once
    )


def test_slabs_and_threads_change_nothing(monkeypatch):
    _, fill = grid((13, 5, 66), seed=2)
    whole = window_histogram(fill)
    monkeypatch.setattr("porous.kernels.windows.SLAB", 700)
    np.testing.assert_array_equal(window_histogram(fill), whole)
    monkeypatch.setenv("POROUS_THREADS", "3")
    np.testing.assert_array_equal(window_histogram(fill), whole)


def test_progress_can_cancel(monkeypatch):
    _, fill = grid((13, 5, 6), seed=2)
    monkeypatch.setattr("porous.kernels.windows.SLAB", 100)
    seen = []

    def progress(done, count):
        seen.append((done, count))
        if done > 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        window_histogram(fill, progress=progress)
    assert seen[0][1] == 14
    assert len(seen) < 14


def test_windows_of_every_other_voxel_are_those_of_eight_grids():
    fill = np.random.default_rng(5).integers(0, 256, (5, 8, 67)).astype(np.uint8)
    layers = [np.array([-1, -1, *range(n), -1, -1]) for n in fill.shape]
    found = layer_windows(fill, layers, step=2)
    grids = [fill[x::2, y::2, z::2] for x, y, z in np.ndindex(2, 2, 2)]
    nothing = ("nothing",) * 3
    inner = [block_histogram(grid, below=nothing, above=nothing) for grid in grids]
    np.testing.assert_array_equal(found[0, 0, 0], sum(inner))
    np.testing.assert_array_equal(found.sum(axis=(0, 1, 2)), sum(map(window_histogram, grids)))


@pytest.mark.parametrize("periodic", [(False, False, False), (False, True, False)])
def test_a_census_tells_the_windows_of_what_is_not_solid(periodic):
    fill = np.random.default_rng(6).integers(0, 256, (5, 4, 7)).astype(np.uint8)
    frame = Frame((0, 0, 0), (1, 1, 1), fill.shape, periodic=periodic)
    census, other = (Census(VoxelGrid(frame, part)) for part in (fill, 255 - fill))
    np.testing.assert_array_equal(census.void_windows, other.windows)
