"""Balls about nets, held against all distances of all samples; tiles, threads, certain blocks."""

from concurrent.futures import ThreadPoolExecutor

import naive_sampling as naive
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from porous.kernels import grown as kernels
from porous.models import cell_cover, cover, net
from porous.models.automaton import of_maps
from porous.models.enclosure import enclosing_balls
from porous.models.net import Net, Window, split_cells
from porous.values import CENTRE, FILL, Frame, Pattern

# Six lines with two depths each, all in one half of the voxel along x.
UNEVEN = Pattern(
    np.column_stack([np.linspace(0.05, 0.45, 6), [0.1, 0.9, 0.5, 0.3, 0.7, 0.2]]),
    np.sort(np.random.default_rng(0).uniform(0.01, 0.99, (6, 2)), axis=1),
)
PATTERNS = {"centre": CENTRE, "fill": FILL, "uneven": UNEVEN}


def dust(points, frame, reach):
    """Return the net of a finite set of points."""

    def mark(window, marks, size, *, whole):
        assert size > 0
        assert whole == (window.spacing > split_cells(frame, reach)[1] * 1.5).all()
        index = np.floor((points - frame.origin) / window.spacing).astype(int) - window.start
        inside = ((index >= 0) & (index < window.shape)).all(axis=1)
        marks[tuple(index[inside].T)] = 1

    return Net.about(frame, reach, (points.min(axis=0), points.max(axis=0)), mark)


def runs(cells):
    """Return the runs along z of cells (k, 3): the first and the last of each, (n, 2, 3)."""
    cells = np.unique(cells, axis=0)
    after = np.any(np.diff(cells, axis=0) != (0, 0, 1), axis=1)
    first, last = np.append(True, after), np.append(after, True)
    return np.stack([cells[first], cells[last]], axis=1)


def brute_force(cells, cell, frame, pattern, radius):
    """Return which samples (nx, ny, nz, p) are within a radius of the runs of cells."""
    points = naive.samples(frame, pattern) - frame.origin
    result = np.zeros(points.shape[:-1], bool)
    for low, high in (runs(cells) + 0.5) * cell:
        z = np.maximum(low[2] - points[..., 2], points[..., 2] - high[2]).clip(0)
        result |= (points[..., 0] - low[0]) ** 2 + (points[..., 1] - low[1]) ** 2 + z**2 <= (
            radius + 1e-6 * min(frame.spacing)
        ) ** 2
    return result


def cells_of(points, frame, cell):
    return np.floor((points - frame.origin) / cell).astype(int)


def clustered(rng, frame, count):
    """Return points in a few lumps and on a few lines along z, some of them beside the frame."""
    box = np.array(frame.shape) * frame.spacing
    lumps = rng.uniform(-0.3, 1.3, (4, 3)) * box
    points = lumps[rng.integers(4, size=count)] + rng.normal(size=(count, 3)) * box * 0.03
    points[: count // 3, :2] = lumps[0, :2]
    return points + frame.origin


@settings(max_examples=40)
@given(
    st.integers(0, 2**32),
    st.tuples(*[st.integers(1, 12)] * 3),
    st.floats(-1.3, 1.3),
    st.integers(1, 60),
    st.sampled_from(sorted(PATTERNS)),
)
def test_samples_are_those_within_the_radius_of_a_net(seed, shape, power, count, name):
    rng = np.random.default_rng(seed)
    frame = Frame(rng.normal(size=3), rng.uniform(0.5, 1.7, 3), shape, start=rng.integers(0, 9, 3))
    # From a fraction of a cell to more than the frame.
    radius = min(frame.spacing) * 10**power
    points = clustered(rng, frame, count) + np.array(frame.start) * frame.spacing
    made = dust(points, frame, radius)
    masks = made.grown(frame, PATTERNS[name], radius)
    cells = cells_of(points, frame, made.cell)
    wanted = brute_force(cells, made.cell, frame, PATTERNS[name], radius)
    assert np.array_equal(naive.bits(masks, PATTERNS[name].points), wanted)


@pytest.mark.parametrize("steps", [0.2, 0.9, 6.0, 25.0])
def test_a_tile_is_the_same_alone_and_among_others_and_on_any_thread(steps):
    rng = np.random.default_rng(5)
    frame = Frame((0.1, -2.0, 5.0), (0.9, 1.3, 1.1), (37, 21, 29))
    radius = steps * 0.9
    made = dust(clustered(rng, frame, 300), frame, radius)
    whole = made.grown(frame, FILL, radius)
    assert whole.any()
    assert np.unique(whole).size > 2
    starts = rng.integers(0, (30, 15, 22), (12, 3))

    def asked(start):
        return made.grown(
            frame.tile(tuple(start), tuple(start + np.array((7, 6, 7)))), FILL, radius
        )

    with ThreadPoolExecutor(3) as pool:
        tiles = list(pool.map(asked, starts))
    for (x, y, z), tile in zip(starts, tiles, strict=True):
        assert np.array_equal(tile, whole[x : x + 7, y : y + 6, z : z + 7])


@pytest.mark.parametrize("steps", [1.0, 12.0])
def test_a_frame_of_several_tiles_is_drawn_without_seams(steps):
    rng = np.random.default_rng(8)
    frame = Frame((0.0, 1.0, 2.0), (1.0, 0.8, 1.25), (67, 66, 131))
    radius = steps * 0.8
    points = clustered(rng, frame, 90)
    made = dust(points, frame, radius)
    masks = made.grown(frame, CENTRE, radius)
    axes = [(np.arange(n) + 0.5) * h for n, h in zip(frame.shape, frame.spacing, strict=True)]
    wanted = np.zeros(frame.shape, bool)
    for low, high in (runs(cells_of(points, frame, made.cell)) + 0.5) * made.cell:
        x, y = (axes[0] - low[0]) ** 2, (axes[1] - low[1]) ** 2
        z = np.maximum(low[2] - axes[2], axes[2] - high[2]).clip(0) ** 2
        wanted |= x[:, None, None] + y[:, None] + z <= (radius + 8e-7) ** 2
    assert np.array_equal(masks != 0, wanted)


def test_balls_are_closed():
    frame = Frame((0.0, 0.0, 0.0), (0.5, 0.5, 0.5), (9, 9, 9))
    made = dust(np.full((1, 3), 2.3), frame, 1.0)
    centre = (cells_of(np.full((1, 3), 2.3), frame, made.cell)[0] + 0.5) * made.cell
    places = (np.indices(frame.shape).reshape(3, -1).T + 0.5) * 0.5
    distances = np.linalg.norm(places - centre, axis=1)
    for radius in np.unique(distances)[:20]:
        found = made.grown(frame, CENTRE, float(radius)).ravel() != 0
        assert np.array_equal(found, distances <= radius + 1e-9)


def test_what_is_certain_needs_no_fine_net():
    frame = Frame((0.0, 0.0, 0.0), (1.0, 1.1, 0.9), (20, 21, 22))
    points = np.array([[10.0, 11.0, 9.0]])
    asked = []

    def counted(made):
        def mark(window, marks, size, *, whole):
            asked.append(whole)
            made.mark(window, marks, size, whole=whole)

        return Net(made.cell, made.held, mark)

    everything = counted(dust(points, frame, 60.0)).grown(frame, FILL, 60.0)
    assert (everything == ~np.uint64(0)).all()
    assert all(asked)
    far = frame.tile((0, 0, 0), (3, 3, 3))
    assert not counted(dust(points, far, 2.0)).grown(far, FILL, 2.0).any()
    assert all(asked)


def test_memory_for_candidates_grows_and_work_can_pause(monkeypatch):
    rng = np.random.default_rng(3)
    frame = Frame((0.0, 0.0, 0.0), (1.0, 0.7, 0.9), (11, 14, 9))
    made = dust(clustered(rng, frame, 200), frame, 2.0)
    wanted = made.grown(frame, FILL, 2.0)
    monkeypatch.setattr(kernels, "ROOM", 4)
    monkeypatch.setattr(kernels, "ENOUGH", 1)
    monkeypatch.setattr(kernels, "BUDGET", 10)
    assert np.array_equal(made.grown(frame, FILL, 2.0), wanted)


# --- nets of attractors --------------------------------------------------------------------


def turned(count, ratio, seed):
    rng = np.random.default_rng(seed)
    for _ in range(count):
        q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        yield q * ratio, rng.uniform(-0.5, 0.5, 3)


def attractor_net(maps, frame, radius):
    automaton = of_maps(maps)
    return cover._net(automaton, enclosing_balls(automaton), frame, radius)


def limit_net(maps, frame, radius):
    return cell_cover._net(cell_cover._limit(of_maps(maps), ()), frame, radius)


@pytest.mark.parametrize("build", [attractor_net, limit_net])
@pytest.mark.parametrize("ratio", [0.35, 0.6])
@pytest.mark.parametrize("steps", [0.4, 1.6, 4.5])
def test_a_grown_attractor_is_drawn_about_all_of_its_net(build, ratio, steps):
    maps = list(turned(3, ratio, 11))
    frame = Frame((-0.7, -0.7, -0.75), (0.12, 0.1, 0.14), (11, 13, 9))
    radius = steps * 0.1
    made = build(maps, frame, radius)
    low, high = (np.floor((side - frame.origin) / made.cell).astype(int) for side in made.held)
    window = Window(low - 1, high - low + 3, made.cell)
    marks = window.empty()
    made.mark(window, marks, float(made.cell.min()) / net.ENDS, whole=False)
    cells = np.argwhere(marks == 1) + window.start
    wanted = brute_force(cells, made.cell, frame, UNEVEN, radius)
    assert wanted.any()
    found = made.grown(frame, UNEVEN, radius)
    assert np.array_equal(naive.bits(found, UNEVEN.points), wanted)
    tile = frame.tile((4, 3, 2), (9, 13, 8))
    assert np.array_equal(made.grown(tile, UNEVEN, radius), found[4:9, 3:13, 2:8])
