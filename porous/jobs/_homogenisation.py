"""Effective stiffness or conductivity of a cell that goes on in copies of itself."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np
from pydantic import Field

from porous.errors import MeshError
from porous.jobs._body import going_on
from porous.jobs._cubic import check_cubic
from porous.jobs._section import TwoPhaseSection, phases
from porous.values import Held, Job, Part, Step
from porous.values.ties import ties

if TYPE_CHECKING:
    from collections.abc import Iterator

    from porous.values import VolumeMesh

PAIRS = ("XPAIRS", "YPAIRS", "ZPAIRS")
PINNED = "PINNED"
"""The part of nodes, one of each body, that are held against moving as a whole."""

STRAINS = {
    "xx": (0, 0),
    "yy": (1, 1),
    "zz": (2, 2),
    "yz": (1, 2),
    "xz": (0, 2),
    "xy": (0, 1),
}
"""Load cases in Voigt's order: the row and column of the strain that is one."""
CUBIC = ("xx", "yz")
"""Those that say all of a body with the symmetry of the cube."""


class HomogenisationSection(TwoPhaseSection):
    """Load cases of one mean strain, or one mean gradient of the temperature, each."""

    PROCEDURES: ClassVar[tuple[str, ...]] = ("static", "conduction")

    analysis: Literal["homogenisation"] = Field(
        default="homogenisation", description='"homogenisation"'
    )
    property: Literal["stiffness", "conductivity"] = Field(
        default="stiffness", description='"stiffness" or "conductivity"'
    )
    symmetry: Literal["none", "cubic"] = Field(
        default="none",
        description='"none", or "cubic" where the cell has the symmetry of the cube: fewer load '
        "cases say all; one that has not is refused",
    )
    decks: tuple[Literal["inp"], ...] = Field(
        default=(), strict=False, description='a list of "inp", which alone ties nodes'
    )


def prepare(mesh: VolumeMesh, section: HomogenisationSection) -> Job:
    """Return the job of finding an effective property of a periodic cell.

    Nodes on opposite sides are tied by ``XPAIRS``, ``YPAIRS`` and ``ZPAIRS``; of each body one node
    is held. What does not go on across faces into the next copy is left out. Where nothing goes on
    along an axis of a periodic cell, its part has no pairs; no heat flows along it, and loose
    plates bear nothing across. Bars are not held: they may turn, and there is no step.

    Raises
    ------
    MeshError
        Where the mesh lacks pairs along an axis, and for a cell said to be cubic that is not.
    """
    cells, materials = phases(mesh, section)
    for name in PAIRS:
        if name not in cells.parts:
            raise MeshError(
                f"homogenisation: the volume mesh has no pairs of nodes {name}; wanted a periodic "
                'one: voxels.periodic = [true, true, true], and volume.method = "voxel-hex" or, '
                'for a model of cells whose opposite sides match, "cells"'
            )
    made_of = " and ".join(material.name for material in materials.values())
    title = f"effective {section.property} of a periodic cell of {made_of}"
    elastic, cubic = section.property == "stiffness", section.symmetry == "cubic"
    found, nodes = going_on(cells, _with_pairs(cells), least=2 if elastic else 1)
    names = _with_pairs(found.mesh)  # an island that lies across a border is left out
    ends = " and ".join(name[0].lower() for name in PAIRS if name not in names)
    if found.why_not:
        return Job(title, cells, materials, why_no_step=found.why_not)
    tied = ties(found.mesh, names)
    if cubic:
        check_cubic(found.mesh, tied, PAIRS, list(materials))
    pins = Part("nodes", np.unique(tied.root[nodes]))
    pinned = replace(found.mesh, parts={**found.mesh.parts, PINNED: pins})
    steps = tuple(_strains(cubic=cubic) if elastic else _slopes(names, cubic=cubic))
    what = "it bears nothing" if elastic else "no heat flows"
    still = f"no body goes on along {ends} into the next copy: {what} there" if ends else ""
    note = "; ".join(one for one in (found.note, still) if one)
    return Job(title, pinned, materials, steps, note=note, tied=names)


def _with_pairs(mesh: VolumeMesh) -> tuple[str, ...]:
    return tuple(name for name in PAIRS if len(mesh.parts[name].members))


def _strains(*, cubic: bool) -> Iterator[Step]:
    held = Held(PINNED, "displacement", components=(0, 1, 2))
    for name in CUBIC if cubic else STRAINS:
        gradient = np.zeros((3, 3))
        row, column = STRAINS[name]
        gradient[row, column] += 0.5
        gradient[column, row] += 0.5
        yield Step(f"strain-{name}", "static", (held,), gradient=tuple(gradient.ravel().tolist()))


def _slopes(names: tuple[str, ...], *, cubic: bool) -> Iterator[Step]:
    held = Held(PINNED, "temperature")
    for axis in "x" if cubic else (name[0].lower() for name in names):
        gradient = tuple(float(axis == other) for other in "xyz")
        yield Step(f"gradient-{axis}", "conduction", (held,), gradient=gradient)
