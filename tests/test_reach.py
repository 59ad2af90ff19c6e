"""How far out bodies are served: rounding stays below what the kernels' boxes are larger by."""

import numpy as np
import pytest

import porous as po
from porous.errors import ModelError
from porous.kernels import cell_cover, cover, overlap
from porous.models import reach


def covered(shift):
    """Return the cover of a Sierpinski tetrahedron so far out along all axes."""
    corners = np.vstack([np.zeros(3), np.eye(3)]) + shift
    maps = [(np.eye(3) / 2, corner / 2) for corner in corners]
    box = po.Box((shift,) * 3, (shift + 1,) * 3)
    return po.voxelize(po.ifs(maps, level="limit", domain=box), voxels=16, sampling="cover").fill


def test_covers_are_served_as_long_as_every_kernel_covers_rounding():
    assert min(cell_cover.SLACK, cover.SLACK, overlap.SLACK) == reach.CERTAIN


@pytest.mark.parametrize("exponent", [4, 10, 16])
def test_a_shift_by_a_power_of_two_moves_no_voxel(exponent):
    assert np.array_equal(covered(0.0), covered(2.0**exponent))


def test_too_far_is_refused_with_what_would_do():
    with pytest.raises(ModelError, match="origin"):
        covered(1e9)
