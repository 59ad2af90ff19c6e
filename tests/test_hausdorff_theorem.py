"""The bound of covers as a theorem: brute force over random systems, through the whole pipeline.

A sampling of the attractor with a known gap δ has a point within δ of each of the attractor's. So
what is farther than the bound + δ from all samples refutes the bound, and so does a sample outside
the cover.
"""

import itertools
import math

import naive_limits as naive
import naive_sampling
import numpy as np
import pytest

from porous import bcifs, ifs, voxelize
from porous.models.builders import Options, Texture, build_cell
from porous.models.digits import DigitSet, named
from porous.models.enclosure import enclosing_balls
from porous.stages import _sampled

SYSTEMS = 50
FAST = 8
"""How many random systems the fast tests look at."""

CUBE = np.array(list(itertools.product((0.0, 1.0), repeat=3))).T

SHAPES = ((11, 8, 9), (7, 12, 8), (9, 10, 6))
"""Numbers of voxels, about: axes and spacings are unequal."""


def fast_and_slow(count, fast):
    return [k if k < fast else pytest.param(k, marks=pytest.mark.slow) for k in range(count)]


def rotation(random):
    q, _ = np.linalg.qr(random.normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q))


def contraction(random, ratio):
    """A rotation after a shear and unequal ratios, of operator norm ``ratio``."""
    shear = np.eye(3) + np.triu(random.uniform(-0.7, 0.7, (3, 3)), 1)
    A = rotation(random) @ shear @ np.diag(random.uniform(0.35, 1, 3))
    if random.random() < 0.3:
        A = rotation(random)  # a similarity now and then
    return A * ratio / np.linalg.norm(A, 2)


def random_maps(seed):
    """Two to six maps of unequal ratios that overlap as they like."""
    random = np.random.default_rng(seed)
    count = int(random.integers(2, 7))
    ratios = random.uniform(0.2, 0.68, count)
    ratios *= min(1.0, (1.3 / (ratios**3).sum()) ** (1 / 3))
    shifts = random.uniform(-0.6, 0.6, (count, 3))
    return [(contraction(random, r), shift) for r, shift in zip(ratios, shifts, strict=True)]


def spacing_of(model, shape):
    return tuple(a / n for a, n in zip(model.domain.lengths, shape, strict=True))


def assert_theorem(grid, points, gap):
    """Hold a cover to samples of its attractor that leave out no more than ``gap``."""
    frame = grid.frame
    h, diagonal = min(frame.spacing), frame.diagonal
    marks = grid.fill == 255
    assert np.array_equal(marks, grid.fill > 0)
    index, inside = naive.voxels_of(points, frame)
    assert inside.all()  # the domain holds the attractor
    assert marks[tuple(index.T)].all()  # and the cover each of its samples
    assert grid.hausdorff <= (diagonal + 2 * h / 16) * (1 + 1e-4)
    # From the attractor to the cover the distance is nothing; and from the cover to it:
    assert naive.furthest(marks, frame, points, steps=4) <= grid.hausdorff + gap


def assert_bytes(model, spacing, grid, monkeypatch):
    """The bytes do not depend on tiles, their order or threads."""
    monkeypatch.setattr(_sampled, "TILE", (5, 4, 7))
    ordered = _sampled._tiles
    for threads, turn in (("1", 1), ("3", -1)):
        monkeypatch.setenv("POROUS_THREADS", threads)
        monkeypatch.setattr(_sampled, "_tiles", lambda shape, turn=turn: ordered(shape)[::turn])
        again = voxelize(model, spacing=spacing, sampling="cover")
        assert again.fill.tobytes() == grid.fill.tobytes()
        assert again.hausdorff == grid.hausdorff


@pytest.mark.parametrize("seed", fast_and_slow(SYSTEMS, FAST))
def test_covers_of_random_maps_obey_the_theorem(seed, monkeypatch):
    maps = random_maps(seed)
    model = ifs(maps, level="limit", primitive="ball")
    spacing = spacing_of(model, SHAPES[seed % len(SHAPES)])
    grid = voxelize(model, spacing=spacing, sampling="cover")
    gap = min(spacing) / 3
    # A part of the attractor is in the image of a ball that holds it all.
    points = naive_sampling.word_points(maps, gap, 2 * enclosing_balls(model.automaton)[0, 3])
    assert_theorem(grid, points, gap)
    assert_bytes(model, spacing, grid, monkeypatch)
    turned = ifs([*maps[::-1], maps[0]], level="limit", primitive="ball", domain=model.domain)
    assert np.array_equal(voxelize(turned, spacing=spacing, sampling="cover").fill, grid.fill)


def cells(name, seed, amount, *, digits=(), texture=None, keep=None):
    """A boundary-controlled system with random controls."""
    brep = build_cell(Options(name, digits=digits, texture=texture, keep=keep))
    state = brep.states[brep.start]
    random = np.random.default_rng(seed)
    controls = state.controls + random.uniform(-amount, amount, state.controls.shape)
    sides = np.diag([1.2, 0.8, 1.0])
    return bcifs(brep, level="limit", controls=sides @ controls, digits=digits)


CORNERS = DigitSet(2, np.array([[0, 0, 0], [1, 1, 0], [1, 0, 1], [0, 1, 1]]))
FEW = DigitSet(3, np.array([[0, 0, 0], [2, 1, 0], [1, 2, 2], [0, 2, 1], [2, 0, 2]]))
BODIES = {
    "a bent sponge": lambda: cells("hex-8", 0, 0.1, digits=(named("menger"),)),
    "a bent dust": lambda: cells("hex-8", 1, 0.15, digits=(FEW,)),
    "three parities": lambda: cells("hex-8", 2, 0.12, digits=(CORNERS,)),
    "threes, then twos": lambda: cells("hex-8", 3, 0.1, digits=(named("vicsek-9"), CORNERS)),
    "a Bézier cell": lambda: cells("hex-27", 4, 0.06, digits=(named("vicsek-9"),)),
    "a texture": lambda: cells(
        "hex-27",
        5,
        0.06,
        digits=(FEW,),
        texture=Texture(edge=(0.3, -0.2, 0.3), bump=(0.5, 0.3)),
    ),
    "a rough texture": lambda: cells(
        "hex-27",
        6,
        0.05,
        digits=(FEW,),
        texture=Texture(edge=(0.45, -0.4, 0.45), bump=(0.5, 0.3)),
    ),
    "a texture of halves": lambda: cells(
        "hex-27", 7, 0.06, digits=(CORNERS,), texture=Texture(edge=(0.2, 0.4), bump=0.4)
    ),
    "tetrahedra": lambda: cells("tetra", 8, 0.2),
    "tetrahedra and octahedra": lambda: cells(
        "tetra-octa", 9, 0.15, keep={"tetra": ("tetra", "octa")}
    ),
}


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.slow)
        if "sponge" in name or "octahedra" in name
        else name
        for name in BODIES
    ],
)
def test_covers_of_cells_obey_the_theorem(name, monkeypatch):
    model = BODIES[name]()
    spacing = spacing_of(model, SHAPES[len(name) % len(SHAPES)])
    grid = voxelize(model, spacing=spacing, sampling="cover")
    gap = min(spacing) / 2
    assert_theorem(grid, naive.limit_points(model.automaton, gap), gap)
    assert_bytes(model, spacing, grid, monkeypatch)


def test_there_are_enough_systems():
    assert SYSTEMS >= 50
    assert len(BODIES) >= 10
    ratios = [np.linalg.norm(A, 2) for seed in range(SYSTEMS) for A, _ in random_maps(seed)]
    assert max(ratios) > 0.6
    assert max(ratios) < 1
    volumes = [sum(abs(np.linalg.det(A)) for A, _ in random_maps(seed)) for seed in range(SYSTEMS)]
    assert sum(volume > 0.3 for volume in volumes) > 3  # some overlap, or nearly fill space
    assert math.isfinite(sum(volumes))
