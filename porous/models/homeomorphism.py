"""Fractal homeomorphisms of a box: maps of the box onto itself that bend it at every scale.

The box is cut into eight trilinear cells by a lattice of 3 × 3 × 3 points, and each cell again by
the image of the same lattice, mirrored so that neighbours agree on their whole common face. A point
is carried to the point of the same address: h(x) = lim g_w(y), w the digits of x in the regular
lattice.

That h is a homeomorphism follows from two things, both checked for each lattice:

* Points lie inside their slots (of the box's corners, edges, faces and inside), so faces go to
  themselves, and the matrices of the eight cells acting on weights of corners contract: the corner
  of the box that a cell holds has a positive weight in each of its corners, so Dobrushin's
  coefficient is below one.
* The Jacobian of each cell is positive everywhere, by its Bernstein coefficients. The piecewise
  trilinear map is then of degree one and turns nothing over, so it is one-to-one; words of it are,
  and with the contraction so is their limit.

Source: M. F. Barnsley & A. Vince 2013, "Fractal homeomorphism for bi-affine iterated function
systems"; the mirrored trilinear cells are those of a cell of eight controls with boundaries.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import ModelError
from porous.models.trilinear import FLAT, jacobians, least_jacobian
from porous.values.value import Value, frozen

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from porous.values import Box, Frame, Pattern

    Floats = NDArray[np.float64]

WORDS = 3
"""The length of the words of cells that contraction is measured by."""

SLOWEST = 0.75
"""Words of ``WORDS`` cells that shrink less are refused: 52 digits would not pin h to a hundredth
of the box."""

FINER = 12
"""Digits that are read beyond those that tell voxels apart."""

NO_SLOT = "wanted a lattice point [i, j, k] of 0, 1 and 2"

Place = tuple[int, int, int]


@dataclass(frozen=True, eq=False)
class Homeomorphism(Value):
    """A fractal homeomorphism h of the unit cube, and so of any box.

    Parameters
    ----------
    lattice
        float64, shape (3, 3, 3, 3): the point of each (i, j, k), in edges of the box. The regular
        one is (i, j, k) / 2.

    Raises
    ------
    ModelError
        Where a point leaves its slot, a cell folds over (names them) or the cells contract too
        slowly (gives the number).
    """

    lattice: NDArray[np.float64]

    def __post_init__(self) -> None:
        self._set("lattice", frozen(self.lattice, np.float64))
        if self.lattice.shape != (3, 3, 3, 3):
            raise ModelError(f"lattice: got shape {self.lattice.shape}; wanted (3, 3, 3, 3)")
        _check_slots(self.lattice)
        _check_contracts(self.cells)
        _check_folds(self.cells)

    @cached_property
    def cells(self) -> Floats:
        """The corners of the eight cells, (8, 8, 3), both lexicographic; mirrored where b is 1."""
        halves = np.array([[0, 1], [2, 1]])  # corner 1 of either half is the middle
        i, j, k = np.array(list(itertools.product((0, 1), repeat=3))).T
        along = (halves[axis[:, None], axis[None]] for axis in (i, j, k))
        return np.ascontiguousarray(self.lattice[tuple(along)])

    @cached_property
    def contraction(self) -> float:
        """The part of a difference of weights that is left after ``WORDS`` cells, at most."""
        return contraction(self.cells)

    def moved(self, places: ArrayLike, digits: int | None = None) -> Floats:
        """Return h of places (n, 3), both in edges of the box, from 0 to 1.

        Parameters
        ----------
        places
            Where in the box.
        digits
            How many digits of the addresses are read; all that a float has where not given. What
            is left is carried along, so the map is a homeomorphism for any number.
        """
        from porous.kernels.warp import MOST_DIGITS, warped_points

        count = MOST_DIGITS if digits is None else digits
        return warped_points(_places(places), self.cells, count)

    def moved_back(self, places: ArrayLike, digits: int | None = None) -> Floats:
        """Return the places (n, 3) whose ``moved`` are given, each found by its address.

        Newton's method finds the cell of each digit, and where in it a point lies. What is found
        has as many digits as a float has, so ``moved`` leads back to within the size of the
        smallest cells: below 1e-9 of the box wherever ``contraction`` is below 0.5.

        Raises
        ------
        ModelError
            For places outside the box, or one that no cell is found to hold.
        """
        from porous.kernels.warp import MOST_DIGITS, unwarped_points

        given = _places(places)
        count = MOST_DIGITS if digits is None else digits
        result, found = unwarped_points(given, self.cells, count)
        if not found.all():
            lost = given[np.argmin(found)].tolist()
            raise ModelError(f"places: none is moved to {lost}, by Newton's method; move less far")
        return result

    def moved_samples(
        self, frame: Frame, box: Box, pattern: Pattern, voxels: tuple[int, int]
    ) -> Floats:
        """Return h of the samples of some voxels of a frame, (n, 3), in edges of the box.

        Parameters
        ----------
        frame, pattern
            Which samples.
        box
            What h moves; samples outside have −1.
        voxels
            The first voxel and the one after the last, in C order.
        """
        from porous.kernels.warp import warped_samples

        lengths, spacing = np.array(box.lengths), np.array(frame.spacing)
        lower = (np.array(frame.origin) - np.array(box.lower)) / lengths
        lattice = frame.shape, frame.start, lower, spacing / lengths
        lines = pattern.rows, pattern.depths
        return warped_samples(voxels, lattice, lines, self.cells, self._digits(frame, box))

    def sampling_error(self, frame: Frame, box: Box) -> float:
        """Return how far ``moved_samples`` may be from h of the samples themselves, in length.

        What is evaluated of the digits w of x lies in g_w(box) = h(f_w(box)), so it is h of a point
        of x's own dyadic cell: the error is that cell's diagonal, however much h stretches.
        """
        return math.hypot(*box.lengths) * 2.0 ** -self._digits(frame, box)

    def _digits(self, frame: Frame, box: Box) -> int:
        from porous.kernels.warp import MOST_DIGITS

        finest = max(np.array(box.lengths) / np.array(frame.spacing))
        return int(np.clip(math.ceil(math.log2(finest)) + FINER, FINER, MOST_DIGITS))


def homeomorphism(offsets: ArrayLike | Mapping[Place, ArrayLike]) -> Homeomorphism:
    """Return the fractal homeomorphism of the lattice whose points are moved by ``offsets``.

    Parameters
    ----------
    offsets
        How far lattice points are moved, in edges of the box: by (i, j, k) of 0, 1, 2, or all of
        them, shape (3, 3, 3, 3). Corners stay, points of edges slide along them, those of faces
        within them, the centre (1, 1, 1) is free; each by less than 0.5.

    Raises
    ------
    ModelError
        As ``Homeomorphism``, and for offsets that are no numbers or of no lattice point.
    """
    moves = _moves(offsets) if isinstance(offsets, Mapping) else _array(offsets, (3, 3, 3, 3))
    return Homeomorphism(_regular() + moves)


def _places(places: ArrayLike) -> Floats:
    given = np.asarray(places, np.float64).reshape(-1, 3)
    if not ((given >= 0) & (given <= 1)).all():
        raise ModelError("places: wanted all of them from 0 to 1, in edges of the box")
    return given


def contraction(cells: Floats) -> float:
    """Return Dobrushin's coefficient of all words of ``WORDS`` cells (8, 8, 3).

    Of each cell, the columns of its matrix are the trilinear weights of its corners; of a word,
    half the largest sum of absolute differences of two columns of the product. Below one, points of
    equal digits come together.
    """
    ones = np.stack([1 - cells, cells])
    x, y, z = (ones[..., axis] for axis in range(3))
    weights = np.einsum("abl,cbl,dbl->bacdl", x, y, z).reshape(8, 8, 8)
    words = weights
    for _ in range(WORDS - 1):
        words = np.einsum("wij,bjk->wbik", words, weights).reshape(-1, 8, 8)
    pairs = itertools.combinations(range(8), 2)
    apart = (np.abs(words[:, :, a] - words[:, :, b]).sum(axis=1).max() for a, b in pairs)
    return float(max(apart) / 2)


def _check_contracts(cells: Floats) -> None:
    found = contraction(cells)
    if not found < SLOWEST:
        raise ModelError(
            f"offsets: words of {WORDS} cells still keep {found:.3g} of a difference (Dobrushin's "
            f"coefficient); wanted less than {SLOWEST}: move points less far"
        )


def _check_slots(lattice: Floats) -> None:
    """Raise ``ModelError`` where a point is not strictly inside its edge, face or the box."""
    regular = _regular()
    free = regular == 0.5
    inside = (lattice > 0) & (lattice < 1)
    bad = np.argwhere(~np.where(free, inside, lattice == regular))
    if not len(bad):
        return
    *at, axis = bad[0].tolist()
    kind = ("corner", "edge", "face", "inside")[int(free[tuple(at)].sum())]
    by = float(lattice[*at, axis] - regular[*at, axis])
    wanted = "between −0.5 and 0.5" if free[*at, axis] else "0"
    slot = "is inside the box" if kind == "inside" else f"belongs to its {kind} of the box"
    raise ModelError(
        f"offsets: got {by:.6g} along {'xyz'[axis]} at {at}, which {slot}; wanted {wanted}"
    )


def _check_folds(cells: Floats) -> None:
    """Raise ``ModelError`` where the Jacobian of a cell is not positive everywhere."""
    for cell, found in zip(itertools.product((0, 1), repeat=3), jacobians(cells), strict=True):
        least, certain = least_jacobian(found * (-1) ** sum(cell) * 8)
        if not least > FLAT:
            verdict = "is folded over" if certain else "may be folded over"
            raise ModelError(
                f"offsets: cell {list(cell)} {verdict}: its volume is stretched by {least:.4g} "
                "somewhere, of a regular cell's by 1; wanted more than 0 everywhere: move its "
                "points less far"
            )


def _regular() -> Floats:
    return np.stack(np.meshgrid(*[[0.0, 0.5, 1.0]] * 3, indexing="ij"), axis=-1)


def _moves(offsets: Mapping[Place, ArrayLike]) -> Floats:
    result = np.zeros((3, 3, 3, 3))
    for at, by in offsets.items():
        if at not in itertools.product(range(3), repeat=3):
            raise ModelError(f"offsets: got {at!r}; {NO_SLOT}")
        result[at] = _array(by, (3,))
    return result


def _array(given: ArrayLike, shape: tuple[int, ...]) -> Floats:
    try:
        result = np.asarray(given, np.float64)
    except (TypeError, ValueError):
        raise ModelError(f"offsets: got {given!r:.80}; wanted numbers") from None
    if not np.isfinite(result).all():
        bad = result[~np.isfinite(result)][0]
        raise ModelError(f"offsets: got {bad}; wanted finite numbers, in edges of the box")
    if result.shape != shape:
        raise ModelError(f"offsets: got numbers of shape {result.shape}; wanted {shape}")
    return result
