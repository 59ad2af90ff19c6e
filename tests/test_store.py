"""A store of chunks: what is written is read, by porous and by Zarr; what is not whole is not."""

import json
import os
import pickle
import shutil
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import pairwise, product

import numpy as np
import pytest
import zarr
from hypothesis import given
from hypothesis import strategies as st

from porous import memory
from porous.errors import (
    FormatError,
    GridError,
    MemoryLimitError,
    PorousError,
    RecipeError,
)
from porous.scale import Store, StoredGrid, codec
from porous.scale.plan import LARGEST_CHUNK
from porous.scale.recent import Recent
from porous.scale.sealed import seal, unseal
from porous.values import Frame, VoxelGrid

RECIPE, OTHER = "0123456789abcdef" * 4, "f" * 64
SHAPE, CHUNK = (7, 10, 9), (4, 5, 3)
FRAME = Frame((0.1, -2.0, 3.0), (0.1, 0.25, 1 / 3), SHAPE, (False, True, False), "um")


def voxels(shape=SHAPE, seed=0):
    return np.random.default_rng(seed).choice(np.array([0, 255, 100], np.uint8), shape)


FILL, BULK = voxels(), voxels(seed=1)


def begun(folder, frame=FRAME, **options):
    options = {"chunk": CHUNK, "recipe_sha256": RECIPE, **options}
    return Store.create(folder, frame, **options)


def fill_in(store, arrays=(FILL, BULK)):
    for name, array in zip(store.arrays, arrays, strict=False):
        for index, (start, stop) in enumerate(store.tiles):
            store.write(name, index, array[tuple(map(slice, start, stop))])
    return store


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "out" / "grid.zarr"


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    place = tmp_path_factory.mktemp("stored") / "grid.zarr"
    return fill_in(begun(place, has_bulk=True, hausdorff=0.5, sampling_error=0.25)).commit()


@pytest.fixture
def whole(stored, folder):
    shutil.copytree(stored.folder, folder)
    return Store.open(folder)


def contents(folder):
    return {p.relative_to(folder): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


# --- what is written is read ---------------------------------------------------------------


def test_tiles_cover_the_frame_once_in_c_order(folder):
    store = begun(folder)
    seen = np.zeros(SHAPE, int)
    for start, stop in store.tiles:
        seen[tuple(map(slice, start, stop))] += 1
        assert all(
            b - a == n or b == end for a, b, n, end in zip(start, stop, CHUNK, SHAPE, strict=True)
        )
    assert (seen == 1).all()
    assert [start for start, _ in store.tiles] == sorted(start for start, _ in store.tiles)
    assert len(store.tiles) == 2 * 2 * 3


@given(st.tuples(*[st.tuples(st.integers(0, n), st.integers(0, n)) for n in SHAPE]))
def test_any_box_across_chunks(stored, box):
    start, stop = zip(*map(sorted, box), strict=True)
    for name, array in (("fill", FILL), ("bulk", BULK)):
        found = stored.read(name, start, stop)
        assert found.dtype == np.uint8
        assert found.flags.c_contiguous
        assert np.array_equal(found, array[tuple(map(slice, start, stop))])


@given(
    shape=st.tuples(*[st.integers(1, 9)] * 3),
    chunk=st.tuples(*[st.integers(1, 11)] * 3),
    seed=st.integers(0, 99),
)
def test_a_chunk_and_back(shape, chunk, seed):
    block = voxels(tuple(map(min, shape, chunk)), seed)
    data = codec.encode(block, chunk)
    codec.check(data, int(np.prod(chunk)))
    full = codec.decode(data, chunk)
    assert full.shape == chunk
    assert np.array_equal(full[tuple(map(slice, block.shape))], block)
    assert int(full.sum()) == int(block.sum())  # zeros beyond the frame
    assert len(data) <= codec.largest(int(np.prod(chunk)))


def test_everything_comes_back(whole, folder):
    store = Store.open(folder)
    assert store == whole
    assert store.is_whole
    assert store.frame == FRAME
    assert (store.sampling, store.hausdorff, store.sampling_error) == ("fill", 0.5, 0.25)
    assert (store.arrays, store.chunk, store.has_bulk) == (("fill", "bulk"), CHUNK, True)
    assert store.missing() == store.verify() == ()
    grid = StoredGrid.open(folder)
    assert grid.to_grid() == VoxelGrid(FRAME, FILL, BULK, "fill", 0.5, 0.25)
    fill, bulk = grid.block((1, 2, 3), (7, 9, 8))
    assert np.array_equal(fill, FILL[1:7, 2:9, 3:8])
    assert np.array_equal(bulk, BULK[1:7, 2:9, 3:8])
    assert (grid.sampling, grid.hausdorff, grid.sampling_error) == ("fill", 0.5, 0.25)
    assert (grid.frame, grid.tiles) == (FRAME, store.tiles)


def test_without_bulk(folder):
    fill_in(begun(folder, sampling="centre")).commit()
    grid = StoredGrid.open(folder)
    assert grid.block((0, 0, 0), (1, 1, 1))[1] is None
    assert grid.to_grid() == VoxelGrid(FRAME, FILL, sampling="centre")
    assert not (folder / "bulk").exists()


@pytest.mark.usefixtures("whole")
def test_zarr_reads_the_same_without_a_word(folder):
    group = zarr.open_group(folder, mode="r")
    assert [name for name, _ in group.members()] == ["fill", "bulk"]
    for name, array in (("fill", FILL), ("bulk", BULK)):
        found = group[name]
        assert (found.shape, found.chunks, found.dtype) == (SHAPE, CHUNK, np.uint8)
        assert found.fill_value == 0
        assert found.metadata.dimension_names == ("x", "y", "z")
        assert np.array_equal(found[:], array)
    said = group.attrs["porous"]
    assert said["frame"]["spacing"] == list(FRAME.spacing)
    assert said["frame"]["unit"] == "um"


@pytest.mark.usefixtures("whole")
def test_zarr_itself_writes_the_same_bytes(folder, tmp_path):
    array = zarr.create_array(
        tmp_path / "judge.zarr",
        shape=SHAPE,
        chunks=CHUNK,
        dtype="uint8",
        fill_value=0,
        compressors=[zarr.codecs.ZstdCodec(level=1), zarr.codecs.Crc32cCodec()],
        chunk_key_encoding={"name": "default", "separator": "."},
        config={"write_empty_chunks": True},
    )
    array[:] = FILL
    for index in product(range(2), range(2), range(3)):
        name = f"c.{index[0]}.{index[1]}.{index[2]}"
        assert (folder / "fill" / name).read_bytes() == (
            tmp_path / "judge.zarr" / name
        ).read_bytes()


@pytest.mark.usefixtures("whole")
@pytest.mark.parametrize("bit", [0, 77, -33, -1])
def test_zarr_notices_a_flipped_bit_too(folder, bit):
    path = folder / "fill" / "c.1.0.2"
    flip(path, bit % (8 * path.stat().st_size))
    with pytest.raises(ValueError, match="checksum"):
        zarr.open_group(folder, mode="r")["fill"][:]


def test_chunks_are_cut_to_the_frame(folder):
    store = begun(folder, chunk=100)
    assert store.chunk == SHAPE
    assert store.tiles == (((0, 0, 0), SHAPE),)
    assert np.array_equal(fill_in(store).commit().read("fill", (0, 0, 0), SHAPE), FILL)


def test_a_tile_of_a_larger_frame(folder):
    part = Frame((0.1, 0.2, 0.3), (1, 2, 3), SHAPE, start=(70, 80, 90))
    fill_in(begun(folder, part)).commit()
    assert StoredGrid.open(folder).to_grid() == VoxelGrid(part, FILL)


def test_the_same_voxels_give_the_same_bytes_in_any_order_on_any_number_of_threads(tmp_path):
    frame = Frame((0, 0, 0), (1, 2, 3), (20, 25, 30))
    array = voxels(frame.shape)
    one, many = (begun(tmp_path / name, frame, chunk=(9, 8, 7)) for name in ("one", "many"))
    fill_in(one, [array]).commit()
    jobs = list(enumerate(many.tiles)) * 2  # two writers of each chunk, as after a lost worker
    np.random.default_rng(3).shuffle(jobs)
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda job: many.write("fill", job[0], array[_slices(*job[1])]), jobs))
    many.commit()
    assert contents(tmp_path / "one") == contents(tmp_path / "many")


def _slices(start, stop):
    return tuple(map(slice, start, stop))


def test_the_checksum_of_a_file_with_its_checksum_says_nothing():
    # Why the manifest holds the sum of a chunk's body: over body and sum every file is alike.
    sums = [codec.crc32c(codec.encode(voxels(CHUNK, seed), CHUNK)) for seed in range(9)]
    assert set(sums) == {0x48674BC7}
    size = int(np.prod(CHUNK))
    bodies = {codec.check(codec.encode(voxels(CHUNK, s), CHUNK), size) for s in range(9)}
    assert len(bodies) == 9


def test_crc32c_is_castagnolis():
    assert codec.crc32c(b"123456789") == 0xE3069283  # the check value of RFC 3720
    assert codec.crc32c(bytes(32)) == 0x8A9136AA


def test_values_that_flow(whole, folder):
    again = pickle.loads(pickle.dumps(whole))
    assert again == whole
    assert len(pickle.dumps(StoredGrid.open(folder))) < 400  # a path, not a manifest
    open_ = Store(whole.folder, whole.plan)
    assert pickle.loads(pickle.dumps(open_)) == open_
    assert open_ != whole
    assert {StoredGrid(whole), StoredGrid(again)} == {StoredGrid(whole)}


# --- what is refused -----------------------------------------------------------------------


@pytest.mark.usefixtures("whole")
def test_without_a_manifest_nothing_is_read(folder):
    (folder / "manifest.json").unlink()
    with pytest.raises(FormatError, match=r"grid\.zarr: is unfinished.*`porous resume`"):
        Store.open(folder)


def test_a_chunk_that_was_never_written(folder):
    store = begun(folder)
    for index, (start, stop) in enumerate(store.tiles):
        if index != 7:
            store.write("fill", index, FILL[_slices(start, stop)])
    assert store.missing() == (("fill", 7),)
    assert [store.has("fill", i) for i in range(12)] == [i != 7 for i in range(12)]
    with pytest.raises(FormatError, match=r"fill/c\.1\.0\.1: is missing; the store is not whole"):
        store.commit()
    with pytest.raises(FormatError, match=r"fill/c\.1\.0\.1: is missing"):
        store.read("fill", (0, 0, 0), SHAPE)
    assert not (folder / "manifest.json").exists()


def test_a_chunk_that_is_gone(whole, folder):
    (folder / "bulk" / "c.1.1.0").unlink()
    with pytest.raises(FormatError, match=r"bulk/c\.1\.1\.0: is missing; `porous resume`"):
        Store.open(folder)
    assert whole.verify() == ("bulk/c.1.1.0",)
    assert whole.missing() == (("bulk", 9),)


@pytest.mark.usefixtures("whole")
def test_a_chunk_cut_short(folder):
    path = folder / "fill" / "c.0.1.2"
    size = path.stat().st_size
    path.write_bytes(path.read_bytes()[:-5])
    with pytest.raises(FormatError, match=rf"c\.0\.1\.2: has {size - 5} bytes; wanted {size}"):
        Store.open(folder)


def test_a_chunk_in_the_place_of_another(folder):
    # Both have a right checksum of their own and the same size; only the manifest knows.
    block = np.random.default_rng(5).integers(0, 256, SHAPE).astype(np.uint8)
    whole = fill_in(begun(folder), [block]).commit()
    one, other = folder / "fill" / "c.0.0.0", folder / "fill" / "c.0.1.0"
    assert one.stat().st_size == other.stat().st_size
    shutil.copy(one, other)
    assert whole.verify() == ("fill/c.0.1.0",)
    with pytest.raises(FormatError, match=r"c\.0\.1\.0: is not the chunk that was committed"):
        Store.open(folder).read("fill", (0, 0, 0), SHAPE)
    again = Store.resume(folder, RECIPE)
    assert again.missing() == (("fill", 3),)
    assert not again.is_whole


def test_another_recipe_frame_or_version(whole, folder):
    with pytest.raises(RecipeError, match="belongs to another recipe: it has 0123456789ab"):
        Store.resume(folder, OTHER)
    with pytest.raises(RecipeError, match="wanted Frame"):
        Store.resume(folder, RECIPE, frame=replace(FRAME, unit="mm"))
    assert Store.resume(folder, RECIPE, frame=FRAME) == whole
    (folder / "plan.json").write_bytes(seal(replace(whole.plan, version="0.0.1").record()))
    with pytest.raises(FormatError, match=r"was begun by porous 0\.0\.1"):
        Store.resume(folder, RECIPE)
    assert not (folder / ".zarr").exists()


@pytest.mark.usefixtures("whole")
def test_a_manifest_of_another_store(folder, tmp_path):
    other = fill_in(begun(tmp_path / "other", recipe_sha256=OTHER, has_bulk=True)).commit()
    shutil.copy(other.folder / "manifest.json", folder)
    with pytest.raises(FormatError, match=r"manifest\.json: is of another plan"):
        Store.open(folder)
    shutil.copy(other.folder / "plan.json", folder)
    with pytest.raises(FormatError, match=r"zarr\.json: is damaged or missing"):
        Store.open(folder)


@pytest.mark.usefixtures("whole")
def test_a_folder_in_use_is_not_begun_anew(folder, tmp_path):
    before = contents(folder)
    with pytest.raises(FormatError, match="holds a store already"):
        begun(folder)
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "thesis.doc").write_text("!")
    with pytest.raises(FormatError, match=r"holds 'thesis\.doc'"):
        begun(mine)
    assert contents(folder) == before
    assert [path.name for path in mine.iterdir()] == ["thesis.doc"]


def test_foreign_stores(tmp_path):
    zarr.create_array(tmp_path / "foreign.zarr", shape=(4,), chunks=(2,), dtype="uint8")
    before = contents(tmp_path)
    for name, said in (("foreign.zarr", "no store that porous has begun"), ("x", "no such folder")):
        for work in (Store.open, StoredGrid.open, lambda f: Store.resume(f, RECIPE)):
            with pytest.raises(FormatError, match=said):
                work(tmp_path / name)
    assert contents(tmp_path) == before


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"chunk": (0, 1, 1)}, "chunk: got"),
        ({"chunk": (-1, 1, 1)}, "chunk"),
        ({"chunk": (2, 2)}, "chunk"),
        ({"sampling": "guess"}, "sampling"),
        ({"hausdorff": -1.0}, "hausdorff"),
        ({"hausdorff": float("nan")}, "hausdorff"),
        ({"sampling_error": float("inf")}, "sampling_error"),
        ({"recipe_sha256": "../x"}, "recipe_sha256"),
    ],
)
def test_plans_that_cannot_be(folder, change, said):
    with pytest.raises(GridError, match=said):
        begun(folder, **change)
    assert not folder.exists()


def test_chunks_too_large_or_too_many(folder):
    huge = Frame((0, 0, 0), (1, 1, 1), (1 << 20, 1 << 20, 1 << 20))
    with pytest.raises(GridError, match=f"at most {LARGEST_CHUNK} voxels"):
        begun(folder, huge, chunk=1024)
    with pytest.raises(GridError, match="choose larger chunks"):
        begun(folder, huge, chunk=256)


def test_wrong_use_is_a_programming_mistake(whole, tmp_path):
    store = begun(tmp_path / "open")
    with pytest.raises(ValueError, match="array: got 'bulk'"):
        store.write("bulk", 0, FILL[:4, :5, :3])
    with pytest.raises(ValueError, match="wanted uint8"):
        store.write("fill", 0, FILL[:4, :5, :2])
    with pytest.raises(ValueError, match="wanted uint8"):
        store.write("fill", 0, FILL[:4, :5, :3] > 0)
    with pytest.raises(ValueError, match="is whole"):
        whole.write("fill", 0, FILL[:4, :5, :3])
    for start, stop in (((0, 0, 0), (8, 1, 1)), ((-1, 0, 0), (1, 1, 1)), ((3, 0, 0), (2, 1, 1))):
        with pytest.raises(ValueError, match="box: got"):
            whole.read("fill", start, stop)


@pytest.mark.usefixtures("whole")
def test_memory_is_asked_for_first(folder, monkeypatch):
    monkeypatch.setattr(memory, "available", lambda: 1000)
    with pytest.raises(MemoryLimitError, match="the stored grid"):
        StoredGrid.open(folder).to_grid()


@pytest.mark.parametrize("module", ["google_crc32c", "numcodecs.zstd"])
def test_without_the_extra(folder, monkeypatch, module):
    store = begun(folder)
    monkeypatch.setitem(__import__("sys").modules, module, None)
    with pytest.raises(PorousError, match=r"pip install 'porous\[scale\]'"):
        store.write("fill", 0, FILL[:4, :5, :3])


# --- hostile files -------------------------------------------------------------------------


def flip(path, bit):
    data = bytearray(path.read_bytes())
    data[bit // 8] ^= 1 << bit % 8
    path.write_bytes(data)


def forged(store, **change):
    """Write a plan that says something else, with a right checksum."""
    record = {**store.plan.record(), **change}
    (store.folder / "plan.json").write_bytes(seal(record))


@pytest.mark.parametrize(
    "change",
    [
        {"chunk": [0, 5, 3]},
        {"chunk": [4, 5]},
        {"chunk": [10**5] * 3, "frame": {"origin": [0, 0, 0], "spacing": [1, 1, 1], "unit": "mm",
                                         "shape": [10**5] * 3, "periodic": [0, 0, 0],
                                         "start": [0, 0, 0]}},
        {"chunk": [1, 1, 1], "frame": {"origin": [0, 0, 0], "spacing": [1, 1, 1], "unit": "mm",
                                       "shape": [10**18] * 3, "periodic": [0, 0, 0],
                                       "start": [0, 0, 0]}},
        {"frame": {"shape": [1, 1, 1]}},
        {"frame": [1, 2, 3]},
        {"frame": {"origin": [0, 0, 0], "spacing": [1, -1, 1], "shape": [7, 10, 9]}},
        {"sampling": ["fill"]},
        {"has_bulk": "yes"},
        {"recipe_sha256": 5},
        {"version": None},
        {"sampling_error": "1"},
        {"more": 1},
        {"format": 2},
        {"format": [[[]]]},
    ],
)  # fmt: skip
def test_plans_that_lie(whole, folder, change):
    forged(whole, **change)
    with pytest.raises(FormatError, match=r"plan\.json: (tells of no store|has format)"):
        Store.open(folder)


HOSTILE = [
    b"",
    b"{",
    b"[]",
    b"null",
    b'{"content": {}}',
    b"[" * 100_000,
    b'{"content": ' + b'{"a": ' * 500 + b"1" + b"}" * 501,
    b'{"content": {"a": NaN}}',
    b'{"content": {"a": 1e999}}',
    b'{"content": {"a": ' + b"9" * 5000 + b"}}",
    b"\xff\xfe",
    seal({}),
    seal({"files": {}}),
    seal({"files": {"../../x": [1, "0"]}}),
    b" " * 70_000,
]


@pytest.mark.usefixtures("whole")
@pytest.mark.parametrize("name", ["plan.json", "manifest.json"])
@pytest.mark.parametrize("text", HOSTILE, ids=range(len(HOSTILE)))
def test_records_that_are_none(folder, name, text):
    (folder / name).write_bytes(text)
    with pytest.raises(FormatError, match=name):
        Store.open(folder)


def test_manifests_that_lie(whole, folder):
    record = whole.manifest.record()
    for name, entry in (
        ("fill/c.0.0.0", [-1, "00000000"]),
        ("fill/c.0.0.0", [10**30, "0"]),
        ("fill/c.0.0.0", ["1", "x"]),
        ("fill/c.0.0.0", 7),
        ("plan.json", [1, "00000000"]),
        ("more", [1, "00000000"]),
    ):
        lie = {**record, "files": {**record["files"], name: entry}}
        (folder / "manifest.json").write_bytes(seal(lie))
        with pytest.raises(FormatError, match=r"is of another plan|is no manifest|list|c\.0\.0\.0"):
            Store.open(folder)


def bomb(size):
    """Return a right chunk that claims and holds ``size`` zeros."""
    return codec.encode(np.zeros((1, 1, size), np.uint8), (1, 1, size))


@pytest.mark.parametrize(
    "body",
    [
        bomb(1 << 26),
        bomb(60)[:-4] + bomb(60)[:-4],  # two frames, each of the right size
        b"",
        b"\x28\xb5\x2f\xfd",
        b"\x28\xb5\x2f\xfd\xc0" + b"\xff" * 20,
        b"\x28\xb5\x2f\xfd\x20\x3c",  # says 60 bytes, holds none
        b"\x28\xb5\x2f\xfd\x20\x3c" + b"\xff" * 30,
        b"\x28\xb5\x2f\xfd\x00\x58" + bytes(20),  # says no size
        np.random.default_rng(0).bytes(64),
    ],
    ids=range(9),
)
def test_chunks_that_lie(whole, folder, body):
    """Files with a right checksum, listed by a right manifest, that are not what they should be."""
    if body.endswith(codec.crc32c(body[:-4]).to_bytes(4, "little")):
        body = body[:-4]
    (folder / "fill" / "c.0.0.0").write_bytes(body + codec.crc32c(body).to_bytes(4, "little"))
    record = whole.manifest.record()
    record["files"]["fill/c.0.0.0"] = [len(body) + 4, f"{codec.crc32c(body):08x}"]
    (folder / "manifest.json").write_bytes(seal(record))
    store = Store.open(folder)
    with pytest.raises(FormatError, match=r"fill/c\.0\.0\.0: .*(would become|damaged|has \d+)"):
        store.read("fill", (0, 0, 0), (1, 1, 1))
    assert store.verify() == ("fill/c.0.0.0",)


@pytest.mark.usefixtures("whole")
def test_links_lead_nowhere(folder, tmp_path):
    secret = tmp_path / "secret"
    chunk = folder / "fill" / "c.0.0.0"
    chunk.rename(secret)
    chunk.symlink_to(secret)
    kept = secret.read_bytes()
    with pytest.raises(FormatError, match=r"c\.0\.0\.0: is missing"):
        Store.open(folder)
    store = Store.resume(folder, RECIPE)
    assert store.missing() == (("fill", 0),)
    chunk.symlink_to(secret)
    store.write("fill", 0, FILL[:4, :5, :3] // 2)
    assert not chunk.is_symlink()
    assert secret.read_bytes() == kept
    (folder / "fill").rename(tmp_path / "away")
    (folder / "fill").symlink_to(tmp_path / "away")
    for work in (store.commit, lambda: Store.resume(folder, RECIPE)):
        with pytest.raises(FormatError, match=r"fill: is a link"):
            work()


def test_pipes_are_not_waited_for(whole, folder):
    for name in ("fill/c.0.0.0", "manifest.json", "plan.json"):
        (folder / name).unlink()
        os.mkfifo(folder / name)
        with pytest.raises(FormatError, match=r"is not a regular file|is missing"):
            Store.open(folder)
    assert "fill/c.0.0.0" in whole.verify()


def test_a_seal_has_one_spelling():
    text = seal({"a": [1, 2.5, None, "é"], "b": {}})
    assert unseal(text) == {"a": [1, 2.5, None, "é"], "b": {}}
    assert json.loads(text)["content"]["a"][3] == "é"
    for bit in range(8 * len(text)):
        data = bytearray(text)
        data[bit // 8] ^= 1 << bit % 8
        with pytest.raises(FormatError):
            unseal(bytes(data))


def test_tile_numbers_and_places_agree(folder):
    store = begun(folder)
    places = [store.plan.place(index) for index in range(len(store.tiles))]
    assert [store.plan.tile(place) for place in places] == list(store.tiles)
    assert all(a < b for a, b in pairwise(places))


# --- chunks that are remembered ------------------------------------------------------------


def test_neighbours_are_read_once_while_there_is_room(whole, monkeypatch):
    grid = StoredGrid.open(whole.folder)
    made = []
    real = codec.decode
    monkeypatch.setattr(codec, "decode", lambda *args: made.append(1) or real(*args))
    for start, stop in grid.tiles:
        wide = tuple(min(b + 1, n) for b, n in zip(stop, SHAPE, strict=True))
        fill, bulk = grid.block(start, wide)
        assert np.array_equal(fill, FILL[_slices(start, wide)])
        assert np.array_equal(bulk, BULK[_slices(start, wide)])
        fill[:] = 7  # the box is the caller's own
    assert len(made) == 2 * len(grid.tiles)


def test_what_is_remembered_has_its_limit():
    recent, made = Recent(100), []

    def make(name):
        made.append(name)
        return np.full(int(name), int(name), np.uint8)

    for name in ("40", "50", "40", "30", "50", "40", "101", "101"):
        assert (recent.get(name, make) == int(name)).all()
    # 30 pushes out 50, which was used longest ago, and 50 then 40 and 30; 101 never fits.
    assert made == ["40", "50", "30", "50", "40", "101", "101"]
