"""What a recipe says of boundary-controlled systems: cells, their digits, textures and controls."""

from __future__ import annotations

import warnings
from pathlib import Path  # noqa: TC003  (pydantic reads it)
from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple, Self

from pydantic import Field, model_validator

from porous.errors import FormatWarning, MeshError, ModelError, nearest
from porous.formats import read
from porous.models.automaton import DEEPEST
from porous.models.builders import CurveSection, Options, Texture, build_cell, cell_names
from porous.models.macro import (
    MacroMesh,
    Sharing,
    check_indices,
    check_macro,
    of_hexahedra,
    with_middles,
)
from porous.models.macro_frames import Assembly, Families, Hexahedron, assembled
from porous.models.rational import columns
from porous.models.sections import BoxSection, DigitsSection, Section
from porous.models.states import StateSection, build_states
from porous.models.swept_body import Sweep
from porous.values import HexMesh, VolumeMesh

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    from numpy.typing import NDArray

    from porous.models.brep import BRep
    from porous.models.digits import DigitSet

    Floats = NDArray[np.float64]
    Three = tuple[Texture, Texture, Texture]

FUSED = 0.25
"""Radius of what fuses contacts where none is given, as a part of the thinnest cell."""

Numbers = Annotated[tuple[float, ...], Field(strict=False, min_length=1)]
Control = Annotated[tuple[float, ...], Field(strict=False, min_length=3, max_length=4)]
Names = Annotated[tuple[str, ...], Field(strict=False, min_length=1)]
Contacts = Literal["apart", "fuse", "shared"]
Level = int | Literal["limit"]
Depth = Annotated[int, Field(ge=0, le=DEEPEST)] | Literal["limit"]
Digits = DigitsSection | Annotated[tuple[DigitsSection, ...], Field(strict=False, min_length=1)]
Curves = Annotated[tuple[CurveSection, ...], Field(strict=False, min_length=1, max_length=3)]
Indices = Annotated[tuple[int, ...], Field(strict=False, min_length=1)]

HEXAHEDRA = ("hex-8", "hex-27")
"""Cells that may differ in digits and textures from each other in one mesh."""


class TextureSection(Section):
    """The curve rule of a cell's edges: where their pieces end, and how far these bulge."""

    edge: float | Numbers | None = Field(
        default=None,
        description="r: the bulge of each piece of an edge, in parts of the edge's own; one number "
        "or one for each division",
    )
    bump: float | Numbers | None = Field(
        default=None,
        description="h: how far each point between pieces lies towards the middle control; one "
        "number or one for each such point",
    )

    def texture(self) -> Texture:
        """Return the rule."""
        return Texture(edge=self.edge, bump=self.bump)


class SweepSection(Section):
    """What is drawn along cells in place of the solid cells."""

    along: Annotated[
        tuple[
            Literal["vertices", "edges", "faces", "face-diagonals", "body-diagonals"],
            ...,
        ],
        Field(strict=False, min_length=1),
    ] = Field(description="some of vertices, edges, faces, face-diagonals, body-diagonals")
    radius: float | Numbers = Field(
        description="of the ball that sweeps them, above zero, in unit; or one for each level"
    )


Textures = TextureSection | Annotated[tuple[TextureSection, ...], Field(strict=False)]


class CellSection(Section):
    """A level-0 cell that is divided in its own way."""

    controls: Indices = Field(description="the indices of its controls")
    digits: Digits | None = Field(
        default=None, description="its own sub-cells, in place of those of all"
    )
    texture: Textures | None = Field(
        default=None, description="its own texture, or three for its lines along x, y and z"
    )
    level: Depth | None = Field(
        default=None,
        description="how often it is divided; the same for all cells that hang together by faces",
    )


class BCIFSSection(Section):
    """The ``[model]`` table of a boundary-controlled iterated function system."""

    kind: Literal["bcifs"] = Field(description='"bcifs"')
    cell: str | None = Field(default=None, description=f"one of {', '.join(cell_names())}")
    states: Annotated[tuple[StateSection, ...], Field(strict=False, min_length=1)] | None = Field(
        default=None, description="tables of one's own states, in place of cell"
    )
    start: str | None = Field(default=None, description="the name of the level-0 cell's state")
    level: Depth = Field(default=2, description='a whole number, zero or more, or "limit"')
    digits: Digits | None = Field(
        default=None,
        description="{ divisions = N, keep = a list or a name }; or a list of these, one for each "
        "level, of which the last holds below",
    )
    keep: dict[str, Names] | None = Field(
        default=None, description="the names of the children that each state keeps"
    )
    texture: Textures | None = Field(
        default=None,
        description="{ edge = r, bump = h } of cells with 27 controls; or three of these, for the "
        "lines along x, y and z; of several cells one for each class of parallel edges, as the "
        "cells' axes meet them",
    )
    curves: Curves | None = Field(
        default=None,
        description='the one to three curves whose product a "tensor" cell is, such as '
        '{ curve = "bezier", degree = 3 }',
    )
    moves: dict[str, Numbers] = Field(
        default_factory=dict, description="free points by name, and how far each is moved"
    )
    controls: Annotated[tuple[Control, ...], Field(strict=False, min_length=1)] | None = Field(
        default=None,
        description="the control points [x, y, z] of the level-0 cells, or [x, y, z, weight]",
    )
    cells: (
        Annotated[tuple[CellSection | Indices, ...], Field(strict=False, min_length=1)] | None
    ) = Field(
        default=None,
        description="for each of several level-0 cells the indices of its controls; or a table "
        "{ controls = [..], digits = .., texture = .. } where it has its own",
    )
    mesh: Path | None = Field(
        default=None,
        strict=False,
        description="a path to a file of hexahedra (.vtu, .inp or .msh), in place of controls and "
        "cells",
    )
    size: float | None = Field(
        default=None,
        gt=0,
        description="length of the domain's longest edge before radius and offset, in unit",
    )
    unit: Literal["nm", "um", "mm", "cm", "m", "in"] = Field(
        default="mm", description="nm, um, mm, cm, m or in"
    )
    draw: Literal["cell"] | SweepSection = Field(
        default="cell", description='"cell" or { along = ["edges"], radius = 0.05 }'
    )
    offset: float = Field(default=0.0, ge=0, description="a length, zero or more, in unit")
    contacts: Contacts = Field(default="apart", description='"apart", "fuse" or "shared"')
    contact_radius: float | None = Field(
        default=None,
        gt=0,
        description=f"a length above zero, in unit; {FUSED:g} of the thinnest cell if left out",
    )
    domain: BoxSection | None = Field(
        default=None, description="{ lower = [x, y, z], upper = [x, y, z] }"
    )
    bulk: BoxSection | None = Field(
        default=None, description="{ lower = [x, y, z], upper = [x, y, z] }"
    )

    @model_validator(mode="after")
    def _one_system(self) -> Self:
        if (self.cell is None) == (self.states is None):
            got = "both" if self.cell else "neither"
            raise ValueError(f"got {got} of cell and states; wanted one")
        if self.cell is not None and self.cell not in cell_names():
            raise ValueError(f"no cell {self.cell!r}{nearest(self.cell, cell_names())}")
        if self.states is not None:
            for name in ("digits", "keep", "texture", "curves"):
                if getattr(self, name) is not None:
                    raise ValueError(f"{name}: shapes a built-in cell; got states of one's own")
        if self.cell == "beam" and self.draw == "cell" and self.level != "limit":
            raise ValueError('draw: wanted { along = ["edges"], radius = … } for cell = "beam"')
        return self

    @model_validator(mode="after")
    def _cells_fit(self) -> Self:
        if self.mesh is not None:
            self._check_mesh()
        if self.cells is None:
            return self
        if self.controls is None:
            raise ValueError("cells: got indices of controls, but no controls; wanted both")
        for index, cell in enumerate(self.cells):
            if isinstance(cell, CellSection) and self.cell not in HEXAHEDRA:
                raise ValueError(
                    f"cells[{index}]: got a table; wanted the indices alone: only cells of "
                    f"{' and '.join(HEXAHEDRA)} may differ"
                )
        return self

    def _check_mesh(self) -> None:
        for name in ("controls", "cells"):
            if getattr(self, name) is not None:
                raise ValueError(f"got both mesh and {name}; wanted one")
        if self.cell not in HEXAHEDRA:
            raise ValueError(
                f"mesh: got cell = {self.cell!r}, but hexahedra are filled with cells of "
                f"{' or '.join(HEXAHEDRA)}"
            )

    def digit_sets(self) -> tuple[DigitSet, ...]:
        """Return the digit set of each level."""
        return _digit_sets(self.digits)

    def sweep(self) -> Sweep | None:
        """Return what is swept along the cells of the level, or None for solid cells."""
        if isinstance(self.draw, str):
            return None
        given = self.draw.radius
        radii = given if isinstance(given, tuple) else (given,)
        sweeps = [Sweep(self.draw.along, radius) for radius in radii]
        level = self.levels()[0]
        return sweeps[-1 if level == "limit" else min(level, len(radii) - 1)]

    def levels(self) -> tuple[Level, ...]:
        """Return how often each level-0 cell is divided, one number where none are listed."""
        own = [c.level if isinstance(c, CellSection) else None for c in self.cells or (None,)]
        return tuple(self.level if level is None else level for level in own)


class System(NamedTuple):
    """What a section says of cells: states, controls, level-0 cells and the digits of all."""

    brep: BRep
    controls: Floats | None
    mesh: MacroMesh | None
    digits: tuple[DigitSet, ...]


def system_of(section: BCIFSSection, folder: Path) -> System:
    """Return the states, controls and cells of a section.

    Parameters
    ----------
    section
        What the recipe says.
    folder
        Where its mesh is looked for.

    Raises
    ------
    ModelError
        As ``build_cell`` and ``assembled``; for as many textures as fit no count, a mesh of
        anything but hexahedra.
    FormatError
        For a mesh that cannot be read.
    """
    controls: Floats | None
    if section.mesh is not None:
        controls, lists = of_hexahedra(_read(folder / section.mesh))
    else:
        controls = None if section.controls is None else columns(section.controls)
        lists = [c.controls if isinstance(c, CellSection) else c for c in section.cells or ()]
    if controls is None or not lists:
        size = None if controls is None else controls.shape[1]
        return System(_brep(section, size), controls, None, section.digit_sets())
    check_indices(lists, controls.shape[1])
    if section.cell not in HEXAHEDRA:
        brep = _brep(section, len(lists[0]))
        mesh = MacroMesh(tuple(lists), (brep.start,) * len(lists))
        return System(brep, controls, mesh, section.digit_sets())
    if section.cell == "hex-27":
        controls, lists = with_middles(controls, lists)
    found = assembled(section.cell, _hexahedra(section, lists))
    _check_levels(section.levels(), found, controls)
    return System(found.brep, controls, found.mesh, found.digits)


def _check_levels(levels: Sequence[Level], found: Assembly, controls: Floats) -> None:
    """Raise ``ModelError`` for cells divided to other levels: those of a body are joined by faces.

    Which face it is is looked for only then.
    """
    if len(set(levels)) > 1:
        check_macro(found.brep, found.mesh, controls.shape[1])
        Sharing(found.brep, found.mesh).check_levels(levels)


def _read(path: Path) -> HexMesh:
    found = read(path)
    if not isinstance(found, VolumeMesh):
        raise ModelError(f"mesh: {path.name} holds a {type(found).__name__}; wanted hexahedra")
    if curved := sum(len(block.cells) for block in found.blocks if block.shape == "hex20"):
        text = f"{path.name}: {curved} hexahedra of 20 nodes are divided by their corners"
        warnings.warn(text, FormatWarning, stacklevel=2)
    try:
        return HexMesh.of_volume(found)
    except MeshError as error:
        raise ModelError(f"mesh: {path.name}: {error}") from None


def _hexahedra(section: BCIFSSection, lists: Sequence[tuple[int, ...]]) -> list[Hexahedron]:
    common = _common_textures(section, lists)
    result = []
    for index, (cell, own) in enumerate(zip(section.cells or lists, lists, strict=True)):
        digits, textures = section.digit_sets(), common[index]
        if isinstance(cell, CellSection):
            digits = _digit_sets(cell.digits) or digits
            textures = _three(cell.texture, f"cells[{index}].texture") or textures
        result.append(Hexahedron(own, digits, textures))
    return result


def _common_textures(section: BCIFSSection, lists: Sequence[tuple[int, ...]]) -> list[Three | None]:
    """Return the textures of each cell's axes that the recipe says for all cells."""
    given = section.texture
    if given is None or isinstance(given, TextureSection):
        return [_three(given, "texture")] * len(lists)
    families = Families.of(lists)
    if len(given) != families.count:
        raise ModelError(
            f"texture: got {len(given)}; wanted one, or {families.count}: one for each class of "
            "parallel edges"
        )
    known = [each.texture() for each in given]
    result: list[Three | None] = []
    for x, y, z in families.axes:
        result.append((known[x.family], known[y.family], known[z.family]))
    return result


def _digit_sets(given: Digits | None) -> tuple[DigitSet, ...]:
    listed = given if isinstance(given, tuple) else (given,)
    return tuple(each.digits() for each in listed if each is not None)


def _three(given: Textures | None, what: str) -> Three | None:
    """Return the textures of a cell's lines along x, y and z."""
    if given is None:
        return None
    if isinstance(given, TextureSection):
        return (given.texture(),) * 3
    if len(given) != 3:
        raise ModelError(f"{what}: got {len(given)}; wanted one, or three for x, y and z")
    x, y, z = (each.texture() for each in given)
    return x, y, z


def _brep(section: BCIFSSection, size: int | None) -> BRep:
    """Return the states of one kind of level-0 cells with ``size`` controls."""
    if section.states is not None:
        return build_states(section.states, section.start)
    assert section.cell is not None
    digits = section.digit_sets()
    textures = _three(section.texture, "texture")
    alike = textures and len(set(textures)) == 1
    return build_cell(
        Options(
            cell=section.cell,
            digits=digits,
            texture=textures[0] if textures and alike else textures,
            keep=section.keep,
            controls=size,
            start=section.start,
            curves=tuple(each.made([d.divisions for d in digits]) for each in section.curves or ()),
        )
    )
