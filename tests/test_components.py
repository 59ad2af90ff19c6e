"""Components: runs and unions against flooding by hand and against scipy."""

from itertools import product

import naive_measures
import numpy as np
import pytest
import scipy.ndimage

from porous.kernels.components import label, label_runs

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
