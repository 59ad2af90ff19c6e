"""Marching cubes over packed bits, with exactly the topology of the 6-connected solid.

The order of work is that of flying edges (Schroeder, Maynard and Geveci 2015): count what each row
of cubes will give, sum the counts, and let every row write its own vertices and triangles where
they belong. So the result does not depend on how rows are dealt out to threads.

Rows run along z. The grid is padded by one void voxel on every side, virtually: row (i, j) of bits
is that of voxels (i − 1, j − 1), and bit k that of voxel k − 1. Cube (i, j, k) has the padded
voxels (i … i + 1, j … j + 1, k … k + 1) as corners; vertices on the three grid edges from (i, j, k)
upwards belong to row (i, j), which lists those along x first, then y, then z.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numba
import numpy as np
from numba import uint64

from porous.kernels._cases import COUNTS, TRIANGLES
from porous.kernels._shared import kernel, slabs, source
from porous.memory import check_memory

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

LEVEL = 127.5
"""Iso level: no uint8 ever equals it, so vertices keep off the corners by 1/256 of an edge."""

_VOXELS_PER_SLAB = 1 << 20


@numba.extending.intrinsic
def _bits_set(_typing, word):
    """Return the number of set bits of a 64-bit word: one machine instruction."""

    def generate(_context, builder, _signature, arguments):
        return builder.ctpop(arguments[0])

    return word(word), generate


@numba.extending.intrinsic
def _lowest_bit(_typing, word):
    """Return the index of the lowest set bit of a word that is not zero."""

    def generate(context, builder, _signature, arguments):
        zero_is_undefined = context.get_constant(numba.boolean, 1)
        return builder.cttz(arguments[0], zero_is_undefined)

    return word(word), generate


@kernel
def _pack(fill, bits, first, last):
    """Set bit k + 1 of row (i + 1, j + 1) where fill[i, j, k] is solid, for planes first … last."""
    ny, nz = fill.shape[1], fill.shape[2]
    words = bits.shape[2]
    for i in range(first, last):
        for j in range(ny):
            row = fill[i, j]
            for w in range(words):
                low = 64 * w - 1
                word = uint64(0)
                if low >= 0 and low + 64 <= nz:
                    whole = row[low : low + 64]  # of a length the compiler knows: vectorises
                    for k in range(64):
                        word |= uint64(whole[k] >> 7) << uint64(k)
                else:
                    for k in range(max(low, 0), min(low + 64, nz)):
                        word |= uint64(row[k] >> 7) << uint64(k - low)
                bits[i + 1, j + 1, w] = word


@kernel
def _count(bits, counts_of_case, vertices, faces, first, last):
    """Count the vertices along x, y, z and the triangles of each row of cubes."""
    rows = faces.shape[1]
    words = bits.shape[2]
    one = uint64(1)
    for i in range(first, last):
        for j in range(rows):
            a, b, c, d = bits[i, j], bits[i, j + 1], bits[i + 1, j], bits[i + 1, j + 1]
            along_x = along_y = along_z = uint64(0)
            triangles = 0
            for w in range(words):
                a0, b0, c0, d0 = a[w], b[w], c[w], d[w]
                a1, b1, c1, d1 = a0 >> one, b0 >> one, c0 >> one, d0 >> one
                if w + 1 < words:
                    a1 |= a[w + 1] << uint64(63)
                    b1 |= b[w + 1] << uint64(63)
                    c1 |= c[w + 1] << uint64(63)
                    d1 |= d[w + 1] << uint64(63)
                some = a0 | b0 | c0 | d0 | a1 | b1 | c1 | d1
                every = a0 & b0 & c0 & d0 & a1 & b1 & c1 & d1
                active = some & ~every
                if active == 0:
                    continue
                along_x += _bits_set(a0 ^ c0)
                along_y += _bits_set(a0 ^ b0)
                along_z += _bits_set(a0 ^ a1)
                while active != 0:
                    k = _lowest_bit(active)
                    active &= active - one
                    case = (
                        ((a0 >> k) & one)
                        | ((a1 >> k) & one) << one
                        | ((b0 >> k) & one) << uint64(2)
                        | ((b1 >> k) & one) << uint64(3)
                        | ((c0 >> k) & one) << uint64(4)
                        | ((c1 >> k) & one) << uint64(5)
                        | ((d0 >> k) & one) << uint64(6)
                        | ((d1 >> k) & one) << uint64(7)
                    )
                    triangles += counts_of_case[case]
            vertices[i, j, 0] = along_x
            vertices[i, j, 1] = along_y
            vertices[i, j, 2] = along_z
            faces[i, j] = triangles


@kernel
def _vertices(fill, bits, base, place, points, first, last):
    """Write the points of each row: place holds origin, spacing and the first voxel's index."""
    nx, ny, nz = fill.shape
    words = bits.shape[2]
    one = uint64(1)
    for i in range(first, last):
        for j in range(ny + 1):
            a, b, c = bits[i, j], bits[i, j + 1], bits[i + 1, j]
            x, y, z = base[i, j, 0], base[i, j, 1], base[i, j, 2]
            px = place[0] + (place[6] + (i - 0.5)) * place[3]
            py = place[1] + (place[7] + (j - 0.5)) * place[4]
            for w in range(words):
                a0 = a[w]
                a1 = a0 >> one
                if w + 1 < words:
                    a1 |= a[w + 1] << uint64(63)
                cut_x, cut_y, cut_z = a0 ^ c[w], a0 ^ b[w], a0 ^ a1
                cut = cut_x | cut_y | cut_z
                while cut != 0:
                    bit = _lowest_bit(cut)
                    cut &= cut - one
                    k = 64 * w + int(bit)
                    here = float(fill[i - 1, j - 1, k - 1]) if i and j and k else 0.0
                    pz = place[2] + (place[8] + (k - 0.5)) * place[5]
                    if (cut_x >> bit) & one:
                        there = float(fill[i, j - 1, k - 1]) if i < nx and j and k else 0.0
                        t = (LEVEL - here) / (there - here)
                        points[x, 0] = place[0] + (place[6] + (i - 0.5 + t)) * place[3]
                        points[x, 1] = py
                        points[x, 2] = pz
                        x += 1
                    if (cut_y >> bit) & one:
                        there = float(fill[i - 1, j, k - 1]) if i and j < ny and k else 0.0
                        t = (LEVEL - here) / (there - here)
                        points[y, 0] = px
                        points[y, 1] = place[1] + (place[7] + (j - 0.5 + t)) * place[4]
                        points[y, 2] = pz
                        y += 1
                    if (cut_z >> bit) & one:
                        there = float(fill[i - 1, j - 1, k]) if i and j and k < nz else 0.0
                        t = (LEVEL - here) / (there - here)
                        points[z, 0] = px
                        points[z, 1] = py
                        points[z, 2] = place[2] + (place[8] + (k - 0.5 + t)) * place[5]
                        z += 1


@kernel
def _triangles(bits, base, offset, table, counts_of_case, ids, triangles, first, last):
    """Write the triangles of each row of cubes; ``ids`` is scratch for the twelve edges."""
    rows = offset.shape[1] - 1
    words = bits.shape[2]
    one = uint64(1)
    for i in range(first, last):
        for j in range(rows):
            a, b, c, d = bits[i, j], bits[i, j + 1], bits[i + 1, j], bits[i + 1, j + 1]
            # Next vertex of each of the eight grid lines that edges of this row of cubes lie on:
            # advanced at active cubes only, for a cut edge makes its cubes active.
            x0, x1 = base[i, j, 0], base[i, j + 1, 0]
            y0, y1 = base[i, j, 1], base[i + 1, j, 1]
            z0, z1 = base[i, j, 2], base[i, j + 1, 2]
            z2, z3 = base[i + 1, j, 2], base[i + 1, j + 1, 2]
            n = uint64(offset[i, j])
            for w in range(words):
                a0, b0, c0, d0 = a[w], b[w], c[w], d[w]
                a1, b1, c1, d1 = a0 >> one, b0 >> one, c0 >> one, d0 >> one
                if w + 1 < words:
                    a1 |= a[w + 1] << uint64(63)
                    b1 |= b[w + 1] << uint64(63)
                    c1 |= c[w + 1] << uint64(63)
                    d1 |= d[w + 1] << uint64(63)
                some = a0 | b0 | c0 | d0 | a1 | b1 | c1 | d1
                every = a0 & b0 & c0 & d0 & a1 & b1 & c1 & d1
                active = some & ~every
                while active != 0:
                    k = _lowest_bit(active)
                    active &= active - one
                    ka, kb, kc, kd = (
                        (a0 >> k) & one,
                        (b0 >> k) & one,
                        (c0 >> k) & one,
                        (d0 >> k) & one,
                    )
                    la, lb, lc, ld = (
                        (a1 >> k) & one,
                        (b1 >> k) & one,
                        (c1 >> k) & one,
                        (d1 >> k) & one,
                    )
                    case = ka | la << one | kb << uint64(2) | lb << uint64(3)
                    case |= kc << uint64(4) | lc << uint64(5) | kd << uint64(6) | ld << uint64(7)
                    ids[0], ids[2], ids[4], ids[6] = x0, x1, y0, y1
                    ids[8], ids[9], ids[10], ids[11] = z0, z1, z2, z3
                    x0 += int(ka ^ kc)
                    x1 += int(kb ^ kd)
                    y0 += int(ka ^ kb)
                    y1 += int(kc ^ kd)
                    z0 += int(ka ^ la)
                    z1 += int(kb ^ lb)
                    z2 += int(kc ^ lc)
                    z3 += int(kd ^ ld)
                    ids[1], ids[3], ids[5], ids[7] = x0, x1, y0, y1
                    edges = table[case]
                    count = counts_of_case[case]
                    for t in range(count):
                        triangles[n, 0] = ids[edges[3 * t]]
                        triangles[n, 1] = ids[edges[3 * t + 1]]
                        triangles[n, 2] = ids[edges[3 * t + 2]]
                        n += one


@kernel
def _caps(fill, points, triangles, offset, bits, counts_of_case, planes, labels, first, last):
    """Label the triangles that lie on the faces of the frame, whose places are ``planes``.

    Only cubes at the border give such: across x and y those of the first and the last rows, across
    z the first and the last cube of each row.
    """
    nx, ny, nz = fill.shape
    one = uint64(1)
    for i in range(first, last):
        for j in range(ny + 1):
            a, b, c, d = bits[i, j], bits[i, j + 1], bits[i + 1, j], bits[i + 1, j + 1]
            border = i == 0 or i == nx or j == 0 or j == ny
            for face in range(0 if border else 4, 6):
                start, stop = offset[i, j], offset[i, j + 1]
                if face < 4:
                    at = i if face < 2 else j
                    if at != (0 if face == 0 or face == 2 else (nx if face == 1 else ny)):
                        continue
                else:
                    # The case of an end cube, whose other four corners are void.
                    voxel = uint64(1 if face == 4 else nz)
                    w, k = voxel >> uint64(6), voxel & uint64(63)
                    case = (
                        ((a[w] >> k) & one)
                        | ((b[w] >> k) & one) << uint64(2)
                        | ((c[w] >> k) & one) << uint64(4)
                        | ((d[w] >> k) & one) << uint64(6)
                    )
                    if face == 4:
                        stop = start + counts_of_case[case << one]
                    else:
                        start = stop - counts_of_case[case]
                    if case == 0x55:
                        # Mostly all four are wholly solid: then there is no need to look.
                        z = int(voxel) - 1
                        least = min(fill[i - 1, j - 1, z], fill[i - 1, j, z])
                        if min(least, fill[i, j - 1, z], fill[i, j, z]) == 255:
                            labels[start:stop] = face + 1
                            continue
                axis, plane = face >> 1, planes[face]
                for t in range(start, stop):
                    if (
                        points[triangles[t, 0], axis] == plane
                        and points[triangles[t, 1], axis] == plane
                        and points[triangles[t, 2], axis] == plane
                    ):
                        labels[t] = face + 1


def marching_cubes(
    fill: NDArray[np.uint8],
    *,
    origin: tuple[float, float, float],
    spacing: tuple[float, float, float],
    start: tuple[int, int, int] = (0, 0, 0),
    progress: Callable[[int, int], None] | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int16]]:
    """Return the surface of the voxels of fill ≥ 128, closed at the border of the array.

    Parameters
    ----------
    fill
        uint8, shape (x, y, z).
    origin, spacing, start
        Point (a, b, c) of the lattice lies at ``origin + (start + (a, b, c)) · spacing``.
    progress
        Called as ``progress(done, count)``; raising in it ends the work.

    Returns
    -------
    points
        float64, shape (n, 3).
    triangles
        int64, shape (t, 3), counter-clockwise seen from the void.
    labels
        int16, shape (t,): 1 … 6 for triangles that lie on the array's own faces, in the order
        x lower, x upper, y lower, …; else 0.
    """
    fill = source(fill, np.uint8)
    nx, ny, nz = fill.shape
    size = max(1, min(_VOXELS_PER_SLAB // ((ny + 1) * (nz + 1)), nx // 8))
    report = _thirds(progress)
    counts_of_case, table = source(COUNTS, np.uint8), source(TRIANGLES, np.uint8)

    bits = np.zeros((nx + 2, ny + 2, (nz + 2 + 63) // 64), dtype=np.uint64)
    slabs(nx, size, lambda a, b: _pack(fill, bits, a, b), report(0))

    vertices = np.empty((nx + 1, ny + 1, 3), dtype=np.int64)
    faces = np.empty((nx + 1, ny + 1), dtype=np.int64)
    slabs(nx + 1, size, lambda a, b: _count(bits, counts_of_case, vertices, faces, a, b), report(1))
    base, offset = _offsets(vertices, faces)

    total = int(offset[-1, -1])
    needed = int(vertices.sum()) * 24 + total * 26
    check_memory(needed, f"A surface of {total} triangles", "Use fewer voxels or a lower level.")
    points = np.empty((int(vertices.sum()), 3), dtype=np.float64)
    triangles = np.empty((total, 3), dtype=np.int64)
    place = np.array([*origin, *spacing, *start], dtype=np.float64)

    def emit(a, b):
        ids = np.empty(12, dtype=np.int64)
        _vertices(fill, bits, base, place, points, a, b)
        _triangles(bits, base, offset, table, counts_of_case, ids, triangles, a, b)

    slabs(nx + 1, size, emit, report(2))

    labels = np.zeros(total, dtype=np.int16)
    planes = np.array(
        [origin[a] + (start[a] + end) * spacing[a] for a in range(3) for end in (0, fill.shape[a])]
    )

    def label(a, b):
        _caps(fill, points, triangles, offset, bits, counts_of_case, planes, labels, a, b)

    slabs(nx + 1, size, label)
    return points, triangles, labels


def _offsets(vertices, faces):
    """Return where each row's vertices (along x, y, z) and its triangles begin.

    Triangles of row (i, j) end where ``offset[i, j + 1]`` says.
    """
    rows, columns = faces.shape
    base = np.zeros((rows + 1, columns + 1, 3), dtype=np.int64)
    np.subtract(np.cumsum(vertices).reshape(vertices.shape), vertices, out=base[:-1, :-1])
    offset = np.zeros((rows, columns + 1), dtype=np.int64)
    offset[:, 1:] = np.cumsum(faces).reshape(faces.shape)
    offset[1:, 0] = offset[:-1, -1]
    return base, offset


def _thirds(progress):
    """Return a function that makes the progress of one of three passes that of the whole."""

    def report(part):
        if progress is None:
            return None
        return lambda done, count: progress(part * count + done, 3 * count)

    return report
