"""Slow, obvious twins of the surface kernel: the case table from its rules, cubes one by one.

Corner c of a cube is (dx, dy, dz) with c = 4 dx + 2 dy + dz; bit c of a case is set where that
corner is solid. Edges: 0–3 run along x at (dy, dz), 4–7 along y at (dx, dz), 8–11 along z at
(dx, dy), each numbered by two bits. ``python tests/naive_surface.py`` prints the table as
``porous/kernels/_cases.py`` holds it.
"""

import itertools

import numpy as np

CORNERS = np.array(list(itertools.product((0, 1), repeat=3)))
TUNNELS = (126, 189, 219, 231)
"""Cases with just two void corners, diagonally opposite: their void is joined through the cube."""


def _ends(edge):
    axis, place = divmod(edge, 4)
    low = np.insert([place >> 1, place & 1], axis, 0)
    high = np.insert([place >> 1, place & 1], axis, 1)
    return tuple(int(c @ [4, 2, 1]) for c in (low, high))


ENDS = [_ends(edge) for edge in range(12)]
EDGE_OF = {frozenset(ends): edge for edge, ends in enumerate(ENDS)}


def _face(axis, side):
    u, v = (axis + 1) % 3, (axis + 2) % 3
    ring = []
    for a, b in ((0, 0), (1, 0), (1, 1), (0, 1)):
        corner = np.zeros(3, int)
        corner[[axis, u, v]] = side, a, b
        ring.append(int(corner @ [4, 2, 1]))
    return ring if side else ring[::-1]


FACES = [_face(axis, side) for axis in range(3) for side in (0, 1)]
"""Corners of the six faces, counter-clockwise seen from outside."""

FACES_OF_EDGE = [{f for f in range(6) if set(ENDS[e]) <= set(FACES[f])} for e in range(12)]


def links(case):
    """Directed segments, edge → edge, that the surface leaves in the cube's faces.

    Each maximal run of solid corners on a face is cut off by one segment: solid corners that are
    diagonal to each other on a face stay apart.
    """
    found = {}
    for ring in FACES:
        solid = [case >> corner & 1 for corner in ring]
        for start in range(4):
            if solid[start] and not solid[start - 1]:
                stop = start
                while solid[(stop + 1) % 4]:
                    stop += 1
                enter = EDGE_OF[frozenset((ring[start - 1], ring[start]))]
                found[enter] = EDGE_OF[frozenset((ring[stop % 4], ring[(stop + 1) % 4]))]
    return found


def loops(case):
    """The closed loops of ``links``, each from its lowest edge."""
    left, result = links(case), []
    while left:
        loop = [min(left)]
        while (after := left.pop(loop[-1])) != loop[0]:
            loop.append(after)
        result.append(tuple(loop))
    return result


def triangulations(loop):
    """All ways to cut a polygon into triangles."""
    if len(loop) < 3:
        return [()]
    found = []
    for middle in range(1, len(loop) - 1):
        triangle = (loop[0], loop[middle], loop[-1])
        for left in triangulations(loop[: middle + 1]):
            found += [(*left, triangle, *right) for right in triangulations(loop[middle:])]
    return found


def chords(triangles, case):
    """Sides of triangles that are not segments in the cube's faces."""
    segments = {frozenset(link) for link in links(case).items()}
    sides = {frozenset(s) for t in triangles for s in itertools.combinations(t, 2)}
    return sides - segments


def in_a_face(chord):
    """Whether a chord joins two cube edges that share a face: a neighbour might have it too."""
    a, b = chord
    return bool(FACES_OF_EDGE[a] & FACES_OF_EDGE[b])


def annuli(case):
    """The strips of six triangles that join the two loops of a tunnel case."""
    one, two = loops(case)
    found = []
    for shift in range(3):
        other = [two[(shift - k) % 3] for k in range(3)]
        for pairs in ((0, 0), (0, 1)):
            strip = []
            for k in range(3):
                a, b = one[k], one[(k + 1) % 3]
                c, d = other[k], other[(k + 1) % 3]
                strip += [(a, b, c), (b, d, c)] if pairs == (0, 0) else [(a, b, d), (a, d, c)]
            found.append(tuple(strip))
    return found


def candidates(case):
    """All sets of triangles that obey the rules for ``case``."""
    if case in TUNNELS:
        return annuli(case)
    per_loop = [
        [t for t in triangulations(loop) if not any(map(in_a_face, chords(t, case)))]
        for loop in loops(case)
    ]
    return [tuple(itertools.chain(*choice)) for choice in itertools.product(*per_loop)]


def parameters(seed=0):
    """Where the level may cut the edges: 1 500 samples, many of them close to the corners."""
    rng = np.random.default_rng(seed)
    extreme = rng.uniform(0.004, 0.024, (500, 12))
    extreme = np.where(rng.random((500, 12)) < 0.5, extreme, 1 - extreme)
    middle = 0.5 + rng.uniform(-1e-3, 1e-3, (100, 12))
    return np.concatenate([rng.uniform(0.004, 0.996, (900, 12)), extreme, middle])


def places(t):
    """Points on the twelve edges: shape (samples, 12, 3)."""
    low, high = (CORNERS[list(ends)] for ends in zip(*ENDS, strict=True))
    return low + t[..., None] * (high - low)


def _signed(a, b, c, d):
    return np.einsum("...i,...i", np.cross(b - a, c - a), d - a)


def crosses(p, q, a, b, c):
    """Whether the segment pq passes through the triangle abc, sample by sample."""
    apart = _signed(a, b, c, p) * _signed(a, b, c, q) < 0
    turns = np.stack([_signed(p, q, u, v) for u, v in ((a, b), (b, c), (c, a))])
    return apart & ((turns > 0).all(axis=0) | (turns < 0).all(axis=0))


def crossings(triangles, points):
    """How many samples have a triangle's side passing through another triangle."""
    bad = np.zeros(len(points), bool)
    for one, other in itertools.permutations(triangles, 2):
        for side in itertools.combinations(one, 2):
            if not set(side) & set(other):
                bad |= crosses(*(points[:, e] for e in (*side, *other)))
    return int(bad.sum())


def least_angle(triangles, points):
    """Mean over the samples of the least angle of all triangles, in radians."""
    least = np.full(len(points), np.pi)
    for t in triangles:
        for k in range(3):
            a, b, c = (points[:, t[(k + n) % 3]] for n in range(3))
            cosine = np.einsum("ij,ij->i", b - a, c - a)
            cosine /= np.linalg.norm(b - a, axis=1) * np.linalg.norm(c - a, axis=1)
            least = np.minimum(least, np.arccos(np.clip(cosine, -1, 1)))
    return float(least.mean())


def derive(case, points):
    """The triangles of ``case``: no crossings, then the best least angle."""
    clean = [c for c in candidates(case) if not crossings(c, points)]
    return max(clean, key=lambda c: (round(least_angle(c, points), 6), c))


def packed(triangles):
    """The text of a case: one hexadecimal digit an edge."""
    return "".join(f"{edge:x}" for triangle in triangles for edge in triangle) or "-"


def marching_cubes(fill, triangles_of):
    """The surface as an array of triangles (t, 3 corners, 3 coordinates), cube by cube.

    ``triangles_of(case)`` gives triples of edges; coordinates count voxels from the array's corner.
    """
    padded = np.pad(fill.astype(float), 1)
    result = []
    for i, j, k in np.ndindex(*(n - 1 for n in padded.shape)):
        values = [padded[i + a, j + b, k + c] for a, b, c in CORNERS]
        case = sum(1 << c for c in range(8) if values[c] > 127.5)
        for triangle in triangles_of(case):
            corners = []
            for low, high in (ENDS[edge] for edge in triangle):
                t = (127.5 - values[low]) / (values[high] - values[low])
                corner = CORNERS[low] + t * (CORNERS[high] - CORNERS[low])
                corners.append(np.array([i, j, k]) - 0.5 + corner)
            result.append(corners)
    return np.array(result).reshape(-1, 3, 3)


def canonical(triangles):
    """Triangles in an order of their own, each from its least corner, rounded to 1e-9."""
    turned = []
    for triangle in np.round(np.asarray(triangles), 9).tolist():
        least = triangle.index(min(triangle))
        turned.append(triangle[least:] + triangle[:least])
    return np.array(sorted(turned))


def ball(radius, shape, centre):
    """Fill of a ball, 8 × 8 × 8 samples a voxel; lengths count voxels."""
    squares = [((np.arange(8 * n) + 0.5) / 8 - c) ** 2 for n, c in zip(shape, centre, strict=True)]
    inside = squares[0][:, None, None] + squares[1][:, None] + squares[2] <= radius**2
    nx, ny, nz = shape
    counts = inside.reshape(nx, 8, ny, 8, nz, 8).sum(axis=(1, 3, 5))
    return np.round(255 * counts / 512).astype(np.uint8)


def main():
    points = places(parameters())
    print(*(packed(derive(case, points)) for case in range(256)))  # noqa: T201


if __name__ == "__main__":
    main()
