"""What comes of a recipe."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING

from porous.measures import Findings
from porous.values import Measures
from porous.values.value import Value

if TYPE_CHECKING:
    from collections.abc import Mapping

    from porous.certificate import Certificate
    from porous.measures import LocalThickness
    from porous.models.model import Model
    from porous.recipe import Recipe
    from porous.scale import StoredGrid
    from porous.stages import StreamedSurface
    from porous.values import Job, SurfaceMesh, VolumeMesh, VoxelGrid


@dataclass(frozen=True)
class Origin(Value):
    """The file that was read.

    Parameters
    ----------
    name
        Of the file, without its folders; of a store of voxels that of the folder.
    sha256
        Of its bytes; nothing of a folder.
    size
        In bytes.
    """

    name: str
    sha256: str = ""
    size: int = 0


@dataclass(frozen=True, eq=False)
class Result(Value):
    """What came of a recipe; None where a stage was not asked for.

    Parameters
    ----------
    recipe, model
        What was asked for.
    grid, surface, volume, job
        What the stages made; where memory would not hold them, a grid in a store, and what is known
        of a surface in a file.
    measures
        Of all of these; closed forms beside what was measured.
    certificate
        Model, grid, surface and mesh held against each other.
    times
        Seconds that each stage took.
    notes
        What was decided on the way and what the user should know.
    findings
        What a survey found, where the recipe is measured in full; its measures are among
        ``measures`` too.
    maps
        How wide pores and how thick walls are, voxel by voxel, by phase: ``"pore"`` and
        ``"solid"``; empty in brief.
    source
        The file that was measured, where there is no recipe.
    """

    recipe: Recipe | None
    model: Model | None = None
    grid: VoxelGrid | StoredGrid | None = None
    surface: SurfaceMesh | StreamedSurface | None = None
    volume: VolumeMesh | None = None
    job: Job | None = None
    measures: Measures = field(default_factory=Measures)
    certificate: Certificate | None = None
    times: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    findings: Findings = field(default_factory=Findings)
    maps: Mapping[str, LocalThickness] = field(default_factory=dict)
    source: Origin | None = None

    def __post_init__(self) -> None:
        for name in ("times", "maps"):
            self._set(name, MappingProxyType(dict(getattr(self, name))))
        self._set("notes", tuple(self.notes))
