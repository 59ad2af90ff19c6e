"""How near the volume of a fill comes to the truth, and how the error falls with the spacing."""

import itertools
import math

import numpy as np
import pytest
from manifold3d import Manifold

from porous.models.bcifs import bcifs
from porous.models.builders import Options, build_cell
from porous.models.digits import named as digits_named
from porous.models.pieces import Pieces
from porous.models.primitive import named
from porous.models.simplices import Simplices, hexa_tets, volumes
from porous.values import FILL, Frame

PLACEMENTS = 12
VOXELS = 64
SIZES = (8, 16, 32, 64)
"""Voxels along the longest edge of the frame; spacings are unequal."""

MANY = 60
ODD_SIZES = (6, 9, 13, 20, 29, 43, 64)
"""Placements and resolutions where errors are linear in the spacing, and depend on luck most."""

EDGE = 20 / VOXELS
"""Edges and diameters of single bodies in a frame of length one: twenty voxels of the finest."""

UNIT = np.array(list(itertools.product((0.0, 1.0), repeat=3)))
LATTICE = np.array(list(itertools.product((0.0, 0.5, 1.0), repeat=3)))
CORNER = np.vstack([np.zeros(3), np.eye(3)])
"""A tetrahedron with three axis-parallel faces."""

GAUSS = np.array([0.5 - math.sqrt(0.15), 0.5, 0.5 + math.sqrt(0.15)]), np.array([5, 8, 5]) / 18
"""Points and weights that integrate polynomials of degree five over [0, 1]."""


def frame_of(voxels):
    return Frame.fit(
        Frame((0, 0, 0), (1, 0.93, 0.88), (1, 1, 1)).box,
        spacing=(1 / voxels, 0.94 / voxels, 1.05 / voxels),
    )


def filled(body, voxels):
    frame = frame_of(voxels)
    return float(np.bitwise_count(body.sample(frame, FILL)).sum()) / 64 * frame.voxel_volume


def rotation(random):
    q, _ = np.linalg.qr(random.normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q))


def placed(points, random):
    """Move points, about the origin's corner, to where their ball of 0.3 lies in the frame."""
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    return points - middle + random.uniform(0.36, 0.52, 3)


def affine(points, images):
    """The frame (3, 4) that carries four and more points to their images."""
    lifted = np.column_stack([points, np.ones(len(points))])
    return np.linalg.lstsq(lifted, images, rcond=None)[0].T


# --- bodies: each returns one for Pieces, the same for Simplices, and the volume -----------------


def ball(random, edge=EDGE):
    centre, radius = random.uniform(0.36, 0.52, 3), edge / 2
    frame = np.column_stack([np.eye(3) * edge, centre - edge / 2])
    simplices = Simplices(balls=[[*centre, radius]])
    return Pieces(named("ball"), frame[None]), simplices, 4 / 3 * math.pi * radius**3


def blocks(corners):
    frames = np.array([affine(UNIT, cell) for cell in corners])
    return Pieces(named("cube"), frames), Simplices(hexa_tets(corners))


def cube(random, edge=EDGE):
    corners = placed(UNIT * edge, random)[None]
    return *blocks(corners), edge**3


def turned_cube(random, edge=EDGE):
    corners = placed(UNIT @ rotation(random) * edge, random)[None]
    return *blocks(corners), edge**3


def tetrahedron(random, edge=EDGE):
    corners = placed(CORNER * edge * random.choice([-1, 1], 3), random)
    frame = affine(named("tetrahedron").points, corners)
    return Pieces(named("tetrahedron"), frame[None]), Simplices(corners[None]), edge**3 / 6


def overlapping(random, edge=EDGE):
    """Three turned cubes that share much; the volume is that of their union by exact booleans."""
    corners = np.array([placed(UNIT @ rotation(random) * edge, random) for _ in range(3)])
    corners += 0.7 * (corners.mean(axis=(0, 1)) - corners.mean(axis=1, keepdims=True))
    union = Manifold()
    for cell in corners:
        union += Manifold.hull_points(cell)
    assert union.volume() < 2.8 * edge**3
    return *blocks(corners), union.volume()


def copies(random, edge=EDGE):
    """The same turned cube three times: a union with itself."""
    corners = placed(UNIT @ rotation(random) * edge, random)[None].repeat(3, axis=0)
    return *blocks(corners), edge**3


BODIES = {
    "ball": (ball, 1e-3),
    "turned cube": (turned_cube, 1e-3),
    "overlapping": (overlapping, 1e-3),
    "copies": (copies, 1e-3),
    "cube": (cube, 5e-3),
    "tetrahedron": (tetrahedron, 1e-2),
}


def relative_errors(name, which, voxels, *, placements=PLACEMENTS, sizes=(EDGE, EDGE)):
    """Errors of bodies of random places, and edges between two sizes."""
    make, _ = BODIES[name]
    errors = []
    for seed in range(placements):
        random = np.random.default_rng(1000 * voxels + seed)
        *bodies, exact = make(random, random.uniform(*sizes))
        errors.append(abs(filled(bodies[which], voxels) / exact - 1))
    return np.array(errors)


each_sampler = pytest.mark.parametrize("which", [0, 1], ids=["pieces", "simplices"])


@each_sampler
@pytest.mark.parametrize("name", BODIES)
def test_a_fill_has_the_volume(name, which):
    _, tolerance = BODIES[name]
    assert relative_errors(name, which, VOXELS).max() < tolerance
    others = relative_errors(name, which, VOXELS, sizes=(EDGE, 1.3 * EDGE))
    assert others.max() < tolerance


@each_sampler
@pytest.mark.parametrize("name", ["ball", "turned cube", "overlapping", "copies"])
def test_the_mean_error_of_turned_bodies_falls_faster_than_linearly(name, which):
    errors = [relative_errors(name, which, voxels).mean() for voxels in SIZES]
    assert order(SIZES, errors) > 1.5


@pytest.mark.slow
@each_sampler
@pytest.mark.parametrize("name", ["cube", "tetrahedron"])
def test_the_mean_error_of_axis_parallel_bodies_falls_linearly(name, which):
    # The places of faces are seen to a sixteenth of a voxel, whatever the spacing.
    errors = [
        relative_errors(name, which, n, placements=MANY, sizes=(0.25, 0.4)).mean()
        for n in ODD_SIZES
    ]
    assert order(ODD_SIZES, errors) >= 1
    each = np.array(errors) * ODD_SIZES
    assert each.max() < 0.35
    assert each[-1] <= each[0]


def order(sizes, errors):
    """The exponent of the spacing in errors at some numbers of voxels."""
    return -np.polyfit(np.log(sizes), np.log(errors), 1)[0]


# --- curved cells ----------------------------------------------------------------------------


def trilinear(random, edge=EDGE):
    """A bent hexahedron and the volume of the trilinear map."""
    corners = UNIT + random.uniform(-0.2, 0.2, UNIT.shape)
    corners = placed(corners @ rotation(random) * edge, random)
    return Simplices(hexa_tets(corners[None])), mapped_volume(corners, 1)


def triquadratic(random, edge=EDGE, level=4):
    """The small cells of a tri-quadratic hexahedron, and the volume of the Bézier map."""
    controls = LATTICE + random.uniform(-0.12, 0.12, LATTICE.shape)
    controls = placed(controls @ rotation(random) * edge, random)
    sets = (digits_named("full-2"),)
    brep = build_cell(Options("hex-27", digits=sets))
    model = bcifs(brep, level=level, controls=controls.T, digits=sets)
    return model.solid, mapped_volume(controls, 2)


def mapped_volume(controls, degree):
    """∫ det of the Jacobian of Σ B_i(u) B_j(v) B_k(w) P_ijk, of degree ≤ 5 in each, exactly."""
    net = controls.reshape(degree + 1, degree + 1, degree + 1, 3)
    nodes, weights = GAUSS
    basis = np.array(
        [math.comb(degree, i) * nodes**i * (1 - nodes) ** (degree - i) for i in range(degree + 1)]
    )
    lower = np.array(
        [
            math.comb(degree - 1, i) * nodes**i * (1 - nodes) ** (degree - 1 - i)
            for i in range(degree)
        ]
    )
    slope = degree * (np.vstack([0 * lower[:1], lower]) - np.vstack([lower, 0 * lower[:1]]))
    columns = []
    for axis in range(3):
        a, b, c = (slope if axis == k else basis for k in range(3))
        columns.append(np.einsum("ijkx,ip,jq,kr->pqrx", net, a, b, c))
    dets = np.linalg.det(np.stack(columns, axis=-1))
    return abs(float(np.einsum("pqr,p,q,r", dets, weights, weights, weights)))


def test_the_twin_of_volumes_is_right():
    assert mapped_volume(UNIT * [2, 3, 5], 1) == pytest.approx(30, rel=1e-14)
    assert mapped_volume(LATTICE * [2, 3, 5], 2) == pytest.approx(30, rel=1e-14)
    random = np.random.default_rng(3)
    corners = UNIT + random.uniform(-0.2, 0.2, UNIT.shape)
    tets = volumes(hexa_tets(corners[None])).sum()
    assert mapped_volume(corners, 1) == pytest.approx(tets, rel=1e-13)


@pytest.mark.parametrize("make", [trilinear, pytest.param(triquadratic, marks=pytest.mark.slow)])
def test_curved_cells_have_the_volume_and_come_nearer_to_it(make):
    found = [make(np.random.default_rng(seed)) for seed in range(PLACEMENTS)]
    errors = np.array([[abs(filled(body, n) / exact - 1) for n in SIZES] for body, exact in found])
    assert errors[:, -1].max() < 1e-3
    assert order(SIZES, errors.mean(axis=0)) > 1


def test_small_cells_have_the_volume_of_the_quadratic_map():
    # Bilinear faces in place of curved ones: of second order in the size of cells.
    away = []
    for level in (2, 3, 4):
        body, exact = triquadratic(np.random.default_rng(7), level=level)
        away.append(abs(volumes(body.tets).sum() / exact - 1))
    assert away[-1] < 2e-4
    assert all(fine < coarse / 3 for coarse, fine in itertools.pairwise(away))
