"""Compiled kernels are kept by the text that they are made from, wherever that lies."""

import pytest

from porous.kernels._shared import ByText

FILES = {
    "_shared": "def kernel(function): ...\n",
    "tables": "from porous.kernels._shared import kernel\nTABLE = (1, 2)\n",
    "marching": "from porous.kernels.tables import TABLE\n",
    "other": "from porous.kernels._shared import kernel\n",
}


def kept(folder, **edited):
    """Return where a function of marching.py would be kept, of files some of which are edited."""
    folder.mkdir()
    for name, text in (FILES | edited).items():
        (folder / f"{name}.py").write_text(text)
    return ByText.from_function(kept, str(folder / "marching.py")).get_cache_path()


@pytest.fixture(autouse=True)
def room(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


def test_a_copy_of_the_package_takes_the_same(tmp_path):
    assert kept(tmp_path / "here") == kept(tmp_path / "there")


@pytest.mark.parametrize("name", ["marching", "tables", "_shared"])
def test_an_edit_to_what_a_kernel_is_made_from_takes_another(tmp_path, name):
    edited = {name: FILES[name] + "# edited\n"}
    assert kept(tmp_path / "before") != kept(tmp_path / "after", **edited)


def test_an_edit_elsewhere_does_not(tmp_path):
    edited = {"other": FILES["other"] + "# edited\n"}
    assert kept(tmp_path / "before") == kept(tmp_path / "after", **edited)
