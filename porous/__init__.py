"""Volumetric porous materials: recipe in; analysed, printable, simulation-ready geometry out."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from porous import measures
    from porous.adapters import to_porespy, to_pyvista, to_skfem, to_taufactor, to_trimesh
    from porous.certificate import Certificate
    from porous.errors import (
        Cancelled,
        DiskError,
        FormatError,
        GridError,
        GuestError,
        MemoryLimitError,
        MeshError,
        ModelError,
        PorousError,
        RecipeError,
        ViewError,
    )
    from porous.formats import read, read_image, write
    from porous.models.bcifs import bcifs
    from porous.models.cifs import cifs
    from porous.models.ifs import CutSet, ifs
    from porous.models.image import segment
    from porous.models.rough import Skin, rough
    from porous.models.tree import tree
    from porous.models.warp import warp
    from porous.pipeline import Result, run
    from porous.recipe import Recipe, build, load
    from porous.report import write_report
    from porous.scale import StoredGrid
    from porous.stages import (
        Finer,
        beams,
        branches,
        clean,
        exact_surface,
        extract_surface,
        hexahedralize,
        mesh_cells,
        name_parts,
        periodic_pairs,
        phase_alone,
        quadratic,
        simplify,
        smooth,
        stream_surface,
        tetrahedralize,
        tetrahedralize_phases,
        voxelize,
        warp_grid,
        warp_mesh,
    )
    from porous.values import (
        BeamLattice,
        Box,
        Frame,
        Image,
        Job,
        Material,
        Measure,
        Measures,
        SurfaceMesh,
        VolumeMesh,
        VoxelGrid,
    )
    from porous.view import show
    from porous.workspace import compare, make, make_stored, resume, solve

_HOMES = {
    "adapters": ("to_porespy", "to_pyvista", "to_skfem", "to_taufactor", "to_trimesh"),
    "certificate": ("Certificate",),
    "errors": (
        "Cancelled",
        "DiskError",
        "FormatError",
        "GridError",
        "GuestError",
        "MemoryLimitError",
        "MeshError",
        "ModelError",
        "PorousError",
        "RecipeError",
        "ViewError",
    ),
    "formats": ("read", "read_image", "write"),
    "models.bcifs": ("bcifs",),
    "models.cifs": ("cifs",),
    "models.ifs": ("CutSet", "ifs"),
    "models.image": ("segment",),
    "models.rough": ("Skin", "rough"),
    "models.tree": ("tree",),
    "models.warp": ("warp",),
    "pipeline": ("Result", "run"),
    "recipe": ("Recipe", "build", "load"),
    "report": ("write_report",),
    "scale": ("StoredGrid",),
    "stages": (
        "Finer",
        "beams",
        "branches",
        "clean",
        "exact_surface",
        "extract_surface",
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
    ),
    "values": (
        "BeamLattice",
        "Box",
        "Frame",
        "Image",
        "Job",
        "Material",
        "Measure",
        "Measures",
        "SurfaceMesh",
        "VolumeMesh",
        "VoxelGrid",
    ),
    "view": ("show",),
    "workspace": ("compare", "make", "make_stored", "resume", "solve"),
}
_HOME = {name: home for home, names in _HOMES.items() for name in names}

__all__ = [
    "BeamLattice",
    "Box",
    "Cancelled",
    "Certificate",
    "CutSet",
    "DiskError",
    "Finer",
    "FormatError",
    "Frame",
    "GridError",
    "GuestError",
    "Image",
    "Job",
    "Material",
    "Measure",
    "Measures",
    "MemoryLimitError",
    "MeshError",
    "ModelError",
    "PorousError",
    "Recipe",
    "RecipeError",
    "Result",
    "Skin",
    "StoredGrid",
    "SurfaceMesh",
    "ViewError",
    "VolumeMesh",
    "VoxelGrid",
    "bcifs",
    "beams",
    "branches",
    "build",
    "cifs",
    "clean",
    "compare",
    "exact_surface",
    "extract_surface",
    "hexahedralize",
    "ifs",
    "load",
    "make",
    "make_stored",
    "measures",
    "mesh_cells",
    "name_parts",
    "periodic_pairs",
    "phase_alone",
    "quadratic",
    "read",
    "read_image",
    "resume",
    "rough",
    "run",
    "segment",
    "show",
    "simplify",
    "smooth",
    "solve",
    "stream_surface",
    "tetrahedralize",
    "tetrahedralize_phases",
    "to_porespy",
    "to_pyvista",
    "to_skfem",
    "to_taufactor",
    "to_trimesh",
    "tree",
    "voxelize",
    "warp",
    "warp_grid",
    "warp_mesh",
    "write",
    "write_report",
]


def __getattr__(name: str) -> Any:
    if name == "measures":
        return import_module("porous.measures")
    if name not in _HOME:
        raise AttributeError(f"module 'porous' has no attribute {name!r}")
    value = getattr(import_module(f"porous.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
