"""What there is of memory: the machine's, the control group's, the limit on the address space."""

import subprocess
import sys

import psutil
import pytest

from porous import memory
from porous.errors import MemoryLimitError, RecipeError

GIB = 2**30


def group(folder, most, used, cached, *, version):
    folder.mkdir(parents=True, exist_ok=True)
    names = memory.FILES["" if version == 2 else "memory"]
    (folder / names[0]).write_text(f"{most}\n")
    (folder / names[1]).write_text(f"{used}\n")
    (folder / "memory.stat").write_text(f"anon 17\n{names[2]} {cached}\nactive_file 5\n")


def groups(tmp_path, text):
    path = tmp_path / "cgroup"
    path.write_text(text)
    return path


def test_version_two_counts_every_group_around(tmp_path):
    root = tmp_path / "control"
    group(root / "job" / "step", 4 * GIB, GIB, GIB // 2, version=2)
    group(root / "job", 3 * GIB, 2 * GIB, 0, version=2)
    group(root, "max", GIB, 0, version=2)
    where = groups(tmp_path, "0::/job/step\n")
    assert memory.group_room(where, root) == [7 * GIB // 2, GIB]


def test_version_one_in_a_container_falls_back_to_the_mount(tmp_path):
    root = tmp_path / "control"
    group(root / "memory", 2 * GIB, GIB, 100, version=1)
    where = groups(tmp_path, "9:cpu:/x\n4:memory:/docker/0123\n0::/\n")
    assert memory.group_room(where, root) == [GIB + 100]


def test_a_group_path_that_leads_out_of_the_mount(tmp_path):
    root = tmp_path / "control"
    group(root, GIB, 0, 0, version=2)
    where = groups(tmp_path, "0::/../../other\n")
    assert memory.group_room(where, root)[-1] == GIB


@pytest.mark.parametrize("text", ["", "0::/\n", "0::/nowhere\n", "4:memory:/\n"])
def test_without_groups_there_is_no_limit(tmp_path, text):
    assert memory.group_room(groups(tmp_path, text), tmp_path / "control") == []
    assert memory.group_room(tmp_path / "missing", tmp_path) == []


def test_damaged_groups_are_no_limit(tmp_path):
    root = tmp_path / "control"
    group(root, "lots", 0, 0, version=2)
    assert memory.group_room(groups(tmp_path, "0::/\n"), root) == []


def test_the_group_binds_where_it_is_lower_than_the_machine(tmp_path, monkeypatch):
    root = tmp_path / "control"
    group(root, 300_000_000, 100_000_000, 0, version=2)
    monkeypatch.setattr(memory, "CONTROL", root)
    monkeypatch.setattr(memory, "GROUPS", groups(tmp_path, "0::/\n"))
    assert memory.available() == 160_000_000
    group(root, 300_000_000, 400_000_000, 0, version=2)
    assert memory.available() == 0
    group(root, 10**18, 0, 0, version=2)
    machine = psutil.virtual_memory().available * memory.SHARE
    assert memory.available() == pytest.approx(machine, rel=0.2)


def test_the_user_lowers_the_limit(monkeypatch):
    monkeypatch.setenv("POROUS_MAX_MEMORY", "1M")
    assert memory.available() == 2**20
    monkeypatch.setenv("POROUS_MAX_MEMORY", "999P")
    assert memory.available() < 2**50


@pytest.mark.parametrize(
    ("text", "amount"),
    [("8G", 8 * GIB), ("500 MiB", 500 * 2**20), ("1.5k", 1536), ("1000000", 10**6), ("2TB", 2**41)],
)
def test_amounts_of_memory(text, amount):
    assert memory.parse(text) == amount


@pytest.mark.parametrize("text", ["", "lots", "-1G", "0", "1e9", "1 G B", "9" * 5000])
def test_what_is_no_amount_of_memory(text):
    with pytest.raises(RecipeError, match="wanted an amount such as 8G"):
        memory.parse(text)


def test_the_limit_on_the_address_space_binds():
    program = """
import psutil, resource
from porous import memory
from porous.errors import MemoryLimitError
used = psutil.Process().memory_info().vms
resource.setrlimit(resource.RLIMIT_AS, (used + 100_000_000,) * 2)
assert 40_000_000 < memory.available() <= 80_000_000, memory.available()
try:
    memory.check_memory(90_000_000, "it", "Do less.")
except MemoryLimitError as error:
    print(error)
"""
    done = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        check=True,
        stdin=subprocess.DEVNULL,
        timeout=120,
    )
    assert done.stdout.startswith("it would need 85.8 MiB of memory; ")


def test_what_is_needed_is_held_against_what_there_is():
    memory.check_memory(100, "it", "Do less.", limit=100)
    with pytest.raises(MemoryLimitError, match=r"^it would need 101 B of memory; 100 B may be"):
        memory.check_memory(101, "it", "Do less.", limit=100)
    with pytest.raises(MemoryLimitError, match=r"Do less\.$"):
        memory.check_memory(10**30, "it", "Do less.")


@pytest.mark.parametrize(
    ("amount", "text"),
    [(0, "0 B"), (1023, "1023 B"), (1536, "1.5 KiB"), (3 * GIB, "3 GiB"), (1e30, "8.882e+14 PiB")],
)
def test_bytes_for_people(amount, text):
    assert memory.readable(amount) == text
