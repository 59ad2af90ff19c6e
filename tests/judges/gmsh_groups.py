"""Two boxes one upon the other, with groups, periodic along x, as Gmsh writes them in a folder.

Prints the files, the volume of the upper box, how many pairs of nodes there are, and of each group
its kind and size.
"""

import json
import sys

import gmsh

gmsh.initialize(interruptible=False)
gmsh.option.setNumber("General.Terminal", 0)
model = gmsh.model
boxes = [model.occ.addBox(0, 0, 0, 1, 2, 3), model.occ.addBox(0, 0, 3, 1, 2, 0.5)]
model.occ.fragment([(3, boxes[0])], [(3, boxes[1])])
model.occ.synchronize()


def at(dimension, axis, value):
    found = []
    for one, tag in model.getEntities(dimension):
        box = model.getBoundingBox(one, tag)
        if abs(box[axis] - value) < 1e-5 and abs(box[axis + 3] - value) < 1e-5:
            found.append(tag)
    return found


model.mesh.setPeriodic(
    2, at(2, 0, 1), at(2, 0, 0), [1, 0, 0, 1, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]
)
upper = [tag for _, tag in model.getEntities(3) if model.occ.getCenterOfMass(3, tag)[2] > 3]
lower = [tag for _, tag in model.getEntities(3) if tag not in upper]
groups = {
    "Above": (3, upper),
    "Below": (3, lower),
    "Bottom": (2, at(2, 2, 0)),
    "Between": (2, at(2, 2, 3)),
    "Sides": (2, at(2, 0, 0) + at(2, 0, 1)),
    "Held": (0, at(0, 2, 0)),
}
for name, (dimension, tags) in groups.items():
    model.setPhysicalName(dimension, model.addPhysicalGroup(dimension, tags), name)
gmsh.option.setNumber("Mesh.MeshSizeMax", 0.6)
model.mesh.generate(3)

KINDS = {0: "nodes", 2: "faces", 3: "cells"}
found = {}
for name, (dimension, tags) in groups.items():
    rows = [model.mesh.getElements(dimension, tag)[1] for tag in tags]
    found[name] = (KINDS[dimension], sum(len(some) for row in rows for some in row))
pairs = set()
for tag in at(2, 0, 1):
    _, slaves, masters, _ = model.mesh.getPeriodicNodes(2, tag)
    pairs |= set(zip(slaves.tolist(), masters.tolist(), strict=True))
files = []
for version, binary in ((4.1, 0), (4.1, 1), (2.2, 0), (2.2, 1)):
    gmsh.option.setNumber("Mesh.MshFileVersion", version)
    gmsh.option.setNumber("Mesh.Binary", binary)
    files.append(f"{sys.argv[1]}/groups-{version}-{binary}.msh")
    gmsh.write(files[-1])
gmsh.option.setNumber("Mesh.MshFileVersion", 4.1)
gmsh.option.setNumber("Mesh.Binary", 0)
model.mesh.setOrder(2)
files.append(f"{sys.argv[1]}/groups-quadratic.msh")
gmsh.write(files[-1])
json.dump({"files": files, "volume": 1.0, "pairs": len(pairs), "groups": found}, sys.stdout)
gmsh.finalize()
