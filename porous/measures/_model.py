"""What a model knows of itself: closed forms, smallest details, dimensions."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from porous.errors import ModelError
from porous.models.model import HasExact
from porous.values import Measure

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from porous.models.automaton import Automaton
    from porous.models.model import Model

    Axes = tuple[bool, bool, bool]

METHOD = "closed form"


@runtime_checkable
class _HasDetails(Protocol):
    @property
    def unit(self) -> str: ...

    def smallest_feature(self) -> float | None: ...

    def smallest_pore(self) -> float | None: ...

    def finest_printable_level(self, feature: float) -> float | None: ...


@runtime_checkable
class _HasAutomaton(Protocol):
    @property
    def automaton(self) -> Automaton: ...


def model_rows(model: Model, periodic: Axes) -> Iterator[Measure]:
    """Yield what is known of a model in vacuum or periodic space, as far as it is known."""
    if isinstance(model, HasExact):
        yield from model.exact(periodic)
    for function in _FUNCTIONS:
        row = function(model)
        if row is not None:
            yield row


def _exact(name: str, value: float | None, unit: str) -> Measure | None:
    return None if value is None else Measure(name, value, unit, METHOD, 0.0, "exact", "model")


def _similar(model: Model) -> bool:
    """Tell whether all maps are similarities, or the model is not made of maps."""
    from porous.models import dimension

    return not isinstance(model, _HasAutomaton) or dimension.ratios(model.automaton) is not None


def _feature(model: Model) -> Measure | None:
    if not isinstance(model, _HasDetails):
        return None
    value = model.smallest_feature()
    if value is None or _similar(model):
        return _exact("smallest_feature", value, model.unit)
    # σ_min(A_w)·t₀: the cell may be thicker, where its map shrinks most across another direction.
    return Measure("smallest_feature", value, model.unit, "lower bound", value, "bound", "model")


def _pore(model: Model) -> Measure | None:
    if not isinstance(model, _HasDetails):
        return None
    return _exact("smallest_pore", model.smallest_pore(), model.unit)


def _similarity(model: Model) -> Measure | None:
    from porous.models import dimension

    if not isinstance(model, _HasAutomaton):
        return None
    value = dimension.similarity_dimension(model.automaton)
    finite = value if value is not None and math.isfinite(value) else None
    return _exact("similarity_dimension", finite, "1")


def _affinity(model: Model) -> Measure | None:
    from porous.models import dimension

    if not isinstance(model, _HasAutomaton):
        return None
    if _similar(model):
        similarity = _similarity(model)  # each s_k is then the root of Σ ratioˢ = 1 itself
        return similarity and replace(similarity, name="affinity_dimension")
    value: float | None = dimension.affinity_dimension(model.automaton)
    if value is None or not math.isfinite(value):
        return None
    # All that is known of the attractor's dimension is that it lies between none and this.
    return Measure("affinity_dimension", value, "1", "upper bound", value, "bound", "model")


_FUNCTIONS: tuple[Callable[[Model], Measure | None], ...] = (
    _feature,
    _pore,
    _similarity,
    _affinity,
)


def _known(row: Measure | None, name: str, why: str) -> Measure:
    if row is None:
        raise ModelError(f"{name}: not known of this model: {why}")
    return row


def smallest_feature(model: Model) -> Measure:
    """Return the thickness of the thinnest cell of a prefractal, in the model's unit.

    The smallest singular value of a cell's map times the least width of the primitive, or a lower
    bound on it where maps are no similarities.

    Raises
    ------
    ModelError
        For an attractor, which has details of every size.
    """
    return _known(_feature(model), "smallest_feature", "it has details of every size")


def smallest_pore(model: Model) -> Measure:
    """Return the shortest void between two solids along an axis, in the model's unit.

    Raises
    ------
    ModelError
        Where there is none, or the model is no digit set of a level.
    """
    why = "wanted a digit set of a whole level with a void between two solids"
    return _known(_pore(model), "smallest_pore", why)


def finest_printable_level(model: Model, *, feature: float) -> Measure:
    """Return the last level up to which no cell is thinner than ``feature``, unit 1.

    Parameters
    ----------
    model
        A prefractal.
    feature
        The least thickness that can be made, in the model's unit, positive.

    Returns
    -------
    Measure
        Infinite where the offset alone is as thick.

    Raises
    ------
    ModelError
        For a feature that is not positive, or where even level 0 is thinner.
    """
    name = "finest_printable_level"
    if not isinstance(model, _HasDetails):
        raise ModelError(f"{name}: this model has no levels")
    level = model.finest_printable_level(feature)
    return _known(_exact(name, level, "1"), name, f"level 0 is thinner than {feature} {model.unit}")


def similarity_dimension(model: Model) -> Measure:
    """Return the root s of Σ ratioˢ = 1 over the maps, unit 1 (P. A. P. Moran 1946).

    The Hausdorff dimension of the attractor where the images do not overlap. Of several states,
    the s at which the matrix of Σ ratioˢ has spectral radius 1 (Mauldin & Williams 1988).

    Raises
    ------
    ModelError
        Where a map is no similarity.
    """
    return _known(_similarity(model), "similarity_dimension", "a map is no similarity")


def affinity_dimension(model: Model) -> Measure:
    """Return an upper bound on the box dimension of the attractor, unit 1 (K. Falconer 1988).

    Raises
    ------
    ModelError
        Where the model has no maps.
    """
    return _known(_affinity(model), "affinity_dimension", "it is no system of maps")
