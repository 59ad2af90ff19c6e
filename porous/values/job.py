"""A simulation that is ready to be written for a solver."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from porous.errors import MeshError
from porous.values.value import Value

if TYPE_CHECKING:
    from porous.values.volume_mesh import VolumeMesh


@dataclass(frozen=True, eq=False)
class Material(Value):
    """A linear elastic material in mm-N-MPa.

    Parameters
    ----------
    name
        Letters, digits and dashes.
    youngs_modulus
        E, in MPa.
    poissons_ratio
        ν, between −1 and 0.5.
    density
        ρ, in t/mm³ (steel: 7.85e-9).
    source
        Where the figures come from.
    """

    name: str
    youngs_modulus: float
    poissons_ratio: float
    density: float
    source: str = ""

    def __post_init__(self) -> None:
        if not 0 < self.youngs_modulus < math.inf:
            raise MeshError(f"material {self.name}: E = {self.youngs_modulus} MPa; wanted E > 0")
        if not -1 < self.poissons_ratio < 0.5:
            raise MeshError(f"material {self.name}: ν = {self.poissons_ratio}; wanted −1 < ν < 0.5")
        if not 0 < self.density < math.inf:
            raise MeshError(f"material {self.name}: density {self.density}; wanted more than zero")


@dataclass(frozen=True, eq=False)
class Compression(Value):
    """A static compression step.

    Parameters
    ----------
    fixed
        Name of the node part that is held in all directions.
    loaded
        Name of the face part that bears the pressure.
    pressure
        In MPa, positive pushes inwards.
    """

    fixed: str
    loaded: str
    pressure: float

    def __post_init__(self) -> None:
        if not math.isfinite(self.pressure):
            raise MeshError(f"pressure: got {self.pressure} MPa; wanted a number")


@dataclass(frozen=True, eq=False)
class Job(Value):
    """A mesh, what it is made of and what is done to it.

    Parameters
    ----------
    title
        One line for the deck's heading.
    mesh
        In any unit; writers convert to mm-N-MPa.
    material
        Of all cells.
    step
        What is done, or None where the mesh can bear no load.
    why_no_step
        Said in the deck and to the user where ``step`` is None.
    note
        Said in the deck and to the user where there is more to know: what was left out.

    Raises
    ------
    MeshError
        Where the step speaks of a part that the mesh does not have.
    """

    title: str
    mesh: VolumeMesh
    material: Material
    step: Compression | None = None
    why_no_step: str = ""
    note: str = ""

    def __post_init__(self) -> None:
        if self.step is not None:
            self._check_part(self.step.fixed, "nodes")
            self._check_part(self.step.loaded, "faces")

    def _check_part(self, name: str, kind: str) -> None:
        part = self.mesh.parts.get(name)
        if part is None or part.kind != kind:
            there = [key for key, part in self.mesh.parts.items() if part.kind == kind]
            raise MeshError(
                f"job: the mesh has no part of {kind} named {name!r}; "
                f"there are {', '.join(there) or 'none'}"
            )
