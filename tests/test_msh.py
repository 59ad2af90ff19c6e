"""Gmsh's versions 4.1 and 2.2 as we write them: to Gmsh itself, to meshio, scikit-fem, and back."""

import io

import meshio
import neutral_meshes as meshes
import numpy as np
import pytest
import skfem
from hypothesis import given
from hypothesis import strategies as st
from skfem.io.meshio import from_meshio
from skfem.models.poisson import laplace

from porous import formats
from porous.errors import FormatError
from porous.formats import msh, msh2
from porous.formats._groups import Groups
from porous.formats._lines import lines_of
from porous.values import Job, Part, VolumeMesh
from porous.values.units import METRES

WRITERS = {".msh": msh.FORMAT.write, ".msh2": msh2.FORMAT.write}
LOST = {"SKIN", "WORD_00"}
"""What is in others of its kind wholly, and so leads nowhere."""


def text(mesh, suffix=".msh"):
    return b"".join(WRITERS[suffix](mesh)).decode("ascii")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("msh")


def put(folder, name, suffix, mesh):
    formats.write(mesh, folder / f"{name}{suffix}")
    return folder / f"{name}{suffix}"


@pytest.mark.judge
def test_gmsh_finds_every_shape_with_its_parts(folder, ask):
    cases = [(kind, suffix) for kind in meshes.KINDS for suffix in WRITERS]
    paths = [put(folder, kind, suffix, meshes.body(kind)) for kind, suffix in cases]
    for (kind, suffix), found in zip(cases, ask("gmsh_mesh", *paths), strict=True):
        mesh = meshes.body(kind)
        shapes, sets = meshes.counts(mesh)
        assert found["complaints"] == []
        assert (found["nodes"], found["elements"]) == (len(mesh.points), shapes)
        assert found["volume"] == pytest.approx(meshes.VOLUME, rel=1e-9)
        assert found["least"] > 0
        assert found["node_sets"] == {"GRIP": 3}
        lost = LOST if suffix == ".msh2" else set()
        for key, kind_of in (("face_sets", "faces"), ("cell_sets", "cells")):
            assert found[key] == {n: c for n, c in sets[kind_of].items() if n not in lost}
        outer = [n for n in found["flux"] if n.endswith("_FACES") or n == "WALL"]
        total = sum(found["flux"][name] for name in outer)
        assert total == pytest.approx(3 * meshes.VOLUME, rel=1e-9)


@pytest.mark.judge
def test_gmsh_finds_what_matches_one_period_on(folder, ask):
    kinds = ("hex20", "mixed")
    found = ask("gmsh_mesh", *(put(folder, k, ".msh", meshes.body(k)) for k in kinds))
    for kind, one in zip(kinds, found, strict=True):
        assert len(one["periodic"]) == 3
        for axis, link in enumerate(one["periodic"]):
            part = meshes.body(kind).parts["XYZ"[axis] + "PAIRS"]
            shift = np.array(link["slaves"]) - np.array(link["masters"])
            assert shift == pytest.approx(
                np.tile(np.eye(3)[axis] * meshes.LENGTHS, (len(part.members), 1))
            )


@pytest.mark.judge
@pytest.mark.filterwarnings("ignore:.*no shifts along an axis:porous.errors.FormatWarning")
def test_what_gmsh_writes_of_ours_is_the_same_mesh(folder, ask):
    """In 2.2 Gmsh pairs other nodes of quadratic faces than it has read; we say so."""
    kinds = ("tet10", "wed6", "hex8")
    paths = [put(folder, f"there-{k}", s, meshes.body(k)) for k in kinds for s in WRITERS]
    ask("gmsh_mesh", "--back", *paths)
    for path in paths:
        ours = formats.read(path)
        back = formats.read(path.with_name(f"{path.stem}-back.msh"))
        assert meshes.cells_by_nodes(back) == meshes.cells_by_nodes(ours)


@pytest.mark.parametrize("suffix", WRITERS)
@pytest.mark.parametrize("kind", meshes.KINDS)
def test_cells_read_back_equal(folder, kind, suffix):
    mesh = meshes.body(kind)
    back = formats.read(put(folder, f"back-{kind}", suffix, mesh))
    assert np.array_equal(back.points, mesh.points)
    assert back.blocks == mesh.blocks


def test_scikit_fem_solves_on_named_boundaries(folder):
    path = put(folder, "skfem", ".msh2", meshes.body("tet4"))
    mesh = from_meshio(meshio.read(path, file_format="gmsh"))
    assert set(mesh.subdomains) - {"GRIP"} == {"SOLID", "PORE"}
    assert {"XMIN_FACES", "XMAX_FACES", "WALL"} <= set(mesh.boundaries)
    basis = skfem.Basis(mesh, skfem.ElementTetP1())
    stiffness = laplace.assemble(basis)
    low, high = (basis.get_dofs(f"X{end}_FACES").all() for end in ("MIN", "MAX"))
    start = basis.zeros()
    start[low] = 1.0
    held = np.concatenate([low, high])
    solution = skfem.solve(*skfem.condense(stiffness, x=start, D=held))
    solid = meshes.VOLUME / meshes.LENGTHS[0] ** 2
    assert solid * 0.97 < solution @ stiffness @ solution < solid  # a hole costs a little


def test_meshio_finds_periods_and_groups_in_2(folder):
    mesh = meshes.body("mixed")
    found = meshio.read(put(folder, "meshio", ".msh2", mesh), file_format="gmsh")
    assert set(found.field_data) == {
        name
        for name, part in mesh.parts.items()
        if part.kind in ("faces", "cells") and len(part.members)
    } - LOST | {"GRIP"}
    assert len(found.gmsh_periodic) == 3
    for axis, (dimension, _, _, pairs) in zip("XYZ", found.gmsh_periodic, strict=True):
        assert dimension == 2
        assert np.array_equal(
            np.sort(pairs[:, 0]), np.sort(mesh.parts[f"{axis}PAIRS"].members[:, 1])
        )


def test_points_are_what_no_faces_say():
    mesh = meshes.body("tet4")
    assert '"XMIN_FACES"' in text(mesh)
    assert '"XMIN"' not in text(mesh)
    alone = {name: part for name, part in mesh.parts.items() if part.kind == "nodes"}
    assert '0 1 "XMIN"\n' in text(VolumeMesh(mesh.points, mesh.blocks, {}, alone))


def test_pairs_without_faces_are_left_out():
    mesh = meshes.body("hex8")
    pairs = VolumeMesh(mesh.points, mesh.blocks, {}, {"XPAIRS": mesh.parts["XPAIRS"]})
    assert "$Periodic" not in text(pairs) + text(pairs, ".msh2")
    assert "$Periodic" in text(mesh)


def test_a_2_lists_each_element_once_and_says_what_that_costs():
    lines = text(meshes.body("hex8"), ".msh2").splitlines()
    count = int(lines[lines.index("$Elements") + 1])
    rows = [line.split() for line in lines[lines.index("$Elements") + 2 :][:count]]
    assert len({row[0] for row in rows}) == len({tuple(row[5:]) for row in rows}) == count
    assert any(line.startswith("SKIN: 0 of its 94 elements are listed so") for line in lines)


@pytest.mark.parametrize("suffix", WRITERS)
def test_names_cannot_steer_the_file(suffix):
    names = ["a part", 'quo"te', "$EndPhysicalNames\n", "Größe", "x" * 200, "back\\slash", ""]
    said = text(meshes.renamed(names), suffix)
    body = said.split("$PhysicalNames\n")[1].split("$EndPhysicalNames")[0]
    for name in ("a part", "quo_te", "_EndPhysicalNames_", "Gr__e", "x" * 127, "back_slash", "_"):
        assert f'"{name}"' in said or suffix == ".msh2"
    assert body.count('"') == 2 * int(body.split("\n")[0])


@pytest.mark.parametrize("suffix", WRITERS)
@pytest.mark.parametrize("names", [('a"', "a\\"), ("é", "è"), ("x" * 127, "x" * 128)])
def test_two_names_that_would_be_one_are_refused(suffix, names):
    with pytest.raises(FormatError, match=r"would both be .* in Gmsh; wanted names that differ"):
        text(meshes.renamed(names), suffix)


@pytest.mark.judge
@pytest.mark.parametrize("suffix", WRITERS)
def test_one_cell_without_parts(folder, ask, suffix):
    paths = [put(folder, f"one-{s}", suffix, meshes.one_cell(s)) for s in meshes.KINDS[:-1]]
    for shape, found in zip(meshes.KINDS[:-1], ask("gmsh_mesh", *paths), strict=True):
        assert (found["elements"], found["complaints"]) == ({shape: 1}, [])
        assert found["volume"] == pytest.approx(meshes.one_cell(shape).volumes.sum(), rel=1e-9)
        assert found["cell_sets"] == {}


@pytest.mark.parametrize("suffix", WRITERS)
def test_lengths_keep_their_unit(suffix):
    said = text(meshes.body("hex8", "um"), suffix)
    assert "made by porous; lengths in um\n" in said
    places = [line for line in text(meshes.body("hex8"), suffix).splitlines() if "." in line]
    assert [line for line in said.splitlines() if "." in line] == places


@pytest.mark.parametrize("suffix", WRITERS)
@pytest.mark.parametrize("unit", METRES)
def test_lengths_come_back_in_their_unit(tmp_path, suffix, unit):
    mesh = meshes.body("hex8", unit)
    formats.write(mesh, tmp_path / f"a{suffix}")
    found = formats.read(tmp_path / f"a{suffix}")
    assert found.unit == unit
    np.testing.assert_allclose(found.points, mesh.points, rtol=1e-15)


@pytest.mark.parametrize("suffix", WRITERS)
def test_what_is_no_mesh_is_refused(tmp_path, suffix):
    job = Job("a body", meshes.body("hex8"))
    with pytest.raises(FormatError, match=r"cannot hold a Job; wanted one of .*\.inp"):
        formats.write(job, tmp_path / f"job{suffix}")
    empty = VolumeMesh(np.zeros((0, 3)), (), {}, {"NOTHING": Part("nodes", np.zeros(0, int))})
    with pytest.raises(FormatError, match="the mesh has no cells"):
        formats.write(empty, tmp_path / f"empty{suffix}")
    assert list(tmp_path.iterdir()) == []


@st.composite
def memberships(draw):
    count = draw(st.integers(1, 12))
    member = st.integers(0, count - 1)
    names = draw(st.lists(st.sampled_from(["SKIN", "a", "SOLID", "b", "PORE"]), unique=True))
    sets = {name: draw(st.sets(member, min_size=1)) for name in names}
    return Groups(count, {name: np.array(sorted(some)) for name, some in sets.items()})


@given(memberships())
def test_combinations_say_every_part_of_every_element(groups):
    label, entities = groups.combined()
    assert len(set(map(frozenset, entities))) == len(entities) == len(np.unique(label))
    for element, number in enumerate(label):
        inside = {name for name, members in groups.sets.items() if element in members}
        assert set(entities[number]) == inside


@given(memberships())
def test_one_part_leads_each_element(groups):
    label, shown = groups.leading()
    order = ["SOLID", "PORE", *(n for n in groups.sets if n in "ab"), "SKIN"]
    for element, number in enumerate(label.tolist()):
        inside = [n for n in order if n in groups.sets and element in groups.sets[n]]
        assert (shown[number] if number >= 0 else None) == (inside[0] if inside else None)
    assert set(label.tolist()) - {-1} == set(range(len(shown)))


def test_numbers_in_lines_keep_every_digit():
    rng = np.random.default_rng(5)
    whole = rng.integers(-(10**12), 10**12, (25_003, 2))
    real = rng.standard_normal((25_003, 3)) * 10.0 ** rng.integers(-300, 300, (25_003, 1))
    table = np.loadtxt(io.BytesIO(b"".join(lines_of(whole[:, 0], real, whole))))
    assert np.array_equal(table[:, 1:4], real)
    assert np.array_equal(table[:, [0, 4, 5]], whole[:, [0, 0, 1]])
    assert list(lines_of(whole[:0])) == []
