"""SU2 meshes: every face of the boundary in one marker, counts that hold, VTK's numbers."""

import numpy as np
import pytest
import strict_su2
from deck_meshes import SIZE, base, volume, written, zoo
from test_inp import voxel_job

from porous import formats
from porous.formats import su2
from porous.stages import hexahedralize, name_parts
from porous.values import Block, Frame, Job, Part, VolumeMesh, VoxelGrid
from porous.values.volume_topology import boundary_faces

LINEAR = ("tet4", "wed6", "hex8")
NODES = {5: 3, 9: 4, 10: 4, 12: 8, 13: 6}
WEDGE = [0, 2, 1, 3, 5, 4]


def parsed(text):
    """Return elements, points and markers, each as many as the file says."""
    lines = [line for line in text.splitlines() if not line.startswith("%")]
    place = 0

    def count(key):
        nonlocal place
        name, _, number = lines[place].partition("= ")
        assert name == key
        place += 1
        return int(number)

    def taken(number):
        nonlocal place
        place += number
        return [line.split() for line in lines[place - number : place]]

    assert count("NDIME") == 3
    elements = [[int(word) for word in row] for row in taken(count("NELEM"))]
    rows = taken(count("NPOIN"))
    assert [int(row[3]) for row in rows] == list(range(len(rows)))
    points = np.array([[float(word) for word in row[:3]] for row in rows])
    for number, (kind, *nodes) in enumerate(elements):
        assert len(nodes) == NODES[kind] + 1
        assert nodes[-1] == number
    markers = {}
    for _ in range(count("NMARK")):
        name = lines[place].partition("= ")[2]
        assert lines[place].startswith("MARKER_TAG= ")
        assert name not in markers
        place += 1
        markers[name] = [[int(word) for word in row] for row in taken(count("MARKER_ELEMS"))]
        assert all(len(nodes) == NODES[kind] for kind, *nodes in markers[name])
    assert place == len(lines)
    return elements, points, markers


def faces_of(markers):
    return sorted(tuple(sorted(nodes)) for some in markers.values() for _, *nodes in some)


def test_points_and_elements_come_as_they_are():
    mesh = zoo(LINEAR, unit="cm")
    elements, points, _ = parsed(written(su2, mesh))
    assert np.array_equal(points, mesh.points * 10)
    assert [row[0] for row in elements] == [10, 13, 12]
    tet, wedge, brick = (np.array(row[1:-1]) for row in elements)
    assert np.array_equal(tet, mesh.blocks[0].cells[0])
    assert np.array_equal(brick, mesh.blocks[2].cells[0])
    assert np.array_equal(wedge, mesh.blocks[1].cells[0][WEDGE])
    # VTK's wedge: the normal of its first triangle points away from the second.
    a, b, c, d, *_ = points[wedge]
    assert np.dot(np.cross(b - a, c - a), d - a) < 0


def tunnel():
    """Return voxels with a hole along x, of sides that are all different."""
    solid = np.ones((4, 5, 6), bool)
    solid[:, 2, 2:4] = False
    frame = Frame((0, 0, 0), (0.5, 0.25, 1 / 3), solid.shape)
    return name_parts(hexahedralize(VoxelGrid.of_solid(solid, frame)), frame.box)


def test_every_face_of_the_boundary_is_in_one_marker():
    mesh = tunnel()
    _, points, markers = parsed(written(su2, mesh))
    sides = [f"{axis}{end}_FACES" for axis in "XYZ" for end in ("MIN", "MAX")]
    assert list(markers) == [*sides, "WALL"]
    assert {name: len(some) for name, some in markers.items()} == {
        "XMIN_FACES": 28,
        "XMAX_FACES": 28,
        "YMIN_FACES": 24,
        "YMAX_FACES": 24,
        "ZMIN_FACES": 20,
        "ZMAX_FACES": 20,
        "WALL": 4 * 6,
    }
    every = faces_of(markers)
    assert len(set(every)) == len(every) == len(boundary_faces(mesh))
    assert flux(points, markers) == pytest.approx(mesh.volumes.sum(), rel=1e-12)


def flux(points, markers):
    """Integrate x · n / 3 over all markers: the volume, where they are seen from outside."""
    total = 0.0
    for some in markers.values():
        for _, *nodes in some:
            x = points[nodes]
            mean = x.mean(axis=0)
            for a, b in zip(x, np.roll(x, -1, axis=0), strict=True):
                total += np.dot(np.cross(a - mean, b - mean), mean) / 6
    return total


def test_all_shapes_are_seen_from_outside():
    _, points, markers = parsed(written(su2, zoo(LINEAR)))
    assert flux(points, markers) == pytest.approx(volume(LINEAR), rel=1e-12)
    assert set(markers) == {"ZMIN_FACES", "N_3_ODD___NAME"}
    lower = {"below": markers["ZMIN_FACES"]}
    assert sum(len(nodes) == 5 for nodes in lower["below"]) == 1
    corners = [points[nodes] for _, *nodes in lower["below"]]
    areas = [np.ptp(x[:, 0]) * np.ptp(x[:, 1]) / (2 if len(x) == 3 else 1) for x in corners]
    assert sum(areas) == pytest.approx(base(LINEAR))
    assert SIZE[0] != SIZE[1]


def test_a_strict_reader_takes_what_is_written(tmp_path):
    for mesh in (zoo(LINEAR), tunnel()):
        formats.write(mesh, tmp_path / "mesh.su2")
        told = strict_su2.read(tmp_path / "mesh.su2")
        assert told["nodes"] == len(mesh.points)
        assert told["elements"] == {block.shape: len(block.cells) for block in mesh.blocks}
        assert told["volume"] == pytest.approx(mesh.volumes.sum(), rel=1e-12)


def test_a_mesh_without_parts_is_all_wall():
    mesh = zoo(("hex8",))
    _, _, markers = parsed(written(su2, VolumeMesh(mesh.points, mesh.blocks)))
    assert {name: len(some) for name, some in markers.items()} == {"WALL": 6}


def test_the_smallest_part_names_a_face_and_faces_between_cells_have_no_marker():
    mesh = zoo(("hex8",))
    faces = np.array([[0, face] for face in range(6)])
    above = mesh.points[4:] + np.array([0, 0, SIZE[2]])
    points = np.vstack([mesh.points, above])
    cells = np.array([[*range(8)], [4, 5, 6, 7, 8, 9, 10, 11]])
    parts = {
        "SKIN": Part("faces", faces[2:4]),
        "SIDES": Part("faces", faces[2:]),
        "INLET": Part("faces", faces[2:3]),
        "ALSO": Part("faces", faces[2:4][::-1]),
        "BETWEEN": Part("faces", np.array([[0, 1], [1, 0]])),
    }
    both = VolumeMesh(points, (Block("hex8", cells),), {}, parts)
    _, _, markers = parsed(written(su2, both))
    assert {name: len(some) for name, some in markers.items()} == {
        "SIDES": 2,
        "INLET": 1,
        "ALSO": 1,
        "WALL": 6,
    }


def test_a_job_in_metres_is_written_in_metres():
    job = voxel_job(np.ones((2, 1, 1), bool), (1, 2, 3), unit="in")
    bare = Job(job.title, job.mesh, system="m-SI")
    _, points, _ = parsed(written(su2, bare))
    assert points.max(axis=0) == pytest.approx(np.array([2, 2, 3]) * 0.0254)
