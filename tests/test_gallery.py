"""The gallery: every preset is on the page, with a picture that shows it."""

import importlib.util
import io
import os
import re
from importlib.machinery import SourceFileLoader
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from test_view import draws

from porous import presets
from porous.recipe import build, load
from porous.stages import mesh_cells

ROOT = Path(__file__).resolve().parent.parent
PICTURES = ROOT / "docs" / "gallery"


@pytest.fixture(scope="module")
def gallery():
    path = str(ROOT / "scripts" / "gallery")
    loader = SourceFileLoader("gallery", path)
    spec = importlib.util.spec_from_loader("gallery", loader)
    module = importlib.util.module_from_spec(spec)
    loader.exec_module(module)
    return module


def pixels(content):
    return np.asarray(Image.open(io.BytesIO(content)).convert("RGB")).astype(int)


def page():
    return (ROOT / "docs" / "gallery.md").read_text(encoding="utf-8")


# --- the page ------------------------------------------------------------------------------


def test_the_page_is_what_the_presets_say(gallery):
    assert page() == gallery.page(), "scripts/gallery --page writes it anew"


@pytest.mark.parametrize("name", presets.names())
def test_an_entry_says_what_it_is_under_its_kind(gallery, name):
    recipe = load(name)
    sections = re.split(r"^## .*\((.*)\)$", page(), flags=re.M)
    kinds = dict(zip(sections[1::2], sections[2::2], strict=True))
    headings = {"ifs": "IFS", "cifs": "C-IFS", "tree": "C-IFS", "bcifs": "BC-IFS"}
    text = kinds[headings.get(recipe.model.kind, recipe.model.kind)]
    entries = re.findall(rf"!\[([^\]]+)\]\(gallery/{name}\.png\)([^|]*)\|", text)
    assert len(entries) == 1
    alt, words = entries[0]
    note = f" ({gallery.NOTES[name]})" if name in gallery.NOTES else ""
    assert alt == recipe.title + note
    for part in (name, recipe.title + note, recipe.source, f"`porous make {name}`"):
        assert f">{part}<" in f"{words.strip()}<".replace("**", "")


def test_what_is_set_apart_is_a_preset(gallery):
    assert {*gallery.CUTS, *gallery.APART} == set(gallery.NOTES) <= set(presets.names())


def test_the_readme_leads_to_the_gallery_and_the_script_can_be_run():
    assert "](docs/gallery.md)" in (ROOT / "README.md").read_text(encoding="utf-8")
    assert os.access(ROOT / "scripts" / "gallery", os.X_OK)


# --- the pictures --------------------------------------------------------------------------


def test_every_preset_has_a_picture_and_none_is_left_over():
    assert {path.name for path in PICTURES.iterdir()} == {f"{name}.png" for name in presets.names()}
    assert sum(path.stat().st_size for path in PICTURES.iterdir()) < 2_500_000


@pytest.mark.parametrize("name", presets.names())
def test_a_picture_shows_a_body_that_fills_it(name):
    content = (PICTURES / f"{name}.png").read_bytes()
    assert content.startswith(b"\x89PNG\r\n\x1a\n")
    image = pixels(content)
    assert image.shape == (480, 480, 3)
    body = image.min(axis=2) < 240
    assert 0.1 < body.mean() < 0.9
    assert image[body].std(axis=0).min() > 10
    rows, columns = np.flatnonzero(body.any(axis=1)), np.flatnonzero(body.any(axis=0))
    assert max(np.ptp(rows), np.ptp(columns)) > 440
    assert min(rows[0], columns[0], 479 - rows[-1], 479 - columns[-1]) >= 5  # nothing is cut off


@draws
@pytest.mark.slow
@pytest.mark.parametrize("name", ["menger-rough", "tetra-octa"])
def test_a_picture_drawn_anew_is_the_one_there(gallery, name):
    old, new = pixels((PICTURES / f"{name}.png").read_bytes()), pixels(gallery.drawn(name))
    # Drivers differ by a shade or along an edge, not in what is shown.
    assert np.abs(old - new).mean() < 6


def test_cells_apart_keep_their_middles_and_shrink_alike(gallery):
    mesh = mesh_cells(build(load("tetra-octa", set={"model.level": 1})))
    surface = gallery.apart(mesh)
    assert surface.volume == pytest.approx(gallery.SHRUNK**3 * mesh.volumes.sum(), rel=1e-9)
    octa = surface.labels == 1
    assert 0 < octa.sum() < len(octa)
    # A cell of several tetrahedra stays whole: its middle is where those meet, and stays.
    _, cell = np.unique(mesh.cell_tags["address"], return_inverse=True)
    corners = mesh.points[mesh.blocks[0].cells]
    shrunk = surface.points.reshape(corners.shape)
    for k in range(cell.max() + 1):
        before, after = corners[cell == k], shrunk[cell == k]
        middle = before.reshape(-1, 3).mean(axis=0)
        assert np.allclose(after - middle, gallery.SHRUNK * (before - middle))
