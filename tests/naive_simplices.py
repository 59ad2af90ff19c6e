"""Slow, obvious twins of simplices: every sample asked of every one, every voxel by a programme."""

import itertools

import naive_sampling as naive
import numpy as np
from scipy.optimize import linprog

FACES = [(1, 2, 3), (0, 2, 3), (0, 1, 3), (0, 1, 2)]


def weights(points, tet):
    """The weights of points (n, 3) over a tetrahedron's corners, (n, 4): none below zero within."""
    system = np.vstack([tet.T, np.ones(4)])
    ends = np.concatenate([points, np.ones((*points.shape[:-1], 1))], axis=-1)
    return np.linalg.solve(system, ends[..., None])[..., 0]


def depth_in_tets(points, tets):
    """How deep points (n, 3) lie in one of the tetrahedra: distance to its surface, < 0 outside."""
    best = np.full(len(points), -np.inf)
    for tet in tets:
        away = naive.distance_to_triangles(points, tet[FACES])
        inside = (weights(points, tet) >= 0).all(axis=1)
        best = np.maximum(best, np.where(inside, away, -away))
    return best


def depth_in_swept(points, corners, radii):
    """How deep points (n, 3) lie in balls swept over simplices (k, 1 … 3, 3); < 0 outside."""
    best = np.full(len(points), -np.inf)
    for simplex, radius in zip(corners, radii, strict=True):
        three = simplex[np.minimum(np.arange(3), len(simplex) - 1)]
        best = np.maximum(best, radius - naive.distance_to_triangles(points, three[None]))
    return best


def depth(points, body):
    """How deep points (n, 3) of the world lie in a body of simplices."""
    return np.max(
        [
            depth_in_tets(points, body.tets),
            depth_in_swept(points, body.balls[:, None, :3], body.balls[:, 3]),
            depth_in_swept(points, body.capsules, body.capsule_radii),
            depth_in_swept(points, body.plates, body.plate_radii),
        ],
        axis=0,
    )


def touches(simplex, lower, upper, slack=0.0):
    """Whether the hull of corners (n, 3) meets a box: is there a point of both?"""
    n = len(simplex)
    if (simplex.min(axis=0) > upper + slack).any() or (simplex.max(axis=0) < lower - slack).any():
        return False
    found = linprog(
        np.zeros(n),
        A_ub=np.vstack([simplex.T, -simplex.T]),
        b_ub=np.concatenate([upper + slack, slack - lower]),
        A_eq=np.ones((1, n)),
        b_eq=[1.0],
        bounds=[(0, None)] * n,
        method="highs",
    )
    return found.status == 0


def touched(simplices, frame, slack=0.0):
    """Which voxels the hulls of corners (k, n, 3) meet, booleans of the frame's shape."""
    result = np.zeros(frame.shape, bool)
    origin, step = np.array(frame.origin), np.array(frame.spacing)
    for voxel in np.ndindex(*frame.shape):
        low = (np.array(voxel) + frame.start) * 1.0
        result[voxel] = any(
            touches((simplex - origin) / step, low, low + 1, slack) for simplex in simplices
        )
    return result


def points_of(corners, count, random):
    """Random points of the hulls of corners (k, n, 3), ``count`` of each, corners included."""
    share = random.dirichlet(np.full(corners.shape[1], 0.6), (len(corners), count))
    inner = np.einsum("kcn,kna->kca", share, corners)
    return np.concatenate([inner, corners], axis=1).reshape(-1, 3)


def trilinear_volume(cell):
    """The volume of a trilinear hexahedron (8, 3) by Gauss's rule of 2 × 2 × 2 points.

    The Jacobian's determinant is of degree two at most in each coordinate, so the rule is exact.
    """
    total = 0.0
    for place in itertools.product((0.5 - 12**-0.5, 0.5 + 12**-0.5), repeat=3):
        columns = []
        for axis in range(3):
            slope = np.zeros(3)
            for corner, digits in zip(cell, itertools.product((0, 1), repeat=3), strict=True):
                factor = 2.0 * digits[axis] - 1
                for other in range(3):
                    if other != axis:
                        factor *= place[other] if digits[other] else 1 - place[other]
                slope += factor * corner
            columns.append(slope)
        total += np.linalg.det(np.array(columns)) / 8
    return total


def in_trilinear(points, cell, steps=12):
    """Which points (n, 3) lie in a trilinear hexahedron (8, 3), by Newton's iteration."""
    unit = np.array(list(itertools.product((0.0, 1.0), repeat=3)))
    place = np.full(points.shape, 0.5)
    for _ in range(steps):
        shape = np.prod(np.where(unit, place[:, None], 1 - place[:, None]), axis=2)
        slope = np.empty((len(points), 8, 3))
        for axis in range(3):
            rest = np.delete(np.where(unit, place[:, None], 1 - place[:, None]), axis, axis=2)
            slope[:, :, axis] = np.where(unit[:, axis], 1, -1) * rest.prod(axis=2)
        jacobian = np.einsum("nka,kb->nba", slope, cell)
        step = np.linalg.solve(jacobian, (points - shape @ cell)[..., None])[..., 0]
        place = np.clip(place + step, -2, 3)
    return ((place >= -1e-12) & (place <= 1 + 1e-12)).all(axis=1)
