"""Volumetric porous materials: recipe in; analysed, printable, simulation-ready geometry out."""
