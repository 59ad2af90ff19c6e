"""Fields of a solver's results on the mesh of a job, in the job's units and by their names."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import MeshError
from porous.formats import frd
from porous.formats.gate import Source
from porous.values import Field, MeshFields
from porous.values.fields import von_mises
from porous.values.units import length_ratio, system_length, system_ratio

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from porous.formats.frd import Block
    from porous.values import Job

    Array = NDArray[np.float64]

STRESS, VON_MISES = "stress", "von_mises_stress"
UNITS: dict[str, tuple[str, Callable[[str], float]]] = {
    "stress": ("MPa", lambda system: system_ratio(system, "pressure")),
    "strain": ("1", lambda _: 1.0),
    "reaction": ("N", lambda system: system_ratio(system, "force")),
    "temperature": ("K", lambda system: system_ratio(system, "temperature")),
    "heat_flux": (
        "mW/mm²",
        lambda system: system_ratio(system, "power") / system_ratio(system, "length") ** 2,
    ),
    "heat_flow": ("mW", lambda system: system_ratio(system, "power")),
    "stress_error_estimate": ("%", lambda _: 1.0),
}
"""In what unit fields are kept, and how many of a deck's units one of these is."""
SHOWN = ("mode", VON_MISES, "temperature", "displacement")
"""Of which field a picture is drawn: the first that is there."""


def fields_of(job: Job | None, content: bytes) -> MeshFields | None:
    """Return the fields that CalculiX wrote; None where it wrote none.

    Parameters
    ----------
    job
        What the deck was written from: fields are on its mesh and in mm-t-s-K, displacements in
        the mesh's unit. Without one they are on the mesh that CalculiX wrote, as they stand.
    content
        Of the file .frd.

    Raises
    ------
    FormatError
        Where it cannot be understood.
    MeshError
        Where a field lacks nodes of the job's mesh.
    """
    if not content:
        return None
    source = Source("results.frd", content)
    if job is None:
        return _with_von_mises(frd.read(source))
    nodes = np.arange(1, len(job.mesh.points) + 1)
    fields: dict[str, Field] = {}
    for block in frd.content(source).blocks:
        for field in _converted(job, block, block.at(nodes)):
            fields[field.name] = field
    return MeshFields(job.mesh, tuple(fields.values()))


def _with_von_mises(found: MeshFields) -> MeshFields:
    fields: list[Field] = []
    for field in found:
        # The heading speaks of the deck that we wrote; who edited it may have changed its units.
        fields.append(replace(field, unit=""))
        if field.name.startswith(STRESS) and field.values.ndim == 2:
            name = field.name.replace(STRESS, VON_MISES, 1)
            fields.append(Field(name, von_mises(field.values)))
    return MeshFields(found.mesh, tuple(fields))


def _converted(job: Job, block: Block, values: Array) -> list[Field]:
    if not np.isfinite(values).all():
        missing = int(np.isnan(values).any(axis=-1).sum() if values.ndim > 1 else 0) or "some"
        raise MeshError(f"field {block.name}: {missing} nodes of the mesh have no number there")
    if block.is_mode:
        return _mode(block, values)
    tail = _tail(job, block)
    if block.name == "displacement":
        ratio = length_ratio(system_length(job.system), job.mesh.unit)
        return [Field(f"displacement{tail}", values * ratio, job.mesh.unit)]
    unit, of_deck = UNITS.get(block.name, ("", lambda _: 1.0))
    values = values / of_deck(job.system)
    fields = [Field(f"{block.name}{tail}", values, unit)]
    if block.name == STRESS and values.ndim == 2:
        fields.append(Field(f"{VON_MISES}{tail}", von_mises(values), unit))
    return fields


def _mode(block: Block, values: Array) -> list[Field]:
    """Return the shape of a mode, whose size says nothing: its greatest displacement is one."""
    if block.name != "displacement":
        return []
    most = float(np.linalg.norm(values, axis=1).max(initial=0.0))
    return [Field(f"mode_{block.frame}", values / most if most else values, "1")]


def _tail(job: Job, block: Block) -> str:
    """Return what tells a step from others in a field's name; nothing where it is the only one."""
    if len(job.steps) < 2:
        return ""
    known = block.frame <= len(job.steps)
    name = job.steps[block.frame - 1].name if known else f"step {block.frame}"
    return "_" + re.sub(r"\W+", "_", name)


def main_field(fields: MeshFields) -> tuple[str, str]:
    """Return of which field a picture says most, and by which the shape is moved, or nothing."""
    for start in SHOWN:
        for name in fields.names:
            if name.startswith(start):
                moved = name.replace(VON_MISES, "displacement", 1)
                vector = moved in fields.names and fields[moved].values.ndim == 2
                return name, moved if vector else ""
    return fields.names[0], ""


def titled(field: Field) -> str:
    """Return a field's name and unit for people."""
    words = field.name.replace("_", " ").replace("von mises", "von Mises")
    return f"{words} / {field.unit}" if field.unit not in ("", "1") else words
