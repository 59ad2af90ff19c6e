"""A model as voxels that are worked out when they are asked for: the same as all at once."""

import itertools
import pickle

import numpy as np
import pytest

import porous as po
from porous import presets
from porous.errors import GridError
from porous.models.model import HasCover
from porous.stages import SampledModel, fit_frame, voxelize
from porous.values import Tiled
from porous.values.value import same


def boxes(shape, size):
    steps = [[(a, min(a + s, n)) for a in range(0, n, s)] for n, s in zip(shape, size, strict=True)]
    return [tuple(zip(*box, strict=True)) for box in itertools.product(*steps)]


def gathered(source, size):
    shape = source.frame.shape
    fill, bulk = np.zeros(shape, np.uint8), np.zeros(shape, np.uint8)
    for start, stop in reversed(boxes(shape, size)):
        place = tuple(map(slice, start, stop))
        fill[place], part = source.block(start, stop)
        bulk[place] = 255 if part is None else part
    return fill, bulk


@pytest.mark.parametrize("sampling", ["fill", "cover"])
@pytest.mark.parametrize("name", presets.names())
def test_blocks_are_those_of_the_whole_grid(name, sampling):
    model = po.build(po.load(name))
    if sampling == "cover" and not isinstance(model, HasCover):
        pytest.skip("this model has no cover")
    if getattr(model, "level", 0) == "limit" and sampling == "fill" and not model.offset:
        pytest.skip("a set without volume")
    grid = voxelize(model, voxels=19, sampling=sampling)
    source = SampledModel(model, grid.frame, sampling)
    assert isinstance(source, Tiled)
    fill, bulk = gathered(source, (7, 8, 11))
    assert same(fill, grid.fill)
    assert same(bulk, np.full_like(bulk, 255) if grid.bulk is None else grid.bulk)
    assert (source.hausdorff, source.sampling_error) == (grid.hausdorff, grid.sampling_error)


def test_it_can_be_sent_elsewhere():
    model = po.build(po.load("menger", set={"model.level": 1}))
    source = SampledModel(model, fit_frame(model, voxels=10))
    there = pickle.loads(pickle.dumps(source))
    assert there == source
    assert same(there.block((0, 1, 2), (9, 8, 10))[0], source.block((0, 1, 2), (9, 8, 10))[0])


def test_an_unknown_sampling_is_refused():
    model = po.build(po.load("menger"))
    with pytest.raises(GridError, match="sampling: got 'filled'; wanted one of fill"):
        SampledModel(model, fit_frame(model, voxels=10), "filled")
