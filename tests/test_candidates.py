"""Sets of bits of voxels: the same as arrays of booleans say, however windows and blocks lie."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from porous.kernels import candidates

small = st.integers(1, 8)
sizes_of_spans = st.tuples(small, small, small)
directions = st.tuples(*3 * [st.floats(-1, 1, allow_subnormal=False)])


def placed(seed, sizes):
    """Return a random window's corner, marks and words of blocks, and a span of these sizes."""
    random = np.random.default_rng(seed)
    start = random.integers(-20, 20, 3)
    shape = np.array(sizes) + random.integers(0, 9, 3)
    marks = (random.random(shape) < random.choice([0.1, 0.9, 1.0])).astype(np.uint8)
    low = random.integers(0, shape - sizes + 1)
    high = low + np.array(sizes) - 1
    span = tuple(int(n) for n in np.stack([low, high], axis=1).ravel())
    shift = tuple(int(s) for s in start % 8)
    blocks = tuple((np.array(shape) + shift + 3) // 4)
    return start, marks, (np.zeros(blocks, np.uint64), np.zeros(blocks, np.uint8)), shift, span


def inside(span):
    return tuple(slice(a, b + 1) for a, b in zip(span[::2], span[1::2], strict=True))


def bits(masks, row, shift, span):
    """Return what a row of masks says of a span."""
    result = np.zeros([s.stop - s.start for s in inside(span)], bool)
    for index in np.ndindex(result.shape):
        i, j, k = (int(n) for n in np.array(index) + span[::2] + shift)
        word = masks[row, (i >> 2 & 1) << 2 | (j >> 2 & 1) << 1 | k >> 2 & 1]
        result[index] = int(word) >> ((i & 3) << 4 | (j & 3) << 2 | k & 3) & 1
    return result


@given(st.integers(0, 10**6), sizes_of_spans)
def test_what_is_left_of_a_span_are_candidates_that_are_not_marked(seed, sizes):
    _, marks, known, shift, span = placed(seed, sizes)
    masks = np.random.default_rng(seed + 1).integers(0, 2**64, (3, 8), np.uint64, endpoint=False)
    asked = bits(masks, 1, shift, span)
    some = candidates.left(marks, *known, shift, span, masks, 1, 2)
    free = marks[inside(span)] == 0
    assert np.array_equal(bits(masks, 2, shift, span), free & asked)
    assert some == (free & asked).any()
    assert candidates.any_left(marks, *known, shift, span) == free.any()
    assert candidates.within(shift, span, masks, 1, 0) == asked.any()
    assert np.array_equal(bits(masks, 0, shift, span), asked)
    assert np.bitwise_count(masks[0]).sum() == asked.sum()


@given(st.integers(0, 10**6), sizes_of_spans)
def test_marking_is_seen_by_who_asks_after(seed, sizes):
    _, marks, known, shift, span = placed(seed, sizes)
    whole = 0, marks.shape[0] - 1, 0, marks.shape[1] - 1, 0, marks.shape[2] - 1
    candidates.any_left(marks, *known, shift, whole)
    masks = np.random.default_rng(seed + 1).integers(0, 2**64, (2, 8), np.uint64, endpoint=False)
    wanted = marks.copy()
    wanted[inside(span)] |= bits(masks, 0, shift, span).astype(np.uint8)
    candidates.left(marks, *known, shift, span, masks, 0, 1)
    candidates.mark(marks, known[0], shift, span, masks, 0)
    assert np.array_equal(marks, wanted)
    assert candidates.any_left(marks, *known, shift, span) == (wanted[inside(span)] == 0).any()


def test_spans_in_too_many_blocks_are_not_asked():
    marks = np.ones((13, 13, 13), np.uint8)
    known = np.zeros((4, 4, 4), np.uint64), np.zeros((4, 4, 4), np.uint8)
    assert not candidates.any_left(marks, *known, (0, 0, 0), (0, 11, 0, 11, 0, 11))
    assert candidates.any_left(marks, *known, (0, 0, 0), (0, 12, 0, 11, 0, 11))


@given(st.integers(0, 10**6), small, small, small, directions, directions, st.floats(0, 4))
@example(3, 5, 6, 7, (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 0.5)
@example(4, 5, 6, 7, (1.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.5)
@example(5, 8, 8, 8, (1e-9, 0.6, 1e-12), (0.6, 0.8, 0.0), 0.0)
def test_slabs_part_what_they_do_not_touch(seed, nx, ny, nz, first, second, half):
    start, _, _, shift, span = placed(seed, (nx, ny, nz))
    centre = start + np.array(span[::2]) + np.random.default_rng(seed).uniform(0, (nx, ny, nz))
    slabs = [(*n, float(np.dot(n, centre)), half) for n in (first, second)]
    masks = np.zeros((1, 8), np.uint64)
    corner = tuple(int(n) for n in start)
    some = candidates.near(shift, corner, span, masks, 0, *slabs)
    index = np.stack(np.indices((nx, ny, nz)), axis=-1) + np.array(span[::2]) + start + 0.5
    wanted, doubtful = np.ones((nx, ny, nz), bool), np.zeros((nx, ny, nz), bool)
    for *n, middle, width in slabs:
        room = width + np.abs(n).sum() / 2 - np.abs(index @ np.array(n) - middle)
        wanted &= room >= 0
        doubtful |= np.abs(room) <= 2 * candidates.SLACK
    found = bits(masks, 0, shift, span)
    assert np.array_equal(found | doubtful, wanted | doubtful)
    assert (found | ~wanted).all()  # nothing that is touched is lost
    assert some == found.any()


@pytest.mark.parametrize("length", [2.5, 6.999])
def test_small_boxes_meet_at_most_eight_voxels(length):
    for low in np.linspace(0, 1, 101):
        assert np.floor(low + length) - np.ceil(low - 1) < 8
