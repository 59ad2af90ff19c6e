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
    ``surface_area`` is the whole surface in vacuum; along periodic axes the body goes on, so only
    the interface is left, and both names give it. Nothing is said of bodies that are grown by an
    offset or by balls, of cut sets and attractors.
    """
    if model.plain_digits is not None:
        return _of_digits(model, periodic)
    plain = not model.offset and (model.contacts != "fuse" or not len(model.balls))
    if not isinstance(model.level, int) or not plain or any(periodic):
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


def _of_digits(model: IFS, periodic: Axes) -> tuple[Measure, ...]:
    from porous.models.oracle import Prefractal

    assert model.digits is not None
    assert isinstance(model.level, int)
    body = Prefractal(model.digits, model.level, periodic)
    side = model.primitive.box.lengths[0]
    voxels = model.digits.divisions**model.level
    rows = _volumes(model, _ratio(body.cells, voxels**3) * side**3)
    rows += _areas(model, _ratio(body.faces, voxels**2) * side**2)
    return (*rows, *_topology(body))


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
    return float(Fraction(a, b))


def _volumes(model: IFS, volume: float) -> list[Measure]:
    rows = [_exact("volume", volume, f"{model.unit}³")]
    if model.bulk.contains(_body_box(model), tolerance=1e-9 * max(model.bulk.lengths)):
        density = volume / model.bulk.volume
        rows.append(_exact("porosity", 1 - density, "1"))
        rows.append(_exact("relative_density", density, "1"))
    return rows


def _areas(model: IFS, area: float) -> list[Measure]:
    rows = [
        _exact("surface_area", area, f"{model.unit}²"),
        _exact("interface_area", area, f"{model.unit}²"),
    ]
    if model.bulk.contains(_body_box(model), tolerance=1e-9 * max(model.bulk.lengths)):
        per_volume = area / model.bulk.volume
        rows.append(_exact("specific_surface_area", per_volume, f"1/{model.unit}"))
    return rows


def _body_box(model: IFS) -> Box:
    # Closed forms are known where every map sends the primitive into itself.
    return model.primitive.box


def _numbers(**values: int | None) -> list[Measure]:
    return [_exact(name, _real(value), "1") for name, value in values.items() if value is not None]


def _real(value: int) -> float:
    try:
        return float(value)
    except OverflowError:
        return math.copysign(math.inf, value)


def _exact(name: str, value: float, unit: str) -> Measure:
    return Measure(name, value, unit, METHOD, 0.0, "exact", "model")
