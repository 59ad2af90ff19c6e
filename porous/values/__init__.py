"""What flows: frozen values of numpy arrays and plain numbers, validated at the door."""

from porous.values.beams import BeamLattice
from porous.values.box import Box
from porous.values.curve import Curve
from porous.values.fields import Field, MeshFields
from porous.values.frame import Frame
from porous.values.grid import VoxelGrid
from porous.values.hex_mesh import HexMesh
from porous.values.image import Image
from porous.values.job import Held, Job, Material, Pressed, Step
from porous.values.measure import Measure, Measures
from porous.values.pattern import CENTRE, FILL, Pattern
from porous.values.surface import SurfaceMesh
from porous.values.tiled import Tiled
from porous.values.volume_mesh import SHAPES, Block, Part, VolumeMesh
from porous.values.voxel_maps import VoxelMaps

__all__ = [
    "CENTRE",
    "FILL",
    "SHAPES",
    "BeamLattice",
    "Block",
    "Box",
    "Curve",
    "Field",
    "Frame",
    "Held",
    "HexMesh",
    "Image",
    "Job",
    "Material",
    "Measure",
    "Measures",
    "MeshFields",
    "Part",
    "Pattern",
    "Pressed",
    "Step",
    "SurfaceMesh",
    "Tiled",
    "VolumeMesh",
    "VoxelGrid",
    "VoxelMaps",
]
