"""Marching cubes over packed bits, with exactly the topology of the 6-connected solid.

The order of work is that of flying edges (Schroeder, Maynard and Geveci 2015): count what each row
of cubes will give, sum the counts, and let every row write its own vertices and triangles where
they belong. So the result depends neither on how rows are dealt out to threads, nor on whether a
lattice is worked on whole or slab by slab: seams are welded because both sides count alike.

Rows run along z, 32 voxels a word: two words hold 32 cubes and the layer beyond them. The lattice
is padded by one void voxel on every side, virtually: row (i, j) of bits is that of voxels
(i − 1, j − 1), and bit k that of voxel k − 1. Cube (i, j, k) has the padded voxels (i … i + 1,
j … j + 1, k … k + 1) as corners; vertices on the three grid edges from (i, j, k) upwards belong to
row (i, j), which lists those along x first, then y, then z.
"""

from __future__ import annotations

import functools
import math
from typing import TYPE_CHECKING

import numba
import numpy as np
from llvmlite import ir
from numba import int64, uint32, uint64
from numba.core import cgutils
from numba.np import arrayobj

from porous.kernels._cases import COUNTS, SLOTS, STEPS, TRIANGLES
from porous.kernels._shared import kernel, slabs, source
from porous.memory import check_memory

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from porous.values import Frame

LEVEL = 127.5
"""Iso level: no uint8 ever equals it, so vertices keep off the corners by 1/256 of an edge."""

_VOXELS_PER_SLAB = 1 << 20
_FULL = uint64(0xFFFFFFFF)
_AHEAD = uint64(1024)
"""How many entries ahead of writing memory is asked for: 8 KiB."""

_COUNTS, _TRIANGLES = source(COUNTS, np.uint8), source(TRIANGLES, np.uint8)
_SLOTS, _STEPS = source(SLOTS, np.uint8), source(STEPS, np.int64)


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


@numba.extending.intrinsic
def _fetch_to_write(_typing, array, index):
    """Ask for the memory of an entry of a contiguous array, to be written soon; it may not exist.

    Surfaces are larger than caches: without this, writing waits for memory at every line of it.
    """

    def generate(context, builder, signature, arguments):
        data = arrayobj.make_array(signature.args[0])(context, builder, arguments[0]).data
        place = builder.bitcast(builder.gep(data, [arguments[1]]), cgutils.voidptr_t)
        flags = [cgutils.int32_t] * 3
        form = ir.FunctionType(ir.VoidType(), [cgutils.voidptr_t, *flags])
        prefetch = builder.module.declare_intrinsic("llvm.prefetch", [cgutils.voidptr_t], form)
        write, near, data_not_code = cgutils.int32_t(1), cgutils.int32_t(3), cgutils.int32_t(1)
        builder.call(prefetch, [place, write, near, data_not_code])
        return context.get_dummy_value()

    return numba.void(array, index), generate


@numba.extending.intrinsic
def _highest_bits(_typing, row, first):
    """Return a word of the highest bits of 32 bytes: two machine instructions."""

    def generate(context, builder, signature, arguments):
        data = arrayobj.make_array(signature.args[0])(context, builder, arguments[0]).data
        many = ir.VectorType(ir.IntType(8), 32)
        place = builder.bitcast(builder.gep(data, [arguments[1]]), many.as_pointer())
        below_zero = builder.icmp_signed("<", builder.load(place, align=1), many(None))
        return builder.bitcast(below_zero, ir.IntType(32))

    return uint32(row, first), generate


@kernel
def _pack(fill, bits, above, first, last):
    """Set bit k + 1 of row (i + above, j + 1) where fill[i, j, k] is solid; first ≤ i < last."""
    ny, nz = fill.shape[1], fill.shape[2]
    words = bits.shape[2]
    for i in range(first, last):
        for j in range(ny):
            row = fill[i, j]
            for w in range(words):
                low = 32 * w - 1
                word = uint32(0)
                if low >= 0 and low + 32 <= nz:
                    word = _highest_bits(row, low)
                else:
                    for k in range(max(low, 0), min(low + 32, nz)):
                        word |= uint32(row[k] >> 7) << uint32(k - low)
                bits[i + above, j + 1, w] = word


@kernel
def _count(bits, counts_of_case, vertices, faces, first, last):
    """Count the vertices along x, y, z and the triangles of rows first … last − 1 of cubes."""
    columns = bits.shape[1] - 1
    words = bits.shape[2] - 1
    one, two, three, four, six = uint64(1), uint64(2), uint64(3), uint64(4), uint64(6)
    word = uint64(32)
    for row in range(first, last):
        i, j = row // columns, row % columns
        a, b, c, d = bits[i, j], bits[i, j + 1], bits[i + 1, j], bits[i + 1, j + 1]
        along_x = along_y = along_z = uint64(0)
        triangles = 0
        for w in range(words):
            a0 = uint64(a[w]) | uint64(a[w + 1]) << word
            b0 = uint64(b[w]) | uint64(b[w + 1]) << word
            c0 = uint64(c[w]) | uint64(c[w + 1]) << word
            d0 = uint64(d[w]) | uint64(d[w + 1]) << word
            some, every = a0 | b0 | c0 | d0, a0 & b0 & c0 & d0
            active = (some | some >> one) & ~(every & every >> one) & _FULL
            along_x += _bits_set((a0 ^ c0) & _FULL)
            along_y += _bits_set((a0 ^ b0) & _FULL)
            along_z += _bits_set((a0 ^ a0 >> one) & _FULL)
            while active != 0:
                k = _lowest_bit(active)
                active &= active - one
                case = (a0 >> k & three) | (b0 >> k & three) << two
                case |= (c0 >> k & three) << four | (d0 >> k & three) << six
                triangles += counts_of_case[case]
        vertices[i, j, 0] = along_x
        vertices[i, j, 1] = along_y
        vertices[i, j, 2] = along_z
        faces[row] = triangles


@kernel
def _vertices(fill, void, bits, above, base, place, entries, first, last):
    """Write the points of rows first … last − 1, three ``entries`` each.

    ``place`` holds origin, spacing, the index of the first voxel of the lattice, and how many
    planes of it come before this slab; ``void`` is a row of void voxels.
    """
    planes, ny, nz = fill.shape
    columns = ny + 1
    words = bits.shape[2] - 1
    one, two, three, word = uint64(1), uint64(2), uint64(3), uint64(32)
    ox, oy, oz, hx, hy, hz = place[0], place[1], place[2], place[3], place[4], place[5]
    sx, sy, sz, before = place[6], place[7], place[8], place[9]
    for row in range(first, last):
        i, j = row // columns, row % columns
        a, b, c = bits[i, j], bits[i, j + 1], bits[i + 1, j]
        p, q = i - above, i + 1 - above  # the planes of voxels of this row and of the next
        here = fill[p, j - 1] if 0 <= p < planes and j else void
        beside = fill[p, j] if 0 <= p < planes and j < ny else void
        behind = fill[q, j - 1] if q < planes and j else void
        x, y = uint64(3 * base[i, j, 0]), uint64(3 * base[i, j, 1])
        z = uint64(3 * base[i, j, 2])
        middle = i + before - 0.5
        px, py = ox + (sx + middle) * hx, oy + (sy + (j - 0.5)) * hy
        for w in range(words):
            cut = uint64(a[w] ^ c[w])
            while cut != 0:
                k = uint64(32 * w) + _lowest_bit(cut)
                cut &= cut - one
                low = float(here[k - one])
                t = (LEVEL - low) / (float(behind[k - one]) - low)
                _fetch_to_write(entries, x + _AHEAD)
                entries[x] = ox + (sx + (middle + t)) * hx
                entries[x + one] = py
                entries[x + two] = oz + (sz + (float(k) - 0.5)) * hz
                x += three
            cut = uint64(a[w] ^ b[w])
            while cut != 0:
                k = uint64(32 * w) + _lowest_bit(cut)
                cut &= cut - one
                low = float(here[k - one])
                t = (LEVEL - low) / (float(beside[k - one]) - low)
                _fetch_to_write(entries, y + _AHEAD)
                entries[y] = px
                entries[y + one] = oy + (sy + (j - 0.5 + t)) * hy
                entries[y + two] = oz + (sz + (float(k) - 0.5)) * hz
                y += three
            a0 = uint64(a[w]) | uint64(a[w + 1]) << word
            cut = (a0 ^ a0 >> one) & _FULL
            while cut != 0:
                k = uint64(32 * w) + _lowest_bit(cut)
                cut &= cut - one
                low = float(here[k - one]) if k else 0.0
                high = float(here[k]) if k < uint64(nz) else 0.0
                t = (LEVEL - low) / (high - low)
                _fetch_to_write(entries, z + _AHEAD)
                entries[z] = px
                entries[z + one] = py
                entries[z + two] = oz + (sz + (float(k) - 0.5 + t)) * hz
                z += three


@kernel
def _triangles(bits, base, offset, slots, steps, counts_of_case, ids, entries, first, last):
    """Write the triangles of rows first … last − 1 of cubes, three ``entries`` each.

    ``ids`` is scratch for 16 vertices: the next one on each of the eight grid lines that edges of
    a row of cubes lie on, before and after the cube at hand. They advance at active cubes only,
    for a cut edge makes its cubes active.
    """
    columns = bits.shape[1] - 1
    words = bits.shape[2] - 1
    one, two, three, four, six = uint64(1), uint64(2), uint64(3), uint64(4), uint64(6)
    eight, word = uint64(8), uint64(32)
    for row in range(first, last):
        i, j = row // columns, row % columns
        a, b, c, d = bits[i, j], bits[i, j + 1], bits[i + 1, j], bits[i + 1, j + 1]
        ids[8], ids[9] = base[i, j, 0], base[i, j + 1, 0]
        ids[10], ids[11] = base[i, j, 1], base[i + 1, j, 1]
        ids[12], ids[13] = base[i, j, 2], base[i, j + 1, 2]
        ids[14], ids[15] = base[i + 1, j, 2], base[i + 1, j + 1, 2]
        n = uint64(3 * offset[row])
        for w in range(words):
            a0 = uint64(a[w]) | uint64(a[w + 1]) << word
            b0 = uint64(b[w]) | uint64(b[w + 1]) << word
            c0 = uint64(c[w]) | uint64(c[w + 1]) << word
            d0 = uint64(d[w]) | uint64(d[w + 1]) << word
            some, every = a0 | b0 | c0 | d0, a0 & b0 & c0 & d0
            active = (some | some >> one) & ~(every & every >> one) & _FULL
            while active != 0:
                k = _lowest_bit(active)
                active &= active - one
                case = (a0 >> k & three) | (b0 >> k & three) << two
                case |= (c0 >> k & three) << four | (d0 >> k & three) << six
                for line in range(eight):
                    ids[line] = ids[eight + line]
                for line in range(eight):
                    ids[eight + line] += steps[case, line]
                _fetch_to_write(entries, n + _AHEAD)
                _fetch_to_write(entries, n + _AHEAD + eight)
                for corner in range(three * counts_of_case[case]):
                    entries[n] = ids[slots[case, corner]]
                    n += one


@kernel
def _caps(fill, bits, above, ends, offset, table, counts_of_case, labels, first, last):
    """Label the triangles that lie on the faces of the lattice, of rows first … last − 1.

    They are those all of whose corners lie on edges that leave the lattice through that face,
    from voxels that are wholly solid. Only cubes at the border have such edges: ``ends`` are the
    first and the last row of cubes along x, counted in this slab.
    """
    ny, nz = fill.shape[1], fill.shape[2]
    columns = ny + 1
    words = bits.shape[2] - 1
    one, two, three, four, six = uint64(1), uint64(2), uint64(3), uint64(4), uint64(6)
    word = uint64(32)
    for row in range(first, last):
        i, j = row // columns, row % columns
        a, b, c, d = bits[i, j], bits[i, j + 1], bits[i + 1, j], bits[i + 1, j + 1]
        border = i == ends[0] or i == ends[1] or j == 0 or j == ny
        n = offset[row]
        for w in range(words):
            if not border and w != 0 and w != nz >> 5:
                continue
            a0 = uint64(a[w]) | uint64(a[w + 1]) << word
            b0 = uint64(b[w]) | uint64(b[w + 1]) << word
            c0 = uint64(c[w]) | uint64(c[w + 1]) << word
            d0 = uint64(d[w]) | uint64(d[w + 1]) << word
            some, every = a0 | b0 | c0 | d0, a0 & b0 & c0 & d0
            active = (some | some >> one) & ~(every & every >> one) & _FULL
            if not border:
                ends_of_row = one if w == 0 else uint64(0)
                if w == nz >> 5:
                    ends_of_row |= one << uint64(nz & 31)
                active &= ends_of_row
            while active != 0:
                bit = _lowest_bit(active)
                active &= active - one
                k = 32 * w + int64(bit)
                case = (a0 >> bit & three) | (b0 >> bit & three) << two
                case |= (c0 >> bit & three) << four | (d0 >> bit & three) << six
                count = int64(counts_of_case[case])
                if k == nz:
                    n = offset[row + 1] - count
                for t in range(count):
                    axis = int64(table[case, 3 * t]) >> 2
                    if axis == 0:
                        lower, upper = i == ends[0], i == ends[1]
                    elif axis == 1:
                        lower, upper = j == 0, j == ny
                    else:
                        lower, upper = k == 0, k == nz
                    caps = lower or upper
                    for corner in range(3 * t, 3 * t + 3):
                        edge = int64(table[case, corner])
                        if not caps or edge >> 2 != axis:
                            caps = False
                        else:
                            # The solid one of the two voxels that the edge joins.
                            u, v = edge >> 1 & 1, edge & 1
                            if axis == 0:
                                x, y, z = i - above + lower, j - 1 + u, k - 1 + v
                            elif axis == 1:
                                x, y, z = i - above + u, j - 1 + lower, k - 1 + v
                            else:
                                x, y, z = i - above + u, j - 1 + v, k - 1 + lower
                            caps = fill[x, y, z] == 255
                    if caps:
                        labels[n + t] = 2 * axis + 1 + upper
                n += count


@kernel
def _add(points, triangles, labels, starts, centre, result, first, last):
    """Add up area, area of caps and volume of the triangles starts[i] … starts[i + 1] − 1."""
    cx, cy, cz = centre[0], centre[1], centre[2]
    for i in range(first, last):
        area = caps = volume = 0.0
        for t in range(starts[i], starts[i + 1]):
            p, q, r = triangles[t, 0], triangles[t, 1], triangles[t, 2]
            ax, ay, az = points[p, 0] - cx, points[p, 1] - cy, points[p, 2] - cz
            bx, by, bz = points[q, 0] - cx, points[q, 1] - cy, points[q, 2] - cz
            dx, dy, dz = points[r, 0] - cx, points[r, 1] - cy, points[r, 2] - cz
            ux, uy, uz = bx - ax, by - ay, bz - az
            vx, vy, vz = dx - ax, dy - ay, dz - az
            nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
            double = math.sqrt(nx * nx + ny * ny + nz * nz)
            area += double / 2
            if labels[t]:
                caps += double / 2
            volume += (ax * nx + ay * ny + az * nz) / 6
        result[i, 0], result[i, 1], result[i, 2] = area, caps, volume


class Slab:
    """Rows of cubes ``first`` … ``last`` − 1 along x of a lattice, counted and ready to be written.

    Parameters
    ----------
    fill
        uint8, shape (p, y, z): the planes of voxels ``first`` − 1 … ``last``, those that there are.
    planes
        How many planes of voxels the lattice has along x; it has one row of cubes more.
    first, last
        Which rows of cubes; ``last`` is at most ``planes`` + 1.
    report
        Gives each of the five steps of work (0 … 4) its progress.
    """

    def __init__(
        self,
        fill: NDArray[np.uint8],
        planes: int,
        first: int,
        last: int,
        report: Callable[[int], Callable[[int, int], None] | None] = lambda _step: None,
    ) -> None:
        self.fill, self.first, self.last = source(fill, np.uint8), first, last
        self._report = report
        self._above = 1 if first == 0 else 0
        self._ends = np.array([-first, planes - first], dtype=np.int64)
        _, ny, nz = fill.shape
        length, self._columns = last - first, ny + 1
        self._bits = np.zeros((length + 2, ny + 2, (nz + 2 + 31) // 32 + 1), dtype=np.uint32)
        self._rows = length * self._columns
        self._size = max(1, min(_VOXELS_PER_SLAB // (nz + 1), self._rows // 8))
        # One row along x more: its vertices are corners of triangles here.
        vertices = np.zeros((length + 1, ny + 2, 3), dtype=np.int64)
        faces = np.zeros(self._rows + self._columns, dtype=np.int64)
        self._count(vertices, faces)
        self._base = np.cumsum(vertices).reshape(vertices.shape) - vertices
        self._offset = np.concatenate([[0], np.cumsum(faces)])
        self._beyond = int(vertices.sum())

    def _count(self, vertices, faces):
        size = -(-self._size // self._columns)
        pack = functools.partial(_pack, self.fill, self._bits, self._above)
        slabs(len(self.fill), size, pack, self._report(0))
        count = functools.partial(_count, self._bits, _COUNTS, vertices, faces)
        slabs(len(faces), self._size, count, self._report(1))

    @property
    def counts(self) -> NDArray[np.int64]:
        """How many vertices and triangles each row of cubes along x has, (last − first, 2)."""
        vertices = np.diff(self._base[:, 0, 0])
        return np.stack([vertices, np.diff(self._starts)], axis=1)

    @property
    def _starts(self):
        return self._offset[: self._rows + 1 : self._columns]

    def points(self, frame: Frame, *, beyond: bool = False) -> NDArray[np.float64]:
        """Return the vertices of these rows, shape (n, 3), and of the next one if ``beyond``."""
        count = self._beyond if beyond else int(self._base[-1, 0, 0])
        result = np.empty((count, 3), dtype=np.float64)
        numbers = np.array([*frame.origin, *frame.spacing, *frame.start, self.first], np.float64)
        void = source(np.zeros(self.fill.shape[2]), np.uint8)
        write = functools.partial(
            _vertices,
            *(self.fill, void, self._bits, self._above, self._base, numbers, result.reshape(-1)),
        )
        slabs(self._rows + beyond * self._columns, self._size, write, self._report(2))
        return result

    def triangles(self) -> NDArray[np.int64]:
        """Return indices of the points of these rows and of the next one, shape (t, 3)."""
        result = np.empty((int(self._offset[self._rows]), 3), dtype=np.int64)

        def write(first, last):
            ids = np.empty(16, dtype=np.int64)
            _triangles(
                *(self._bits, self._base, self._offset, _SLOTS, _STEPS, _COUNTS, ids),
                *(result.reshape(-1), first, last),
            )

        slabs(self._rows, self._size, write, self._report(3))
        return result

    def labels(self) -> NDArray[np.int16]:
        """Return which face of the lattice each triangle lies on, 1 … 6, or 0; shape (t,)."""
        result = np.zeros(int(self._offset[self._rows]), dtype=np.int16)
        write = functools.partial(
            _caps,
            *(self.fill, self._bits, self._above, self._ends, self._offset),
            *(_TRIANGLES, _COUNTS, result),
        )
        slabs(self._rows, self._size, write, self._report(4))
        return result

    def sums(
        self, frame: Frame, triangles: NDArray[np.int64], labels: NDArray[np.int16]
    ) -> NDArray[np.float64]:
        """Return what each row of cubes along x adds, shape (last − first, 3).

        To the area, to that of the caps, and to the enclosed volume; in ``frame.unit``.
        ``triangles`` and ``labels`` are those of these rows, points counted from zero. The sums do
        not depend on how the lattice is cut into slabs.
        """
        points = self.points(frame, beyond=True)
        result = np.empty((len(self._starts) - 1, 3), dtype=np.float64)
        centre = np.array(frame.box.centre, dtype=np.float64)
        add = functools.partial(_add, points, triangles, labels, self._starts, centre, result)
        slabs(len(result), 1, add)
        return result


def marching_cubes(
    fill: NDArray[np.uint8], frame: Frame, progress: Callable[[int, int], None] | None = None
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int16]]:
    """Return the surface of the voxels of fill ≥ 128, closed at the border of the array.

    Parameters
    ----------
    fill
        uint8, shape (x, y, z).
    frame
        Where the lattice lies: its point (a, b, c) is at ``origin + (start + (a, b, c)) ·
        spacing``.
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

    Raises
    ------
    MemoryLimitError
        Where the surface would not fit into memory.
    """
    slab = Slab(fill, len(fill), 0, len(fill) + 1, _fifths(progress))
    vertices, total = slab.counts.sum(axis=0).tolist()
    check_memory(
        vertices * 24 + total * 26,
        f"A surface of {total} triangles",
        "Use fewer voxels or a lower level.",
    )
    return slab.points(frame), slab.triangles(), slab.labels()


def _fifths(progress):
    """Return a function that makes the progress of one of five steps that of the whole."""

    def report(step):
        if progress is None:
            return None
        return lambda done, count: progress(step * count + done, 5 * count)

    return report
