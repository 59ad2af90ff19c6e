"""Sums over layers and planes: equal to adding voxel by voxel."""

from itertools import product

import numpy as np
import pytest

from porous.kernels import sums
from porous.kernels.sums import layer_sums, summed_planes


def voxels(has_bulk):
    random = np.random.default_rng(5)
    fill, bulk = random.integers(0, 256, (2, 5, 6, 7), dtype=np.uint8)
    return random, fill, bulk if has_bulk else None


@pytest.mark.parametrize("has_bulk", [False, True])
def test_layers_count_what_their_voxels_do(has_bulk, monkeypatch):
    monkeypatch.setattr(sums, "SLAB", 90)  # two layers, and one that is left
    random, fill, bulk = voxels(has_bulk)
    solids, bulks = random.integers(0, 99, (2, 256))
    most = bulks[np.full_like(fill, 255) if bulk is None else bulk]
    solid = np.minimum(solids[fill], most)
    for axis, (first, second) in enumerate(layer_sums(fill, bulk, (solids, bulks))):
        others = tuple({0, 1, 2} - {axis})
        assert first.tolist() == solid.sum(axis=others).tolist()
        assert second.tolist() == most.sum(axis=others).tolist()


@pytest.mark.parametrize("has_bulk", [False, True])
@pytest.mark.parametrize("wraps", [(False, False, False), (True, False, True), (False, True, True)])
def test_planes_count_what_their_voxels_and_windows_do(has_bulk, wraps):
    random, fill, bulk = voxels(has_bulk)
    solids, bulks, windows = random.random((3, 256))
    wanted = np.zeros((3, 6, 7))
    for i, j, k in product(range(3), range(6), range(7)):
        most = bulks[255 if bulk is None else bulk[i, j, k]]
        window = 0
        for corner in product((0, 1), repeat=3):
            place = [p - 1 + c for p, c in zip((i, j, k), corner, strict=True)]
            # Before the first voxel lies the last one, or the second again.
            place = [1 if p < 0 and not w else p for p, w in zip(place, wraps, strict=True)]
            window += int(fill[tuple(place)] >= 128) << (corner @ np.array((4, 2, 1)))
        wanted[:, j, k] += min(solids[fill[i, j, k]], most), most, windows[window]
    parts = [
        summed_planes(fill, bulk, (solids, bulks, windows), wraps, planes)
        for planes in ((0, 1), (1, 3))
    ]
    assert sum(parts) == pytest.approx(wanted)
