"""Read 3MF files with lib3mf, the consortium's own library, in strict mode; say what is in them."""

import json
import sys

import lib3mf
import numpy as np

CAPS = ("sphere", "hemisphere", "butt")
CLIPS = ("none", "inside", "outside")


def signed_volume(corners):
    a, b, c = np.moveaxis(corners - corners.reshape(-1, 3).mean(axis=0), 1, 0)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def lattice(mesh):
    beams = mesh.BeamLattice()
    found = beams.GetBeams()
    balls = beams.GetBalls() if beams.GetBallCount() else []
    mode, clip = beams.GetClipping()
    return {
        "beams": [list(beam.Indices) for beam in found],
        "radii": [list(beam.Radii) for beam in found],
        "caps": sorted({CAPS[cap] for beam in found for cap in beam.CapModes}),
        "balls": [ball.Index for ball in balls],
        "ball_radii": [ball.Radius for ball in balls],
        "shortest": beams.GetMinLength(),
        "clip": [CLIPS[int(mode)], clip],
    }


def described(path):
    model = lib3mf.get_wrapper().CreateModel()
    reader = model.QueryReader("3mf")
    reader.SetStrictModeActive(True)
    reader.ReadFromFile(path)
    warnings = [reader.GetWarning(i) for i in range(reader.GetWarningCount())]
    items = model.GetBuildItems()
    built = []
    while items.MoveNext():
        built.append(items.GetCurrent().GetObjectResourceID())
    rows = []
    meshes = model.GetMeshObjects()
    while meshes.MoveNext():
        mesh = meshes.GetCurrentMeshObject()
        points = np.array([list(v.Coordinates) for v in mesh.GetVertices()]).reshape(-1, 3)
        faces = np.array([list(t.Indices) for t in mesh.GetTriangleIndices()], int).reshape(-1, 3)
        beams = mesh.BeamLattice().GetBeamCount()
        rows.append(
            {
                "built": mesh.GetResourceID() in built,
                "points": len(points),
                "triangles": len(faces),
                "manifold": bool(mesh.IsManifoldAndOriented()) if len(faces) else None,
                "volume": signed_volume(points[faces]) if len(faces) else 0.0,
                "lower": points.min(axis=0).tolist(),
                "upper": points.max(axis=0).tolist(),
                "places": points.tolist() if beams else [],
                **(lattice(mesh) if beams else {}),
            }
        )
    metadata = model.GetMetaDataGroup()
    names = {
        metadata.GetMetaData(i).GetName(): metadata.GetMetaData(i).GetValue()
        for i in range(metadata.GetMetaDataCount())
    }
    return {"warnings": warnings, "unit": model.GetUnit().name, "meshes": rows, "names": names}


sys.stdout.write(json.dumps({path: described(path) for path in sys.argv[1:]}))
