"""The volume of a bent block of cubes in closed form: moments of the digits, not a sum of cells.

Eight controls span a trilinear map Φ of the unit cube, whose Jacobian determinant is a polynomial
of degree two in each coordinate. Its integral over the cubes that digit sets keep is a sum of their
moments ∫ xⁱyʲzᵏ, and these follow level by level from the digits alone.
"""

from __future__ import annotations

from itertools import product
from math import comb
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from porous.models.digits import DigitSet

    Floats = NDArray[np.float64]

POWERS = 3
"""The determinant has no higher power of a coordinate than the second."""


def block_volume(corners: Floats, digits: Sequence[DigitSet]) -> float:
    """Return the volume of the image of the cubes that digit sets keep, in the corners' unit³.

    Of a block that is nowhere folded; it may be mirrored.

    Parameters
    ----------
    corners
        Shape (3, 8): the controls, lexicographic (corner 4a + 2b + c at (a, b, c)).
    digits
        The digit set of each level, the coarsest first; none for the whole block.
    """
    moments = np.array([1 / np.prod(np.add(p, 1.0)) for p in product(range(POWERS), repeat=3)])
    moments = moments.reshape((POWERS,) * 3)
    for level in reversed(digits):
        moments = _coarser(moments, level)
    return abs(float((jacobian(corners) * moments).sum()))


def jacobian(corners: Floats) -> Floats:
    """Return the coefficients (3, 3, 3) of det DΦ by the powers of x, y and z."""
    monomials = corners.reshape(3, 2, 2, 2).copy()
    for axis in (1, 2, 3):
        lower, upper = np.moveaxis(monomials, axis, 0)  # views: f(0) and f(1) become 1 and x
        upper -= lower
    vectors = np.moveaxis(monomials, 0, -1)
    result = np.zeros((POWERS,) * 3)
    for a, b, c in product(product((0, 1), repeat=3), repeat=3):
        if a[0] and b[1] and c[2]:
            degree = np.add(np.add(a, b), c) - 1
            x, y, z = (vectors[index] for index in (a, b, c))
            result[tuple(degree)] += x @ np.cross(y, z)
    return result


def _coarser(moments: Floats, digits: DigitSet) -> Floats:
    """Return the moments of the union of (d + K) / N from those of K."""
    base = digits.divisions
    shifts = np.zeros((len(digits.keep), 3, POWERS, POWERS))
    for high, low in product(range(POWERS), repeat=2):
        if low <= high:  # ((d + y) / N)ʰ holds binom(h, l)·d^(h−l)·y^l
            part = comb(high, low) * digits.keep.astype(np.float64) ** (high - low)
            shifts[:, :, high, low] = part / float(base) ** high
    x, y, z = np.moveaxis(shifts, 1, 0)
    total = np.einsum("dil,djm,dkn,lmn->ijk", x, y, z, moments, optimize=True)
    return np.asarray(total / base**3)
