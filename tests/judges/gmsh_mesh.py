"""What Gmsh finds in meshes: elements, groups, volume by quadrature, orientation, periodicity.

With ``--back`` it also writes each mesh again beside it, as ``…-back.msh``, in the same version.
"""

import json
import sys

import gmsh

SHAPES = {4: "tet4", 5: "hex8", 6: "wed6", 11: "tet10", 17: "hex20"}


def volume(entity=-1):
    total, least = 0.0, float("inf")
    for kind in gmsh.model.mesh.getElementTypes(3, entity):
        points, weights = gmsh.model.mesh.getIntegrationPoints(kind, "Gauss3")
        _, factors, _ = gmsh.model.mesh.getJacobians(kind, points, entity)
        total += sum(f * weights[i % len(weights)] for i, f in enumerate(factors))
        tags, _ = gmsh.model.mesh.getElementsByType(kind, entity)
        least = min(least, *gmsh.model.mesh.getElementQualities(tags, "minDetJac"))
    return total, least


def flux(entity):
    """Integrate x · n: three times the volume, over a surface that is seen from outside."""
    total, number = 0.0, 0
    for kind in gmsh.model.mesh.getElementTypes(2, entity):
        points, weights = gmsh.model.mesh.getIntegrationPoints(kind, "Gauss3")
        jacobians, factors, places = gmsh.model.mesh.getJacobians(kind, points, entity)
        number += len(gmsh.model.mesh.getElementsByType(kind, entity)[0])
        for i in range(len(factors)):
            (a, b, c, d, e, f), x = jacobians[9 * i : 9 * i + 6], places[3 * i : 3 * i + 3]
            normal = (b * f - c * e, c * d - a * f, a * e - b * d)
            total += weights[i % len(weights)] * sum(p * q for p, q in zip(x, normal, strict=True))
    return total, number


def judge(path, back):
    gmsh.clear()
    gmsh.logger.start()
    gmsh.open(path)
    said = [line for line in gmsh.logger.get() if line.startswith(("Error", "Warning"))]
    gmsh.logger.stop()
    found = {"complaints": said, "nodes": len(gmsh.model.mesh.getNodes()[0]), "elements": {}}
    for kind in gmsh.model.mesh.getElementTypes(3):
        found["elements"][SHAPES[kind]] = len(gmsh.model.mesh.getElementsByType(kind)[0])
    found["volume"], found["least"] = volume()
    sets = {0: {}, 2: {}, 3: {}}
    fluxes = {}
    for dimension, tag in gmsh.model.getPhysicalGroups():
        name = gmsh.model.getPhysicalName(dimension, tag)
        entities = gmsh.model.getEntitiesForPhysicalGroup(dimension, tag)
        rows = [gmsh.model.mesh.getElements(dimension, e)[1] for e in entities]
        sets[dimension][name] = sum(len(tags) for row in rows for tags in row)
        if dimension == 2:
            fluxes[name] = sum(flux(entity)[0] for entity in entities)
    found |= {"node_sets": sets[0], "face_sets": sets[2], "cell_sets": sets[3], "flux": fluxes}
    found["periodic"] = []
    for dimension, tag in gmsh.model.getEntities(2):
        master, slaves, masters, _ = gmsh.model.mesh.getPeriodicNodes(dimension, tag)
        if master != tag:
            places = [
                [gmsh.model.mesh.getNode(node)[0].tolist() for node in nodes]
                for nodes in (masters, slaves)
            ]
            found["periodic"].append({"masters": places[0], "slaves": places[1]})
    if back:
        gmsh.option.setNumber("Mesh.MshFileVersion", 2.2 if path.endswith(".msh2") else 4.1)
        gmsh.write(path.rsplit(".", 1)[0] + "-back.msh")
    return found


paths = [word for word in sys.argv[1:] if word != "--back"]
gmsh.initialize(interruptible=False)
gmsh.option.setNumber("General.Terminal", 0)
results = [judge(path, "--back" in sys.argv) for path in paths]
gmsh.finalize()
json.dump(results[0] if len(results) == 1 else results, sys.stdout)
