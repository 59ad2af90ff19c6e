"""What the ``[simulation]`` tables of all analyses have in common, and what is read out of them."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from porous import presets
from porous.errors import MeshError, nearest
from porous.jobs._material import check_known, material, read_material
from porous.jobs._through import walled
from porous.models.sections import Section
from porous.toml import read_table
from porous.values.volume_topology import extracted

if TYPE_CHECKING:
    from collections.abc import Mapping

    from porous.values import Material, VolumeMesh

PHASES = {"solid": "SOLID", "pore": "PORE"}
"""The parts of cells that the phases are."""


def _known(name: str | Path) -> str | Path:
    """Return the name of a material of the presets, or the path of one of the user's own."""
    if str(name).endswith(presets.SUFFIX):
        return Path(name)
    there = presets.material_names()
    if name not in there:
        known = nearest(str(name), there)
        stop = "" if known.endswith("?") else "."
        raise ValueError(
            f"no material {name!r}{known}{stop} A file of your own ends in {presets.SUFFIX}"
        )
    return name


def _writable(suffix: str) -> str:
    """Return the suffix of a format that steps can be written in."""
    from porous.formats import formats

    there = {form.suffix[1:] for form in formats() if form.procedures}
    if suffix.removeprefix(".") not in there:
        raise ValueError(f"no deck {suffix!r}{nearest(suffix, there)}")
    return suffix.removeprefix(".")


MaterialName = Annotated[str | Path, AfterValidator(_known)]
"""The name of a material of the presets, or the path of a file, relative to the recipe."""

Axis = Literal["x", "y", "z"]


class SimulationSection(Section):
    """What all analyses are told; each adds its own keys in a file of its own."""

    PHASE: ClassVar[Literal["solid", "pore", "both"]] = "solid"
    """What is simulated: one phase, or both at once where the mesh has both."""
    DECK: ClassVar[str] = "inp"
    """The suffix of the deck that is written unasked."""
    PROCEDURES: ClassVar[tuple[str, ...]] = ("static",)
    """What its steps may be, of ``values.job.PROCEDURES``: every deck must hold them."""

    material: MaterialName = Field(
        default="steel",
        description="the name of a material, or a path to a TOML file, relative to the recipe",
    )
    units: Literal["mm-N-MPa", "m-SI"] = Field(
        default="mm-N-MPa",
        description='"mm-N-MPa" or "m-SI": the units that decks are written in',
    )
    decks: Annotated[tuple[Annotated[str, AfterValidator(_writable)], ...], Field(strict=False)] = (
        Field(default=(), description="a list of suffixes: decks to write besides the default")
    )

    @model_validator(mode="after")
    def _decks_hold_it(self) -> Self:
        from porous.formats import formats

        there = {form.suffix[1:]: form.procedures for form in formats()} if self.decks else {}
        homes = [name for name, held in there.items() if set(self.PROCEDURES) <= set(held)]
        for suffix in self.decks:
            if suffix not in homes:
                raise ValueError(
                    f"decks: a .{suffix} file cannot hold a step of "
                    f"{' and '.join(self.PROCEDURES)}; wanted some of {', '.join(homes)}"
                )
        return self

    @property
    def suffixes(self) -> tuple[str, ...]:
        """The suffixes of all decks, without dots, the default first."""
        return tuple(dict.fromkeys((self.DECK, *self.decks)))


class TwoPhaseSection(SimulationSection):
    """An analysis of both phases, where the pores are filled with a material."""

    PHASE: ClassVar[Literal["solid", "pore", "both"]] = "both"

    pore_material: MaterialName | None = Field(
        default=None,
        description="the name or path of a material that fills the pores; where it is missing, "
        "they are empty",
    )


def substance(name: str | Path) -> Material:
    """Return the material that a section names, in mm-t-s-K.

    One of the user's own is called by its title: the file has another name in the folder that
    ``porous make`` fills.

    Raises
    ------
    RecipeError
        Where the file is missing or not understood.
    """
    if isinstance(name, str):
        return material(name)
    title = str(read_table(name).get("title", ""))
    slug = re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")
    return replace(read_material(name), name=slug or "material")


def phases(
    mesh: VolumeMesh, section: SimulationSection
) -> tuple[VolumeMesh, Mapping[str, Material]]:
    """Return the cells that an analysis is about, and by their parts what they are made of.

    A mesh without a part ``PORE`` is solid throughout.

    Raises
    ------
    MeshError
        Where the mesh has no cells of the phase.
    RecipeError
        For a material's file that cannot be understood.
    """
    filling = getattr(section, "pore_material", None)
    wanted = {"pore": substance(section.material)} if section.PHASE == "pore" else {}
    if section.PHASE != "pore":
        wanted["solid"] = substance(section.material)
    if filling is not None:
        wanted["pore"] = substance(filling)
    for phase, found in wanted.items():
        check_known(found, section.PROCEDURES)
        if PHASES[phase] not in mesh.parts:
            raise MeshError(
                f"simulation: the volume mesh has no part {PHASES[phase]}, cells of the {phase}; "
                f"it has {', '.join(sorted(mesh.parts)) or 'no parts'}"
            )
    materials = {PHASES[phase]: found for phase, found in wanted.items()}
    return _of_phases(mesh, tuple(materials)), materials


def _of_phases(mesh: VolumeMesh, names: tuple[str, ...]) -> VolumeMesh:
    import numpy as np

    chosen = np.zeros(mesh.cells, dtype=bool)
    for name in names:
        chosen[mesh.parts[name].members] = True
    return mesh if chosen.all() else walled(extracted(mesh, chosen))
