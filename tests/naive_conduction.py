"""Steady conduction by scikit-fem: what a deck's step of heat should come to."""

import numpy as np
import skfem
from skfem.helpers import dot, grad

KINDS = {
    "tet4": (4, skfem.MeshTet, skfem.ElementTetP1(), [0, 1, 2, 3]),
    "hex8": (8, skfem.MeshHex, skfem.ElementHex1(), [0, 1, 3, 4, 2, 5, 7, 6]),
    "tet10": (4, skfem.MeshTet, skfem.ElementTetP2(), [0, 1, 2, 3]),
    "hex20": (8, skfem.MeshHex, skfem.ElementHexS2(), [0, 1, 3, 4, 2, 5, 7, 6]),
}
"""Corners, scikit-fem's mesh and element, and its corners in our numbers."""


def heat_flow(job, axis):
    """Return the heat that flows between the sides of a box at 0 and 1 K, lengths in mm.

    The sides are found by coordinates. Between 0 and 1 K it is the energy, the integral of λ|∇T|².
    """
    (block,) = job.mesh.blocks
    count, kind, element, order = KINDS[block.shape]
    used, cells = np.unique(block.cells[:, :count], return_inverse=True)
    cells = cells.reshape(-1, count)[:, order]
    m = kind(np.ascontiguousarray(job.mesh.points[used].T), np.ascontiguousarray(cells.T))
    basis = skfem.Basis(m, element, intorder=4)
    conductivity = np.zeros(len(cells))
    for name, material in job.materials.items():
        conductivity[job.mesh.parts[name].members] = material.conductivity

    @skfem.BilinearForm
    def conduction(u, v, w):
        return w.conductivity * dot(grad(u), grad(v))

    field = basis.with_element(skfem.ElementTetP0() if count == 4 else skfem.ElementHex0())
    K = conduction.assemble(basis, conductivity=field.interpolate(conductivity))
    x = m.p[axis]
    low, high = (
        basis.get_dofs(m.facets_satisfying(lambda x, end=end: np.isclose(x[axis], end), True)).all()
        for end in (x.min(), x.max())
    )
    temperature = np.zeros(K.shape[0])
    temperature[high] = 1.0
    temperature = skfem.solve(*skfem.condense(K, x=temperature, D=np.union1d(low, high)))
    return temperature @ K @ temperature
