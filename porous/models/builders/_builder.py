"""What a cell's designer says, and the builders that make a boundary representation of it."""

from __future__ import annotations

import pkgutil
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields
from functools import cache
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

from porous.errors import ModelError, nearest
from porous.models.builders._rules import Texture
from porous.models.digits import DigitSet
from porous.values.value import Value

if TYPE_CHECKING:
    from porous.models.brep import BRep
    from porous.models.builders._curves import Curve

    Names = tuple[str, ...]
    Textures = Texture | tuple[Texture, Texture, Texture]


@dataclass(frozen=True, eq=False)
class Options(Value):
    """A cell's name and its shape parameters; each family takes some and refuses the others.

    Parameters
    ----------
    cell
        A name of ``builders()``.
    digits
        Which sub-cells are kept, one set per level; the last repeats.
    texture
        One for all axes, or three: of the lines along x, y and z.
    keep
        Names of the children kept, by state: ``{"octa": ("0", "1")}``; all where a state is not
        there. The name of a state stands for all children of that state. A tuple alone is that
        of the state that the cell starts with.
    controls
        Number of control points given: says which of its cells a family makes where there is a
        choice (``"beam"``), and is checked where there is none.
    start
        State of the level-0 cell, where there is a choice.
    curves
        The lines along one, two or three axes whose product a cell is.

    Raises
    ------
    ModelError
        For digits or textures that are none.
    """

    cell: str
    digits: tuple[DigitSet, ...] = ()
    texture: Textures | None = None
    keep: Mapping[str, Names] | Names | None = None
    controls: int | None = None
    start: str | None = None
    curves: tuple[Curve, ...] = ()

    def __post_init__(self) -> None:
        digits = (self.digits,) if isinstance(self.digits, DigitSet) else tuple(self.digits)
        if not all(isinstance(d, DigitSet) for d in digits):
            raise ModelError(f"digits: got {digits!r:.100}; wanted sets of digits")
        self._set("digits", digits)
        self._set("curves", tuple(self.curves))
        if self.texture is not None and not isinstance(self.texture, Texture):
            self._set("texture", _three(self.texture))
        if isinstance(self.keep, Mapping):
            kept = {str(state): _names(names, state) for state, names in self.keep.items()}
            self._set("keep", MappingProxyType(kept))
        elif self.keep is not None:
            self._set("keep", _names(self.keep, self.cell))

    def keeping(self, start: str) -> dict[str, Names]:
        """Return the names kept by state; ``start`` is the state that a tuple alone is of."""
        if isinstance(self.keep, Mapping):
            return dict(self.keep)
        return {} if self.keep is None else {start: self.keep}


@dataclass(frozen=True, eq=False)
class Builder(Value):
    """A family of cells.

    Parameters
    ----------
    names
        Of its cells; the builder tells them apart by ``Options.cell``.
    build
        Makes the boundary representation; raises ``ModelError`` for options it cannot serve.
    takes
        The options that it looks at, apart from the cell's name.
    """

    names: tuple[str, ...]
    build: Callable[[Options], BRep]
    takes: tuple[str, ...]


def build_cell(options: Options) -> BRep:
    """Return the boundary representation of a cell.

    The guesses are the exact matrices of the regular or textured cell: they satisfy all
    constraints as they are.

    Raises
    ------
    ModelError
        For an unknown name, with the nearest; for options that the cell does not take or that do
        not fit together.
    """
    known = builders()
    if options.cell not in known:
        raise ModelError(f"cell: got {options.cell!r}{nearest(str(options.cell), known)}")
    builder = known[options.cell]
    for field in fields(options):
        given = getattr(options, field.name) not in (None, ())
        if field.name != "cell" and given and field.name not in builder.takes:
            raise ModelError(
                f"{field.name}: a {options.cell} cell takes none; wanted only "
                f"{', '.join(builder.takes)}"
            )
    return builder.build(options)


@cache
def builders() -> Mapping[str, Builder]:
    """Return the builder of each cell there is, by the cell's name."""
    modules = sorted(m.name for m in pkgutil.iter_modules([str(Path(__file__).parent)]))
    found: dict[str, Builder] = {}
    for module in (m for m in modules if not m.startswith("_")):
        builder: Builder = import_module(f"porous.models.builders.{module}").CELL
        found |= dict.fromkeys(builder.names, builder)
    return MappingProxyType(dict(sorted(found.items())))


def cell_names() -> tuple[str, ...]:
    """Return the names of the cells there are, sorted."""
    return tuple(builders())


def _three(texture: object) -> tuple[Texture, Texture, Texture]:
    given = tuple(texture) if isinstance(texture, Iterable) else (texture,)
    if len(given) != 3 or not all(isinstance(t, Texture) for t in given):
        raise ModelError(f"texture: got {texture!r:.100}; wanted one, or three for x, y and z")
    return given[0], given[1], given[2]


def _names(names: object, state: object) -> Names:
    given = tuple(names) if isinstance(names, Iterable) and not isinstance(names, str) else ()
    if not given or not all(isinstance(name, str) for name in given):
        raise ModelError(f"keep: got {names!r:.100} for {state}; wanted names of children")
    return given
