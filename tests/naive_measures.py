"""Slow, obvious twins of the measures: loops over voxels, edges and corners."""

from itertools import product

import numpy as np


def padded(solid, periodic):
    """Return the grid with one more layer below (wrapped or void), and above where in vacuum."""
    result = np.asarray(solid, bool)
    for axis, wraps in enumerate(periodic):
        last = result.take([-1], axis=axis)
        void = np.zeros_like(last)
        parts = [last, result] if wraps else [void, result, void]
        result = np.concatenate(parts, axis=axis)
    return result


def histogram(solid, periodic=(False, False, False)):
    """Count the 2×2×2 windows by looking at each."""
    grid = padded(solid, periodic)
    counts = np.zeros(256, int)
    for i, j, k in product(*(range(n - 1) for n in grid.shape)):
        window = 0
        for x, y, z in product((0, 1), repeat=3):
            window += int(grid[i + x, j + y, k + z]) << (4 * x + 2 * y + z)
        counts[window] += 1
    return counts


def complex_counts(solid, periodic=(False, False, False)):
    """Count vertices, edges, faces, cells of the closed union as sets of doubled coordinates."""
    size = [2 * n if wraps else None for n, wraps in zip(solid.shape, periodic, strict=True)]
    parts = set()
    for voxel in np.argwhere(solid):
        for step in product((-1, 0, 1), repeat=3):
            point = 2 * voxel + 1 + step
            parts.add(tuple(p if m is None else p % m for p, m in zip(point, size, strict=True)))
    dimensions = [sum(p % 2 for p in point) for point in parts]
    return [dimensions.count(d) for d in range(4)]


def neighbours(voxel, shape, periodic, steps):
    """Yield the voxels next to one, by wrapping or stopping at the border."""
    for step in steps:
        there = [v + s for v, s in zip(voxel, step, strict=True)]
        there = [t % n if w else t for t, n, w in zip(there, shape, periodic, strict=True)]
        if all(0 <= t < n for t, n in zip(there, shape, strict=True)):
            yield tuple(there)


STEPS = {
    26: [s for s in product((-1, 0, 1), repeat=3) if any(s)],
    6: [s for s in product((-1, 0, 1), repeat=3) if sum(map(abs, s)) == 1],
}


def faces(solid, periodic=(False, False, False)):
    """Count the voxel faces between the phases by their normal axis."""
    counts = [0, 0, 0]
    for voxel in np.argwhere(solid):
        for step in STEPS[6]:
            there = list(neighbours(voxel, solid.shape, periodic, [step]))
            axis = int(np.argmax(np.abs(step)))
            counts[axis] += not there or not solid[there[0]]
    return counts


def euler_number_6(solid, periodic=(False, False, False)):
    """Count voxels − pairs + squares − cubes of face-joined solid voxels."""
    grid = padded(solid, periodic)
    total = 0
    for shape in product((1, 2), repeat=3):
        sign = (-1) ** sum(n - 1 for n in shape)
        for corner in product(*(range(1, n) for n in grid.shape)):
            block = tuple(slice(c - n + 1, c + 1) for c, n in zip(corner, shape, strict=True))
            total += sign * bool(grid[block].all())
    return total


def label(mask, connectivity, periodic=(False, False, False)):
    """Flood from each voxel in raster order."""
    labels = np.zeros(mask.shape, int)
    count = 0
    for start in map(tuple, np.argwhere(mask)):
        if labels[start]:
            continue
        count += 1
        labels[start] = count
        front = [start]
        while front:
            voxel = front.pop()
            for there in neighbours(voxel, mask.shape, periodic, STEPS[connectivity]):
                if mask[there] and not labels[there]:
                    labels[there] = count
                    front.append(there)
    return labels, count


def winds(mask, connectivity, periodic, axis):
    """Tell which voxels can walk along a periodic axis back onto themselves, once around.

    Each component is walked in a grid that is unrolled along ``axis``: where a voxel is reached
    in two different turns, the component goes around.
    """
    labels, count = label(mask, connectivity, periodic)
    result = np.zeros(mask.shape, bool)
    n = mask.shape[axis]
    for piece in range(1, count + 1):
        start = tuple(np.argwhere(labels == piece)[0])
        turns = {start: 0}
        front = [start]
        around = False
        while front:
            voxel = front.pop()
            for step in STEPS[connectivity]:
                for there in neighbours(voxel, mask.shape, periodic, [step]):
                    if not mask[there]:
                        continue
                    turn = turns[voxel] + (voxel[axis] + step[axis]) // n
                    if there not in turns:
                        turns[there] = turn
                        front.append(there)
                    around |= turns[there] != turn
        if around:
            result |= labels == piece
    return result


def hausdorff(a, b):
    """Return the Hausdorff distance of two point sets by all distances."""
    d = np.linalg.norm(a[:, None] - b[None], axis=2)
    return max(d.min(axis=0).max(), d.min(axis=1).max())
