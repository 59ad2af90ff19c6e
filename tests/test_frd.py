"""Results of CalculiX as fields: what Hooke and Fourier say, scikit-fem finds, and is refused."""

import math
from dataclasses import replace

import naive_boundary as naive
import naive_elasticity
import numpy as np
import pytest
import systems
from deck_meshes import STEEL, zoo

from porous import formats
from porous.errors import FormatError, MeshError
from porous.formats import frd, inp
from porous.formats.gate import Source
from porous.guests import ccx
from porous.jobs import compression, material
from porous.stages import hexahedralize, name_parts, quadratic
from porous.values import (
    Field,
    Frame,
    Held,
    Job,
    MeshFields,
    Part,
    Pressed,
    Step,
    VolumeMesh,
    VoxelGrid,
)

SIX = 2e-5
"""Numbers have six digits."""
FOUR = 1e-4
"""What is carried from points of integration to nodes is so by factors of four digits: 2.549 …"""


def block(shape=(2, 3, 4), spacing=(1.0, 0.5, 0.25)):
    frame = Frame((0, 0, 0), spacing, shape)
    mesh = hexahedralize(VoxelGrid.of_solid(np.ones(shape, dtype=bool), frame))
    return name_parts(mesh, frame.box)


def results(job, program):
    solved = ccx.solve(inp.write(job), program=program, fields=True)
    return formats_of(solved.fields)


def formats_of(data):
    return frd.read(Source("job.frd", data))


def held(name, axis):
    return Held(name, "displacement", 0.0, (axis,))


@pytest.mark.parametrize("order", [1, 2])
def test_a_bar_that_is_pulled_moves_as_hooke_says(judge, order):
    mesh = block() if order == 1 else quadratic(block())
    free = tuple(held(f"{a}MIN", i) for i, a in enumerate("XYZ"))
    pull = Step("pull", "static", free, (Pressed("ZMAX_FACES", -420.0),))
    found = results(Job("bar", mesh, {"SOLID": STEEL}, (pull,)), judge("ccx"))
    assert {b.shape for b in found.mesh.blocks} == {b.shape for b in mesh.blocks}
    np.testing.assert_allclose(found.mesh.points, mesh.points, atol=1e-5)
    strain = 420.0 / STEEL.youngs_modulus * np.array([-0.3, -0.3, 1.0])
    moved = mesh.points * strain
    np.testing.assert_allclose(found["displacement"].values, moved, atol=SIX * np.abs(moved).max())
    stress = np.zeros(6)
    stress[2] = 420.0
    np.testing.assert_allclose(
        found["stress"].values, stress[None] + 0 * moved[:, :1], atol=420 * FOUR
    )
    np.testing.assert_allclose(found["stress"].magnitude, 420.0, rtol=FOUR)
    np.testing.assert_allclose(found["strain"].values[:, :3], strain[None] + 0 * moved, atol=1e-7)


def test_heat_in_a_bar_flows_as_fourier_says(judge):
    mesh = block()
    held = (Held("YMIN", "temperature", 5.0), Held("YMAX", "temperature", 11.0))
    job = Job("bar", mesh, {"SOLID": STEEL}, (Step("heat", "conduction", held),))
    found = results(job, judge("ccx"))
    length = 3 * 0.5
    linear = 5 + 6 * mesh.points[:, 1] / length
    np.testing.assert_allclose(found["temperature"].values, linear, rtol=SIX)
    flux = -STEEL.conductivity * 6 / length
    np.testing.assert_allclose(found["heat_flux"].values[:, 1], flux, rtol=FOUR)
    np.testing.assert_allclose(found["heat_flux"].values[:, [0, 2]], 0, atol=FOUR * abs(flux))
    assert found["heat_flux"].magnitude == pytest.approx(abs(flux), rel=FOUR)


def test_results_of_our_decks_know_their_units(judge):
    job = compression(block(), material=material("steel"), pressure=2.0)
    mm, si = (
        results(
            replace(job, system=system, title="units mm-N-MPa: a long title " * 9), judge("ccx")
        )
        for system in ("mm-N-MPa", "m-SI")
    )
    assert (mm.mesh.unit, si.mesh.unit) == ("mm", "m")
    np.testing.assert_allclose(si.mesh.points * 1e3, mm.mesh.points, rtol=SIX, atol=1e-9)
    ratios = {"displacement": (1e3, "mm", "m"), "stress": (1e-6, "MPa", "Pa")}
    ratios |= {"strain": (1, "1", "1"), "reaction": (1, "N", "N")}
    for name, (ratio, *units) in ratios.items():
        assert [mm[name].unit, si[name].unit] == units
        scale = np.abs(mm[name].values).max()
        np.testing.assert_allclose(si[name].values * ratio, mm[name].values, atol=1e-5 * scale)


def test_displacements_are_those_of_scikit_fem(judge):
    solid = np.kron(naive.prefractal(3, systems.MENGER, 1), np.ones((2, 2, 2), dtype=bool))
    frame = Frame((0, 0, 0), (1 / 6, 1 / 7, 1 / 5), solid.shape)
    mesh = name_parts(hexahedralize(VoxelGrid.of_solid(solid, frame)), frame.box)
    job = compression(mesh, material=material("steel"), pressure=2.0)
    found = results(job, judge("ccx"))
    wanted = naive_elasticity.solved(job)[0].reshape(-1, 3)
    far = np.abs(wanted).max()
    np.testing.assert_allclose(found["displacement"].values, wanted, atol=1e-5 * far)
    held = job.mesh.parts["ZMIN"].members
    total = found["reaction"].values[held].sum(axis=0)
    assert total[2] == pytest.approx(2.0 * 32 / 42, rel=1e-4)


def test_every_shape_comes_back_with_its_nodes_in_order(judge):
    bare = zoo()
    every = Part("cells", np.arange(bare.cells))
    mesh = VolumeMesh(bare.points, bare.blocks, {}, {"ALL": every, "ZMIN": bare.parts["ZMIN"]})
    step = Step("m", "static", (Held("ZMIN", "displacement", 0.0, (0, 1, 2)),))
    found = results(Job("zoo", mesh, {"ALL": STEEL}, (step,)), judge("ccx"))
    back = {b.shape: found.mesh.points[b.cells] for b in found.mesh.blocks}
    for b in mesh.blocks:
        np.testing.assert_allclose(back.pop(b.shape), mesh.points[b.cells], atol=2e-5)
    assert not back


def test_modes_and_steps_have_names_of_their_own(judge):
    clamp = (Held("ZMIN", "displacement", 0.0, (0, 1, 2)),)
    modal = Job("m", block(), {"SOLID": STEEL}, (Step("m", "modal", clamp, modes=3),))
    assert results(modal, judge("ccx")).names == tuple(f"displacement_mode_{i}" for i in (1, 2, 3))
    steps = tuple(
        Step(f"s{p}", "static", clamp, (Pressed("ZMAX_FACES", float(p)),)) for p in (1, 2)
    )
    found = results(Job("two", block(), {"SOLID": STEEL}, steps), judge("ccx"))
    first, second = (found[f"displacement_step_{i}"].values for i in (1, 2))
    np.testing.assert_allclose(second, 2 * first, atol=1e-5 * np.abs(second).max())


# --- without a solver ----------------------------------------------------------------------

NODES = [(0, 0, 0), (2, 0, 0), (0, 3, 0), (0, 0, 5)]
HEAD = "    1C\n    1UPGM               CalculiX\n"


def text(*, labels=(1, 2, 3, 4), values=((1.0,), (-2.0,), (3.0,), (-4.5,)), short=False, **more):
    """Return the results of a tetrahedron: a number at each of its nodes."""
    n, flag = (5, 0) if short else (10, 1)
    points = "".join(
        f" -1{i:{n}d}" + "".join(f"{c:12.5E}" for c in p) + "\n"
        for i, p in zip(labels, NODES, strict=True)
    )
    cell = f" -1{1:{n}d}{3:5d}    0    1\n -2" + "".join(f"{i:{n}d}" for i in labels) + "\n"
    rows = "".join(
        f" -1{i:{n}d}" + "".join(f"{v:12.5E}" for v in row) + "\n"
        for i, row in zip(labels, values, strict=True)
    )
    name = more.get("name", "NDTEMP")
    parts = "".join(f" -5  T{i}          1    1    0    0\n" for i in range(len(values[0])))
    result = (
        f"  100CL  101 1.000000000{len(values):12d}{'':20} 0    1{'':10}{flag:2d}\n"
        f" -4  {name:8}{len(values[0]):5d}    1\n{parts}{rows} -3\n"
    )
    mesh = f"    2C{'':18}{4:12d}{'':37}{flag}\n{points} -3\n"
    mesh += f"    3C{'':18}{1:12d}{'':37}{flag}\n{cell} -3\n"
    return (HEAD + mesh + result + " 9999\n").encode()


@pytest.mark.parametrize("short", [False, True])
def test_numbers_may_touch_and_labels_have_gaps(short):
    found = formats_of(text(labels=(40, 7, 99999, 12), short=short))
    order = np.argsort([40, 7, 99999, 12])
    assert found.mesh.points.tolist() == np.array(NODES, float)[order].tolist()
    assert found["temperature"].values.tolist() == np.array([1, -2, 3, -4.5])[order].tolist()
    assert found["temperature"].unit == ""


@pytest.mark.parametrize(
    ("heading", "units"),
    [
        ("units m-SI: mine", ("m", "K")),
        ("units mm-N-MPa: mine", ("mm", "K")),
        ("mine, units m-SI: ", ("mm", "")),
        ("units m-SIX: mine", ("mm", "")),
        ("units cm: mine", ("mm", "")),
    ],
)
def test_units_are_what_our_own_heading_says(heading, units):
    head = f"    1C\n    1U{heading}\n    1Uunits mm-N-MPa: too late\n".encode()
    if units[1] == "":
        head = head.replace(b"    1Uunits mm-N-MPa: too late\n", b"")
    found = formats_of(text().replace(b"    1C\n", head))
    assert (found.mesh.unit, found["temperature"].unit) == units


def test_what_is_no_vector_is_passed_over():
    assert formats_of(text(values=((1.0, 2.0),) * 4)).fields == ()
    assert formats_of(text(name="MY OWN")).names == ("my_own",)


def test_lines_of_windows_and_a_node_without_a_value():
    data = text()
    assert formats_of(data.replace(b"\n", b"\r\n")) == formats_of(data)
    lost = data.replace(b" -1         4-4.50000E+00\n", b"")
    lost = lost.replace(b"1.000000000           4", b"1.000000000           3")
    assert np.isnan(formats_of(lost)["temperature"].values).tolist() == [False] * 3 + [True]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (b" 9999\n", b"", "ends before its last line, 9999"),
        (b"-4.50000E+00", b"-4.5000xE+00", "wanted a number"),
        (b"-4.50000E+00", b"            ", "a number in every column"),
        (b"-4.50000E+00", b"-4.5", "1 columns of 12 characters"),
        (b"-4.50000E+00", b"         INF", "infinite value"),
        (b" 5.00000E+00\n -3", b"         NaN\n -3", "point 3 is .0.0, 0.0, nan"),
        (b"    2C", b"    7C", "one of 1C, 1U"),
        (b"    3C                             1", b"    3C                             9", "9 as"),
        (b"    3    0    1", b"   15    0    1", "type: got 15; wanted one of"),
        (b"    3    0    1", b"    1    0    1", "columns of 10"),
        (b"         4\n -3", b"         9\n -3", "has node 9"),
        (b" 0    1           1", b" 0    1           2", "0 or 1, text"),
        (b"NDTEMP      1", b"NDTEMP      x", "a whole number"),
        (b" -3\n 9999", b" 9999", "without an end"),
    ],
)
def test_what_is_damaged_is_refused_in_one_line(old, new, said, tmp_path):
    data = text()
    assert data.count(old) >= 1
    (tmp_path / "a.frd").write_bytes(data.replace(old, new))
    with pytest.raises((FormatError, MeshError), match=said) as caught:
        formats.read(tmp_path / "a.frd")
    assert "\n" not in str(caught.value)


def test_it_becomes_a_file_for_paraview(tmp_path):
    pv = pytest.importorskip("pyvista")
    (tmp_path / "a.frd").write_bytes(text())
    found = formats.read(tmp_path / "a.frd")
    named = MeshFields(found.mesh, (Field("temperature", found["temperature"].values, "K"),))
    formats.write(named, tmp_path / "a.vtu")
    grid = pv.read(tmp_path / "a.vtu")
    assert grid.point_data["temperature"].tolist() == [1, -2, 3, -4.5]
    array = grid.GetPointData().GetArray("temperature")
    assert array.GetInformation().Get(array.UNITS_LABEL()) == "K"
    assert formats.read(tmp_path / "a.vtu") == found.mesh


def test_fields_are_of_their_mesh():
    mesh = formats_of(text()).mesh
    with pytest.raises(MeshError, match="got 3 rows; wanted one for each of 4 nodes"):
        MeshFields(mesh, (Field("a", np.zeros(3)),))
    with pytest.raises(MeshError, match="each name once"):
        MeshFields(mesh, (Field("a", np.zeros(4)), Field("a", np.ones(4))))
    with pytest.raises(MeshError, match=r"wanted \(n,\), \(n, 3\) or \(n, 6\)"):
        Field("a", np.zeros((4, 2)))
    with pytest.raises(MeshError, match="wanted nodes or cells"):
        Field("a", np.zeros(4), at="faces")


def test_fields_at_cells_are_written_too(tmp_path):
    mesh = formats_of(text()).mesh
    formats.write(
        MeshFields(mesh, (Field("b", np.ones((1, 3)), "mm", "cells"),)), tmp_path / "a.vtu"
    )
    pv = pytest.importorskip("pyvista")
    assert pv.read(tmp_path / "a.vtu").cell_data["b"].tolist() == [[1, 1, 1]]


def test_von_mises_of_a_shear_is_root_three():
    shear = Field("stress", np.array([[0, 0, 0, 2.0, 0, 0], [5.0, 5.0, 5.0, 0, 0, 0]]))
    assert shear.magnitude.tolist() == pytest.approx([2 * math.sqrt(3), 0.0])
