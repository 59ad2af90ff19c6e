"""Components: runs and unions against flooding by hand and against scipy."""

from itertools import pairwise, product

import naive_measures
import numpy as np
import pytest
import scipy.ndimage

from porous.kernels.components import (
    label,
    label_runs,
    layer_labels,
    sizes_from,
    touching,
    unite,
)

PERIODIC = list(product((False, True), repeat=3))
STRUCTURE = {6: scipy.ndimage.generate_binary_structure(3, 1), 26: np.ones((3, 3, 3))}


def random_mask(shape, seed, density):
    return np.random.default_rng(seed).random(shape) < density


@pytest.mark.parametrize("connectivity", [6, 26])
@pytest.mark.parametrize("periodic", PERIODIC)
@pytest.mark.parametrize("shape", [(4, 5, 6), (1, 3, 7), (2, 2, 9), (5, 1, 1), (3, 6, 2)])
def test_labels_are_those_of_flooding(connectivity, periodic, shape):
    for seed, density in enumerate((0.0, 0.1, 0.25, 0.4, 0.6, 1.0)):
        mask = random_mask(shape, seed, density)
        labels, count = label(mask, connectivity, periodic=periodic)
        expected, number = naive_measures.label(mask, connectivity, periodic)
        assert count == number
        np.testing.assert_array_equal(labels, expected)


@pytest.mark.parametrize("connectivity", [6, 26])
@pytest.mark.parametrize("density", [0.05, 0.2, 0.31, 0.5, 0.9])
def test_labels_equal_scipys(connectivity, density):
    mask = random_mask((31, 24, 70), 4, density)
    labels, count = label(mask, connectivity)
    expected, number = scipy.ndimage.label(mask, STRUCTURE[connectivity])
    assert count == number
    np.testing.assert_array_equal(labels, expected)


@pytest.mark.parametrize("connectivity", [6, 26])
def test_slabs_and_threads_change_nothing(connectivity, monkeypatch):
    mask = random_mask((23, 9, 20), 7, 0.3)
    for periodic in ((False, False, False), (True, True, True)):
        whole, _ = label(mask, connectivity, periodic=periodic)
        with monkeypatch.context() as patch:
            patch.setattr("porous.kernels.components.SLAB", 400)
            patch.setenv("POROUS_THREADS", "3")
            np.testing.assert_array_equal(label(mask, connectivity, periodic=periodic)[0], whole)


def test_sizes_count_voxels():
    mask = random_mask((9, 8, 7), 2, 0.4)
    runs = label_runs(mask, 6)
    labels, count = label(mask, 6)
    np.testing.assert_array_equal(runs.sizes, np.bincount(labels.ravel(), minlength=count + 1)[1:])
    assert runs.sizes.sum() == mask.sum()
    assert len(runs.rows) == len(runs.starts)
    for row, start, number in zip(runs.rows, runs.starts, runs.labels, strict=True):
        assert labels[row // 8, row % 8, start] == number + 1


def test_diagonal_chain_is_one_by_corners_and_many_by_faces():
    mask = np.zeros((5, 5, 5), bool)
    mask[range(5), range(5), range(5)] = True
    assert label(mask, 26)[1] == 1
    assert label(mask, 6)[1] == 5
    assert label(mask[::-1], 26)[1] == 1


def test_periodic_corner_neighbours():
    mask = np.zeros((4, 5, 6), bool)
    mask[0, 0, 0] = mask[3, 4, 5] = True
    assert label(mask, 26)[1] == 2
    assert label(mask, 26, periodic=(True, True, True))[1] == 1
    assert label(mask, 6, periodic=(True, True, True))[1] == 2
    assert label(mask, 26, periodic=(True, True, False))[1] == 2


def test_unknown_connectivity_is_a_mistake():
    with pytest.raises(ValueError, match="6 or 26"):
        label(np.ones((2, 2, 2), bool), 18)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_layers_are_those_of_the_labels(axis):
    mask = random_mask((6, 7, 9), 3, 0.5)
    runs, (labels, _) = label_runs(mask, 26), label(mask, 26)
    for layer in range(mask.shape[axis]):
        np.testing.assert_array_equal(
            layer_labels(runs, mask.shape, axis, layer), labels.take(layer, axis=axis)
        )


@pytest.mark.parametrize("first", [(0, 0, 0), (1, 0, 0), (0, 1, 1), (1, 1, 1), (3, 2, 5)])
def test_sizes_from_a_voxel_on(first):
    mask = random_mask((6, 7, 9), 4, 0.4)
    runs, (labels, count) = label_runs(mask, 6), label(mask, 6)
    own = labels[tuple(slice(a, None) for a in first)]
    np.testing.assert_array_equal(
        sizes_from(runs, mask.shape, first), np.bincount(own.ravel(), minlength=count + 1)[1:]
    )


def test_components_that_touch_a_mask():
    mask, other = random_mask((6, 7, 9), 5, 0.3), random_mask((6, 7, 9), 6, 0.05)
    labels, count = label(mask, 6)
    found = np.flatnonzero(touching(label_runs(mask, 6), other)) + 1
    assert 0 < len(found) < count
    assert set(found) == set(labels[other & mask].tolist())


def test_more_runs_than_can_be_numbered_are_refused(monkeypatch):
    monkeypatch.setattr("porous.kernels.components.LARGEST", 9)
    with pytest.raises(ValueError, match="smaller tiles"):
        label_runs(random_mask((6, 7, 9), 5, 0.3), 6)


@pytest.mark.parametrize("seed", range(40))
def test_unions_are_those_of_walking(seed):
    random = np.random.default_rng(seed)
    n, m = int(random.integers(1, 12)), int(random.integers(0, 25))
    voxels = np.sort(random.integers(0, 9, m))
    owners, turns = random.integers(0, n, m), random.integers(-1, 2, (m, 3))
    sizes, marks = random.integers(1, 2**60 // n, n), random.integers(0, 4, n)
    found = unite(voxels, owners, turns, sizes, marks, around=4)
    links = [(a, b) for a, b in pairwise(range(m)) if voxels[a] == voxels[b]]
    steps = [(owners[a], owners[b], turns[a] - turns[b]) for a, b in links]
    steps += [(b, a, -step) for a, b, step in steps]
    number = 0
    for start in range(n):
        if start in owners_before(steps, start):
            continue
        places, around, front = {start: np.zeros(3, int)}, np.zeros(3, bool), [start]
        while front:
            here = front.pop()
            for _, there, step in (s for s in steps if s[0] == here):
                if there not in places:
                    places[there] = places[here] + step
                    front.append(there)
                around |= places[there] != places[here] + step
        assert found.sizes[number] == sum(int(sizes[one]) for one in places)
        joined = np.bitwise_or.reduce([marks[one] for one in places])
        assert found.marks[number] == joined | 4 * around @ (1, 2, 4)
        for one, place in places.items():
            assert found.numbers[one] == number
            if not around.any():
                np.testing.assert_array_equal(found.places[one], place)
        number += 1
    assert len(found.sizes) == number


def owners_before(steps, start):
    """Return the components that can be reached from one that comes earlier."""
    reached = set(range(start))
    while more := {int(b) for a, b, _ in steps if a in reached} - reached:
        reached |= more
    return reached - set(range(start)) if reached else set()
