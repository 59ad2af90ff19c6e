"""One step each: from model to voxels, from voxels to a surface, from a surface to a mesh."""

from porous.stages._beams import beams
from porous.stages._branches import branches
from porous.stages._clean import Cleaned, CleanStep, clean
from porous.stages._exact_surface import exact_surface
from porous.stages._extract_surface import extract_surface
from porous.stages._hexahedralize import hexahedralize
from porous.stages._mesh_cells import mesh_cells
from porous.stages._name_parts import name_parts
from porous.stages._pairs import periodic_pairs
from porous.stages._phases import phase_alone, tetrahedralize_phases
from porous.stages._quadratic import quadratic
from porous.stages._sampled import SampledModel
from porous.stages._simplify import simplify
from porous.stages._sizing import Finer
from porous.stages._smooth import smooth
from porous.stages._stream_surface import StreamedSurface, stream_surface
from porous.stages._tetrahedralize import tetrahedralize
from porous.stages._voxelize import fit_frame, voxelize
from porous.stages._warp import warp_grid, warp_mesh

__all__ = [
    "CleanStep",
    "Cleaned",
    "Finer",
    "SampledModel",
    "StreamedSurface",
    "beams",
    "branches",
    "clean",
    "exact_surface",
    "extract_surface",
    "fit_frame",
    "hexahedralize",
    "mesh_cells",
    "name_parts",
    "periodic_pairs",
    "phase_alone",
    "quadratic",
    "simplify",
    "smooth",
    "stream_surface",
    "tetrahedralize",
    "tetrahedralize_phases",
    "voxelize",
    "warp_grid",
    "warp_mesh",
]
