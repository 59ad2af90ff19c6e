"""The closed form of a bent block's volume, against the sum of its cells and Gauss's rule."""

from itertools import product

import numpy as np
import pytest

from porous.models.digits import DigitSet, named
from porous.models.hexa_volume import block_volume, jacobian

CUBE = np.array(list(product((0.0, 1.0), repeat=3))).T


def gauss(corners):
    """Two points per axis integrate a polynomial of degree three exactly."""
    points = 0.5 + np.array([-0.5, 0.5]) / np.sqrt(3)
    total = 0.0
    for u in product(points, repeat=3):
        total += np.linalg.det(gradient(corners, u)) / 8
    return total


def gradient(corners, u):
    columns = []
    for axis in range(3):
        weights = []
        for corner in product((0, 1), repeat=3):
            factors = [u[a] if corner[a] else 1 - u[a] for a in range(3)]
            factors[axis] = 1 if corner[axis] else -1
            weights.append(np.prod(factors))
        columns.append(corners @ np.array(weights))
    return np.column_stack(columns)


def image(corners, u):
    weights = [
        np.prod([u[a] if corner[a] else 1 - u[a] for a in range(3)])
        for corner in product((0, 1), repeat=3)
    ]
    return corners @ np.array(weights)


def sum_of_cells(corners, digits):
    boxes = [(np.zeros(3), 1.0)]
    for level in digits:
        boxes = [
            (low + size * d / level.divisions, size / level.divisions)
            for low, size in boxes
            for d in level.keep
        ]
    return sum(
        gauss(np.column_stack([image(corners, low + size * np.array(c)) for c in CUBE.T]))
        for low, size in boxes
    )


def bent(seed, amount=0.2):
    return np.diag([2.0, 3.0, 5.0]) @ (
        CUBE + np.random.default_rng(seed).uniform(-amount, amount, (3, 8))
    )


def test_the_jacobian_is_that_of_the_trilinear_map():
    corners = bent(1)
    coefficients = jacobian(corners)
    for u in np.random.default_rng(2).random((20, 3)):
        powers = np.einsum("i,j,k->ijk", *(u[:, None] ** np.arange(3)))
        found = (coefficients * powers).sum()
        assert found == pytest.approx(np.linalg.det(gradient(corners, u)), rel=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_a_block_is_the_sum_of_its_cells(seed):
    corners = bent(seed)
    random = np.random.default_rng(seed)
    table = [np.array(d) for d in product(range(2), repeat=3) if random.random() < 0.6]
    other = DigitSet(2, np.array(table or [[1, 0, 1]]))
    for digits in ([], [named("menger")], [named("menger"), other], [other, named("vicsek-7")]):
        assert block_volume(corners, digits) == pytest.approx(
            sum_of_cells(corners, digits), rel=1e-13
        )


@pytest.mark.parametrize("name", ["menger", "mosely-light", "even-parity"])
def test_an_affine_block_loses_what_its_digits_lose(name):
    digits = named(name)
    matrix = np.random.default_rng(3).random((3, 3)) + np.eye(3)
    ratio = len(digits.keep) / digits.divisions**3
    for level in range(8):
        found = block_volume(matrix @ CUBE, [digits] * level)
        assert found == pytest.approx(np.linalg.det(matrix) * ratio**level, rel=1e-12)
