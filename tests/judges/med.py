"""What SALOME's own reader finds in MED files: elements, groups, volume, orientation, unit."""

import json
import sys

import medcoupling as mc

SHAPES = {
    mc.NORM_TETRA4: "tet4",
    mc.NORM_HEXA8: "hex8",
    mc.NORM_PENTA6: "wed6",
    mc.NORM_TETRA10: "tet10",
    mc.NORM_HEXA20: "hex20",
}


def flux(mesh):
    """Integrate x · n over faces by their corners, as they are turned."""
    flat = mesh.deepCopy()
    if flat.getNumberOfCells() == 0:
        return 0.0
    flat.convertQuadraticCellsToLinear()
    normals = flat.buildOrthogonalField().getArray()
    areas = flat.getMeasureField(True).getArray()
    middle = flat.computeIsoBarycenterOfNodesPerCell()
    return sum(
        area * sum(a * b for a, b in zip(n, x, strict=True))
        for area, n, x in zip(
            areas.getValues(), normals.getValuesAsTuple(), middle.getValuesAsTuple(), strict=True
        )
    )


def bent(edges):
    """Return how far at most a node upon an edge lies from the edge's middle."""
    rows, places = edges.getNodalConnectivity().getValues(), edges.getCoords().getValuesAsTuple()
    assert set(rows[::4]) == {mc.NORM_SEG3}
    return max(
        abs((u + v) / 2 - w)
        for a, b, middle in zip(rows[1::4], rows[2::4], rows[3::4], strict=True)
        for u, v, w in zip(places[a], places[b], places[middle], strict=True)
    )


def judge(path):
    file = mc.MEDFileMesh.New(path)
    cells = file.getMeshAtLevel(0)
    linear = cells.deepCopy()
    linear.convertQuadraticCellsToLinear()
    found = {
        "name": file.getName(),
        "units": [file.getCoords().getInfoOnComponent(i) for i in range(3)],
        "nodes": cells.getNumberOfNodes(),
        "elements": {SHAPES[k]: cells.getNumberOfCellsWithType(k) for k in cells.getAllGeoTypes()},
        "volume": linear.getMeasureField(False).accumulate()[0],
        "least": linear.getMeasureField(False).getArray().getMinValue()[0],
        "turned": linear.deepCopy().findAndCorrectBadOriented3DCells().getNumberOfTuples(),
        "flux": {},
    }
    for level, key in ((1, "node_sets"), (-1, "face_sets"), (0, "cell_sets")):
        there = level == 1 or level in file.getNonEmptyLevels()
        names = file.getGroupsOnSpecifiedLev(level) if there else ()
        found[key] = {n: file.getGroupArr(level, n).getNumberOfTuples() for n in names}
        if level == -1:
            found["flux"] = {name: flux(file.getGroup(-1, name)) for name in names}
    if cells.getAllGeoTypes()[0] in (mc.NORM_TETRA10, mc.NORM_HEXA20):
        found["bent"] = bent(cells.explode3DMeshTo1D()[0])
        if -1 in file.getNonEmptyLevels():
            faces = file.getMeshAtLevel(-1)
            found["bent"] = max(found["bent"], bent(faces.buildDescendingConnectivity()[0]))
    return found


results = [judge(path) for path in sys.argv[1:]]
json.dump(results[0] if len(results) == 1 else results, sys.stdout)
