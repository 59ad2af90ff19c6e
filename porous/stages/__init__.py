"""One step each: from model to voxels, from voxels to a surface, from a surface to a mesh."""

from porous.stages._extract_surface import extract_surface

__all__ = ["extract_surface"]
