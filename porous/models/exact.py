"""The measures of an iterated function system that are known in closed form."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import TYPE_CHECKING

from porous.models.closed_forms import closed_forms
from porous.values import Measure

if TYPE_CHECKING:
    from porous.models.ifs import IFS
    from porous.models.oracle import Axes, Prefractal
    from porous.values import Box

METHOD = "closed form"


def exact_measures(model: IFS, periodic: Axes) -> tuple[Measure, ...]:
    """Return what is known in closed form of a model in vacuum or closed on itself.

    Of digit sets: volume, porosity, area, Euler numbers in both conventions, and pieces and genus
    where they follow level by level; of other systems what ``closed_forms`` knows, in vacuum.
    ``surface_area`` is that of a body that ends at the domain along axes in vacuum and goes on
    along periodic ones; ``interface_area`` leaves out what lies on the domain's sides. Nothing is
    said of bodies that are grown by an offset or by balls, of cut sets and attractors, nor where
    the recipe's own domain cuts the body or leaves a gap to its periodic copies.
    """
    box = model.primitive.box
    whole = _holds(model.domain, box)
    if model.plain_digits is not None:
        tiles = whole and _holds(box, model.domain)
        known = tiles if any(periodic) else whole
        return _of_digits(model, periodic, tiles=tiles) if known else ()
    plain = not model.offset and (model.contacts != "fuse" or not len(model.balls))
    if not isinstance(model.level, int) or not plain or not whole or any(periodic):
        return ()
    found = closed_forms(model.automaton, model.primitive, model.level)
    if found is None:
        return ()
    rows = _volumes(model, found.volume)
    if found.area is not None:
        rows += _areas(model, found.area)
    if found.pieces is not None:
        rows += _numbers(components=found.pieces, euler_number=found.pieces, genus=0)
    return tuple(rows)


def _of_digits(model: IFS, periodic: Axes, *, tiles: bool) -> tuple[Measure, ...]:
    from porous.models.oracle import Prefractal

    assert model.digits is not None
    assert isinstance(model.level, int)
    body = Prefractal(model.digits, model.level, periodic)
    side = model.primitive.box.lengths[0]
    voxels = model.digits.divisions**model.level
    rows = _volumes(model, _ratio(body.cells, voxels**3) * side**3)
    rows += _areas(model, _ratio(body.faces, voxels**2) * side**2)
    if tiles:
        inner = _ratio(body.faces - body.border_faces, voxels**2) * side**2
        rows.append(_exact("interface_area", inner, f"{model.unit}²"))
    return (*rows, *_topology(body))


def _holds(outer: Box, inner: Box) -> bool:
    return outer.contains(inner, tolerance=1e-9 * max(inner.lengths))


def _topology(body: Prefractal) -> list[Measure]:
    return _numbers(
        components=body.components(6),
        euler_number=body.count("euler_number"),
        genus=body.genus(6),
        components_26=body.components(26),
        euler_number_26=body.count("euler_number_26"),
        genus_26=body.genus(26),
    )


def _ratio(a: int, b: int) -> float:
    # Whole numbers of a deep level are no floats; their ratio is one.
    return _real(Fraction(a, b))


def _volumes(model: IFS, volume: float) -> list[Measure]:
    rows = [_exact("volume", volume, f"{model.unit}³")]
    if _holds(model.bulk, model.primitive.box):
        density = volume / model.bulk.volume
        rows.append(_exact("porosity", 1 - density, "1"))
        rows.append(_exact("relative_density", density, "1"))
    return rows


def _areas(model: IFS, area: float) -> list[Measure]:
    rows = [_exact("surface_area", area, f"{model.unit}²")]
    if _holds(model.bulk, model.primitive.box):
        per_volume = area / model.bulk.volume
        rows.append(_exact("specific_surface_area", per_volume, f"1/{model.unit}"))
    return rows


def _numbers(**values: int | None) -> list[Measure]:
    return [_exact(name, _real(value), "1") for name, value in values.items() if value is not None]


def _real(value: int | Fraction) -> float:
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf


def _exact(name: str, value: float, unit: str) -> Measure:
    return Measure(name, value, unit, METHOD, 0.0, "exact", "model")
