"""Tiles on Dask's workers: the same bytes, whoever dies; and an end to all waiting."""

import contextlib
import logging
import os
import socket
import struct
import subprocess
import sys
import threading
import time
from functools import partial

import dask_processes as work
import msgpack
import numpy as np
import psutil
import pytest
from dask_processes import Site, until

import porous as po
from porous import measures
from porous.errors import DiskError, FormatError, GuestError, PorousError, RecipeError
from porous.scale import Store, StoredGrid, tasks
from porous.scale import cluster as module
from porous.scale.cluster import Cluster, check_address
from porous.scale.rasterise import fill_store
from porous.stages import SampledModel
from porous.values import Frame, VoxelGrid

RECIPE = "5" * 64
FRAME = Frame((0.0, 1.0, -2.0), (0.5, 0.25, 0.125), (30, 21, 26))


def grid_of(seed=1):
    """A porous body without order, of unequal axes."""
    random = np.random.default_rng(seed)
    return VoxelGrid(FRAME, random.integers(0, 256, FRAME.shape).astype(np.uint8))


def new_store(folder):
    return Store.create(folder, FRAME, recipe_sha256=RECIPE, chunk=(8, 8, 8))


def bytes_of(folder):
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*.*")}


@pytest.fixture(scope="module")
def grid():
    return grid_of()


@pytest.fixture(scope="module")
def expected(grid, tmp_path_factory):
    """The files of a store that this process has written alone."""
    folder = tmp_path_factory.mktemp("alone") / "grid.zarr"
    store = new_store(folder)
    assert len(store.tiles) == 4 * 3 * 4
    for index in range(len(store.tiles)):
        work.write_chunk(store, grid, index)
    store.commit()
    return bytes_of(folder)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """A scheduler and two workers for tests that kill none of them."""
    with Site(tmp_path_factory.mktemp("site")) as made:
        with Cluster.connect(made.address) as cluster:
            until(lambda: cluster.workers == 2)
        yield made


@pytest.fixture
def cluster(site):
    with Cluster.connect(site.address, patience=60) as made:
        yield made


def family():
    """Return the processes that have come from this one, and theirs."""
    return set(psutil.Process().children(recursive=True))


def connected(site, workers=2, **options):
    made = Cluster.connect(site.address, **options)
    until(lambda: made.workers == workers)
    return made


# --- results -------------------------------------------------------------------------------


def test_two_workers_write_the_bytes_of_one_process(cluster, grid, expected, tmp_path):
    store = new_store(tmp_path / "grid.zarr")
    cluster.check(store.folder)
    done = list(cluster.map(partial(work.write_chunk, store, grid), range(len(store.tiles))))
    assert done == list(range(len(store.tiles)))
    store.commit()
    assert bytes_of(store.folder) == expected


def test_results_come_in_order_from_both_workers(cluster):
    found = list(cluster.map(work.square_and_process, range(40)))
    assert [value for value, _ in found] == [i * i for i in range(40)]
    assert len({process for _, process in found} - {os.getpid()}) == 2
    assert list(cluster.map(work.square, [])) == []
    assert list(cluster.map(work.square, [3.5])) == [12.25]


def test_functions_that_have_no_module_come_along(cluster):
    offset = 7
    assert list(cluster.map(lambda i: i + offset, range(5))) == [7, 8, 9, 10, 11]


@pytest.mark.slow
def test_measures_of_a_stored_grid_are_those_of_one_process(cluster, grid, tmp_path):
    store = new_store(tmp_path / "grid.zarr")
    list(map(partial(work.write_chunk, store, grid), range(len(store.tiles))))
    store.commit()
    tiles = [
        ((x, y, 0), (min(x + 16, 30), min(y + 8, 21), 26)) for x in (0, 16) for y in (0, 8, 16)
    ]
    stored = StoredGrid.open(store.folder)
    rows = measures.measure(stored, tiles=tiles, map=cluster.map)
    assert rows == measures.measure(grid)


def test_only_a_few_tasks_are_under_way(cluster):
    taken = []
    results = cluster.map(work.square, (taken.append(i) or i for i in range(1000)))
    assert next(results) == 0
    assert 2 <= len(taken) <= module.AHEAD * 2 + 1
    results.close()


def test_what_has_not_begun_never_begins_once_results_are_left(cluster, tmp_path):
    results = cluster.map(partial(work.note, str(tmp_path)), range(100))
    next(results)
    results.close()
    time.sleep(0.3)
    begun = len(list(tmp_path.iterdir()))
    time.sleep(0.6)
    assert len(list(tmp_path.iterdir())) == begun <= 4
    assert list(cluster.map(work.square, range(3))) == [0, 1, 4]


def test_a_large_function_is_sent_once_to_each_worker(cluster, monkeypatch):
    array = np.arange(2_000_000)
    assert tasks.packed_size(array) > module.LARGE
    sent = []
    submit = cluster._client.submit
    monkeypatch.setattr(
        cluster._client, "submit", lambda *a, **k: sent.append(a) or submit(*a, **k)
    )
    found = list(cluster.map(partial(work.parity, array), range(20)))
    assert [value for value, _ in found] == list(range(20))
    assert sum(any(isinstance(a, bytes) and len(a) > module.LARGE for a in s) for s in sent) == 1


def test_volumes_are_not_sent(cluster, monkeypatch, grid, tmp_path):
    monkeypatch.setattr(module, "LARGEST", grid.fill.nbytes)
    store = new_store(tmp_path / "grid.zarr")
    with pytest.raises(GuestError, match="write the voxels to a store"):
        next(cluster.map(partial(work.write_chunk, store, grid), range(3)))


@pytest.mark.parametrize("thing", [np.zeros(5000), [1, "two"], grid_of()], ids=["0", "1", "2"])
def test_the_size_of_a_pickle_is_known_before_it_is_made(thing):
    assert abs(tasks.packed_size(thing) - len(tasks.packed(thing))) < 300
    again = tasks.unpacked(tasks.packed(thing))
    assert np.array_equal(again, thing) if isinstance(thing, np.ndarray) else again == thing


# --- errors of tasks -----------------------------------------------------------------------


def test_what_a_task_raises_comes_out_as_itself(cluster):
    results = cluster.map(partial(work.fail_at, 3), range(30))
    assert [next(results) for _ in range(3)] == [0, 1, 2]
    with pytest.raises(DiskError, match=r"^tile 3: no space left on device$"):
        next(results)
    with pytest.raises(KeyError, match="0"):
        next(cluster.map(work.fail_otherwise, range(3)))
    with pytest.raises(TimeoutError, match="of 0's own"):
        next(cluster.map(work.time_out, range(3)))
    assert list(cluster.map(work.square, range(3))) == [0, 1, 4]


def test_workers_have_to_see_the_store(cluster, tmp_path, monkeypatch):
    store = new_store(tmp_path / "grid.zarr")
    cluster.check(store.folder)
    with pytest.raises(FormatError, match=r"plan\.json: is missing"):
        cluster.check(tmp_path)
    monkeypatch.chdir(tmp_path)  # a path that means something else where workers stand
    with pytest.raises(GuestError, match=r"worker tcp://127.*does not see the store: .*missing"):
        cluster.check("grid.zarr")


def test_workers_have_to_see_the_same_store(cluster, tmp_path, monkeypatch):
    store = new_store(tmp_path / "grid.zarr")
    read = module.read_file
    monkeypatch.setattr(module, "read_file", lambda *a: read(*a).replace(b"5555", b"5655", 1))
    with pytest.raises(GuestError, match=r"worker tcp://127.*sees another store"):
        cluster.check(store.folder)


@pytest.mark.parametrize("name", sorted(tasks.versions()))
def test_workers_have_to_run_the_same(site, name, monkeypatch):
    ours = {**tasks.versions(), name: "0.0.1"}
    monkeypatch.setattr(tasks, "versions", lambda: ours)
    wanted = rf"worker tcp://127\S+: runs {name} \S+; wanted 0.0.1"
    with pytest.raises(GuestError, match=wanted):
        Cluster.connect(site.address)


def test_a_worker_that_comes_later_finds_out_by_itself(cluster, monkeypatch):
    ours = {**tasks.versions(), "porous": "0.0.1"}
    monkeypatch.setattr(tasks, "versions", lambda: ours)
    with pytest.raises(GuestError, match=r"worker tcp://127\S+: runs porous \S+; wanted 0\.0\.1"):
        next(cluster.map(work.square, range(3)))


def test_a_worker_that_cannot_run_porous_is_named(cluster, monkeypatch):
    monkeypatch.setattr(tasks, "call", lambda *_: 1 / 0)
    with pytest.raises(GuestError, match=r"worker tcp://127\S+ cannot run porous: ZeroDivision"):
        cluster._ask(bool, None)


def test_one_thread_of_ours_for_each_of_dasks(cluster):
    assert os.environ.get("POROUS_THREADS") is None
    assert set(cluster.map(work.setting, ["POROUS_THREADS"] * 8)) == {"1"}


# --- addresses -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    "address",
    [
        *("", "loopback", "local:", "local:0", "local:-1", "local:two", "local:1\n"),
        *("127.0.0.1:8786", "tcp://", "tcp://host", "tcp://host:", "tcp://host:port"),
        *("tcp://host:0", "tcp://host:65536", "http://host:80", "tcp://host:80/path"),
        *("tcp://a b:80", "tcp://[::1:80", "tcp://host:８０", "inproc://1/2/3", "tcp://me@host:80"),
    ],
)
def test_a_malformed_address(address):
    with pytest.raises(RecipeError, match="cluster: got"):
        check_address(address)
    with pytest.raises(RecipeError, match="cluster: got"):
        Cluster.connect(address)


@pytest.mark.parametrize(
    "address", ["local", "local:3", "tcp://host.example:8786", "tls://10.0.0.1:1", "tcp://[::1]:9"]
)
def test_an_address_that_could_be(address):
    check_address(address)


@pytest.mark.parametrize("times", [{"patience": 0.0}, {"limit": -1.0}, {"limit": float("nan")}])
def test_times_are_positive(times):
    with pytest.raises(RecipeError, match="wanted a positive number of seconds"):
        Cluster.connect("local", **times)


def test_nobody_is_there(capfd):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    begin = time.monotonic()
    with pytest.raises(GuestError, match="cannot be reached: connection refused") as caught:
        Cluster.connect(address)
    with pytest.raises(GuestError, match="cannot be reached"):
        Cluster.connect("tcp://no-such-host.invalid:8786")
    assert time.monotonic() - begin < 12
    assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")


HELLO = msgpack.packb({"compression": None, "python": (3, 11, 7), "pickle-protocol": 5})
HELLO = struct.pack("<QQQ", 16 + len(HELLO), 1, len(HELLO)) + HELLO


@contextlib.contextmanager
def somebody(first_words):
    """Give the address of a server that says something, and then nothing more."""
    lines = []

    def answer():
        with contextlib.suppress(OSError):
            while True:
                lines.append(server.accept()[0])
                lines[-1].sendall(first_words)

    with socket.create_server(("127.0.0.1", 0)) as server:
        thread = threading.Thread(target=answer)
        thread.start()
        yield f"tcp://127.0.0.1:{server.getsockname()[1]}"
        server.shutdown(socket.SHUT_RDWR)
        thread.join()
    for line in lines:
        line.close()


@pytest.mark.parametrize(
    "words", [b"HTTP/1.1 400 Bad Request\r\n\r\n" * 20, b"\xff" * 9, struct.pack("<Q", 4) + b"abcd"]
)
def test_somebody_else_is_there(words, capfd):
    with somebody(words) as address, pytest.raises(GuestError, match="is no scheduler") as caught:
        Cluster.connect(address)
    assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "said"), [(b"", "cannot be reached: timed out"), (HELLO, "no scheduler has answered")]
)
def test_somebody_there_is_silent(words, said, capfd):
    begin = time.monotonic()
    with somebody(words) as address, pytest.raises(GuestError, match=said) as caught:
        Cluster.connect(address)
    assert time.monotonic() - begin < 12
    assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")


def test_dask_is_not_installed(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(PorousError, match=r"pip install 'porous\[scale\]'"):
        Cluster.connect("local")


def test_logs_are_as_they_were_before(site):
    with Cluster.connect(site.address):
        pass  # Dask configures its loggers when it is first imported
    log = logging.getLogger("distributed")
    before = log.level
    with Cluster.connect(site.address):
        assert not log.isEnabledFor(logging.CRITICAL)
    assert log.level == before <= logging.WARNING


def test_only_dasks_own_coroutines_are_not_heard(site, caplog):
    with Cluster.connect(site.address):
        pass
    log = logging.getLogger("asyncio")
    log.error("Task exception was never retrieved: %s", "/x/distributed/client.py:1")
    log.error("Task exception was never retrieved: %s", "/x/mine.py:1")
    assert [record.args for record in caplog.records] == [("/x/mine.py:1",)]


# --- deaths --------------------------------------------------------------------------------


def test_a_killed_worker_loses_nothing(site, cluster, grid, expected, tmp_path):
    store = new_store(tmp_path / "grid.zarr")
    function = partial(work.write_chunk, store, grid, seconds=0.02)
    victim = site.join()
    until(lambda: cluster.workers == 3)
    results = cluster.map(function, range(len(store.tiles)))
    done = [next(results) for _ in range(10)]
    site.kill(victim)
    done += results
    assert cluster.workers == 2
    assert done == list(range(len(store.tiles)))
    store.commit()
    assert bytes_of(store.folder) == expected


@pytest.mark.slow
def test_a_model_becomes_the_same_store_though_a_worker_is_killed(tmp_path):
    model = po.build(po.load("menger"))
    frame = Frame((-0.013, 0.007, -0.02), (1 / 41, 1 / 37, 1 / 43), (42, 38, 44))
    source, options = SampledModel(model, frame), {"recipe_sha256": RECIPE, "chunk": (16, 8, 12)}
    fill_store(tmp_path / "alone", source, **options)
    with Site(tmp_path) as site, connected(site, patience=60) as cluster:

        def kill_one(done, _):
            if done == 20:
                site.kill(site.workers[0])

        fill_store(tmp_path / "both", source, **options, map=cluster.map, progress=kill_one)
        assert cluster.workers == 1
    assert bytes_of(tmp_path / "both") == bytes_of(tmp_path / "alone")
    assert 0.1 < StoredGrid.open(tmp_path / "both").to_grid().solid.mean() < 0.9


@pytest.mark.slow
def test_workers_may_die_one_after_the_other(grid, expected, tmp_path):
    store = new_store(tmp_path / "grid.zarr")
    function = partial(work.write_chunk, store, grid, seconds=0.1)
    done = []
    with Site(tmp_path) as site, connected(site, patience=30) as cluster:
        for index in cluster.map(function, range(len(store.tiles))):
            done.append(index)
            if index % 6 == 5:
                site.kill(site.workers.pop(0))
                site.join()
    assert done == list(range(len(store.tiles)))
    store.commit()
    assert bytes_of(store.folder) == expected


@pytest.mark.slow
def test_a_large_function_outlives_the_workers_that_had_it(tmp_path):
    array = np.arange(100_000)
    with Site(tmp_path) as site, connected(site, patience=30) as cluster:
        results = cluster.map(partial(work.parity, array), range(40))
        found = [next(results) for _ in range(5)]
        for worker in site.workers[:2]:
            site.kill(worker)
        site.join()
        found += results
    assert [value for value, _ in found] == list(range(40))
    assert len({process for _, process in found}) >= 2


@pytest.mark.slow
def test_no_worker_is_left(tmp_path):
    with Site(tmp_path) as site, connected(site, patience=2) as cluster:
        results = cluster.map(work.slow_square, range(100))
        assert next(results) == 0
        for worker in site.workers:
            site.kill(worker)
        begin = time.monotonic()
        with pytest.raises(GuestError, match=r"for 2 s, and 0 workers are .*porous resume"):
            list(results)
        assert 1 < time.monotonic() - begin < 6


@pytest.mark.slow
def test_the_scheduler_dies(tmp_path, capfd):
    with Site(tmp_path) as site:
        with connected(site) as cluster:
            results = cluster.map(work.slow_square, range(100))
            assert next(results) == 0
            site.kill(site.scheduler)
            with pytest.raises(GuestError, match=r"scheduler was lost.*porous resume"):
                list(results)
            with pytest.raises(GuestError, match="scheduler was lost"):
                _ = cluster.workers
        assert capfd.readouterr() == ("", "")


@pytest.mark.slow
@pytest.mark.nightly
def test_a_task_is_blamed_in_the_end_but_not_at_once(tmp_path):
    (tmp_path / "deaths").mkdir()
    with Cluster.connect("local:2", patience=60) as cluster:
        # Dask gives up after four deaths.
        often = partial(work.die_so_often, str(tmp_path / "deaths"), 6)
        assert list(cluster.map(often, range(4))) == [0, 1, 2, 3]
        assert len(list((tmp_path / "deaths").iterdir())) == 6
        with pytest.raises(GuestError, match=rf"tile 1: {module.DEATHS} workers have died"):
            list(cluster.map(partial(work.die_at, 1), range(4)))


# --- time ----------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("times", "said"),
    [({"patience": 4.0}, "no task has ended for 4 s, and 1 worker is there"),
     ({"limit": 4.0}, "its time limit of 4 s is over")],
)  # fmt: skip
def test_time_is_up(times, said):
    begin, before = time.monotonic(), family()
    with Cluster.connect("local:1", **times) as cluster:
        with pytest.raises(GuestError, match=rf"{said}; what is done is kept, and `porous resume`"):
            list(cluster.map(work.hang, range(3)))
        assert time.monotonic() - begin < 15
    assert family() == before


# --- local clusters ------------------------------------------------------------------------


@pytest.mark.slow
def test_a_local_cluster_leaves_nothing_behind(tmp_path, monkeypatch, capfd):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    before = family()
    with Cluster.connect("local:2") as cluster:
        assert cluster.workers == 2
        found = list(cluster.map(work.square_and_process, range(20)))
        assert [value for value, _ in found] == [i * i for i in range(20)]
        new = family() - before
        assert {process for _, process in found} <= {p.pid for p in new}
        ends = [c.laddr for p in new for c in p.net_connections() if c.status == "LISTEN"]
        assert {end.ip for end in ends} == {"127.0.0.1"}
        assert list(tmp_path.iterdir()) != []
    assert psutil.wait_procs(new, timeout=5)[1] == []
    assert family() == before
    assert list(tmp_path.iterdir()) == []
    assert capfd.readouterr() == ("", "")


@pytest.mark.slow
def test_leaving_by_an_error_leaves_nothing_behind():
    before = family()
    new = set()

    def interrupted():
        with Cluster.connect("local:1") as cluster:
            new.update(family() - before)
            for _ in cluster.map(work.slow_square, range(100)):
                raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert new
    assert psutil.wait_procs(new, timeout=5)[1] == []


SCRIPT = """
from porous.scale.cluster import Cluster
print("begun", flush=True)
def cube(number):
    return number ** 3
cluster = Cluster.connect("local:2")
print(*cluster.map(cube, range(5)), flush=True)
"""


def alone(folder, script, **options):
    """Run a script as a user would, in a session of its own."""
    (folder / "script.py").write_text(script)
    (folder / "select.py").write_text("raise RuntimeError('not the one of the library')\n")
    return subprocess.Popen(
        [sys.executable, "-W", "error", "-P", "script.py"],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(work.ROOT)},
        stdin=subprocess.DEVNULL,
        text=True,
        start_new_session=True,
        **options,
    )


@pytest.mark.slow
def test_a_script_needs_no_guard_and_may_forget_to_close(tmp_path):
    script = SCRIPT + "import psutil\nprint(*(p.pid for p in psutil.Process().children(True)))\n"
    process = alone(tmp_path, script, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    said, errors = process.communicate(timeout=60)
    lines = said.splitlines()
    assert (errors, process.returncode) == ("", 0)
    assert lines[:2] == ["begun", "0 1 8 27 64"]
    assert len(lines[2].split()) >= 3
    until(lambda: not any(alive(int(pid)) for pid in lines[2].split()))


def alive(pid):
    try:
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


@pytest.mark.slow
def test_whoever_is_killed_takes_the_local_cluster_along(tmp_path):
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    script = f"import tempfile\ntempfile.tempdir = {str(temporary)!r}\n{SCRIPT}\n"
    script += "import time\ntime.sleep(60)\n"
    with alone(tmp_path, script, stdout=subprocess.PIPE) as process:
        try:
            assert [process.stdout.readline().strip() for _ in range(2)] == ["begun", "0 1 8 27 64"]
            new = [p.pid for p in psutil.Process(process.pid).children(recursive=True)]
            assert len(new) >= 3
        finally:
            process.kill()
        until(lambda: not any(alive(pid) for pid in new), 10)
    assert list(temporary.iterdir()) == []


def test_a_local_cluster_that_does_not_come_up(monkeypatch):
    before = family()
    monkeypatch.setattr("porous.guests.dask_host.START", 0.01)
    with pytest.raises(GuestError, match=r"did not come up within 0\.01 s"):
        Cluster.connect("local:1")
    assert family() == before


def test_a_local_cluster_that_dies_as_it_comes_up(monkeypatch):
    monkeypatch.setattr(sys, "executable", "/bin/false")
    with pytest.raises(GuestError, match="did not come up: nothing was said"):
        Cluster.connect("local:1")


@pytest.mark.slow
def test_workers_share_the_memory_that_one_may_take(monkeypatch):
    monkeypatch.setenv("POROUS_MAX_MEMORY", "64M")
    with Cluster.connect("local:2") as cluster:
        assert set(cluster.map(work.setting, ["POROUS_MAX_MEMORY"] * 4)) == {str(32 << 20)}
        assert set(cluster.map(work.setting, ["POROUS_THREADS"] * 4)) == {"1"}
