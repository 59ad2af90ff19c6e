"""Surface by line probes: random lines through the model itself, which no voxel comes between."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, Protocol, runtime_checkable

import numpy as np

from porous.errors import ModelError
from porous.measures._sample import Family, Findings
from porous.models.model import HasBulk, HasCells, HasLines
from porous.values import Measure, Measures

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from porous.measures._sample import Sample
    from porous.models.lines import LineBody, Stretches
    from porous.models.model import Model
    from porous.values import Box

    Floats = NDArray[np.float64]
    Axes = tuple[bool, bool, bool]

METHOD = "line probes"

LINES = 20_000
"""Lines that a survey sends: the standard error of an area is below a hundredth then."""

ROUNDING = 1e-9
"""Ends lie where they are found within this part of the box; no share is told more closely."""

FEWEST = 2
"""Lines of which a spread can be told."""


@runtime_checkable
class _HasBulkLines(Protocol):
    """A model whose bulk is no box, but may be known to lines."""

    def bulk_line_body(self) -> LineBody | None: ...


@dataclass(frozen=True)
class _Seen:
    """What lines through a box saw, each float64 (n,): lengths and numbers of ends.

    ``length`` is that of each line in a body of known ``volume``, the box or the bulk in it;
    ``inside`` are the ends in the box and on its periodic sides, ``capped`` those on other sides.
    """

    stretches: Stretches
    length: Floats
    volume: float
    inside: Floats
    capped: Floats


class _Ratio(NamedTuple):
    value: float
    error: float


def line_probes(
    model: Model,
    *,
    lines: int = LINES,
    seed: int = 0,
    box: Box | None = None,
    periodic: tuple[bool, bool, bool] = (False, False, False),
    progress: Callable[[int, int], None] | None = None,
) -> Measures:
    """Return what straight lines through a model tell of its surface; no voxels are involved.

    Lines are isotropic and uniformly random: all lines that meet the box are equally likely, for
    they enter it at places spread evenly over its sides, at directions by Lambert's cosine law.
    Where each is in the solid follows from the pieces that the model is made of, up to rounding;
    pieces that overlap or touch are one. The area of a surface in a volume is twice the number of
    crossings per length of line, S_V = 2 P_L (S. A. Saltykov; E. E. Underwood, Quantitative
    Stereology, 1970), whatever its shape.

    Parameters
    ----------
    model
        With pieces that are known (``models.model.HasLines``): levels of iterated function systems
        of any kind, of cells with boundaries, of what is swept or grown.
    lines
        How many.
    seed
        Of the lines.
    box
        What lines are sent through, the model's domain where not given.
    periodic
        Axes along which the body goes on in copies of the box: there its sides are surface only
        where solid meets void.
    progress
        Called as ``progress(done, lines)``; raising in it cancels.

    Returns
    -------
    Measures
        ``porosity`` (not where the bulk is no box and the body no cells), ``surface_area`` and
        ``specific_surface_area`` of the whole boundary, ``interface_area`` and ``pore_chord_mean``
        without what lies on the box's sides (not where the bulk is no box), ``wall_chord_mean``.
        The uncertainty is the standard error of a ratio of sums over independent lines; there is
        no other error but rounding. Where no line met what is counted, it is what one of them
        would have made of it.

    Raises
    ------
    ModelError
        Where the model is known by its voxels alone, or for fewer than two lines.
    """
    body = _body(model)
    if body is None:
        raise ModelError(
            f"line_probes: got a {type(model).__name__}, of which only voxels are known, or a "
            "limit; wanted a level of cells, pieces or beams"
        )
    if lines != int(lines) or lines < FEWEST:
        raise ModelError(f"lines: got {lines!r}; wanted a whole number, at least {FEWEST}")
    sent = random_lines(box or model.domain, int(lines), seed)
    return _told(body, model, sent, box or model.domain, periodic, progress)


def _body(model: Model | None) -> LineBody | None:
    return model.line_body() if isinstance(model, HasLines) else None


def _told(
    body: LineBody,
    model: Model,
    lines: Floats,
    box: Box,
    periodic: Axes,
    progress: Callable[[int, int], None] | None,
) -> Measures:
    return Measures(tuple(_rows(_sent(body, model, lines, box, periodic, progress), model)))


def random_lines(box: Box, count: int, seed: int) -> Floats:
    """Return isotropic uniformly random lines through a box, (count, 6): where they enter, whither.

    Lines that meet a convex body have the density dA·cosθ dω over the places where they enter and
    the directions there (L. A. Santaló, Integral Geometry and Geometric Probability, 1976).
    """
    random = np.random.default_rng(seed)
    x, y, z = box.lengths
    areas = np.array([y * z, x * z, x * y])
    axis, upper = random.choice(3, count, p=areas / areas.sum()), random.integers(0, 2, count)
    places, cosine = random.random((count, 3)), np.sqrt(random.random(count))
    turn, sine = 2 * np.pi * random.random(count), np.sqrt(1 - cosine**2)
    line, along = np.arange(count), np.empty((count, 3))
    places[line, axis] = upper
    along[line, axis] = np.where(upper, -cosine, cosine)
    along[line, (axis + 1) % 3] = sine * np.cos(turn)
    along[line, (axis + 2) % 3] = sine * np.sin(turn)
    lower, top = np.array(box.lower), np.array(box.upper)
    return np.column_stack([np.where(places == 1, top, lower + places * box.lengths), along])


def _sent(
    body: LineBody,
    model: Model,
    lines: Floats,
    box: Box,
    periodic: Axes,
    progress: Callable[[int, int], None] | None,
) -> _Seen:
    seen = body.seen(lines, box, model.bulk, progress)
    inside, capped = seen.crossings.copy(), np.zeros(len(lines))
    enters, leaves = _sides(lines, box)
    wraps = np.array(periodic)
    capped += np.where(wraps[enters], 0, seen.from_solid) + np.where(
        wraps[leaves], 0, seen.to_solid
    )
    on = np.flatnonzero(wraps[leaves])
    if len(on):
        # A seam is met by lines that leave through either of its sides: each counts once.
        further = lines[on].copy()
        axis = leaves[on], np.arange(len(on))
        forward = np.sign(further[axis[1], 3 + axis[0]])
        further[axis[1], axis[0]] -= forward * np.array(box.lengths)[axis[0]]
        beyond = body.seen(further, box, model.bulk).from_solid
        inside[on] += seen.to_solid[on] != beyond
    return _Seen(seen, *_known(lines, seen, model, box), inside, capped)


def _known(lines: Floats, seen: Stretches, model: Model, box: Box) -> tuple[Floats, float]:
    """Return how long lines are in a body of known volume: a bulk that is no box, or the box.

    What is counted varies from line to line as its length in the bulk does, more than in the box.
    """
    own = isinstance(model, _HasBulkLines) and _has_own_bulk(model)
    bulk = model.bulk_line_body() if own else None  # type: ignore[attr-defined]
    if bulk is None or not box.contains(model.bulk, tolerance=1e-9 * max(box.lengths)):
        return seen.length, box.volume
    assert isinstance(model, HasBulk)
    return bulk.seen(lines, box, box).solid, model.bulk_volume


def _sides(lines: Floats, box: Box) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return across which axis lines enter a box and leave it."""
    places, along = lines[:, :3], lines[:, 3:]
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = np.stack([(np.array(c) - places) / along for c in (box.lower, box.upper)])
    still = along == 0
    near = np.where(still, -np.inf, ends.min(axis=0))
    far = np.where(still, np.inf, ends.max(axis=0))
    return near.argmax(axis=1), far.argmin(axis=1)


def _has_own_bulk(model: Model) -> bool:
    """Tell whether a model's bulk is no box."""
    box = model.bulk.volume
    return isinstance(model, HasBulk) and not math.isclose(model.bulk_volume, box, rel_tol=1e-9)


def _rows(seen: _Seen, model: Model) -> Iterator[Measure]:
    s, unit, total = seen.stretches, model.unit, float(seen.length.sum())
    own, ends = _has_own_bulk(model), seen.inside + seen.capped
    bulk = model.bulk_volume if isinstance(model, HasBulk) else model.bulk.volume
    if own and isinstance(model, HasCells):
        part = seen.volume / bulk
        yield _pores(_ratio(s.solid * part, seen.length), 0.0)
    elif not own and s.bulk.any():
        yield _pores(_ratio(s.bulk_solid, s.bulk), 1 / len(ends))
    area, least = _ratio(ends, seen.length), 1 / total
    yield _row("surface_area", area, 2 * seen.volume, f"{unit}²", least)
    yield _row("specific_surface_area", area, 2 * seen.volume / bulk, f"1/{unit}", least)
    if not own:
        yield _row(
            "interface_area", _ratio(seen.inside, seen.length), 2 * seen.volume, f"{unit}²", least
        )
        if seen.inside.any():
            yield _row("pore_chord_mean", _ratio(s.length - s.solid, seen.inside), 2.0, unit, 0.0)
    if ends.any():
        yield _row("wall_chord_mean", _ratio(s.solid, ends), 2.0, unit, 0.0)


def _ratio(over: Floats, under: Floats) -> _Ratio:
    """Return a ratio of sums over lines, and its standard error (W. G. Cochran 1977, chapter 6)."""
    n, total = len(over), float(under.sum())
    value = float(over.sum()) / total
    left = over - value * under
    return _Ratio(value, math.sqrt(n / (n - 1) * float((left**2).sum())) / total)


def _row(name: str, ratio: _Ratio, factor: float, unit: str, least: float) -> Measure:
    """Return a row; where no line met anything, it is as uncertain as ``least``."""
    error = max(ratio.error or (least if not ratio.value else 0.0), ROUNDING * ratio.value)
    return Measure(name, factor * ratio.value, unit, METHOD, factor * error, "standard", "model")


def _pores(solid: _Ratio, least: float) -> Measure:
    """Return the porosity that a share of solid leaves."""
    value = 1 - solid.value
    error = max(solid.error or least, ROUNDING)
    return Measure(
        "porosity", value if value > ROUNDING else 0.0, "1", METHOD, error, "standard", "model"
    )


def _take(sample: Sample) -> Findings:
    model, frame = sample.model, sample.frame
    body = _body(model)
    if model is None or body is None:
        return Findings()
    found = _told(
        body,
        model,
        random_lines(frame.box, LINES, sample.how.seed),
        frame.box,
        frame.periodic,
        lambda done, of: sample.tell(FAMILY.name, done / of),
    )
    return Findings(
        found, notes=(f"line probes: {LINES} random lines went through the model itself",)
    )


FAMILY = Family("probes", "Surface by line probes", 10, _take)
