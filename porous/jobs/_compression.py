"""Static compression along an axis: the lower side is held, the upper one pressed or moved."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from pydantic import AfterValidator, Field, model_validator

from porous.errors import MeshError
from porous.jobs._body import between
from porous.jobs._section import Axis, SimulationSection, phases
from porous.values import Held, Job, Pressed, Step
from porous.values.units import length_ratio

if TYPE_CHECKING:
    from porous.values import Material, VolumeMesh


def _some(value: float) -> float:
    if not value:
        raise ValueError("wanted a number but zero, for no load makes no step")
    return value


class CompressionSection(SimulationSection):
    """One side is held in all directions; the opposite one bears a pressure, or is moved."""

    PROCEDURES: ClassVar[tuple[str, ...]] = ("static",)

    analysis: Literal["compression"] = Field(default="compression", description='"compression"')
    axis: Axis = Field(default="z", description='"x", "y" or "z": the MIN side is held')
    pressure: Annotated[float, AfterValidator(_some)] | None = Field(
        default=None, description="a number but zero: the pressure on the MAX side, in MPa"
    )
    strain: Annotated[float, AfterValidator(_some)] | None = Field(
        default=None,
        description="a number but zero, in place of a pressure: how far the MAX side is moved "
        "towards the other, relative to their distance; it slides freely along its plane",
    )

    @model_validator(mode="after")
    def _one_load(self) -> CompressionSection:
        if self.pressure is not None and self.strain is not None:
            raise ValueError("got pressure and strain; wanted one of them")
        if self.pressure is None and self.strain is None:
            object.__setattr__(self, "pressure", 1.0)
        return self


def prepare(mesh: VolumeMesh, section: CompressionSection) -> Job:
    """Return the job that a section asks for; see ``compression``."""
    solid, materials = phases(mesh, section)
    load = {"pressure": section.pressure, "strain": section.strain}
    return compression(
        solid,
        material=materials["SOLID"],
        axis=section.axis,
        **{name: value for name, value in load.items() if value is not None},
    )


def compression(
    mesh: VolumeMesh,
    *,
    material: Material,
    pressure: float = math.nan,
    strain: float = math.nan,
    axis: str = "z",
) -> Job:
    """Return the job of pressing a mesh along an axis while its lower side is held.

    The mesh is cut down to the one body, joined across faces, that has faces on both sides:
    whatever hangs on it by a point or an edge, or not at all, bears no load and would leave the
    solver with a mechanism. Where there is no such body, or several, the job has no step and says
    why.

    Parameters
    ----------
    mesh
        With the parts that ``name_parts`` gives.
    material
        Of all cells.
    pressure
        In MPa, on the faces of the ``MAX`` side; positive pushes.
    strain
        In place of a pressure: how far the ``MAX`` side is moved, relative to the mean distance of
        the nodes of both sides; positive presses. It slides freely along its plane.
    axis
        x, y or z.

    Raises
    ------
    MeshError
        For a mesh without cells, or a load that is no number.
    """
    if not mesh.cells:
        raise MeshError("compression: the mesh has no cells")
    if math.isfinite(pressure) == math.isfinite(strain):
        raise MeshError(
            f"compression: got pressure = {pressure} MPa and strain = {strain}; wanted one number"
        )
    fixed, loaded = f"{axis.upper()}MIN", f"{axis.upper()}MAX"
    moved = math.isfinite(strain)
    load = f"{loaded} moved by {strain:g}" if moved else f"{pressure:g} MPa on {loaded}"
    title = f"static compression of {material.name}, {load}, {fixed} held"
    found = between(mesh, fixed, loaded)
    materials = {name: material for name in ("SOLID",) if name in mesh.parts}
    if found.why_not:
        return Job(title, mesh, materials, why_no_step=found.why_not)
    held = [Held(fixed, "displacement", components=(0, 1, 2))]
    if moved:
        held.append(_moved(found.mesh, fixed, loaded, strain))
    pressed = () if moved else (Pressed(f"{loaded}_FACES", float(pressure)),)
    step = Step("compression", "static", tuple(held), pressed)
    return Job(title, found.mesh, materials, (step,), note=found.note)


def _moved(mesh: VolumeMesh, fixed: str, loaded: str, strain: float) -> Held:
    axis = "XYZ".index(loaded[0])
    low, high = (mesh.points[mesh.parts[side].members, axis].mean() for side in (fixed, loaded))
    far = float(high - low) * length_ratio(mesh.unit, "mm")
    return Held(loaded, "displacement", -strain * far, (axis,))
