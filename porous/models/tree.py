"""Branching trees that bear a face: a wide top for the load, one thin trunk for the heat.

A tree is a controlled system with terminal states. Its trunks are drawn once, each with the radius
of the level that it was born at; the last subtrees are drawn as struts to their part of the top.
The matrices are those of cells with boundaries (``models.tree_cells``).
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from pydantic import BeforeValidator, Field

from porous.errors import ModelError
from porous.models.automaton import check_apart, numbers
from porous.models.cifs import CIFS, cifs
from porous.models.drawing import Drawing, sticks
from porous.models.sections import BoxSection, Section, Triple
from porous.models.solve import solve
from porous.models.tree_cells import APEX, TRUNK, tree_cells
from porous.values import Box

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from numpy.typing import ArrayLike, NDArray

    Floats = NDArray[np.float64]

KIND = "tree"

DEEPEST = 32
"""The deepest level of a tree: 2^64 struts."""

THINNING = {"area": 1.0, "murray": 2 / 3}
"""Exponents e of radii r·N^−e of N × N branches: those that keep Σr², and those that keep Σr³."""

LEVEL = 1e-12
"""Differences that are none, as a part of a tree's size."""

Law = Literal["area", "murray"]


def _listed(value: object) -> object:
    return (value,) if isinstance(value, int | float) else value


class TreeSection(Section):
    """The ``[model]`` table of a branching tree."""

    kind: Literal["tree"] = Field(description='"tree"')
    branches: Annotated[
        tuple[Annotated[int, Field(ge=2)], ...],
        BeforeValidator(_listed),
        Field(strict=False, min_length=1),
    ] = Field(
        description="N of the N × N branches of a level, from 2; or a list with one for each "
        "level, of which the last holds below"
    )
    heights: Annotated[
        tuple[Annotated[float, Field(gt=0, lt=1)], ...],
        BeforeValidator(_listed),
        Field(strict=False, min_length=1),
    ] = Field(
        description="how far up it branches, in parts of the way from the root to the top, above "
        "0 and below 1; or a list with one for each level, of which the last holds below"
    )
    level: int = Field(default=3, ge=0, le=DEEPEST, description=f"a whole number, 0 … {DEEPEST}")
    radius: float = Field(gt=0, description="of the first trunk, above zero, in unit")
    law: Law = Field(
        default="area",
        description='"area": the struts of all levels have the same section in all, r/N; '
        '"murray": the same Σr³, r·N^(−2/3)',
    )
    minimum_radius: float = Field(
        default=0.0, ge=0, description="refuse thinner struts; a length, zero or more, in unit"
    )
    plate: float | None = Field(
        default=None, gt=0, description="thickness of a plate on the top, above zero, in unit"
    )
    controls: Annotated[tuple[Triple, ...], Field(strict=False)] | None = Field(
        default=None,
        description="five points [x, y, z]: the top's corners, (0, 0), (0, 1), (1, 0), (1, 1), "
        "and the root",
    )
    size: float | None = Field(
        default=None,
        gt=0,
        description="the length of the longest edge of the domain, or of the controls' box where "
        "none is given, above zero, in unit; controls are in unit if left out",
    )
    unit: Literal["nm", "um", "mm", "cm", "m", "in"] = Field(
        default="mm", description="nm, um, mm, cm, m or in"
    )
    offset: float = Field(default=0.0, ge=0, description="a length, zero or more, in unit")
    domain: BoxSection | None = Field(
        default=None,
        description="{ lower = [x, y, z], upper = [x, y, z] } as controls, before size scales "
        "them; if left out, all of the tree from the root's plane to the top",
    )
    bulk: BoxSection | None = Field(
        default=None,
        description="{ lower = [x, y, z], upper = [x, y, z] } as controls, before size scales "
        "them; the domain if left out",
    )


def build(section: TreeSection, _: Path) -> CIFS:
    """Return the model of a recipe's section; it reads no files.

    Raises
    ------
    ModelError
        Where there is no such tree, as ``tree``.
    """
    return tree(
        domain=section.domain.box() if section.domain else None,
        bulk=section.bulk.box() if section.bulk else None,
        **section.model_dump(exclude={"kind", "domain", "bulk"}),
    )


def tree(
    branches: Sequence[int],
    heights: Sequence[float],
    *,
    radius: float,
    level: int = 3,
    law: Law = "area",
    minimum_radius: float = 0.0,
    plate: float | None = None,
    controls: ArrayLike | None = None,
    size: float | None = None,
    unit: str = "mm",
    offset: float = 0.0,
    domain: Box | None = None,
    bulk: Box | None = None,
) -> CIFS:
    """Return the model of a tree: ``level`` branchings, and struts from the last to the top.

    Parameters
    ----------
    branches
        N of the N × N subtrees of each level; the last holds below. (3, 2) branches threefold
        along each axis first, then twofold.
    heights
        Where each level branches, in parts of the way from its root to the top; the last holds
        below. From the first root that is 1 − ∏(1 − h).
    radius
        Of the first trunk, in ``unit``.
    level
        How often it branches.
    law
        ``"area"``: r/N, so that all levels have the same section (da Vinci); ``"murray"``:
        r·N^(−2/3), so that all levels have the same Σr³ (Murray 1926).
    minimum_radius
        The thinnest that can be printed, in ``unit``; with ``offset`` no strut may be thinner.
    plate
        Thickness of a plate on the top; none where not given.
    controls
        The top's corners (0, 0), (0, 1), (1, 0), (1, 1) and the root, (5, 3); those of the unit
        cube's top and the middle of its bottom where not given.
    size, unit, offset
        As of ``cifs``.
    domain, bulk
        Boxes in the units of ``controls``, before ``size`` scales them. Where no domain is given,
        it holds the tree of any level; along an axis on which the top is level it begins in the
        root's plane and ends in the top's, or in the plate's outer side, so that the body is cut
        flat at both. The bulk is the domain where not given.

    Raises
    ------
    ModelError
        For branches, heights or lengths that cannot be; for struts thinner than
        ``minimum_radius`` (says which level, what was got, and what would do); for a trunk wider
        or a plate thicker than the tree has room for; as ``cifs``.
    """
    if not 0 <= level <= DEEPEST:
        raise ModelError(f"level: got {level}; wanted 0 … {DEEPEST}")
    if controls is not None:
        check_apart(numbers(controls, "controls").T, "controls")
    automaton = solve(tree_cells(branches, heights)).automaton()
    radii = strut_radii(radius, branches, law)
    _check_radius(radii, level, law, minimum_radius, offset)
    drawn = {state.name: _leaf(radii, plate) for state in automaton.states if state.name != TRUNK}
    # The trunk of a cell is born a level later than the cell.
    drawn[TRUNK] = sticks(2, beams=[(0, 1)], radius=(radii[0], *radii))
    model = cifs(
        automaton,
        drawn,
        level=level,
        controls=controls,
        size=size,
        unit=unit,
        offset=offset,
        domain=domain,
        bulk=bulk,
    )
    placed = model.automaton.states[model.automaton.start].controls
    _check_room(placed, heights[0], radius, plate or 0.0)
    if domain is not None:
        return model
    ends = list(_ends(placed, branches, heights, radii))
    box = _cut(ends, placed, (plate or 0.0) / 2, offset)
    return replace(model, domain=box, bulk=box if bulk is None else model.bulk)


def _ends(
    controls: Floats, branches: Sequence[int], heights: Sequence[float], radii: Sequence[float]
) -> Iterator[tuple[Floats, Floats]]:
    """Yield bounds on the struts of each level, drawn to their nodes and to their tops: two (3,).

    Middles of the tops of a level are those of the parts of a bilinear face, which lie between
    those of the parts in its corners.
    """
    top, count = controls[:, :APEX], 1
    lower = upper = controls[:, APEX]
    for level, radius in enumerate(radii):
        share = heights[min(level, len(heights) - 1)]
        outer = [
            top @ np.outer((1 - u, u), (1 - v, v)).ravel()
            for u, v in product((0.5 / count, 1 - 0.5 / count), repeat=2)
        ]
        low, high = np.min(outer, axis=0), np.max(outer, axis=0)
        yield np.minimum(lower, low) - radius, np.maximum(upper, high) + radius
        lower, upper = share * low + (1 - share) * lower, share * high + (1 - share) * upper
        count *= branches[min(level, len(branches) - 1)]


def _cut(
    struts: Sequence[tuple[Floats, Floats]], controls: Floats, plate: float, offset: float
) -> Box:
    """Return the box of struts, and of a top of half a thickness, cut off flat at both ends."""
    top, root = controls[:, :APEX], controls[:, APEX]
    least, most = top.min(axis=1), top.max(axis=1)
    lower = np.minimum(np.min([low for low, _ in struts], axis=0), least - plate) - offset
    upper = np.maximum(np.max([high for _, high in struts], axis=0), most + plate) + offset
    thick = plate + offset if plate else 0.0
    level = np.ptp(top, axis=1) <= LEVEL * np.ptp(controls)
    for axis in np.flatnonzero(level & (np.abs(least - root) > LEVEL * np.ptp(controls))):
        out = np.sign(least[axis] - root[axis])
        lower[axis], upper[axis] = sorted((root[axis], least[axis] + out * thick))
    return Box(tuple(lower), tuple(upper))


def _check_room(controls: Floats, height: float, radius: float, plate: float) -> None:
    """Raise ``ModelError`` for a trunk wider than it is long, a plate thicker than the tree."""
    whole = float(np.linalg.norm(controls[:, :APEX].mean(axis=1) - controls[:, APEX]))
    if radius > height * whole:
        raise ModelError(
            f"radius: got {radius:g}, of a first trunk {height * whole:.6g} long; wanted that at "
            "most"
        )
    if plate >= whole:
        raise ModelError(
            f"plate: got {plate:g}, on a tree {whole:.6g} from the root to the top; wanted less"
        )


def strut_radii(radius: float, branches: Sequence[int], law: Law) -> tuple[float, ...]:
    """Return the radii of the struts of the levels 0 … ``DEEPEST``, in the first one's unit.

    Raises ``ModelError`` for a law that is not there, or a radius that is not above zero.
    """
    if law not in THINNING:
        raise ModelError(f"law: got {law!r}; wanted {' or '.join(THINNING)}")
    if not 0 < radius < math.inf:
        raise ModelError(f"radius: got {radius}; wanted a length above zero")
    radii = [float(radius)]
    for level in range(DEEPEST):
        radii.append(radii[-1] * branches[min(level, len(branches) - 1)] ** -THINNING[law])
    return tuple(radii)


def _check_radius(
    radii: Sequence[float], level: int, law: Law, minimum: float, offset: float
) -> None:
    if not 0 <= minimum < math.inf:
        raise ModelError(f"minimum_radius: got {minimum}; wanted zero or a length")
    finest = radii[level] + offset
    if finest >= minimum * (1 - 1e-12):
        return
    wanted = (minimum - offset) * radii[0] / radii[level]
    enough = [k for k, r in enumerate(radii[:level]) if r + offset >= minimum * (1 - 1e-12)]
    fewer = f", or level = {enough[-1]}" if enough else ""
    raise ModelError(
        f"radius: got {radii[0]:g}, by the law {law!r} struts of radius {finest:.4g} after "
        f"{level} branchings; minimum_radius is {minimum:g}. Wanted radius = {wanted:.4g} or "
        f"more{fewer}"
    )


def _leaf(radii: Sequence[float], plate: float | None) -> Drawing:
    """Return the drawing of a subtree that branches no more: a strut to the middle of its top."""
    mix = np.column_stack([np.eye(APEX + 1), [*[1 / APEX] * APEX, 0]])
    middle = APEX + 1
    loop = (0, 1, 3, 2)
    fan = [(a, b, middle) for a, b in zip(loop, (*loop[1:], loop[0]), strict=True)]
    return Drawing(
        mix,
        beams=np.array([(APEX, middle)]),
        plates=np.array(fan if plate is not None else np.zeros((0, 3)), np.int64),
        radius=tuple(radii),
        thickness=() if plate is None else (plate,),
    )
