"""Whether a cell may be taken for one with the symmetry of the cube, before and after."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from porous.errors import MeshError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from porous.values import VolumeMesh
    from porous.values.ties import Ties

SAME = 1e-6
"""Places closer than this part of the period are one."""
ALIKE = 0.01
"""Stresses that symmetry makes equal, or nothing, may differ by this part of the greatest: voxels
need not have the symmetry of the body that they were sampled from."""
ANOTHER = 'wanted simulation.symmetry = "none", which takes all load cases'


def check_cubic(mesh: VolumeMesh, tied: Ties, pairs: Sequence[str], made_of: Sequence[str]) -> None:
    """Refuse a cell that is not the same along x, y and z.

    Its periods are to be equal and along the axes, and turning it about its diagonal, so that x
    becomes y, y z and z x, is to lead the middles of its cells onto each other, of each material.

    Parameters
    ----------
    mesh
        Any.
    tied
        What its three parts of pairs tie.
    pairs, made_of
        Names of these parts, and of those of cells that are of a material each.

    Raises
    ------
    MeshError
        Says what differs.
    """
    if len(tied.periods) < len(pairs):
        raise MeshError(f'symmetry = "cubic": nothing goes on along some of the axes; {ANOTHER}')
    length = float(tied.periods[0, 0])
    if not np.allclose(tied.periods, length * np.eye(3), rtol=0, atol=SAME * length):
        told = " × ".join(f"{np.linalg.norm(period):.6g}" for period in tied.periods)
        raise MeshError(
            f'symmetry = "cubic": the cell is {told} {mesh.unit}, no cube along the axes; {ANOTHER}'
        )
    origin = [
        mesh.points[mesh.parts[name].members[:, 0], axis].mean() for axis, name in enumerate(pairs)
    ]
    middles = np.concatenate([mesh.points[block.cells].mean(axis=1) for block in mesh.blocks])
    material = np.zeros(mesh.cells, np.int64)
    for number, name in enumerate(made_of):
        material[mesh.parts[name].members] = number
    lost = _lost(middles - origin, material, SAME * length)
    if lost:
        raise MeshError(
            f'symmetry = "cubic": the cell is not the same along x, y and z: {lost} of '
            f"{mesh.cells} elements lie elsewhere when it is turned about its diagonal; {ANOTHER}"
        )


def _lost(middles: NDArray[np.float64], material: NDArray[np.int64], reach: float) -> int:
    from scipy.spatial import cKDTree

    far, which = cKDTree(middles).query(middles[:, [1, 2, 0]])
    return int(((far > reach) | (material[which] != material)).sum())


def check_stresses(normal: NDArray[np.float64], shear: NDArray[np.float64]) -> None:
    """Refuse mean stresses that no body with the symmetry of the cube has.

    Parameters
    ----------
    normal, shear
        Six stresses in Voigt's order each, of the strains xx and yz.

    Raises
    ------
    MeshError
        Says by how much they differ.
    """
    wrong = np.abs([normal[1] - normal[2], *normal[3:], *shear[:3], *shear[4:]])
    most = float(wrong.max() / np.abs(normal).max(initial=1e-300))
    if most > ALIKE:
        raise MeshError(
            f'symmetry = "cubic": the cell has not the symmetry of the cube: stresses that are '
            f"equal or nothing then differ by {100 * most:.2g} % of the greatest; {ANOTHER}"
        )
