"""Lines, patches and blocks that are products of curves: B-splines by name, or any of one's own."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import ModelError, nearest
from porous.memory import check_memory
from porous.models.builders._builder import Builder
from porous.models.builders._curves import uniform
from porous.models.builders._tensor import BYTES_PER_CHILD, pieces, tensor

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from porous.models.brep import BRep
    from porous.models.builders._builder import Options
    from porous.models.builders._curves import Curve

    Ints = NDArray[np.int64]

CELLS = {"biquadratic": (2, 2), "bicubic": (3, 2), "spline-2": (2, 3), "spline-3": (3, 3)}
"""Degree and number of axes of the cells of uniform B-splines."""

OWN = "tensor"
"""The cell of one's own curves."""


def _build(options: Options) -> BRep:
    """Return the cell of one, two or three curves, with the pieces that are kept; all if not told.

    Corners of the reference cell are the unit cube's.

    Raises
    ------
    ModelError
        For curves where the cell has its own, or for none where it has not; for digits of other
        divisions than the curves', children that are not there, another number of controls.
    MemoryLimitError
        For more divisions than fit; names them.
    """
    curves = _own(options) if options.cell == OWN else _uniform(options)
    sizes = [curve.arcs[0].size for curve in curves]
    if options.controls not in (None, int(np.prod(sizes))):
        raise ModelError(
            f"controls: got {options.controls} for a {options.cell} cell; wanted "
            f"{' × '.join(map(str, sizes))} = {np.prod(sizes)}"
        )
    if options.digits and options.keep is not None:
        raise ModelError("got both of digits and keep; wanted one")
    return tensor(curves, _of_names(options, curves) or _of_digits(options, curves))


def _own(options: Options) -> tuple[Curve, ...]:
    if not options.curves:
        raise ModelError("curves: got none; wanted one to three, one for each axis")
    return options.curves


def _uniform(options: Options) -> tuple[Curve, ...]:
    """Return the uniform B-splines of a named cell, in halves where no digits say otherwise."""
    if options.curves:
        raise ModelError(f'curves: a {options.cell} cell has its own; wanted cell = "{OWN}"')
    degree, dimension = CELLS[options.cell]
    if options.digits and dimension < 3:
        raise ModelError(f"digits: a {options.cell} cell takes none; wanted keep")
    for digits in options.digits:
        needed = 3 * float(digits.divisions) ** 2 * (8 * (degree + 1) ** 6 + 26 * BYTES_PER_CHILD)
        what = f"a cell of {digits.divisions}³ sub-cells"
        check_memory(needed, what, "Divide less, on more levels.")
    divisions = [digits.divisions for digits in options.digits]
    return (uniform(degree, divisions or 2),) * dimension


def _of_digits(options: Options, curves: Sequence[Curve]) -> list[Ints] | None:
    """Return the digits of each level, where there are any."""
    for level, digits in enumerate(options.digits):
        found = pieces(curves, level)
        if len(found) < 3 or set(found) != {digits.divisions}:
            raise ModelError(
                f"digits[{level}]: got divisions = {digits.divisions} for curves of "
                f"{' × '.join(map(str, found))} pieces; wanted three curves of as many pieces"
            )
    return [digits.keep for digits in options.digits] or None


def _of_names(options: Options, curves: Sequence[Curve]) -> list[Ints] | None:
    """Return the digits whose children are named, where any are."""
    if options.keep is None:
        return None
    found = pieces(curves, 0)
    between = "." if max(found) > 10 else ""
    known = {between.join(map(str, digit)): digit for digit in product(*map(range, found))}
    keep = options.keeping("cell")
    for state in keep:
        if state != "cell":
            raise ModelError(f"keep: got children of {state!r}; wanted those of cell")
    names = dict.fromkeys(keep.get("cell", tuple(known)))
    for name in names:
        if name not in known:
            raise ModelError(f"keep: got {name!r} for cell{nearest(name, known)}")
    return [np.array([known[name] for name in names], np.int64)]


CELL = Builder((*CELLS, OWN), _build, ("curves", "digits", "keep", "controls"))
