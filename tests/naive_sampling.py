"""Slow, obvious twins of sampling: every sample point asked of every piece."""

import itertools

import numpy as np


def samples(frame, pattern):
    """Sample points in the world, shape (nx, ny, nz, R·C, 3), in the order of the mask's bits."""
    result = np.empty((*frame.shape, pattern.points, 3))
    columns = pattern.depths.shape[1]
    for voxel in np.ndindex(*frame.shape):
        for r, c in itertools.product(range(len(pattern.rows)), range(columns)):
            inside = np.array([*pattern.rows[r], pattern.depths[r, c]])
            index = np.array(voxel) + frame.start + inside
            result[(*voxel, r * columns + c)] = frame.origin + index * np.array(frame.spacing)
    return result


def bits(masks, points):
    """The bits of masks as booleans, one more axis."""
    return (masks[..., None] >> np.arange(points, dtype=np.uint64) & np.uint64(1)).astype(bool)


def depth_in_hulls(points, primitive, frames):
    """How deep points lie in the union of images of a convex primitive; negative outside."""
    best = np.full(points.shape[:-1], -np.inf)
    for frame in frames:
        inverse = np.linalg.inv(frame[:, :3])
        normals = primitive.planes[:, :3] @ inverse
        offsets = primitive.planes[:, 3] + normals @ frame[:, 3]
        length = np.linalg.norm(normals, axis=1)
        best = np.maximum(best, ((offsets - points @ normals.T) / length).min(axis=-1))
    return best


def depth_in_ellipsoids(points, primitive, frames):
    """Like a depth: positive inside, negative outside, zero on the surface."""
    best = np.full(points.shape[:-1], -np.inf)
    for frame in frames:
        local = (points - frame[:, 3]) @ np.linalg.inv(frame[:, :3]).T - primitive.points[0]
        best = np.maximum(best, primitive.radius - np.linalg.norm(local, axis=-1))
    return best


def windings(points, corners):
    """How often a closed surface, triangles (t, 3, 3), winds round points (n, 3): solid angles."""
    result = np.empty(len(points))
    for i, point in enumerate(points):
        a, b, c = np.moveaxis(corners - point, 1, 0)
        la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
        triple = (a * np.cross(b, c)).sum(axis=1)
        rest = la * lb * lc + (a * b).sum(1) * lc + (b * c).sum(1) * la + (c * a).sum(1) * lb
        result[i] = np.arctan2(triple, rest).sum() / (2 * np.pi)
    return result


def distance_to_triangles(points, corners):
    """Distance of points (n, 3) from triangles (t, 3, 3): the plane where it is hit, or an edge."""
    best = np.full(len(points), np.inf)
    for triangle in corners:
        normal = np.cross(triangle[1] - triangle[0], triangle[2] - triangle[0])
        sides = []
        for k in range(3):
            p, q = triangle[k], triangle[(k + 1) % 3]
            along = q - p
            t = np.clip((points - p) @ along / max(along @ along, 1e-300), 0, 1)
            best = np.minimum(best, np.linalg.norm(points - p - t[:, None] * along, axis=1))
            sides.append((points - p) @ np.cross(normal, along) >= 0)
        length = np.linalg.norm(normal)
        if length > 1e-12:
            height = np.abs((points - triangle[0]) @ normal) / length
            best = np.where(np.all(sides, axis=0), np.minimum(best, height), best)
    return best


def digit_cells(place, divisions, level):
    """The indices of the level-``level`` cells of [0, 1] that hold a number, closed: 0, 1 or 2."""
    count = divisions**level
    near = round(place * count)
    if abs(place * count - near) < 1e-9 * count:
        both = (near - 1, near)
    else:
        both = (int(np.floor(place * count)),)
    return [index for index in both if 0 <= index < count]


def in_digits(point, divisions, keep, level):
    """Whether a point of the unit cube lies in a kept cell: digit by digit, cell by cell."""
    kept = {tuple(d) for d in keep}
    for cell in itertools.product(*(digit_cells(p, divisions, level) for p in point)):
        digits = [tuple(index // divisions**k % divisions for index in cell) for k in range(level)]
        if all(d in kept for d in digits):
            return True
    return False


def chaos_points(maps, count, seed=0):
    """Points of an attractor by the chaos game: matrices (n, 3, 3), translations (n, 3)."""
    random = np.random.default_rng(seed)
    linear, shift = np.array([m[0] for m in maps]), np.array([m[1] for m in maps])
    at = np.zeros((1000, 3))
    found = []
    for step in range(100 + -(-count // 1000)):
        k = random.integers(len(maps), size=len(at))
        at = np.einsum("nab,nb->na", linear[k], at) + shift[k]
        if step >= 100:
            found.append(at)
    return np.concatenate(found)[:count]


def word_points(maps, size, radius):
    """A point of every part of an attractor that is smaller than ``size``: words by length."""
    linear, shift = np.array([m[0] for m in maps], float), np.array([m[1] for m in maps], float)
    start = np.linalg.solve(np.eye(3) - linear[0], shift[0])
    A, b, found = np.eye(3)[None], np.zeros((1, 3)), []
    while len(A):
        small = np.linalg.norm(A, axis=(1, 2)) * radius <= size
        found.append(A[small] @ start + b[small])
        A, b = A[~small], b[~small]
        b = (np.einsum("wab,mb->wma", A, shift) + b[:, None]).reshape(-1, 3)
        A = np.einsum("wab,mbc->wmac", A, linear).reshape(-1, 3, 3)
    return np.concatenate(found)


def depth_in_grown_ellipsoids(points, centres, matrices, radius):
    """r − the distance from the nearest ellipsoid {c + A·y : |y| ≤ ½}, at most r inside of them.

    The nearest point has y = (AᵀA + μ)⁻¹Aᵀ(p − c), μ ≥ 0 such that |y| = ½ or zero: bisected.
    """
    depth = np.full(points.shape[:-1], -np.inf)
    for c, A in zip(centres, matrices, strict=True):
        turn, sigma, _ = np.linalg.svd(A)
        q = (points - c) @ turn
        low = np.zeros(q.shape[:-1])
        high = np.full_like(low, 2 * sigma.max() * np.abs(q).sum(axis=-1).max() + 1)
        for _ in range(200):
            mu = (low + high) / 2
            y = sigma * q / (sigma**2 + mu[..., None])
            outside = (y**2).sum(axis=-1) > 0.25
            low, high = np.where(outside, mu, low), np.where(outside, high, mu)
        away = q * high[..., None] / (sigma**2 + high[..., None])
        depth = np.maximum(depth, radius - np.linalg.norm(away, axis=-1))
    return depth
