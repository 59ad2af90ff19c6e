"""What is simulated: an analysis makes a job of a mesh; materials come from presets."""

from porous.jobs._compression import compression
from porous.jobs._material import material

__all__ = ["compression", "material"]
