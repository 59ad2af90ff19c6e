"""Surfaces streamed to files: the bytes of the whole, slab by slab, in little memory."""

import tracemalloc

import numpy as np
import pytest

from porous import formats
from porous.errors import Cancelled, DiskError, FormatError, MemoryLimitError, MeshError
from porous.kernels import surface as kernels
from porous.scale import Store, StoredGrid
from porous.stages import _stream_surface as stage
from porous.stages import extract_surface, stream_surface
from porous.values import Frame, VoxelGrid
from porous.values.surface_topology import euler_number

SHAPE = (23, 9, 70)
SPACING = (0.5, 1.25, 2.0)

each_format = pytest.mark.parametrize("suffix", [".stl", ".ply"])


class Source:
    """A grid that records what is read of it, and may come in chunks."""

    def __init__(self, grid):
        self.grid, self.frame, self.reads = grid, grid.frame, []
        self.sampling, self.sampling_error, self.hausdorff = "fill", 0.0, None

    def block(self, start, stop):
        self.reads.append((start[0], stop[0]))
        assert (start[1:], stop[1:]) == ((0, 0), self.frame.shape[1:])
        return self.grid.block(start, stop)


class ChunkedSource(Source):
    chunk = 7

    @property
    def tiles(self):
        return (((0, 0, 0), (self.chunk, 5, 9)),)


def grey(seed, shape=SHAPE, full=0.5):
    rng = np.random.default_rng(seed)
    fill = np.where(rng.random(shape) < full, 255, rng.integers(0, 256, shape)).astype(np.uint8)
    return VoxelGrid(Frame((3.0, -40.0, 7.0), SPACING, shape), fill)


def whole(grid, path):
    surface = extract_surface(grid)
    formats.write(surface, path)
    return surface, path.read_bytes()


@each_format
@pytest.mark.parametrize("planes", [1, 2, 3, 10, 1000])
@pytest.mark.parametrize("most", [1, 700, 1 << 30])
def test_the_bytes_are_those_of_the_whole(suffix, planes, most, tmp_path, monkeypatch):
    grid = grey(planes)
    _, wanted = whole(grid, tmp_path / f"whole{suffix}")
    monkeypatch.setattr(stage, "READ", planes * SHAPE[1] * SHAPE[2])
    monkeypatch.setattr(stage, "VOXELS", most)
    monkeypatch.setattr(stage, "TRIANGLES", most)
    stream_surface(grid, tmp_path / f"parts{suffix}")
    assert (tmp_path / f"parts{suffix}").read_bytes() == wanted


@each_format
@pytest.mark.parametrize("shape", [(1, 1, 1), (1, 8, 9), (2, 1, 33), (3, 4, 1), (40, 2, 3)])
def test_thin_grids(suffix, shape, tmp_path, monkeypatch):
    grid = grey(3, shape, full=0.8)
    _, wanted = whole(grid, tmp_path / f"whole{suffix}")
    for planes in (1, 2, 4):
        monkeypatch.setattr(stage, "READ", planes * shape[1] * shape[2])
        stream_surface(grid, tmp_path / f"parts{suffix}")
        assert (tmp_path / f"parts{suffix}").read_bytes() == wanted


@each_format
@pytest.mark.parametrize("threads", ["1", "3"])
def test_the_number_of_threads_changes_nothing(suffix, threads, tmp_path, monkeypatch):
    grid = grey(5)
    _, wanted = whole(grid, tmp_path / f"whole{suffix}")
    monkeypatch.setenv("POROUS_THREADS", threads)
    monkeypatch.setattr(kernels, "_VOXELS_PER_SLAB", 300)
    monkeypatch.setattr(stage, "VOXELS", 4000)
    stream_surface(grid, tmp_path / f"parts{suffix}")
    assert (tmp_path / f"parts{suffix}").read_bytes() == wanted


@each_format
def test_chunks_are_read_whole_layers_at_a_time_and_in_order(suffix, tmp_path):
    source = ChunkedSource(grey(1))
    _, wanted = whole(source.grid, tmp_path / f"whole{suffix}")
    stream_surface(source, tmp_path / f"parts{suffix}")
    layers = [(0, 7), (7, 14), (14, 21), (21, 23)]
    assert source.reads == layers * (3 if suffix == ".ply" else 2)
    assert (tmp_path / f"parts{suffix}").read_bytes() == wanted


@each_format
def test_a_stored_grid_is_streamed_in_its_chunks(suffix, tmp_path):
    grid = grey(2)
    _, wanted = whole(grid, tmp_path / f"whole{suffix}")
    store = Store.create(
        tmp_path / "grid.zarr",
        grid.frame,
        chunk=(6, 5, 32),
        recipe_sha256="0" * 64,
        sampling="fill",
        has_bulk=False,
    )
    for index, tile in enumerate(store.tiles):
        store.write("fill", index, grid.block(*tile)[0])
    store.commit()
    stream_surface(StoredGrid.open(tmp_path / "grid.zarr"), tmp_path / f"parts{suffix}")
    assert (tmp_path / f"parts{suffix}").read_bytes() == wanted


def test_layers_of_chunks_too_large_are_read_in_parts(tmp_path, monkeypatch):
    source = ChunkedSource(grey(1))
    monkeypatch.setattr(stage, "MOST_READ", 2 * SHAPE[1] * SHAPE[2])
    stream_surface(source, tmp_path / "parts.ply")
    assert set(np.ptp(source.reads, axis=1)) == {1, 2}


@each_format
def test_what_is_told_is_the_surfaces(suffix, tmp_path, monkeypatch):
    grid = grey(8)
    told = stream_surface(grid, tmp_path / f"parts{suffix}")
    surface = extract_surface(grid)
    assert (told.points, told.triangles) == (len(surface.points), len(surface.triangles))
    assert told.euler_number == euler_number(surface)
    assert told.volume == pytest.approx(surface.volume, rel=1e-12)
    assert told.area == pytest.approx(surface.area, rel=1e-12)
    on_frame = np.linalg.norm(surface.area_vectors[surface.labels > 0], axis=1).sum()
    assert told.caps_area == pytest.approx(on_frame, rel=1e-12)
    assert told.caps_area > 0
    assert told.unit == grid.frame.unit
    monkeypatch.setattr(stage, "READ", 2 * SHAPE[1] * SHAPE[2])
    monkeypatch.setattr(stage, "TRIANGLES", 500)
    assert stream_surface(grid, tmp_path / f"again{suffix}") == told


def test_facets_that_collapse_in_single_precision_are_left_out(tmp_path, monkeypatch):
    fill = grey(4, (9, 6, 7), full=0.3).fill
    frame = Frame((0.0, 0.0, 0.0), (1e-7, 1.0, 1.0), fill.shape, start=(10**7, 0, 0))
    grid = VoxelGrid(frame, fill)
    surface, wanted = whole(grid, tmp_path / "whole.stl")
    assert len(wanted) < 84 + 50 * len(surface.triangles)
    monkeypatch.setattr(stage, "READ", 2 * 42)
    source = Source(grid)
    stream_surface(source, tmp_path / "parts.stl")
    assert (tmp_path / "parts.stl").read_bytes() == wanted
    assert source.reads == [(0, 2), (2, 4), (4, 6), (6, 8), (8, 9)] * 3


def test_far_from_zero_the_origin_is_in_the_header(tmp_path):
    fill = grey(4, (9, 6, 7)).fill
    grid = VoxelGrid(Frame((1e6, -1e7, 1e5), SPACING, fill.shape), fill)
    _, wanted = whole(grid, tmp_path / "whole.stl")
    assert b"origin=" in wanted[:80]
    stream_surface(grid, tmp_path / "parts.stl")
    assert (tmp_path / "parts.stl").read_bytes() == wanted


class Endless:
    """A lattice of balls, computed where it is asked for: no memory of its own."""

    sampling, sampling_error, hausdorff = "fill", 0.0, None

    def __init__(self, shape):
        self.frame = Frame((0.0, 0.0, 0.0), SPACING, shape)

    def block(self, start, stop):
        x, y, z = (((np.arange(a, b) % 16) - 7.5) ** 2 for a, b in zip(start, stop, strict=True))
        inside = x[:, None, None].astype("f4") + y[:, None].astype("f4") + z.astype("f4") < 36
        return np.where(inside, np.uint8(255), np.uint8(0)), None


def peak_of(planes, path):
    stream_surface(Endless((planes, 64, 64)), path)  # compiled, and all that is imported
    tracemalloc.start()
    try:
        told = stream_surface(Endless((planes, 64, 64)), path)
        return told, tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@each_format
def test_memory_does_not_grow_with_the_grid(suffix, tmp_path, monkeypatch):
    monkeypatch.setattr(stage, "READ", 16 * 64 * 64)
    monkeypatch.setattr(stage, "VOXELS", 16 * 64 * 64)
    monkeypatch.setattr(stage, "TRIANGLES", 8000)
    path = tmp_path / f"balls{suffix}"
    few, little = peak_of(32, path)
    many, peak = peak_of(320, path)
    assert many.triangles == 10 * few.triangles
    assert peak < 1.1 * little
    assert peak < path.stat().st_size / 4


# What is refused, and progress


def test_other_formats_are_refused_before_any_work(tmp_path):
    source = Source(grey(0))
    with pytest.raises(FormatError, match=r"x\.obj: surfaces are streamed to \.stl or \.ply"):
        stream_surface(source, tmp_path / "x.obj")
    assert source.reads == []


@each_format
def test_an_empty_grid_is_refused_with_a_remedy(suffix, tmp_path):
    grid = VoxelGrid(Frame((0, 0, 0), (1, 1, 1), (3, 4, 5)), np.full((3, 4, 5), 127, np.uint8))
    with pytest.raises(MeshError, match=r"no voxel is at least half solid .*50 %.*Use more voxels"):
        stream_surface(grid, tmp_path / f"x{suffix}")
    assert list(tmp_path.iterdir()) == []


def test_more_triangles_than_stl_can_count_are_refused_before_writing(tmp_path, monkeypatch):
    monkeypatch.setattr(stage.stl, "MOST", 100)
    with pytest.raises(FormatError, match=r"x\.stl: \d+ facets; wanted at most 100 .*Write PLY"):
        stream_surface(grey(0), tmp_path / "x.stl")
    assert list(tmp_path.iterdir()) == []


def test_a_slab_that_does_not_fit_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("porous.memory.available", lambda: 10_000)
    with pytest.raises(MemoryLimitError, match="Use a frame with smaller planes"):
        stream_surface(grey(0), tmp_path / "x.ply")
    assert list(tmp_path.iterdir()) == []


@each_format
def test_a_disk_that_fills_leaves_nothing(suffix, tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.write", full)
    with pytest.raises(DiskError, match="no space left"):
        stream_surface(grey(0), tmp_path / f"x{suffix}")
    assert list(tmp_path.iterdir()) == []


@each_format
def test_a_source_that_breaks_leaves_what_was_there(suffix, tmp_path, monkeypatch):
    class Breaks(Source):
        def block(self, start, stop):
            if len(self.reads) == 14:
                raise FormatError("fill/c/1: damaged")
            return super().block(start, stop)

    monkeypatch.setattr(stage, "READ", 2 * SHAPE[1] * SHAPE[2])
    path = tmp_path / f"x{suffix}"
    path.write_bytes(b"before")
    with pytest.raises(FormatError, match=r"fill/c/1: damaged"):
        stream_surface(Breaks(grey(0)), path)
    assert [p.name for p in tmp_path.iterdir()] == [path.name]
    assert path.read_bytes() == b"before"


@each_format
def test_progress_rises_to_one(suffix, tmp_path, monkeypatch):
    monkeypatch.setattr(stage, "READ", 2 * SHAPE[1] * SHAPE[2])
    seen = []
    stream_surface(grey(0), tmp_path / f"x{suffix}", progress=lambda *args: seen.append(args))
    assert {name for name, _ in seen} == {"stream_surface"}
    done = [part for _, part in seen]
    assert done == sorted(done)
    assert done[-1] == 1.0
    assert len(done) > 20


@each_format
def test_raising_in_progress_cancels_and_leaves_nothing(suffix, tmp_path):
    def stop(stage, done):
        if done > 0.8:
            raise Cancelled(f"{stage} at {done}")

    with pytest.raises(Cancelled):
        stream_surface(grey(0), tmp_path / f"x{suffix}", progress=stop)
    assert list(tmp_path.iterdir()) == []
