"""The front of sampling: which points of which voxels lie in what a model is made of."""

from __future__ import annotations

from porous.models.lattice import fill_digits, sample_digits

__all__ = ["fill_digits", "sample_digits"]
