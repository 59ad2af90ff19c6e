"""Linear elasticity by scikit-fem: what a deck's static step should come to."""

import numpy as np
import skfem
from skfem.helpers import ddot, div, sym_grad


def energy(job):
    """Return the strain energy of a job's step, in the mesh's own unit, and the reaction (3,).

    Tetrahedra are linear. Hexahedra are trilinear with the dilatation averaged over each cell
    (B-bar, Hughes 1980), as CalculiX has them: for boxes that is its value at the centre.
    """
    mesh, block = job.mesh, job.mesh.blocks[0]
    points = np.ascontiguousarray(mesh.points.T)
    if block.shape == "tet4":
        cells = np.ascontiguousarray(block.cells.T)
        m, element = skfem.MeshTet(points, cells), skfem.ElementTetP1()
    else:
        order = [0, 1, 3, 4, 2, 5, 7, 6]  # scikit-fem's corners in VTK's numbers
        cells = np.ascontiguousarray(block.cells[:, order].T)
        m, element = skfem.MeshHex(points, cells), skfem.ElementHex1()
    E, nu = job.material.youngs_modulus, job.material.poissons_ratio
    shear, bulk = E / (2 * (1 + nu)), E / (3 * (1 - 2 * nu))

    @skfem.BilinearForm
    def deviatoric(u, v, _):
        a, b = sym_grad(u), sym_grad(v)
        return 2 * shear * (ddot(a, b) - div(u) * div(v) / 3)

    @skfem.BilinearForm
    def volumetric(u, v, _):
        return bulk * div(u) * div(v)

    full = skfem.Basis(m, skfem.ElementVector(element), intorder=3)
    centre = skfem.Basis(m, skfem.ElementVector(element), intorder=1)
    K = deviatoric.assemble(full) + volumetric.assemble(centre)
    f = np.zeros(K.shape[0])
    for nodes, area in loaded(job):
        for axis in range(3):
            f[3 * nodes + axis] -= job.step.pressure * area[axis] / len(nodes)
    held = (3 * mesh.parts[job.step.fixed].members[:, None] + np.arange(3)).ravel()
    u = skfem.solve(*skfem.condense(K, f, D=held))
    return 0.5 * u @ f, -f.reshape(-1, 3).sum(axis=0)


def loaded(job):
    """Yield the nodes and the outward area vector of each loaded triangle or rectangle."""
    from porous.values import SHAPES

    block = job.mesh.blocks[0]
    for cell, local in job.mesh.parts[job.step.loaded].members:
        nodes = block.cells[cell][list(SHAPES[block.shape].faces[local])]
        p = job.mesh.points[nodes]
        yield nodes, np.cross(p[1] - p[0], p[2] - p[0]) * (0.5 if len(nodes) == 3 else 1.0)
