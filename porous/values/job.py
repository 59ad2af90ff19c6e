"""A simulation that is ready to be written for a solver: a mesh, what it is made of, what is done.

All quantities are in mm, t, s, K and what follows from these: N, MPa, mW, t/mm³; writers convert
them, and the mesh, to the job's own system of units.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING

from porous.errors import MeshError
from porous.values.units import SYSTEMS, check_system
from porous.values.value import Value

if TYPE_CHECKING:
    from collections.abc import Mapping

    from porous.values.volume_mesh import VolumeMesh

PROPERTIES: Mapping[str, str] = MappingProxyType(
    {
        "youngs_modulus": "pressure",
        "poissons_ratio": "number",
        "density": "density",
        "conductivity": "conductivity",
        "specific_heat": "specific_heat",
        "viscosity": "viscosity",
        "diffusivity": "diffusivity",
    }
)
"""What is known of materials, and of what dimension each property is (``units.DIMENSIONS``)."""

QUANTITIES = ("displacement", "temperature", "concentration", "velocity", "pressure")
"""What may be held at nodes: vectors of three components, or numbers."""

PROCEDURES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "static": ("youngs_modulus", "poissons_ratio"),
        "modal": ("youngs_modulus", "poissons_ratio", "density"),
        "conduction": ("conductivity",),
        "diffusion": ("diffusivity",),
        "flow": ("viscosity", "density"),
    }
)
"""What a step may be, and what of a material it needs: linear statics, natural frequencies,
steady conduction of heat, steady diffusion, steady incompressible flow."""


@dataclass(frozen=True, eq=False)
class Material(Value):
    """A material, in mm-t-s-K; what is not known is None.

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
    conductivity
        Of heat, λ, in mW/(mm·K), which is W/(m·K).
    specific_heat
        c, in mm²/(s²·K) (steel: 4.9e8).
    viscosity
        Dynamic, μ, in MPa·s (water: 1e-9).
    diffusivity
        Of what diffuses in it, D, in mm²/s.

    Raises
    ------
    MeshError
        For a property that is not above zero, or ν out of its range.
    """

    name: str
    youngs_modulus: float | None = None
    poissons_ratio: float | None = None
    density: float | None = None
    source: str = ""
    conductivity: float | None = None
    specific_heat: float | None = None
    viscosity: float | None = None
    diffusivity: float | None = None

    def __post_init__(self) -> None:
        for name in PROPERTIES:
            value = getattr(self, name)
            if name != "poissons_ratio" and value is not None and not 0 < value < math.inf:
                raise MeshError(f"material {self.name}: {name} = {value}; wanted more than zero")
        ratio = self.poissons_ratio
        if ratio is not None and not -1 < ratio < 0.5:
            raise MeshError(
                f"material {self.name}: poissons_ratio = {ratio}; wanted a number between −1 "
                "and 0.5"
            )

    def known(self, name: str) -> float:
        """Return a property that a step needs.

        Raises
        ------
        MeshError
            Where it is not known.
        """
        value: float | None = getattr(self, name)
        if value is None:
            there = [key for key in PROPERTIES if getattr(self, key) is not None]
            raise MeshError(
                f"material {self.name}: has no {name}; it has {', '.join(there) or 'nothing'}"
            )
        return value


@dataclass(frozen=True, eq=False)
class Held(Value):
    """A quantity that is held at the nodes of a part.

    Parameters
    ----------
    part
        Name of a part of nodes.
    quantity
        One of ``QUANTITIES``.
    value
        In mm, K, mm/s or MPa; a concentration in whatever the user counts it.
    components
        Of a vector: which of 0, 1, 2 are held, each at ``value``.
    """

    part: str
    quantity: str
    value: float = 0.0
    components: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if self.quantity not in QUANTITIES:
            raise MeshError(f"held: got {self.quantity!r}; wanted one of {', '.join(QUANTITIES)}")
        if not math.isfinite(self.value):
            raise MeshError(f"held {self.quantity}: got {self.value}; wanted a number")
        vector = self.quantity in ("displacement", "velocity")
        if bool(self.components) != vector or not set(self.components) <= {0, 1, 2}:
            raise MeshError(
                f"held {self.quantity}: got components {self.components}; wanted "
                f"{'some of 0, 1, 2' if vector else 'none'}"
            )


@dataclass(frozen=True, eq=False)
class Pressed(Value):
    """A pressure on the faces of a part, in MPa; positive pushes inwards."""

    part: str
    pressure: float

    def __post_init__(self) -> None:
        if not math.isfinite(self.pressure):
            raise MeshError(f"pressure: got {self.pressure} MPa; wanted a number")


@dataclass(frozen=True, eq=False)
class Step(Value):
    """One thing that is done; each starts from the body as it was.

    Parameters
    ----------
    name
        One word.
    procedure
        One of ``PROCEDURES``.
    held, pressed
        Boundary conditions; what is not said is free (no force, no flux; of a flow: walls).
    gradient
        Of a periodic body: the mean gradient that drives it, nine numbers ∂u_i/∂x_j, row by row,
        or three of a scalar per mm; empty where nothing does.
    modes
        How many natural frequencies, lowest first.
    """

    name: str
    procedure: str
    held: tuple[Held, ...] = ()
    pressed: tuple[Pressed, ...] = ()
    gradient: tuple[float, ...] = ()
    modes: int = 0

    def __post_init__(self) -> None:
        if self.procedure not in PROCEDURES:
            raise MeshError(f"step: got {self.procedure!r}; wanted one of {', '.join(PROCEDURES)}")
        wanted = 9 if self.procedure == "static" else 3
        if self.gradient and len(self.gradient) != wanted:
            raise MeshError(f"step: got {len(self.gradient)} slopes; wanted {wanted} or none")
        if not all(map(math.isfinite, self.gradient)):
            raise MeshError(f"step: got a gradient {self.gradient}; wanted numbers")


@dataclass(frozen=True, eq=False)
class Job(Value):
    """A mesh, what it is made of and what is done to it.

    Parameters
    ----------
    title
        One line for the deck's heading.
    mesh
        In any unit; writers convert.
    materials
        By the part of cells that is made of each; every cell is in one of them.
    steps
        What is done, or nothing where the mesh can bear no load.
    why_no_step
        Said in the deck and to the user where there are no steps.
    note
        Said in the deck and to the user where there is more to know: what was left out.
    tied
        Names of parts of pairs, by which the body goes on in copies of itself.
    system
        The units of the deck, one of ``units.SYSTEMS``.

    Raises
    ------
    MeshError
        Where a step speaks of a part that the mesh does not have, or needs of a material what is
        not known.
    """

    title: str
    mesh: VolumeMesh
    materials: Mapping[str, Material] = field(default_factory=dict)
    steps: tuple[Step, ...] = ()
    why_no_step: str = ""
    note: str = ""
    tied: tuple[str, ...] = ()
    system: str = SYSTEMS[0]

    def __post_init__(self) -> None:
        self._set("materials", MappingProxyType(dict(self.materials)))
        self._set("steps", tuple(self.steps))
        check_system(self.system)
        for name in self.materials:
            self._check_part(name, "cells")
        for name in self.tied:
            self._check_part(name, "pairs")
        for step in self.steps:
            self._check_step(step)

    def _check_step(self, step: Step) -> None:
        if not self.materials:
            raise MeshError(f"job: step {step.name!r} without a material")
        for material in self.materials.values():
            for needed in PROCEDURES[step.procedure]:
                material.known(needed)
        for held in step.held:
            self._check_part(held.part, "nodes")
        for pressed in step.pressed:
            self._check_part(pressed.part, "faces")
        if step.gradient and not self.tied:
            raise MeshError(f"job: step {step.name!r} has a gradient; wanted tied pairs of nodes")

    def _check_part(self, name: str, kind: str) -> None:
        part = self.mesh.parts.get(name)
        if part is None or part.kind != kind:
            there = [key for key, part in self.mesh.parts.items() if part.kind == kind]
            raise MeshError(
                f"job: the mesh has no part of {kind} named {name!r}; "
                f"there are {', '.join(there) or 'none'}"
            )
