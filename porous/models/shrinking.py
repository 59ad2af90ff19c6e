"""Whether a matrix shrinks, decided exactly: whether its spectral radius is below one.

Floating-point numbers are whole numbers over powers of two: the characteristic polynomial is formed
in integers (Faddeev–LeVerrier), and Schur–Cohn's recursion decides.
"""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

BITS = 4096
"""With how many bits the recursion is tried before it is run in full."""


def shrinks(matrix: NDArray[np.float64], *more: NDArray[np.float64]) -> bool:
    """Tell exactly whether the product of matrices has a spectral radius below one.

    The first factor stands outermost. Entries are taken as the floating-point numbers they are.
    """
    whole, shift = _integers(matrix)
    for factor in more:
        other, power = _integers(factor)
        whole, shift = whole @ other, shift + power
    polynomial = _characteristic(whole, shift)
    quick = _schur_rounded(polynomial)
    return _schur(polynomial) if quick is None else quick


def _integers(matrix: NDArray[np.float64]) -> tuple[NDArray[np.object_], int]:
    """Return whole numbers M and a shift s with matrix = M / 2^s, exactly."""
    fractions = [Fraction(float(value)) for value in matrix.flat]
    shift = max(f.denominator.bit_length() - 1 for f in fractions)
    whole = np.array([int(f * (1 << shift)) for f in fractions], dtype=object)
    return whole.reshape(matrix.shape), shift


def _characteristic(M: NDArray[np.object_], shift: int) -> list[int]:
    """Return whole coefficients of a multiple of det(z − M/2^shift), constant term first."""
    n = len(M)
    identity = np.array([[int(i == j) for j in range(n)] for i in range(n)], dtype=object)
    coefficients, B = [1], identity
    for k in range(1, n + 1):
        MB = M @ B
        c = -sum(int(MB[i, i]) for i in range(n)) // k
        coefficients.append(c)
        B = MB + c * identity
    # The coefficient of z^(n−k) of M/2^s is c_k / 2^(s·k); multiply all by 2^(s·n).
    return [c << (shift * (n - k)) for k, c in enumerate(coefficients)][::-1]


def _schur(polynomial: list[int]) -> bool:
    """Tell whether all roots lie inside the unit circle; constant term first, leading not zero."""
    p = polynomial
    while len(p) > 1:
        first, last = p[0], p[-1]
        if abs(first) >= abs(last):
            return False
        p = [last * a - first * b for a, b in zip(p, reversed(p), strict=True)][1:]
        common = int(np.gcd.reduce(np.array(p, dtype=object)))
        p = [c // common for c in p] if common > 1 else p
    return True


def _schur_rounded(polynomial: list[int]) -> bool | None:
    """Do as ``_schur`` with numbers cut to ``BITS`` and a bound on the error; None if too close."""
    p, error = _cut(polynomial, 0)
    while len(p) > 1:
        first, last = p[0], p[-1]
        gap = abs(first) - abs(last)
        if abs(gap) <= 2 * error:
            return None
        if gap > 0:
            return False
        largest = max(map(abs, p))
        p = [last * a - first * b for a, b in zip(p, reversed(p), strict=True)][1:]
        p, error = _cut(p, 4 * error * (largest + error))
    return True


def _cut(p: list[int], error: int) -> tuple[list[int], int]:
    extra = max(0, max(map(abs, p)).bit_length() - BITS)
    return [c >> extra for c in p], (error >> extra) + 2 if extra else error
