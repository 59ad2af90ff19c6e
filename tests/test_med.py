"""MED as SALOME's own reader and MED's own tools take it."""

import time

import h5py
import neutral_meshes as meshes
import numpy as np
import programs
import pytest

from porous import formats
from porous.errors import FormatError
from porous.formats import med
from porous.values import Job, VolumeMesh


def put(folder, name, mesh):
    formats.write(mesh, folder / f"{name}.med")
    return folder / f"{name}.med"


@pytest.mark.judge
def test_salome_finds_every_shape_with_its_parts(tmp_path, ask):
    paths = [put(tmp_path, kind, meshes.body(kind, "um")) for kind in meshes.KINDS]
    for kind, found in zip(meshes.KINDS, ask("med", *paths), strict=True):
        mesh = meshes.body(kind)
        shapes, sets = meshes.counts(mesh)
        assert found["units"] == ["x [um]", "y [um]", "z [um]"]
        assert (found["nodes"], found["elements"]) == (len(mesh.points), shapes)
        assert found["volume"] == pytest.approx(meshes.VOLUME, rel=1e-12)
        assert (found["least"] > 0, found["turned"]) == (True, 0)
        for key in ("nodes", "faces", "cells"):
            assert found[f"{key[:-1]}_sets"] == sets[key]
        outer = found["flux"]["SKIN"] + found["flux"]["WALL"]
        assert outer == pytest.approx(3 * meshes.VOLUME, rel=1e-12)
        assert found.get("bent", 0.0) < 1e-12
        assert ("bent" in found) == (kind in ("tet10", "hex20"))


@pytest.mark.judge
@pytest.mark.parametrize("kind", ["hex20", "mixed"])
def test_meds_own_tools_take_it(tmp_path, judge, kind):
    path = put(tmp_path, kind, meshes.body(kind))
    for command in (
        [judge("medconforme"), path],
        [judge("mdump4"), path, "NODALE", "NO_INTERLACE", "1"],
    ):
        words = "".join(programs.said(command, seconds=20))
        assert "Erreur" not in words
    assert words.count("XMIN_FACES") >= 1


@pytest.mark.judge
def test_one_cell_without_parts_and_strange_names(tmp_path, ask):
    shapes = meshes.KINDS[:-1]
    names = ["a part", "quo\"te's", "Größe\n", "x" * 100]
    paths = [put(tmp_path, shape, meshes.one_cell(shape)) for shape in shapes]
    kinds = ("cells", "faces", "nodes")
    paths += [put(tmp_path, kind, meshes.renamed(names, kind)) for kind in kinds]
    *ones, cells, faces, nodes = ask("med", *paths)
    for shape, found in zip(shapes, ones, strict=True):
        assert (found["elements"], found["cell_sets"]) == ({shape: 1}, {})
        assert found["volume"] == pytest.approx(meshes.one_cell(shape).volumes.sum(), rel=1e-12)
    held = dict.fromkeys(["a part", "quo\"te's", "Gr__e_", "x" * 80], 1)
    assert (cells["cell_sets"], faces["face_sets"], nodes["node_sets"]) == (held, held, held)


@pytest.mark.parametrize("names", [("é", "è"), ("x" * 80, "x" * 81)])
def test_two_names_that_would_be_one_are_refused(names):
    with pytest.raises(FormatError, match=r"would both be .* in MED; wanted names that differ"):
        med.write(meshes.renamed(names))


def test_the_same_mesh_gives_the_same_bytes():
    first = b"".join(med.write(meshes.body("mixed")))
    time.sleep(1.1)  # HDF5 keeps times in seconds, where it keeps them
    assert b"".join(med.write(meshes.body("mixed"))) == first


def test_coordinates_keep_every_digit(tmp_path):
    mesh = meshes.body("hex8")
    moved = VolumeMesh(mesh.points * np.pi, mesh.blocks)
    with h5py.File(put(tmp_path, "digits", moved)) as file:
        (step,) = file["ENS_MAA/mesh"].values()
        assert np.array_equal(step["NOE/COO"][()].reshape(3, -1).T, moved.points)


def test_what_is_no_mesh_is_refused(tmp_path):
    with pytest.raises(FormatError, match=r"\.med file cannot hold a Job; wanted one of .*\.inp"):
        put(tmp_path, "job", Job("a body", meshes.body("hex8")))
    with pytest.raises(FormatError, match="the mesh has no cells"):
        put(tmp_path, "empty", VolumeMesh(np.zeros((2, 3)), ()))
    assert list(tmp_path.iterdir()) == []


def test_without_h5py_it_says_what_to_install(tmp_path, monkeypatch):
    from porous.formats import _registry

    monkeypatch.setattr(_registry, "find_spec", lambda name: None if name == "h5py" else name)
    with pytest.raises(FormatError, match=r"need h5py; wanted pip install 'porous\[io\]'"):
        put(tmp_path, "none", meshes.body("hex8"))
