"""Who reads each format that porous writes, what it finds, and what of a value a format keeps."""

import json
from typing import NamedTuple

import neutral_meshes as meshes
import numpy as np
import pytest
import pyvista
import strict_cli
import strict_k
import strict_su2
import tifffile
import trimesh
from ccx_judge import check_deck
from foam_judge import check_mesh
from image_cases import in_file_order
from PIL import Image
from vtkmodules.vtkIOXdmf2 import vtkXdmfReader

from porous.values import SHAPES, BeamLattice
from porous.values.volume_topology import nodes_of

SETS = ("node_sets", "face_sets", "cell_sets")


class Judge(NamedTuple):
    """Who looks at a format's files."""

    look: object
    """From paths, what they hold, and the fixtures ``ask`` and ``judge``: what is found in each."""
    scale: float = 1.0
    """Of the file's unit of length to the value's own."""
    keeps: object = None
    """From a value and what a perfect file holds: what this format's files hold."""
    alone: bool = True
    """Whether it is a program, or in an environment of its own."""
    slow: bool = False
    """Whether it takes seconds to start."""


# --- meshes ---


def of_mesh(mesh):
    """Return what a file that keeps all tells of a mesh."""
    shapes, sets = meshes.counts(mesh)
    found = {f"{kind[:-1]}_sets": members for kind, members in sets.items()}
    volume = float(mesh.volumes.sum())
    return {"nodes": len(mesh.points), "elements": shapes, "volume": volume} | found


def of_fields(value):
    """Return what a file that keeps all tells of a mesh with fields."""
    sums = {f"field {field.name}": field.values.sum(axis=0).tolist() for field in value}
    return of_mesh(value.mesh) | sums


def area(mesh, part):
    """Return the area of the flat faces of a part."""
    rows = nodes_of(mesh, mesh.parts[part].members)
    corners = mesh.points[np.where(rows < 0, rows[:, [2]], rows)]
    vectors = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]) / 2
    return float(np.linalg.norm(vectors, axis=1).sum())


def asked(script, *words):
    """Return a judge that is a script of ``tests/judges``: one call for all files."""

    def look(paths, values, ask, judge):  # noqa: ARG001
        found = ask(script, *words, *paths)
        return found if isinstance(found, list) else [found]

    return look


def each(read):
    """Return a judge that reads one file after the other, here."""
    return lambda paths, values, ask, judge: [read(path) for path in paths]  # noqa: ARG005


def by_exodus(paths, values, ask, judge):
    """Exodus' blocks are sets of cells too; a part of several shapes is a block of each."""
    result = asked("exodus")(paths, values, ask, judge)
    for found in result:
        elements, cells = {}, {}
        names = {"TETRA4": "tet4", "TETRA10": "tet10", "WEDGE": "wed6"}
        for name, (kind, count) in found["blocks"].items():
            shape = names.get(kind, kind.lower())
            elements[shape] = elements.get(shape, 0) + count
            part = name.removesuffix(f"_{kind}")
            cells[part] = cells.get(part, 0) + count
        found |= {"elements": elements, "cell_sets": cells | found["cell_sets"]}
    return result


def by_foam(paths, values, ask, judge):  # noqa: ARG001
    program, result = judge("checkMesh"), []
    for path, value in zip(paths, values, strict=True):
        found = check_mesh(program, path, thorough=False)
        mesh = getattr(value, "mesh", value)
        sides = {(name if name == "WALL" else f"{name}_FACES"): n for name, n in
                 found["patches"].items()}  # fmt: skip
        zones = {name: n for name, n in found["face_sets"].items() if name in mesh.parts}
        result.append(found | {"face_sets": sides | zones})
    return result


def by_calculix(paths, values, ask, judge):  # noqa: ARG001
    program, result = judge("ccx"), []
    for path, value in zip(paths, values, strict=True):
        mesh = getattr(value, "mesh", value)
        found = check_deck(program, path, every="ALL_CELLS", held="XMIN")
        assert found["cell_sets"].pop("ALL_CELLS") == mesh.cells
        for name, one in found.pop("areas").items():
            assert one == pytest.approx(100 * area(mesh, name), rel=1e-6), name
            found.setdefault("face_sets", {})[name] = len(mesh.parts[name].members)
        result.append(found)
    return result


def by_vtk(path):
    """Return what VTK finds in an unstructured grid and its fields."""
    grid = pyvista.read(path)
    fields = {tuple(name.split(":", 1)): values for name, values in grid.field_data.items()}
    found = {
        f"{kind[:-1]}_sets": {
            name: len(np.unique(values, axis=0))
            for (of, name), values in ((k, v) for k, v in fields.items() if len(k) == 2)
            if of == kind and len(values)
        }
        for kind in ("nodes", "faces", "cells")
    }
    data = [*grid.point_data.items(), *grid.cell_data.items()]
    sums = {f"field {name}": values.sum(axis=0).tolist() for name, values in data}
    return gridded(grid) | found | sums


def gridded(grid):
    """Return nodes, elements and volume of a grid of VTK."""
    numbers = {shape.vtk: name for name, shape in SHAPES.items()}
    kinds, counts = np.unique(grid.celltypes, return_counts=True)
    sizes = grid.compute_cell_sizes(length=False, area=False)["Volume"]
    # VTK draws a wedge's first triangle seen from outside, and measures it as seen from inside.
    sizes = np.where(grid.celltypes == SHAPES["wed6"].vtk, np.abs(sizes), sizes)
    assert (sizes > 0).all()
    elements = {numbers[kind]: n for kind, n in zip(kinds.tolist(), counts.tolist(), strict=True)}
    return {"nodes": grid.n_points, "elements": elements, "volume": float(sizes.sum())}


def by_xdmf(path):
    """Return what VTK finds in the two grids of an XDMF file."""
    reader = vtkXdmfReader()
    reader.SetFileName(str(path))
    reader.UpdateInformation()
    reader.Update()
    grids = pyvista.wrap(reader.GetOutputDataObject(0))
    cells, facets = grids["mesh"], grids["facets"]
    marks = {"node_sets": cells.point_data, "face_sets": facets.cell_data}
    marks["cell_sets"] = cells.cell_data
    found = {
        kind: {name: int((values == 1).sum()) for name, values in data.items()}
        for kind, data in marks.items()
    }
    for one in found.values():
        one.pop("leading", None)
    found["cell_sets"].pop("phase")
    return gridded(cells) | found


def without(*names):
    """Return what becomes of a format whose elements are of one part only."""
    return lambda mesh, whole: {  # noqa: ARG005
        key: {n: c for n, c in value.items() if n not in names} if key in SETS else value
        for key, value in whole.items()
    }


def points_for_faces(mesh, whole):
    """Gmsh says the nodes of a side by its faces."""
    nodes = {
        name: count
        for name, count in whole["node_sets"].items()
        if f"{name}_FACES" not in mesh.parts
    }
    return whole | {"node_sets": nodes}


def gmsh_2(mesh, whole):
    """In 2.2 each element is of one part: the skin is of the sides, branches are of phases."""
    return without("SKIN", "WORD_00", "WORD_01")(mesh, points_for_faces(mesh, whole))


def nodes_of_faces(mesh, whole):
    """Components of Ansys are of nodes or elements: those of faces are of all their nodes."""
    faces = {}
    for name in whole["face_sets"]:
        rows, quadratic = mesh.parts[name].members, mesh.blocks[0].shape
        corners = nodes_of(mesh, rows)
        own = set(corners[corners >= 0].tolist())
        if edges := SHAPES[quadratic].edges:
            first = SHAPES[quadratic].nodes - len(edges)
            for (cell, _), ring in zip(rows.tolist(), corners.tolist(), strict=True):
                nodes = mesh.blocks[0].cells[cell].tolist()
                own |= {
                    nodes[first + i]
                    for i, (a, b) in enumerate(edges)
                    if nodes[a] in ring and nodes[b] in ring
                }
        faces[name] = len(own)
    return whole | {"node_sets": whole["node_sets"] | faces, "face_sets": {}}


def ends_of_pairs(mesh, whole):
    """Decks of CalculiX have a set for either side of pairs."""
    ends = {
        f"{name}_{end}": len(np.unique(column))
        for name, part in mesh.parts.items()
        if part.kind == "pairs"
        for end, column in zip(("FIRST", "SECOND"), part.members.T, strict=True)
    }
    return whole | {"node_sets": whole["node_sets"] | ends}


def markers(mesh, whole):  # noqa: ARG001
    """SU2 has sides and walls, each face once, and no other sets."""
    inner = ("SKIN", "INTERFACE")
    faces = {name: n for name, n in whole["face_sets"].items() if name not in inner}
    return whole | {"node_sets": {}, "cell_sets": {}, "face_sets": faces}


MESHES = {
    ".bdf": Judge(asked("pynastran"), 10.0, slow=True),
    ".cdb": Judge(asked("mapdl"), 10.0, nodes_of_faces),
    ".exo": Judge(by_exodus),
    ".feb": Judge(asked("febio"), 10.0, slow=True),
    ".foam": Judge(by_foam, 0.01),
    ".inp": Judge(by_calculix, 10.0, ends_of_pairs),
    ".k": Judge(each(strict_k.read), 10.0, alone=False),
    ".med": Judge(asked("med")),
    ".msh": Judge(asked("gmsh_mesh"), 1.0, points_for_faces),
    ".msh2": Judge(asked("gmsh_mesh"), 1.0, gmsh_2),
    ".su2": Judge(each(strict_su2.read), 10.0, markers, alone=False),
    ".vtu": Judge(each(by_vtk), alone=False),
    ".xdmf": Judge(each(by_xdmf), alone=False),
}
"""By suffix, for meshes and jobs; ``scale`` of centimetres."""


# --- voxels ---


def seen(values, spacing, corner):
    """Return what all judges tell of voxels with axes (x, y, z)."""
    return {
        "shape": list(values.shape),
        "spacing": list(map(float, spacing)),
        "corner": list(map(float, corner)),
        "crc32": in_file_order(np.ascontiguousarray(values, np.uint8)),
    }


def of_voxels(grid):
    return seen(grid.fill, grid.frame.spacing, grid.frame.box.lower)


def centred(centre, spacing):
    return [c - h / 2 for c, h in zip(centre, spacing, strict=True)]


def by_itk(paths, values, ask, judge):
    return [
        {
            "shape": found["size"],
            "spacing": found["spacing"],
            "corner": centred(found["origin"], found["spacing"]),
            "crc32": found["crc32"],
        }
        for found in asked("itk", "read")(paths, values, ask, judge)
    ]


def by_h5py(paths, values, ask, judge):
    return [
        {
            "shape": found["sets"]["fill"]["shape"][::-1],
            "spacing": found["sets"]["fill"]["element_size_um"][::-1],
            "corner": found["origin"],
            "crc32": found["sets"]["fill"]["crc32"],
        }
        for found in asked("h5")(paths, values, ask, judge)
    ]


def by_damask(paths, values, ask, judge):  # noqa: ARG001
    result = []
    for path in paths:
        found = ask("damask", path, path.parent)
        spacing = np.divide(found["size"], found["cells"])
        material = np.reshape(found["material"], found["cells"], order="F")
        result.append(seen(material, spacing, found["origin"]))
    return result


def by_numpy(path):
    with np.load(path) as file:
        return seen(file["fill"], file["spacing"], file["origin"])


def by_zarr(path):
    zarr = pytest.importorskip("zarr", minversion="3")
    group = zarr.open_group(path, mode="r")
    (image,) = group.attrs["ome"]["multiscales"]
    (level,) = image["datasets"]
    scale, shift = (one[one["type"]][::-1] for one in level["coordinateTransformations"])
    return seen(group[level["path"]][:].transpose(2, 1, 0), scale, centred(shift, scale))


def by_pillow(path):
    known = json.loads((path / "slices.json").read_text())
    pictures = np.stack([np.asarray(Image.open(path / name)) for name in known["slices"]])
    spacing = known["pixel_width"], known["pixel_height"], known["layer_height"]
    return seen(pictures[:, ::-1].transpose(2, 1, 0), spacing, known["lower"])


def by_tifffile(path):
    with tifffile.TiffFile(path) as file:
        said, tags = file.imagej_metadata, file.pages[0].tags
        spacing = [1 / np.divide(*tags[f"{a}Resolution"].value) for a in "XY"] + [said["spacing"]]
        corner = [-said[f"{axis}origin"] * h for axis, h in zip("xyz", spacing, strict=True)]
        return seen(file.asarray().transpose(2, 1, 0), spacing, corner)


def by_vtk_image(path):
    image = pyvista.read(path)
    shape = np.array(image.dimensions) - 1
    return seen(image["fill"].reshape(shape, order="F"), image.spacing, image.origin)


def by_vtk_maps(path):
    image = pyvista.read(path)
    assert image.get_cell(0).bounds[1] == pytest.approx(image.origin[0] + image.spacing[0])
    return of_lengths(image.cell_data, image.spacing, image.origin)


def of_maps(value):
    flat = {name: values.ravel(order="F") for name, values in value.maps.items()}
    return of_lengths(flat, value.frame.spacing, value.frame.box.lower)


def of_lengths(arrays, spacing, corner):
    told = {name: values.tolist() for name, values in arrays.items()}
    return told | {"spacing": list(map(float, spacing)), "corner": list(map(float, corner))}


def by_layers(path):
    """Return the heights of layers and the area of the solid in each, in mm."""
    found = strict_cli.read(path)
    return {"layers": np.array(found["layers"]).ravel().tolist()}


def phases(grid, whole):
    return whole | {"crc32": in_file_order((grid.fill >= 128).astype(np.uint8))}


def layers(grid, whole):  # noqa: ARG001
    (dx, dy, dz), low = grid.frame.spacing, grid.frame.box.lower[2]
    areas = (grid.fill >= 128).sum(axis=(0, 1)) * dx * dy * 1e-6
    heights = (low + dz * np.arange(len(areas) + 1)) * 1e-3
    return {"layers": np.column_stack([heights, [0, *areas]]).ravel().tolist()}


VOXELS = {
    ".cli": Judge(each(by_layers), 1.0, layers, alone=False),
    ".damask.vti": Judge(by_damask, 1e-6, phases, slow=True),
    ".h5": Judge(by_h5py),
    ".mhd": Judge(by_itk, 1e-3),
    ".npz": Judge(each(by_numpy), alone=False),
    ".nrrd": Judge(by_itk),
    ".ome.zarr": Judge(each(by_zarr), alone=False),
    ".pngs": Judge(each(by_pillow), alone=False),
    ".tif": Judge(each(by_tifffile), alone=False),
    ".vti": Judge(each(by_vtk_image), alone=False),
}


# --- surfaces and beams ---


def by_trimesh(path):
    mesh = trimesh.load_mesh(path)
    assert mesh.is_watertight
    return {
        "points": len(mesh.vertices),
        "triangles": len(mesh.faces),
        "volume": float(mesh.volume),
        "lower": mesh.bounds[0].tolist(),
        "upper": mesh.bounds[1].tolist(),
    }


def by_lib3mf(paths, values, ask, judge):  # noqa: ARG001
    said, result = ask("lib3mf_judge", *paths), []
    for path, value in zip(paths, values, strict=True):
        found = said[str(path)]
        assert (found["warnings"], found["unit"]) == ([], "MilliMeter")
        (mesh,) = found["meshes"]
        assert mesh["built"]
        wanted = of_beams if isinstance(value, BeamLattice) else of_triangles
        found = {key: mesh[key] for key in wanted(value)}
        rows = {k: np.ravel(v).tolist() for k, v in found.items() if isinstance(v, list)}
        result.append(found | rows)
    return result


def of_triangles(surface):
    return {
        "points": len(surface.points),
        "triangles": len(surface.triangles),
        "volume": float(surface.volume),
        "lower": list(surface.box.lower),
        "upper": list(surface.box.upper),
    }


def of_beams(value):
    return {
        "points": len(value.points),
        "places": value.points.ravel().tolist(),
        "beams": value.beams.ravel().tolist(),
        "radii": value.radii.ravel().tolist(),
    }


SURFACES = {
    ".3mf": Judge(by_lib3mf),
    ".obj": Judge(each(by_trimesh), alone=False),
    ".ply": Judge(each(by_trimesh), alone=False),
    ".stl": Judge(each(by_trimesh), alone=False),
}
BEAMS = {".3mf": Judge(by_lib3mf)}
MAPS = {".vti": Judge(each(by_vtk_maps), alone=False)}

# --- all of them ---

TABLES = {
    "VolumeMesh": MESHES,
    "Job": MESHES,
    "MeshFields": {".vtu": Judge(each(by_vtk), alone=False)},
    "VoxelGrid": VOXELS,
    "SurfaceMesh": SURFACES,
    "BeamLattice": BEAMS,
    "VoxelMaps": MAPS,
}
"""By the name of what is written, and the format's suffix."""


def scaled(whole, scale):
    """Return what a file holds whose unit of length is another."""
    powers = {"volume": 3, "spacing": 1, "corner": 1}
    return {
        key: (np.array(value) * scale ** powers[key]).tolist() if key in powers else value
        for key, value in whole.items()
    }


def near(value):
    """Return lengths and volumes as equal to seven digits, everything else as it is."""
    exact = isinstance(value, int | dict) or np.array(value).dtype.kind != "f"
    return value if exact else pytest.approx(value, rel=1e-7, abs=1e-12)
