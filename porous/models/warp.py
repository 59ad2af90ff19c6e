"""Fractal homeomorphisms of a box: any solid bent at every scale, its topology kept.

The box is cut into eight trilinear cells by a lattice of 3 × 3 × 3 points, and each cell again by
the image of the same lattice, mirrored so that neighbours agree on their whole common face. A point
is carried to the point of the same address: h(x) = lim g_w(y), w the digits of x in the regular
lattice. The warped body is { x : h(x) ∈ body }, so h is only ever evaluated forward.

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
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from pydantic import Field

from porous.errors import ModelError
from porous.models import bcifs, ifs
from porous.models.bcifs_section import BCIFSSection
from porous.models.hexa_volume import jacobian
from porous.models.ifs import IFSSection
from porous.models.model import HasDoubts, HasMembership, Model
from porous.models.sections import Digit, Section, Triple
from porous.values.value import Value, frozen

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import ArrayLike, NDArray

    from porous.values import Box, Frame, Pattern

    Floats = NDArray[np.float64]
    Flags = NDArray[np.bool_]

KIND = "warp"

WORDS = 3
"""The length of the words of cells that contraction is measured by."""

SLOWEST = 0.75
"""Words of ``WORDS`` cells that shrink less are refused: 52 digits would not pin h to a hundredth
of the box."""

FLAT = 1e-6
"""A Jacobian of less than this part of a regular cell's is none."""

HALVINGS = 8
"""How often a cell is cut to decide whether its Jacobian is positive."""

FINER = 12
"""Digits that are read beyond those that tell voxels apart."""

CHUNK = 1 << 19
"""Samples that are looked at in one step."""

NO_SLOT = "wanted a lattice point [i, j, k] of 0, 1 and 2"


@dataclass(frozen=True, eq=False)
class Warp(Value):
    """A model bent by a fractal homeomorphism of its domain: the x with h(x) in the model.

    The box that is sampled and that porosity refers to is the model's domain, which h maps onto
    itself. No porosity is known in closed form, and no smallest detail: h stretches without bound.

    Parameters
    ----------
    model
        Any model that can be asked point by point.
    lattice
        float64, shape (3, 3, 3, 3): the point of each (i, j, k), in edges of the domain. The
        regular one is (i, j, k) / 2.

    Raises
    ------
    ModelError
        Where the model answers on lattices alone; where a point leaves its slot, a cell folds over
        (names them) or the cells contract too slowly (gives the number).
    """

    model: Model
    lattice: NDArray[np.float64]

    def __post_init__(self) -> None:
        self._set("lattice", frozen(self.lattice, np.float64))
        if self.lattice.shape != (3, 3, 3, 3):
            raise ModelError(f"lattice: got shape {self.lattice.shape}; wanted (3, 3, 3, 3)")
        if not isinstance(self.model, HasMembership):
            raise ModelError(
                f"model: a {type(self.model).__name__} is known on lattices of voxels alone; "
                "wanted one that can be asked point by point, such as kind = "
                '"ifs" or the solid cells of kind = "bcifs"'
            )
        self.model.check_membership()
        _check_slots(self.lattice)
        _check_contracts(self.cells)
        _check_folds(self.cells)

    @property
    def unit(self) -> str:
        """Unit of length."""
        return self.model.unit

    @property
    def domain(self) -> Box:
        """The box that is bent within itself and sampled."""
        return self.model.domain

    @property
    def bulk(self) -> Box:
        """The same box."""
        return self.model.domain

    @property
    def is_cut(self) -> bool:
        """Whether the domain leaves out a part of the model."""
        return isinstance(self.model, HasDoubts) and self.model.is_cut

    @property
    def feature_size(self) -> None:
        """None: a fractal homeomorphism has no least stretch."""
        return None

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

    def sample(self, frame: Frame, pattern: Pattern) -> NDArray[np.uint64]:
        """Return the mask of each voxel: bit r·C + c where h of the pattern's point is solid.

        Each sample is asked for at its own place: to sample the model on a finer lattice instead
        would have an error without a useful bound, for h stretches without bound.
        """
        masks = np.zeros(frame.size, np.uint64)
        bits = np.uint64(1) << np.arange(pattern.points, dtype=np.uint64)
        step = max(1, CHUNK // pattern.points)
        for first in range(0, frame.size, step):
            last = min(first + step, frame.size)
            inside = self._inside(frame, pattern, first, last).reshape(-1, pattern.points)
            masks[first:last] = np.where(inside, bits, 0).sum(axis=1, dtype=np.uint64)
        return masks.reshape(frame.shape)

    def _inside(self, frame: Frame, pattern: Pattern, first: int, last: int) -> Flags:
        """Tell which samples of some voxels are solid."""
        from porous.kernels.warp import warped_samples

        lengths, spacing = np.array(self.domain.lengths), np.array(frame.spacing)
        lower = (np.array(frame.origin) - np.array(self.domain.lower)) / lengths
        lattice = frame.shape, frame.start, lower, spacing / lengths
        lines = pattern.rows, pattern.depths
        return self._holds(
            warped_samples((first, last), lattice, lines, self.cells, self._digits(frame))
        )

    def _holds(self, places: Floats) -> Flags:
        """Tell which places, in edges of the domain, are in the model; negative ones are not."""
        assert isinstance(self.model, HasMembership)
        result = np.zeros(len(places), np.bool_)
        inside = np.flatnonzero((places >= 0).all(axis=1))
        world = np.array(self.domain.lower) + places[inside] * np.array(self.domain.lengths)
        result[inside] = self.model.contains(world)
        return result

    def check_membership(self) -> None:
        """Do nothing: what is warped can be warped again."""

    def contains(self, points: Floats) -> Flags:
        """Tell which points (n, 3), in ``unit``, lie in the warped body."""
        places = (np.asarray(points) - self.domain.lower) / self.domain.lengths
        outside = ((places < 0) | (places > 1)).any(axis=1)
        images = self.moved(np.clip(places, 0, 1))
        images[outside] = -1
        return self._holds(images)

    def moved(self, places: ArrayLike, digits: int | None = None) -> Floats:
        """Return h of places (n, 3), both in edges of the domain, from 0 to 1.

        Parameters
        ----------
        places
            Where in the domain.
        digits
            How many digits of the addresses are read; all that a float has where not given. What
            is left is carried along, so the map is a homeomorphism for any number.
        """
        from porous.kernels.warp import MOST_DIGITS, warped_points

        given = np.asarray(places, np.float64).reshape(-1, 3)
        if not ((given >= 0) & (given <= 1)).all():
            raise ModelError("places: wanted all of them from 0 to 1, in edges of the domain")
        return warped_points(given, self.cells, MOST_DIGITS if digits is None else digits)

    def _digits(self, frame: Frame) -> int:
        from porous.kernels.warp import MOST_DIGITS

        finest = max(np.array(self.domain.lengths) / np.array(frame.spacing))
        return int(np.clip(math.ceil(math.log2(finest)) + FINER, FINER, MOST_DIGITS))

    def sampling_error(self, frame: Frame) -> float:
        """Return how far the boundary that is sampled may lie from the body's, in ``unit``.

        What is evaluated of the digits w of x lies in g_w(box) = h(f_w(box)), so it is h of a point
        of x's own dyadic cell: the error is that cell's diagonal, however much h stretches.
        """
        return math.hypot(*self.domain.lengths) * 2.0 ** -self._digits(frame)


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
    for cell, corners in zip(itertools.product((0, 1), repeat=3), cells, strict=True):
        least, certain = _least_jacobian(jacobian(corners.T) * (-1) ** sum(cell) * 8)
        if not least > FLAT:
            verdict = "is folded over" if certain else "may be folded over"
            raise ModelError(
                f"offsets: cell {list(cell)} {verdict}: its volume is stretched by {least:.4g} "
                "somewhere, of a regular cell's by 1; wanted more than 0 everywhere: move its "
                "points less far"
            )


def _least_jacobian(coefficients: Floats) -> tuple[float, bool]:
    """Return a bound on a polynomial of degree 2 per axis over the cube, and whether it is a value.

    The least Bernstein coefficient bounds it from below, those at corners are values; the cube is
    cut into eights until all coefficients are positive or a value is not.
    """
    convert = np.array([[1, 0, 0], [1, 0.5, 0], [1, 1, 1]])
    boxes = np.einsum("ai,bj,ck,ijk->abc", convert, convert, convert, coefficients)[None]
    for _ in range(HALVINGS):
        value = float(boxes[:, ::2, ::2, ::2].min())
        if value <= FLAT:
            return value, True
        boxes = boxes[boxes.min(axis=(1, 2, 3)) <= FLAT]
        if not len(boxes):
            return value, True
        boxes = _halved(boxes)
    return float(boxes.min()), False


def _halved(boxes: Floats) -> Floats:
    """Return the Bernstein coefficients (8·n, 3, 3, 3) of the eighths of boxes (de Casteljau)."""
    low = np.array([[1, 0, 0], [0.5, 0.5, 0], [0.25, 0.5, 0.25]])
    half = np.stack([low, low[::-1, ::-1]])
    parts = np.einsum("xai,ybj,zck,nijk->nxyzabc", half, half, half, boxes, optimize=True)
    return np.asarray(parts.reshape(-1, 3, 3, 3))


def _regular() -> Floats:
    return np.stack(np.meshgrid(*[[0.0, 0.5, 1.0]] * 3, indexing="ij"), axis=-1)


Place = tuple[int, int, int]


def warp(model: Model, offsets: ArrayLike | Mapping[Place, ArrayLike]) -> Warp:
    """Return a model bent by a fractal homeomorphism of its domain; its topology is kept.

    Parameters
    ----------
    model
        What is bent: any model that can be asked point by point.
    offsets
        How far lattice points are moved, in edges of the domain: by (i, j, k) of 0, 1, 2, or all of
        them, shape (3, 3, 3, 3). Corners stay, points of edges slide along them, those of faces
        within them, the centre (1, 1, 1) is free; each by less than 0.5.

    Raises
    ------
    ModelError
        As ``Warp``.
    """
    moves = _moves(offsets) if isinstance(offsets, Mapping) else _array(offsets, (3, 3, 3, 3))
    return Warp(model, _regular() + moves)


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
    if result.shape != shape or not np.isfinite(result).all():
        raise ModelError(f"offsets: got shape {result.shape}; wanted {shape} finite numbers")
    return result


class OffsetSection(Section):
    """How far one point of the lattice is moved."""

    at: Digit = Field(description="[i, j, k] of 0, 1 and 2: a point of the lattice")
    by: Triple = Field(description="three numbers, in edges of the domain")


Warped = Annotated[IFSSection | BCIFSSection, Field(discriminator="kind")]


class WarpSection(Section):
    """The ``[model]`` table of a fractal homeomorphism of another model."""

    kind: Literal["warp"] = Field(default="warp", description='"warp"')
    model: Warped = Field(description='a table [model.model] of kind "ifs" or "bcifs"')
    offsets: Annotated[tuple[OffsetSection, ...], Field(strict=False)] = Field(
        default=(),
        description="tables { at = [i, j, k], by = [x, y, z] }: lattice points that are moved",
    )


def build(section: WarpSection, folder: Path) -> Warp:
    """Return the model of a recipe's section; files lie relative to ``folder``.

    Raises
    ------
    ModelError
        As ``Warp``, or where the model within cannot be.
    """
    moves: dict[Place, Triple] = {}
    for each in section.offsets:
        if each.at in moves:
            raise ModelError(f"offsets: {list(each.at)} is there twice")
        moves[each.at] = each.by
    inner = section.model
    built = (
        ifs.build(inner, folder) if isinstance(inner, IFSSection) else bcifs.build(inner, folder)
    )
    if not isinstance(built, Model):
        raise ModelError("model: wanted a body that can be asked point by point")
    return warp(built, moves)
