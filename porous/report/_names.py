"""What measures are called by people."""

from __future__ import annotations

import re

KEYS = (
    ("porosity", "porosity"),
    ("open_porosity", "open porosity"),
    ("closed_porosity", "closed porosity"),
    ("accessible_porosity", "porosity that balls of the probe reach"),
    ("specific_surface_area", "specific surface area"),
    ("pore_thickness_p50", "pore size D50"),
    ("largest_pore_diameter", "largest pore"),
    ("pore_chord_mean", "mean pore chord"),
    ("wall_thickness_p50", "wall thickness D50"),
    ("smallest_wall", "thinnest wall"),
    ("smallest_gap", "narrowest gap"),
    ("components", "pieces of solid"),
    ("genus", "independent tunnels"),
    ("coordination_number_mean", "throats of a pore, on average"),
    ("box_dimension", "box dimension"),
    ("percolation_diameter_x", "widest ball that passes along x"),
    ("percolation_diameter_y", "widest ball that passes along y"),
    ("percolation_diameter_z", "widest ball that passes along z"),
    ("geometric_tortuosity_x", "geometric tortuosity along x"),
    ("geometric_tortuosity_y", "geometric tortuosity along y"),
    ("geometric_tortuosity_z", "geometric tortuosity along z"),
    ("thin_wall_share", "walls thinner than the machine makes, part of the solid"),
    ("narrow_gap_share", "gaps narrower than the machine leaves, part of the pores"),
    ("trapped_volume", "volume that nothing gets out of"),
)
"""What the first table has of what there is, and what it calls it."""

CLOSED = "closed form"

FORMS = {
    "smallest_wall": "smallest_feature",
    "smallest_gap": "smallest_pore",
    "box_dimension": "similarity_dimension",
}
"""Closed forms of the model of another name that stand beside what is measured. Cells that touch
make walls that are thicker than any of them, and few sizes make a slope: they need not agree."""

LABELS = dict(KEYS)
DIRECTION = re.compile(r"(\w+?)_([xyz])_(up|down)")
AXIS = re.compile(r"(\w+?)_([xyz])")
PART = re.compile(r"(\w+?)_p(\d\d)")
SIGNS = {"up": "+", "down": "−"}


def called(name: str) -> str:
    """Return what a measure is called in sentences and tables for people."""
    if name in LABELS:
        return LABELS[name]
    if found := DIRECTION.fullmatch(name):
        return f"{_words(found[1])}, built along {SIGNS[found[3]]}{found[2]}"
    if found := AXIS.fullmatch(name):
        return f"{_words(found[1])} along {found[2]}"
    if found := PART.fullmatch(name):
        return f"{_words(found[1])} D{found[2]}"
    return _words(name)


def _words(name: str) -> str:
    return name.replace("_", " ")
