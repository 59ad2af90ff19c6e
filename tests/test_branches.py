"""Sets of a fractal's branches: by address in its own cells, by place in all other meshes."""

import numpy as np
import pytest

import porous as po
from porous.errors import ModelError
from porous.recipe import parse
from porous.stages import branches, hexahedralize, mesh_cells
from porous.values import Block, Frame, Part, VolumeMesh, VoxelGrid


def sets(mesh):
    return {name: part.members for name, part in mesh.parts.items() if name.startswith("WORD_")}


def check_partition(mesh, found):
    """Every cell is in exactly one set."""
    members = np.concatenate(list(found.values()))
    assert np.array_equal(np.sort(members), np.arange(mesh.cells))


def brick():
    solid = np.ones((1, 2, 3), bool)
    return hexahedralize(VoxelGrid.of_solid(solid, Frame((0, 0, 0), (1, 2, 3), solid.shape)))


def voxels(model, count):
    return hexahedralize(po.voxelize(model, voxels=count))


@pytest.mark.parametrize(("length", "count"), [(1, 9), (2, 9), (1, 12), (1, 27)])
def test_words_of_the_menger_sponge_are_its_cubes(length, count):
    model = po.build(po.load("menger", set={"model.level": 2}))
    mesh = voxels(model, count)
    found = sets(branches(mesh, model, length=length))
    check_partition(mesh, found)
    assert len(found) == 20**length
    keep = model.digits.keep
    middles = mesh.points[mesh.blocks[0].cells].mean(axis=1)
    box = model.primitive.box
    if count != 12:
        volumes = [mesh.volumes[members].sum() for members in found.values()]
        assert np.allclose(volumes, mesh.volumes.sum() / 20**length)
    for name, members in found.items():
        digits = keep[[int(letter) for letter in name.split("_")[1:]]]
        corner = sum(d / 3.0 ** (i + 1) for i, d in enumerate(digits))
        lower = np.array(box.lower) + corner * box.lengths
        inside = (middles[members] - lower) / box.lengths * 3**length
        assert -1e-9 < inside.min() <= inside.max() < 1 + 1e-9


def test_tetrahedra_of_the_sierpinski_tetrahedron():
    model = po.build(po.load("sierpinski-tetrahedron", set={"model.level": 2}))
    # The cells themselves, and a point moved between two of them.
    corners = (
        np.einsum("kij,nj->kni", model.frames()[:, :, :3], model.primitive.points)
        + model.frames()[:, None, :, 3]
    )
    block = Block("tet4", np.arange(4 * len(corners)).reshape(-1, 4))
    mesh = VolumeMesh(corners.reshape(-1, 3), (block,), parts={"WORD_OLD": Part("cells", [0])})
    found = sets(branches(mesh, model, length=1))
    assert list(found) == ["WORD_0", "WORD_1", "WORD_2", "WORD_3"]
    assert [members.tolist() for members in found.values()] == np.arange(16).reshape(4, 4).tolist()
    assert [m.tolist() for m in sets(branches(mesh, model, length=2)).values()] == [
        [i] for i in range(16)
    ]


def test_bent_cells_go_by_their_addresses():
    model = po.build(po.load("menger-bent", set={"model.level": 2}))
    mesh = mesh_cells(model)
    named = branches(mesh, model, length=1)
    found = sets(named)
    check_partition(mesh, found)
    assert len(found) == 20
    assert {len(members) for members in found.values()} == {20}
    order = mesh.cell_tags["address"]
    for index, members in enumerate(found.values()):
        assert set(order[members] // 20) == {index}
    children = [child.name for child in model.brep.states[model.brep.start].children]
    assert list(found) == [f"WORD_{name}" for name in children]
    assert set(mesh.parts) < set(named.parts)
    with pytest.raises(ModelError, match="addresses run from 0 to 399; the model has 20 cells"):
        branches(mesh, po.build(po.load("menger-bent", set={"model.level": 1})), length=1)


def test_cells_of_several_states_and_of_several_level_zero_cells():
    model = po.build(po.load("tetra-octa", set={"model.level": 2}))
    mesh = mesh_cells(model)
    found = sets(branches(mesh, model, length=1))
    check_partition(mesh, found)
    assert len(found) == len(model.automaton.children[model.automaton.start])
    ring = po.build(po.load("menger-cylinder", set={"model.level": 1}))
    mesh = mesh_cells(ring)
    found = sets(branches(mesh, ring, length=1))
    check_partition(mesh, found)
    assert len({name.split("_")[1] for name in found}) == len(ring.macro.cells) > 1
    assert len(found) == mesh.cells
    for members in found.values():
        assert len(members) == 1


def test_cells_of_several_states_drawn_as_solids():
    model = po.build(po.load("koch-cube"))
    mesh = voxels(model, 20)
    found = sets(branches(mesh, model, length=1))
    check_partition(mesh, found)
    assert len(found) > 1


def test_words_of_one_place_are_the_first_one():
    maps = [
        {"matrix": (np.eye(3) / 2).tolist(), "translation": [d, 0.0, 0.0]} for d in (0.0, 0.5, 0.0)
    ]
    model = po.build(parse({"model": {"kind": "ifs", "maps": maps, "level": 1}}))
    mesh = voxels(model, 4)
    found = sets(branches(mesh, model, length=1))
    check_partition(mesh, found)
    assert list(found) == ["WORD_0", "WORD_1"]


@pytest.mark.parametrize("level", [2, "limit"])
def test_what_an_offset_adds_belongs_to_the_nearest(level):
    change = {"model.level": level, "model.offset": 0.05, "voxels.voxels": 24}
    model = po.build(po.load("cantor-dust", set=change))
    mesh = voxels(model, 24)
    found = sets(branches(mesh, model, length=1))
    check_partition(mesh, found)
    assert len(found) == 8
    middles = mesh.points[mesh.blocks[0].cells].mean(axis=1)
    centre = np.mean([model.domain.lower, model.domain.upper], axis=0)
    for members in found.values():
        assert len(np.unique(middles[members] > centre, axis=0)) == 1


def test_a_long_word_count_and_other_lengths_are_refused():
    model = po.build(po.load("menger", set={"model.level": 3}))
    mesh = brick()
    for length in (0, -1, 4, 1.5, True):
        with pytest.raises(ModelError, match="wanted 1 … 3, the model's level"):
            branches(mesh, model, length=length)
    with pytest.raises(ModelError, match="8000 words of length 3; wanted"):
        branches(mesh, model, length=3)


@pytest.mark.parametrize("name", ["rough-block", "menger-warped"])
def test_models_without_addresses_say_so(name):
    model = po.build(po.load(name))
    mesh = brick()
    with pytest.raises(ModelError, match="has no addresses; wanted"):
        branches(mesh, model, length=1)


def test_voxels_of_a_bent_model_are_refused():
    model = po.build(po.load("menger-bent", set={"model.level": 1}))
    mesh = brick()
    with pytest.raises(ModelError, match="only its own cells have addresses"):
        branches(mesh, model, length=1)
    with pytest.raises(ModelError, match="IFS has none of its own"):
        branches(mesh_cells(model), po.build(po.load("menger")), length=1)


def test_limbs_of_a_tree_are_branches():
    model = po.build(po.load("support-tree"))
    mesh = voxels(model, 40)
    found = sets(branches(mesh, model, length=1))
    check_partition(mesh, found)
    assert len(found) == len(model.automaton.children[model.automaton.start])
