"""Cells by name: every file builds one family of boundary representations and registers itself."""

from porous.models.builders._builder import Builder, Options, build_cell, builders, cell_names
from porous.models.builders._curve_section import CurveSection
from porous.models.builders._rules import Texture

__all__ = ["Builder", "CurveSection", "Options", "Texture", "build_cell", "builders", "cell_names"]
