"""Grey values on a lattice: what can be an image, and what cannot."""

import pickle

import numpy as np
import pytest
from image_cases import CORNER, SHAPE, SPACING, ramp

from porous.errors import GridError
from porous.values import Image


def test_an_image_is_a_value():
    image = Image(ramp(np.uint16), SPACING, CORNER, "um")
    assert image.shape == SHAPE
    assert image == pickle.loads(pickle.dumps(image))
    assert image != Image(ramp(np.uint8), SPACING, CORNER, "um")
    assert image != Image(ramp(np.uint16), SPACING, CORNER, "mm")
    with pytest.raises(ValueError, match="read-only"):
        image.values[0, 0, 0] = 1


def test_values_are_kept_as_they_lie_in_memory():
    turned = ramp().transpose(2, 1, 0)
    assert np.shares_memory(Image(turned, SPACING).values, turned)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            {"values": ramp()[0]},
            r"image: got int64 of shape \(6, 7\); wanted numbers on three axes",
        ),
        ({"values": np.zeros((0, 2, 3))}, "image: got float64 of shape"),
        ({"values": ramp(complex)}, "image: got complex128"),
        ({"values": ramp().astype("U3")}, "image: got <U3"),
        ({"spacing": (1, 0, 1)}, "image spacing: got .*; wanted three positive lengths"),
        ({"spacing": (1, np.nan, 1)}, "image spacing: got .*; wanted three finite numbers"),
        ({"origin": (1, 2)}, "image origin: got .*; wanted three numbers"),
        ({"unit": "ell"}, "unit: got 'ell'"),
    ],
)
def test_what_is_no_image(change, said):
    with pytest.raises(GridError, match=said):
        Image(**{"values": ramp(), "spacing": SPACING, **change})
