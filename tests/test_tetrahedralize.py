"""Tetrahedra of closed surfaces: volume, quality, refusals before the mesher starts, its death."""

import itertools
import os
import re
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path

import numpy as np
import psutil
import pytest
import systems

import porous
from porous import load, run
from porous.errors import Cancelled, GuestError, MeshError, RecipeError
from porous.guests import process, tetwild
from porous.guests.tetwild import signed_volumes
from porous.models.boundary import exact_boundary
from porous.models.primitive import named
from porous.recipe import dump, parse
from porous.stages import Finer, tetrahedralize
from porous.stages._sizing import background
from porous.values import Box, SurfaceMesh
from porous.values.volume_topology import bodies

CUBE = named("cube").surface("um")


def smallest_dihedral(mesh):
    """Return the smallest angle between two faces of a tetrahedron, in degrees."""
    smallest = 180.0
    corners = mesh.points[mesh.blocks[0].cells]
    for i, j in itertools.combinations(range(4), 2):
        k, m = (n for n in range(4) if n not in (i, j))
        edge = corners[:, j] - corners[:, i]
        a, b = (np.cross(edge, corners[:, n] - corners[:, i]) for n in (k, m))
        cosine = (a * b).sum(axis=1) / np.linalg.norm(a, axis=1) / np.linalg.norm(b, axis=1)
        smallest = min(smallest, np.degrees(np.arccos(np.clip(cosine, -1, 1))).min())
    return smallest


@pytest.fixture
def no_guest(monkeypatch):
    def run(*_args, **_options):
        pytest.fail("the mesher was started")

    monkeypatch.setattr(tetwild, "run", run)


def without(surface, triangles):
    return SurfaceMesh(surface.points, surface.triangles[triangles:])


def test_a_box_of_unequal_edges(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    surface = SurfaceMesh(CUBE.points * [1.0, 2.0, 3.0], CUBE.triangles, "um")
    told = []
    mesh = tetrahedralize(surface, edge_length=0.7, progress=lambda *x: told.append(x))
    assert mesh.unit == "um"
    assert (mesh.volumes > 0).all()
    assert mesh.volumes.sum() == pytest.approx(6, rel=1e-3)
    assert len(np.unique(mesh.blocks[0].cells)) == len(mesh.points)
    assert bodies(mesh).max() == 0
    assert smallest_dihedral(mesh) > 8
    assert told[-1] == ("volume", 1.0)
    assert not list(tmp_path.iterdir())  # the mesher writes where it stands


def test_shorter_edges_make_more_cells():
    coarse, fine = (tetrahedralize(CUBE, edge_length=e).cells for e in (0.6, 0.1))
    assert fine > 2 * coarse


# --- how fine where ------------------------------------------------------------------------

BAR = SurfaceMesh(CUBE.points * [4.0, 1.0, 1.0], CUBE.triangles)


def edges(mesh):
    """Return the middles (n, 3) and the lengths (n,) of the edges of tetrahedra."""
    pairs = [mesh.blocks[0].cells[:, list(ends)] for ends in itertools.combinations(range(4), 2)]
    ends = mesh.points[np.unique(np.sort(np.concatenate(pairs), axis=1), axis=0)]
    return ends.mean(axis=1), np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)


@pytest.mark.parametrize("scale", [1.0, 10.0])
def test_edges_follow_the_field(scale):
    def wanted(points):
        return np.clip(0.25 * points[:, 0], 0.15 * scale, 0.5 * scale)

    bar = SurfaceMesh(BAR.points * scale, BAR.triangles)
    mesh = tetrahedralize(bar, sizing=wanted)
    assert mesh.volumes.sum() == pytest.approx(4 * scale**3, rel=1e-3)
    middle, length = edges(mesh)
    for x in (0.3, 1.0, 1.5):
        near = np.abs(middle[:, 0] / scale - x) < 0.3
        assert length[near].mean() / wanted(middle[near]).mean() == pytest.approx(1, abs=0.25)


def test_boxes_are_finer_than_the_rest():
    finer = [Finer(Box((0, 0, 0), (0.8, 1, 1)), 0.15), Finer(Box((3.5, 0, 0), (4, 1, 1)), 0.2)]
    mesh = tetrahedralize(BAR, edge_length=0.45, sizing=finer)
    middle, length = edges(mesh)
    mean = [length[(middle[:, 0] > a) & (middle[:, 0] < b)].mean() for a, b in SECTIONS]
    assert mean[0] == pytest.approx(0.15, rel=0.2)
    assert mean[1] > 1.6 * mean[0]
    assert mean[2] == pytest.approx(0.2, rel=0.25)
    assert smallest_dihedral(mesh) > 8


SECTIONS = ((0, 0.8), (1.8, 2.6), (3.5, 4))


def test_the_lattice_fills_the_box_and_has_the_fields_values():
    box, part = Box((1, 2, 3), (2, 4, 6)), Finer(Box((1, 2, 3), (1.01, 2.02, 3.03)), 0.02)
    field = background([part], box, edge_length=0.4)
    around = Box.of_points(field.points)
    assert around.contains(box.grown(0.4))
    volumes = signed_volumes(field.points, field.tets)
    assert (volumes > 0).all()
    assert volumes.sum() == pytest.approx(around.volume)
    inside = ((field.points >= part.box.lower) & (field.points <= part.box.upper)).all(axis=1)
    assert inside.sum() >= 8  # its corners at least, though it is smaller than a cell
    assert (field.lengths[inside] == 0.02).all()
    assert field.lengths.max() == 0.4
    assert len(field.tets) < 200_000


@pytest.mark.usefixtures("no_guest")
def test_fields_that_are_none_are_refused():
    for field in (lambda p: -p[:, 0], lambda p: p, lambda p: np.full(len(p), np.nan)):
        with pytest.raises(MeshError, match="sizing: got"):
            tetrahedralize(CUBE, sizing=field)
    with pytest.raises(MeshError, match="edge_length"):
        Finer(CUBE.box, 0.0)


@pytest.mark.usefixtures("no_guest")
@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("end", [-5.0, 5.0])
def test_a_finer_box_beyond_the_body_is_refused(axis, end):
    lower, upper = [0.25, 0.25, 0.25], [0.5, 0.5, 0.5]
    lower[axis] += end
    upper[axis] += end
    told = re.escape(f"{_point(lower)} … {_point(upper)} lies beyond the body, which is")
    with pytest.raises(MeshError, match=f"finer: the box {told}") as caught:
        tetrahedralize(CUBE, sizing=[Finer(CUBE.box, 0.3), Finer(Box(lower, upper), 0.1)])
    body = f"is within {_point(CUBE.box.lower)} … {_point(CUBE.box.upper)}; wanted"
    assert body in str(caught.value)


def _point(place):
    return f"({', '.join(f'{x:g}' for x in place)})"


def test_a_finer_box_that_touches_the_body_is_taken():
    box = CUBE.box
    beside = Box((box.upper[0], 0, 0), (box.upper[0] + 1, 1, 1))
    field = background([Finer(beside, 0.1)], box, edge_length=0.4)
    assert field.lengths.min() == 0.1


def test_a_recipe_says_how_fine_where_and_for_how_long(monkeypatch):
    table = {"model.level": 0, "volume.edge_length": 0.5, "volume.time_limit": 33.5}
    finer = [{"lower": [0, 0, 0], "upper": [1, 0.2, 0.2], "edge_length": 0.1}]
    recipe = load("menger", set=table | {"volume.finer": finer, "volume.method": "tetwild"})
    assert parse(tomllib.loads(dump(recipe))) == recipe
    asked = {}

    def run_guest(_command, *, folder, time_limit, **_):
        asked["limit"] = time_limit
        with np.load(folder / "in.npz") as given:
            asked.update({key: given[key] for key in given})
        raise GuestError("enough")

    monkeypatch.setattr(tetwild, "run", run_guest)
    with pytest.raises(GuestError, match="enough"):
        run(recipe)
    assert 33 < asked["limit"] <= 33.5
    assert asked["bg_values"].min() == 0.1
    assert asked["edge_length_abs"] == asked["bg_values"].max() == 0.5
    with pytest.raises(RecipeError, match=r"volume\.finer\.0\.edge_length"):
        load("menger", set={"volume.finer": [finer[0] | {"edge_length": -1}]})


def test_solids_that_touch_share_no_nodes():
    automaton, solid = systems.flake("tetrahedron")
    surface = exact_boundary(automaton, solid, 1)
    mesh = tetrahedralize(surface, edge_length=0.5)
    assert bodies(mesh).max() + 1 == 4
    groups = [np.unique(mesh.blocks[0].cells[bodies(mesh) == i]) for i in range(4)]
    assert sum(map(len, groups)) == len(mesh.points)
    assert mesh.volumes.sum() == pytest.approx(1 / 6, rel=1e-3)


@pytest.mark.usefixtures("no_guest")
@pytest.mark.parametrize(
    ("surface", "words"),
    [
        (without(CUBE, 1), "hole"),
        (without(CUBE, 12), "no triangles"),
        (SurfaceMesh(CUBE.points, CUBE.triangles[:, ::-1]), "inside out"),
        (
            SurfaceMesh(CUBE.points, np.concatenate([CUBE.triangles, CUBE.triangles])),
            "not a manifold",
        ),
    ],
)
def test_bad_surfaces_are_refused_before_the_mesher_starts(surface, words):
    with pytest.raises(MeshError, match=words):
        tetrahedralize(surface)


def test_numbers_that_are_none_and_indices_of_nothing_never_become_a_surface():
    points = CUBE.points.copy()
    points[3, 1] = np.nan
    with pytest.raises(MeshError, match="point 3"):
        SurfaceMesh(points, CUBE.triangles)
    with pytest.raises(MeshError, match="indices"):
        SurfaceMesh(CUBE.points, CUBE.triangles + 1)


@pytest.mark.usefixtures("no_guest")
@pytest.mark.parametrize("option", ["edge_length", "epsilon", "stop_energy"])
@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
def test_lengths_that_are_none_are_refused(option, value):
    with pytest.raises(MeshError, match=option):
        tetrahedralize(CUBE, **{option: value})


def standing_in(folder):
    """Return the processes whose current folder lies in a folder, or lay there before it went."""
    running = psutil.process_iter(["cwd", "status"])
    there = [one for one in running if (one.info["cwd"] or "").startswith(str(folder))]
    return [one for one in there if one.info["status"] != psutil.STATUS_ZOMBIE]


@pytest.fixture
def nothing_left(tmp_path, monkeypatch):
    """Fail where a call leaves a process, or a file in the temporary folder or where it stands."""
    here, there = tmp_path / "here", tmp_path / "there"
    here.mkdir()
    there.mkdir()
    monkeypatch.chdir(here)
    monkeypatch.setattr("tempfile.tempdir", str(there))
    yield there
    assert not list(here.iterdir())
    assert not list(there.iterdir())
    for _ in range(50):
        if not standing_in(there):
            return
        time.sleep(0.02)
    pytest.fail(f"still there: {standing_in(there)}")


guarded = pytest.mark.usefixtures("nothing_left")


@guarded
def test_time_is_up():
    with pytest.raises(GuestError, match=r"time limit of 0\.1 s"):
        tetrahedralize(CUBE, time_limit=0.1)


def test_progress_cancels_while_the_mesher_runs(nothing_left):
    told = []

    def stop(stage, done):
        told.append((stage, done))
        if len(told) > 3:
            assert standing_in(nothing_left)
            raise Cancelled("enough")

    with pytest.raises(Cancelled):
        tetrahedralize(CUBE, edge_length=0.02, progress=stop)
    assert set(told) == {("volume", 0.0)}


def worker(monkeypatch, code):
    """Have the mesher's process do something else."""

    def run(command, **options):
        process.run([command[0], "-c", code, *command[-2:]], **options)

    monkeypatch.setattr(tetwild, "run", run)


@guarded
@pytest.mark.parametrize(
    ("code", "words"),
    [
        ("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)", "was ended by SIGSEGV"),
        ("raise SystemExit(3)", "pytetwild failed with exit code 3"),
        ("pass", "ended without a mesh"),
        ("open('out.npz', 'w').write('junk')", "no mesh but something else"),
        ("open('out.npz', 'wb').write(b'PK' + bytes(99))", "no mesh but something else"),
        ("open('out.npz', 'wb')", "no mesh but something else"),
        ("import numpy; numpy.savez('out.npz', points=0)", "no mesh but something else"),
        (
            "import numpy; numpy.savez('out.npz', points=numpy.eye(3), tets=[[0, 1, 2, 3]])",
            "tetrahedra of points that are not there",
        ),
        (
            "import numpy as n; n.savez('out.npz', points=n.ones((4, 3)) * n.nan, tets=[[0] * 4])",
            "points that are none",
        ),
        (
            "import numpy; numpy.savez('out.npz', points=numpy.eye(4)[:, :3], tets=numpy.eye(4))",
            "tetrahedra of points that are not there",
        ),
    ],
)
def test_a_mesher_that_dies_or_talks_nonsense_is_told(monkeypatch, code, words):
    worker(monkeypatch, code)
    with pytest.raises(GuestError, match=words):
        tetrahedralize(CUBE)


@guarded
def test_a_mesher_that_hangs_or_floods_is_ended_with_its_children(monkeypatch):
    child = "import subprocess, time; subprocess.Popen(['sleep', '60']); "
    worker(monkeypatch, child + "time.sleep(60)")
    with pytest.raises(GuestError, match=r"time limit of 0\.7 s"):
        tetrahedralize(CUBE, time_limit=0.7)
    monkeypatch.setattr(process, "MOST_SAID", 1000)
    worker(monkeypatch, child + "\nwhile True: print('more and more')")
    with pytest.raises(GuestError, match="it printed"):
        tetrahedralize(CUBE)


KILLED = """
import os, signal
from porous.models.primitive import named
from porous.stages import tetrahedralize
told = []
def progress(*_):
    told.append(0)
    if len(told) > 30:
        os.kill(os.getpid(), signal.SIGKILL)
tetrahedralize(named("cube").surface("mm"), edge_length=0.01, progress=progress)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="the kernel ends them on Linux only")
def test_a_mesher_ends_with_whoever_started_it(tmp_path):
    ours = {"TMPDIR": str(tmp_path), "PYTHONPATH": str(Path(porous.__file__).parent.parent)}
    done = subprocess.run(
        [sys.executable, "-c", KILLED],
        env=os.environ | ours,
        timeout=60,
        check=False,
        stdin=subprocess.DEVNULL,
    )
    assert done.returncode == -signal.SIGKILL
    assert list(tmp_path.iterdir())  # nobody was left to clear up
    time.sleep(0.2)
    assert not standing_in(tmp_path)


def test_all_attempts_together_have_the_time_that_was_given(monkeypatch):
    limits = []

    def run(_command, *, folder, time_limit, **_):
        limits.append(time_limit)
        time.sleep(0.2)
        np.savez(folder / "out.npz", points=SMALL[0], tets=np.array(SMALL[1]))

    monkeypatch.setattr(tetwild, "run", run)
    with pytest.raises(GuestError, match="% off"):
        tetrahedralize(TET.surface(), time_limit=5.0)
    assert limits[0] == pytest.approx(5, abs=0.1)
    assert limits[1] == pytest.approx(4.8, abs=0.2)


def answer(monkeypatch, *meshes):
    """Have the mesher give these answers one after the other; return what it was asked."""
    asked, left = [], list(meshes)

    def run(_command, *, folder, **_):
        with np.load(folder / "in.npz") as given:
            asked.append(float(given["epsilon"]))
        points, tets = left.pop(0)
        np.savez(folder / "out.npz", points=points, tets=np.array(tets, dtype=np.int64))

    monkeypatch.setattr(tetwild, "run", run)
    return asked


TET = named("tetrahedron")
WHOLE = TET.points, [[0, 1, 3, 2]]
FLIPPED = TET.points, [[0, 1, 2, 3]]
SMALL = TET.points * 0.99, [[0, 1, 3, 2]]


def test_tetrahedra_are_turned_and_unused_points_dropped(monkeypatch):
    for points, tets in (WHOLE, FLIPPED):
        more = np.vstack([[[7, 7, 7]], points])
        answer(monkeypatch, (more, np.array(tets) + 1))
        mesh = tetrahedralize(TET.surface())
        assert mesh.volumes.tolist() == pytest.approx([1 / 3])
        assert len(mesh.points) == 4


def test_a_wrong_volume_is_tried_again_and_then_told(monkeypatch):
    asked = answer(monkeypatch, SMALL, WHOLE)
    assert tetrahedralize(TET.surface()).volumes.sum() == pytest.approx(1 / 3)
    assert asked == [1e-3, 2.5e-4]
    answer(monkeypatch, SMALL, SMALL)
    with pytest.raises(GuestError, match=r"-3 % off"):
        tetrahedralize(TET.surface())


def test_no_tetrahedra_and_flat_ones_are_told(monkeypatch):
    answer(monkeypatch, (TET.points, np.zeros((0, 4))))
    with pytest.raises(GuestError, match="no tetrahedra"):
        tetrahedralize(TET.surface())
    answer(monkeypatch, (TET.points * [1, 1, 0], WHOLE[1]))
    with pytest.raises(GuestError, match="without volume"):
        tetrahedralize(TET.surface())


@pytest.mark.slow
@pytest.mark.parametrize("times", [1, pytest.param(3, marks=pytest.mark.nightly)])
def test_exact_menger_3_more_than_once(times):
    surface = exact_boundary(systems.digits(3, systems.MENGER), named("cube"), 3)
    for _ in range(times):
        mesh = tetrahedralize(surface)
        assert smallest_dihedral(mesh) > 8
        assert (mesh.volumes > 0).all()
        assert mesh.volumes.sum() == pytest.approx((20 / 27) ** 3, rel=1e-3)
        assert bodies(mesh).max() == 0
