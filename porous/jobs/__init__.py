"""What is simulated: an analysis makes a job of a mesh; materials come from presets.

An analysis is one file ``_<analysis>.py`` of this folder, and nothing else anywhere. It holds its
table of a recipe, a ``SimulationSection`` with ``analysis: Literal["<analysis>"]``, and::

    def prepare(mesh: VolumeMesh, section: ItsSection) -> Job: ...
"""

from porous.jobs._analyses import prepare, section_of, sections
from porous.jobs._block import why_no_block
from porous.jobs._compression import compression
from porous.jobs._diffusion import diffusion, effective_diffusivity
from porous.jobs._effective import effective
from porous.jobs._flow import flow, permeability
from porous.jobs._material import material
from porous.jobs._results import results
from porous.jobs._section import SimulationSection, TwoPhaseSection

__all__ = [
    "SimulationSection",
    "TwoPhaseSection",
    "compression",
    "diffusion",
    "effective",
    "effective_diffusivity",
    "flow",
    "material",
    "permeability",
    "prepare",
    "results",
    "section_of",
    "sections",
    "why_no_block",
]
