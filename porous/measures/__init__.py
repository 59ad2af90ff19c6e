"""What is known: one function per measure, and ``measure`` for all that a subject can tell.

Measures of a grid are folds: counts of tiles that add up, and what follows from their sum.
"""

from porous.measures._betti import betti_numbers, connectivity_density
from porous.measures._blocks import OverBlocks, over_blocks
from porous.measures._boxes import box_counts, box_dimension
from porous.measures._census import Census
from porous.measures._chords import (
    ChordLengths,
    Chords,
    LinealPath,
    chord_lengths,
    chords,
    pore_chord_mean,
    wall_chord_mean,
)
from porous.measures._correlation import TwoPoint, correlation_length, two_point
from porous.measures._drain_path import drain_path_length
from porous.measures._fold import Journal, fold, tiles_of
from porous.measures._fractal import (
    generalised_dimensions,
    gliding_boxes,
    lacunarity,
    succolarity,
)
from porous.measures._hausdorff import hausdorff_distance
from porous.measures._intercept import Intercepts, fabric, intercepts
from porous.measures._intrusion import (
    MercuryIntrusion,
    accessible_porosity,
    mercury_intrusion,
    percolation_diameters,
)
from porous.measures._islands import islands
from porous.measures._measure import COUNTED, measure
from porous.measures._mesh import (
    largest_aspect_ratio,
    largest_dihedral_angle,
    largest_edge_ratio,
    smallest_dihedral_angle,
    smallest_scaled_jacobian,
)
from porous.measures._model import (
    affinity_dimension,
    finest_printable_level,
    similarity_dimension,
    smallest_feature,
    smallest_pore,
)
from porous.measures._network import PoreNetwork, pore_network
from porous.measures._overhangs import overhangs
from porous.measures._pores import (
    closed_porosity,
    open_porosity,
    through_porosity_x,
    through_porosity_y,
    through_porosity_z,
)
from porous.measures._porosity import porosity, relative_density
from porous.measures._printability import narrow_gap_share, thin_wall_share
from porous.measures._probes import line_probes
from porous.measures._roughness import (
    HeightMap,
    Variogram,
    height_map,
    roughness,
    roughness_of_sides,
    variogram,
)
from porous.measures._sample import Family, Findings, Sample, Survey
from porous.measures._sizes import size_curves, sizes
from porous.measures._statistics import chord_curves, correlation_curves
from porous.measures._surface_area import (
    interface_area,
    specific_surface_area,
    surface_area,
)
from porous.measures._survey import families, survey
from porous.measures._thickness import LocalThickness, local_thickness, thicknesses
from porous.measures._topology import (
    components,
    components_26,
    euler_number,
    euler_number_26,
    genus,
    genus_26,
)
from porous.measures._tortuosity import geometric_tortuosity
from porous.measures._trapped import cupped_volume, trapped_volume
from porous.measures._volume import volume

__all__ = [
    "COUNTED",
    "Census",
    "ChordLengths",
    "Chords",
    "Family",
    "Findings",
    "HeightMap",
    "Intercepts",
    "Journal",
    "LinealPath",
    "LocalThickness",
    "MercuryIntrusion",
    "OverBlocks",
    "PoreNetwork",
    "Sample",
    "Survey",
    "TwoPoint",
    "Variogram",
    "accessible_porosity",
    "affinity_dimension",
    "betti_numbers",
    "box_counts",
    "box_dimension",
    "chord_curves",
    "chord_lengths",
    "chords",
    "closed_porosity",
    "components",
    "components_26",
    "connectivity_density",
    "correlation_curves",
    "correlation_length",
    "cupped_volume",
    "drain_path_length",
    "euler_number",
    "euler_number_26",
    "fabric",
    "families",
    "finest_printable_level",
    "fold",
    "generalised_dimensions",
    "genus",
    "genus_26",
    "geometric_tortuosity",
    "gliding_boxes",
    "hausdorff_distance",
    "height_map",
    "intercepts",
    "interface_area",
    "islands",
    "lacunarity",
    "largest_aspect_ratio",
    "largest_dihedral_angle",
    "largest_edge_ratio",
    "line_probes",
    "local_thickness",
    "measure",
    "mercury_intrusion",
    "narrow_gap_share",
    "open_porosity",
    "over_blocks",
    "overhangs",
    "percolation_diameters",
    "pore_chord_mean",
    "pore_network",
    "porosity",
    "relative_density",
    "roughness",
    "roughness_of_sides",
    "similarity_dimension",
    "size_curves",
    "sizes",
    "smallest_dihedral_angle",
    "smallest_feature",
    "smallest_pore",
    "smallest_scaled_jacobian",
    "specific_surface_area",
    "succolarity",
    "surface_area",
    "survey",
    "thicknesses",
    "thin_wall_share",
    "through_porosity_x",
    "through_porosity_y",
    "through_porosity_z",
    "tiles_of",
    "trapped_volume",
    "two_point",
    "variogram",
    "volume",
    "wall_chord_mean",
]
