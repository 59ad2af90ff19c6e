"""Images as models: which voxels are selected, where they lie, and what is told of it."""

import pickle
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from image_cases import CORNER, SHAPE, SPACING, ramp
from skimage.filters import threshold_otsu

from porous import formats
from porous.errors import GridError, ModelError, RecipeError
from porous.models.image import Segmented, segment
from porous.models.model import HasFill, HasLattice, HasNotes, Model
from porous.models.threshold import levels_of, otsu, within
from porous.pipeline import run
from porous.recipe import build, files, load, parse
from porous.stages import SampledModel, voxelize
from porous.values import CENTRE, FILL, Frame, Image, VoxelGrid

GREY = np.random.default_rng(7).integers(0, 256, (9, 8, 7)).astype(np.uint8)
IMAGE = Image(GREY, (0.5, 1.0, 2.0), (3, -1, 4), "um")


def naive_otsu(values):
    """Return the greatest variance between two classes, and the classes, of every split."""
    levels = np.unique(values[np.isfinite(values)]).tolist()
    flat = values[np.isfinite(values)].astype(float)
    found = []
    for low, high in pairwise(levels):
        a, b = flat[flat <= low], flat[flat >= high]
        between = len(a) * len(b) * (a.mean() - b.mean()) ** 2
        found.append((between / len(flat) ** 2, low, high))
    return max(found)


# --- thresholds --------------------------------------------------------------------------------


@pytest.mark.parametrize("form", ["?", "i1", "u2", "i4", "f4"])
@pytest.mark.parametrize("axes", [(0, 1, 2), (2, 1, 0), (1, 2, 0)])
def test_levels_and_choices_do_not_depend_on_the_order_in_memory(form, axes):
    numbers = np.random.default_rng(3).integers(-90, 90, (70, 131, 66)).astype(form)
    values = numbers.transpose(axes)[
        ::-1, 2:
    ]  # a line and a part of one, more rows than go at once
    chosen = within(values, -3, 40)
    assert chosen.flags.c_contiguous
    assert np.array_equal(chosen, (values >= -3) & (values <= 40))
    levels, counts = np.unique(values, return_counts=True)
    if form != "f4":  # floats are sorted in steps
        assert np.array_equal(levels_of(values).first, levels)
        assert np.array_equal(levels_of(values).counts, counts)


@given(st.lists(st.integers(0, 40), min_size=8, max_size=60), st.sampled_from([1, 7, 1000, 0.37]))
@settings(max_examples=60, deadline=None)
def test_otsu_is_the_best_of_all_splits(values, scale):
    values = np.array(values) * scale
    if len(np.unique(values)) < 2:
        with pytest.raises(ModelError, match="nothing to part"):
            otsu(levels_of(values))
        return
    between, *_ = naive_otsu(values)
    threshold, apart = otsu(levels_of(values))
    low, high = values[values < threshold], values[values >= threshold]
    mine = len(low) * len(high) * (low.mean() - high.mean()) ** 2 / len(values) ** 2
    close = 1e-9 if values.dtype.kind == "i" else 1e-4  # floats are sorted in steps
    assert mine == pytest.approx(between, rel=close)
    assert apart == pytest.approx(between / values.var(), rel=close)


@pytest.mark.parametrize("form", [np.uint8, np.int8, np.uint16, np.int16, np.int32])
def test_otsu_selects_what_scikit_image_selects(form):
    rng = np.random.default_rng(5)
    values = np.concatenate([rng.normal(30, 9, 4000), rng.normal(90, 14, 2500)]).clip(0, 127)
    values = values.astype(form).reshape(10, 10, 65)
    threshold, _ = otsu(levels_of(values))
    assert np.array_equal(values >= threshold, values > threshold_otsu(values))


def test_empty_levels_change_nothing():
    few = np.random.default_rng(2).integers(0, 12, (20, 20, 20)).astype(np.uint16)
    holes = few * np.uint16(5461)  # twelve levels of 65 536
    assert len(levels_of(holes).counts) == 12
    threshold, apart = otsu(levels_of(few))
    stretched, same = otsu(levels_of(holes))
    assert (stretched, same) == pytest.approx((5461 * threshold, apart))
    assert threshold % 1 == 0.5  # between two levels


def test_wide_numbers_keep_their_last_digits():
    values = np.array([2**62 + 1, 2**62 + 3] * 4, np.int64).reshape(2, 2, 2)
    taken = segment(Image(values, (1, 1, 1)), threshold=(2**62 + 2, 2**62 + 9))
    assert not taken.solid.all()


def test_levels_hold_every_value():
    for values in (GREY, GREY.astype(np.float32), GREY.astype(np.int64) << 40, GREY > 99):
        found = levels_of(values)
        assert found.counts.sum() == values.size
        assert (found.low, found.high) == (values.min(), values.max())
        assert found.share(found.low, np.inf) == 1
    turned = levels_of(GREY.transpose(2, 0, 1)[::-1])
    assert np.array_equal(turned.counts, levels_of(GREY).counts)


# --- what is selected --------------------------------------------------------------------------


@pytest.mark.parametrize("form", [np.uint8, np.int32, np.uint64, np.float32, np.float64])
@pytest.mark.parametrize("phase", ["solid", "pore"])
@pytest.mark.parametrize("threshold", [100, 99.5, [30, 100], (29.5, 100.5)])
def test_a_threshold_selects_one_phase(form, phase, threshold):
    low, high = threshold if isinstance(threshold, list | tuple) else (threshold, np.inf)
    selected = (low <= GREY) & (high >= GREY)
    model = segment(replace(IMAGE, values=GREY.astype(form)), threshold=threshold, phase=phase)
    assert np.array_equal(model.solid, selected == (phase == "solid"))
    assert f"{selected.mean():.4%} of 9 × 8 × 7 voxels are selected as {phase}" in model.notes[0]


def test_the_note_says_what_another_threshold_would_select():
    step = 0.01 * (int(GREY.max()) - int(GREY.min()))
    fewer, more = (np.mean(limit <= GREY) for limit in (100 + step, 100 - step))
    assert f"; {fewer:.2%} to {more:.2%} would be" in segment(IMAGE, threshold=100).notes[0]


@pytest.mark.parametrize("values", [(0, 1), (False, True), (3, 200), (-0.5, 0.25), (0, 2**40)])
def test_two_values_need_no_threshold(values):
    mask = GREY > 128
    model = segment(Image(np.where(mask, values[1], values[0]), (1, 1, 1)))
    assert np.array_equal(model.solid, mask)
    assert "two grey values" in model.notes[0]


def test_a_region_is_cut_out_where_it_lies():
    model = segment(IMAGE, threshold=100, region=((2, 1, 0), (9, 5, 6)))
    assert np.array_equal(model.solid, GREY[2:9, 1:5, 0:6] >= 100)
    assert model.lower == (4, 0, 4)
    assert model.notes[0] == "region: voxels [2, 1, 0] to [9, 5, 6] of 9 × 8 × 7"
    whole = segment(IMAGE, threshold=100)
    frame = model.lattice()
    assert np.array_equal(whole.fill(frame, FILL), model.fill(frame, FILL))


@pytest.mark.parametrize("phase", ["solid", "pore"])
def test_voxels_without_a_number_are_void_and_counted(phase):
    values = GREY.astype(np.float32)
    values[0, 1, 2], values[3, 4, 5], values[8, 7, 6] = np.nan, np.inf, -np.inf
    model = segment(replace(IMAGE, values=values), threshold="otsu", phase=phase)
    there = np.isfinite(values)
    assert not model.solid[~there].any()
    threshold, _ = otsu(levels_of(values))
    assert np.array_equal(model.solid[there], (values >= threshold)[there] == (phase == "solid"))
    assert model.notes[-1] == "3 voxels hold no number; they are counted as void"


@pytest.mark.parametrize(
    ("change", "how", "said"),
    [
        ({"values": np.full((3, 4, 5), 7)}, {}, "all of its voxels hold 7; wanted two phases"),
        ({"values": np.full((3, 4, 5), 7)}, {"threshold": "otsu"}, "all grey values are 7"),
        ({"values": np.full((3, 4, 5), 7.5)}, {"threshold": 3}, "got 3, which selects all of 60"),
        ({"values": np.full((1, 1, 1), 7)}, {}, "got 1 × 1 × 1 voxels, which is flat"),
        ({"values": GREY[:, :, :1]}, {"threshold": 3}, "got 9 × 8 × 1 voxels, which is flat"),
        ({}, {"threshold": 300}, "got 300, which selects none of 504 .* run from . to 25.: wanted"),
        ({}, {"threshold": 0}, "got 0, which selects all"),
        ({}, {"threshold": [300, 400]}, r"got \[300, 400\], which selects none"),
        ({}, {"threshold": [40, 30]}, "wanted the smaller number first"),
        ({}, {}, 'got none for an image of 2.. grey values, from . to 25.; wanted .* "otsu"'),
        ({"values": GREY + 0.5}, {}, "got none for an image of"),
        (
            {"values": np.where(GREY > 99, np.nextafter(1, 2), GREY > 9)},
            {},
            "got none for an image of more than two grey values",
        ),
        (
            {"values": np.where(GREY > 9, np.nan, 1.0)},
            {},
            "voxels hold no number: that is no image",
        ),
        ({"values": np.full((2, 2, 2), np.nan)}, {"threshold": 1}, "none of 8 is a finite number"),
        ({}, {"threshold": 9, "region": ((0, 0, 0), (9, 8, 8))}, r"region: .* \[9, 8, 7\]"),
        ({}, {"threshold": 9, "region": ((-1, 0, 0), (9, 8, 7))}, "region: got voxels"),
        ({}, {"threshold": 9, "region": ((3, 0, 0), (3, 8, 7))}, "wanted lower below upper"),
        ({}, {"threshold": 9, "region": ((3, 0, 0), (4, 8, 7))}, "1 × 8 × 7 voxels, which is flat"),
    ],
)
def test_what_cannot_be_segmented(change, how, said):
    with pytest.raises(ModelError, match=said):
        segment(replace(IMAGE, **change), **how)


# --- a model -----------------------------------------------------------------------------------


def test_it_is_a_model_and_a_value():
    model = segment(IMAGE, threshold=100)
    assert isinstance(model, Model)
    assert isinstance(model, HasFill)
    assert isinstance(model, HasLattice)
    assert isinstance(model, HasNotes)
    assert model == pickle.loads(pickle.dumps(model))
    assert model != segment(IMAGE, threshold=101)
    assert model.domain.lower == (3, -1, 4)
    assert model.domain.lengths == (4.5, 8, 14)
    with pytest.raises(ValueError, match="read-only"):
        model.solid[0, 0, 0] = True


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"solid": GREY}, "solid: got uint8 of shape"),
        ({"solid": np.zeros((3, 4), bool)}, "solid: got bool of shape"),
        ({"solid": np.zeros((3, 4, 5), bool)}, "all of its 60 voxels are void"),
        ({"solid": np.ones((3, 4, 5), bool)}, "all of its 60 voxels are solid"),
        ({"spacing": (1, 0, 1)}, "spacing: got"),
        ({"lower": (1, 2)}, "lower: got"),
    ],
)
def test_bodies_that_cannot_be(change, said):
    with pytest.raises(ModelError, match=said):
        Segmented(**{"solid": GREY > 99, "spacing": (1, 2, 3), **change})


def test_its_own_lattice_is_the_usual_one():
    model = segment(IMAGE, threshold=100)
    grid = voxelize(model, sampling="centre", periodic=(True, False, False))
    assert np.array_equal(grid.solid, GREY >= 100)
    assert grid.frame == Frame((3, -1, 4), (0.5, 1, 2), (9, 8, 7), (True, False, False), "um")
    assert grid.bulk is None
    with pytest.raises(GridError, match="own voxels are as they are"):
        voxelize(model, cubic=True)


@pytest.mark.parametrize("pattern", [FILL, CENTRE], ids=["fill", "centre"])
def test_every_sample_is_in_the_voxel_that_holds_it(pattern):
    model = segment(IMAGE, threshold=100)
    frame = Frame((2.3, -2, 3.7), (0.9, 1.3, 1.7), (7, 8, 9), unit="um", start=(-1, 0, 1))
    masks = model.sample(frame, pattern)
    bit = 0
    for row, depths in zip(pattern.rows, pattern.depths, strict=True):
        for depth in depths:
            steps = np.moveaxis(np.indices(frame.shape), 0, -1) + frame.start + (*row, depth)
            place = frame.origin + steps * np.array(frame.spacing)
            index = np.floor((place - model.lower) / model.spacing).astype(int)
            there = ((index >= 0) & (index < model.solid.shape)).all(axis=-1)
            clipped = np.clip(index, 0, np.array(model.solid.shape) - 1)
            expected = model.solid[tuple(np.moveaxis(clipped, -1, 0))] & there
            assert np.array_equal(masks >> np.uint64(bit) & np.uint64(1), expected)
            bit += 1


def test_the_short_cut_gives_what_sampling_gives():
    model = segment(IMAGE, threshold=100)
    for frame in (model.lattice(), model.lattice().tile((2, 3, 1), (9, 7, 6))):
        full = np.bitwise_count(model.sample(frame, FILL)).astype(int) * 255 // 64
        assert np.array_equal(model.fill(frame, FILL), full)
    fitted = Frame.fit(model.domain, spacing=model.spacing, unit="um")
    assert np.array_equal(model.fill(fitted, FILL), model.solid * np.uint8(255))
    assert model.fill(Frame.fit(model.domain, voxels=30, unit="um"), FILL) is None
    assert model.fill(replace(model.lattice(), shape=(9, 8, 8)), FILL) is None


def test_whole_parts_of_voxels_keep_the_volume_exactly():
    model = segment(IMAGE, threshold=100)
    for parts in (2, 3):
        grid = voxelize(model, spacing=tuple(h / parts for h in model.spacing))
        expected = model.solid
        for axis in range(3):
            expected = expected.repeat(parts, axis=axis)
        assert np.array_equal(grid.fill, expected * np.uint8(255))
    halved = voxelize(model, spacing=(1.5, 4.0, 14.0))
    means = model.solid.reshape(3, 3, 2, 4, 1, 7).mean(axis=(1, 3, 5))
    assert np.abs(halved.fill / 255 - means).max() < 0.15


def test_tiles_are_parts_of_the_whole():
    model = segment(IMAGE, threshold=100)
    source = SampledModel(model, Frame.fit(model.domain, voxels=20, unit="um"))
    whole = source.fill((0, 0, 0), source.frame.shape)
    assert np.array_equal(source.fill((2, 3, 4), (6, 9, 11)), whole[2:6, 3:9, 4:11])


# --- recipes -----------------------------------------------------------------------------------


def written(folder, name="scan.nrrd", values=None):
    frame = Frame((3, -1, 4), (0.5, 1.0, 2.0), GREY.shape, unit="um")
    formats.write(VoxelGrid(frame, GREY if values is None else values), folder / name)
    return folder / name


def recipe(folder, name="scan.nrrd", voxels=None, **model):
    table = {"model": {"kind": "image", "path": name, "threshold": 100, **model}}
    return parse({**table, **({"voxels": voxels} if voxels else {})}, folder=folder)


@pytest.mark.parametrize("suffix", [".nrrd", ".mha", ".tif", ".vti", ".npz"])
def test_a_file_of_every_format_is_the_same_body(tmp_path, suffix):
    written(tmp_path, f"scan{suffix}")
    model = build(recipe(tmp_path, f"scan{suffix}", unit="um"))
    assert np.array_equal(model.solid, GREY >= 100)
    assert model.unit == "um"
    assert model.spacing == pytest.approx((0.5, 1, 2))
    assert model.lower == pytest.approx((3, -1, 4))


def test_the_recipe_may_say_another_size_or_another_unit(tmp_path):
    written(tmp_path)
    metres = build(recipe(tmp_path, unit="mm"))
    assert metres.spacing == pytest.approx((0.0005, 0.001, 0.002))
    assert metres.lower == pytest.approx((0.003, -0.001, 0.004))
    other = build(recipe(tmp_path, spacing=[3, 2, 1], unit="cm"))
    assert (other.spacing, other.lower, other.unit) == ((3, 2, 1), (0, 0, 0), "cm")
    assert other.notes[0] == "voxels of 3 × 2 × 1 cm, as the recipe says"
    assert build(recipe(tmp_path, spacing=0.25)).spacing == (0.25, 0.25, 0.25)


def test_what_a_reader_says_is_in_the_notes(tmp_path, recwarn):
    np.savez(tmp_path / "scan.npz", GREY)
    bare = build(recipe(tmp_path, "scan.npz"))
    assert bare.notes[0].startswith("scan.npz: it says no voxel size; taken as 1 mm")
    sized = build(recipe(tmp_path, "scan.npz", spacing=2.0))
    assert not any("no voxel size" in note for note in sized.notes)
    assert not recwarn.list


@pytest.mark.parametrize("name", ["scan.nrrd", "scan.mha"])
def test_headers_without_a_voxel_size_are_taken_as_1_and_the_recipe_says_otherwise(
    tmp_path, name, recwarn
):
    nrrd = "NRRD0004\ntype: uint8\ndimension: 3\nsizes: {}\nencoding: raw\n\n"
    mha = "ObjectType = Image\nNDims = 3\nDimSize = {}\nElementType = MET_UCHAR\n"
    head = nrrd if name.endswith("nrrd") else f"{mha}ElementDataFile = LOCAL\n"
    values = np.arange(24, dtype=np.uint8).reshape(2, 3, 4)
    data = head.format("2 3 4").encode() + values.transpose(2, 1, 0).tobytes()
    (tmp_path / name).write_bytes(data)
    told = {"format": 1, "model": {"kind": "image", "path": name, "threshold": 9.0}}
    bare = build(parse(told, folder=tmp_path))
    assert (bare.spacing, bare.lower, bare.unit) == ((1, 1, 1), (0, 0, 0), "mm")
    assert bare.notes[0] == f"{name}: it says no voxel size; taken as 1 mm along x, y and z"
    told["model"]["spacing"] = 2.0
    sized = build(parse(told, folder=tmp_path))
    assert sized.spacing == (2, 2, 2)
    assert not any("no voxel size" in note for note in sized.notes)
    assert not recwarn.list


def test_voxels_are_the_images_own_unless_asked(tmp_path):
    written(tmp_path)
    own = recipe(tmp_path)
    assert own.voxels.sampling == "centre"
    assert own.voxels.per_feature is None
    result = run(own, only="voxels")
    assert np.array_equal(result.grid.solid, GREY >= 100)
    finer = run(recipe(tmp_path, voxels={"voxels": 28}), only="voxels")
    assert finer.recipe.voxels.sampling == "fill"
    assert max(finer.grid.frame.shape) == 28


def test_measures_and_notes_come_with_it(tmp_path):
    written(tmp_path)
    result = run(recipe(tmp_path), only="voxels")
    assert result.measures["porosity"].value == pytest.approx((GREY < 100).mean())
    assert result.measures["porosity"].uncertainty > 0
    assert "threshold at 100" in result.notes[0]


def test_the_file_is_one_of_the_recipe(tmp_path):
    path = written(tmp_path)
    assert files(recipe(tmp_path)) == {"model.path": path.resolve()}


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"path": "none.tif"}, "model.path: not found: .*none.tif.*; wanted a file"),
        ({"phase": "bright"}, 'model.phase: got "bright"; wanted "solid" or "pore"'),
        ({"threshold": "best"}, 'model.threshold: got "best"; wanted a grey value'),
        ({"threshold": [1, 2, 3]}, "model.threshold: got"),
        ({"spacing": [1, 2]}, "model.spacing: got"),
        ({"spacing": 0}, "model.spacing: got 0; wanted the edge lengths"),
        ({"unit": "ell"}, 'model.unit: got "ell"; wanted nm, um'),
        ({"region": {"lower": [0, 0, 0]}}, "model.region.upper: got nothing"),
        ({"region": {"lower": [0, 0, 3], "upper": [2, 2, 3]}}, "model.region: got upper"),
        ({"region": {"lower": [0, 0, -3], "upper": [2, 2, 3]}}, "model.region.lower"),
        ({"level": 2}, "model.level: unknown key"),
    ],
)
def test_recipes_that_cannot_be_understood(tmp_path, change, said):
    written(tmp_path)
    with pytest.raises(RecipeError, match=said):
        recipe(tmp_path, **change)


def test_grey_values_of_the_judges_lie_where_they_say():
    model = segment(Image(ramp(), SPACING, CORNER), threshold=60)
    assert model.solid.shape == SHAPE
    assert model.solid[4, 5, 6] == (ramp()[4, 5, 6] >= 60)
    assert model.domain.lower == CORNER


def test_a_preset_keeps_its_own_defaults():
    assert load("menger").voxels.per_feature == 4


def test_an_image_is_a_recipe_by_itself(tmp_path):
    path = written(tmp_path)
    taken = load(path, set={"model.threshold": 100, "voxels.periodic": [True, False, False]})
    assert taken.title == "scan.nrrd"
    assert np.array_equal(build(taken).solid, GREY >= 100)
    assert load(str(path)).model.threshold is None
