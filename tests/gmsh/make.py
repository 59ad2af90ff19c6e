"""Make the meshes of this folder: two bricks side by side, 12 cells, by Gmsh 4.15.2.

Gmsh's wheel needs libraries of the desktop, so what it writes is kept here. Volume 9 in all.
"""

import os
from pathlib import Path

import gmsh

COUNTS = (2, 3, 4)
"""Points along the curves of each axis."""


def bricks(order=1, *, serendipity=False, hexahedra=True, groups=False, prisms=False):
    gmsh.clear()
    left = gmsh.model.occ.addBox(0, 0, 0, 2, 3, 1)
    right = gmsh.model.occ.addBox(2, 0, 0, 1, 3, 1)
    gmsh.model.occ.fragment([(3, left)], [(3, right)])
    gmsh.model.occ.synchronize()
    mesh = gmsh.model.mesh
    for dimension, curve in gmsh.model.getEntities(1):
        x, y, z, u, v, w = gmsh.model.getBoundingBox(dimension, curve)
        extents = (u - x, v - y, w - z)
        mesh.setTransfiniteCurve(curve, COUNTS[extents.index(max(extents))])
    for dimension, surface in gmsh.model.getEntities(2):
        mesh.setTransfiniteSurface(surface)
        z = gmsh.model.occ.getCenterOfMass(dimension, surface)[2]
        if hexahedra and not (prisms and z in (0.0, 1.0)):
            mesh.setRecombine(dimension, surface)
    for _, volume in gmsh.model.getEntities(3):
        mesh.setTransfiniteVolume(volume)
    volumes = [tag for _, tag in gmsh.model.getEntities(3)]
    gmsh.model.addPhysicalGroup(3, volumes, 7, "BODY")
    gmsh.model.addPhysicalGroup(2, [1], 9, "X MIN")
    if groups:
        gmsh.model.addPhysicalGroup(3, volumes[:1], 8, "LEFT")
    gmsh.option.setNumber("Mesh.SecondOrderIncomplete", int(serendipity))
    mesh.generate(3)
    mesh.setOrder(order)


def save(name, version=4.1, *, binary=False, parametric=False):
    gmsh.option.setNumber("Mesh.MshFileVersion", version)
    gmsh.option.setNumber("Mesh.Binary", int(binary))
    gmsh.option.setNumber("Mesh.SaveParametric", int(parametric))
    gmsh.write(name)


os.chdir(Path(__file__).parent)  # decks hold the path that they are written to
gmsh.initialize()
gmsh.option.setNumber("General.Terminal", 0)
bricks()
save("text-2.msh", 2.2)
save("binary-2.msh", 2.2, binary=True)
save("text-4.msh")
save("binary-4.msh", binary=True)
save("parametric-4.msh", parametric=True)
save("bricks.inp")
bricks(2)
save("hexahedra-27.msh", 2.2, binary=True)
bricks(2, serendipity=True)
save("hexahedra-20.msh", binary=True)
save("hexahedra-20.inp")
bricks(groups=True)
save("groups.msh", 2.2)
bricks(2, hexahedra=False)
save("tetrahedra-10.msh", binary=True)
bricks(prisms=True)
save("prisms.msh")
save("prisms-2.msh", 2.2, binary=True)
