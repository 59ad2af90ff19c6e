"""The gallery: every preset is on the page, with a picture that shows it."""

import importlib.util
import io
import re
from importlib.machinery import SourceFileLoader
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from test_view import draws

from porous import presets

ROOT = Path(__file__).resolve().parent.parent
PICTURES = ROOT / "docs" / "gallery"


def script():
    path = str(ROOT / "scripts" / "gallery")
    loader = SourceFileLoader("gallery", path)
    spec = importlib.util.spec_from_loader("gallery", loader)
    module = importlib.util.module_from_spec(spec)
    loader.exec_module(module)
    return module


def pixels(content):
    return np.asarray(Image.open(io.BytesIO(content)).convert("RGB")).astype(int)


def test_the_page_is_what_the_presets_say():
    page = (ROOT / "docs" / "gallery.md").read_text()
    assert page == script().page(), "scripts/gallery --page writes it anew"
    shown = re.findall(r"\(gallery/([^)]+)\.png\)", page)
    assert sorted(shown) == sorted(presets.names())
    assert all(alt for alt in re.findall(r"!\[([^\]]*)\]", page))


def test_no_picture_is_left_over():
    assert {path.stem for path in PICTURES.glob("*.png")} == set(presets.names())
    assert sum(path.stat().st_size for path in PICTURES.iterdir()) < 2_500_000


@pytest.mark.parametrize("name", presets.names())
def test_a_picture_shows_a_body(name):
    image = pixels((PICTURES / f"{name}.png").read_bytes())
    assert image.shape == (480, 480, 3)
    body = (image[..., 0] - image[..., 2] > 20) & (image[..., 0] < 250)
    assert 0.02 < body.mean() < 0.95
    assert image[body].std() > 5


def test_the_readme_leads_to_the_gallery():
    assert "docs/gallery.md" in (ROOT / "README.md").read_text()


@draws
@pytest.mark.slow
@pytest.mark.parametrize("name", ["menger-rough", "tetra-octa"])
def test_a_picture_drawn_anew_is_the_one_there(name):
    old, new = pixels((PICTURES / f"{name}.png").read_bytes()), pixels(script().drawn(name))
    # Drivers differ by a shade or along an edge, not in what is shown.
    assert np.abs(old - new).mean() < 6
