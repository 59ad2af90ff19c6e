"""Islands go and closed pores are filled: which ones, how many, and what the volume becomes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from porous.errors import GridError, RecipeError
from porous.measures import closed_porosity, components, open_porosity, volume
from porous.pipeline import run, run_stored
from porous.recipe import dump, load
from porous.stages import clean
from porous.values import Frame, VoxelGrid

FULL = ndimage.generate_binary_structure(3, 3)
FACES = ndimage.generate_binary_structure(3, 1)
SPACING = (0.5, 1.0, 2.0)


def grid_of(solid, periodic=(False, False, False), bulk=None):
    frame = Frame((1, 2, 3), SPACING, solid.shape, periodic, "um")
    body = None if bulk is None else np.where(bulk, np.uint8(255), np.uint8(0))
    fill = np.where(solid, np.uint8(255), np.uint8(0))
    return VoxelGrid(frame, fill, body, "centre", hausdorff=0.1)


def noise(seed, share, shape=(9, 8, 7)):
    return np.random.default_rng(seed).random(shape) < share


def joined(mask, structure, periodic):
    """Return labels with the pieces on opposite sides of periodic axes joined, slowly."""
    labels, count = ndimage.label(mask, structure)
    parent = list(range(count + 1))

    def root(a):
        while parent[a] != a:
            a = parent[a]
        return a

    steps = np.argwhere(structure) - 1
    for place in np.argwhere(mask):
        for step in steps:
            other = place + step
            beyond = (other < 0) | (other >= mask.shape)
            if beyond.any() and not (beyond & ~np.array(periodic)).any():
                other %= mask.shape
                if mask[tuple(other)]:
                    parent[root(labels[tuple(other)])] = root(labels[tuple(place)])
    return np.array([root(a) for a in range(count + 1)])[labels]


def naive_open(void, periodic):
    """Tell which void is joined with the outside or winds around, by copies of the grid."""
    copies = [3 if p else 1 for p in periodic]
    labels, count = ndimage.label(np.tile(void, copies), FULL)
    is_open = np.zeros(count + 1, bool)
    for axis in range(3):
        if not periodic[axis]:
            for side in (0, -1):
                is_open[np.unique(labels.take(side, axis=axis))] = True
    n = void.shape
    for axis in (a for a in range(3) if periodic[a]):
        # What winds around has the same label one period on; three periods are enough of a walk.
        for a, b in ((0, 1), (1, 2), (0, 2)):
            first = labels.take(range(a * n[axis], (a + 1) * n[axis]), axis=axis)
            second = labels.take(range(b * n[axis], (b + 1) * n[axis]), axis=axis)
            is_open[first[(first == second) & (first > 0)]] = True
    is_open[0] = False
    found = is_open[labels]
    for axis in range(3):
        parts = np.split(found, copies[axis], axis=axis)
        found = np.logical_or.reduce(parts)
    whole = joined(void, FULL, periodic)
    return np.isin(whole, np.unique(whole[found & void])) & void


PERIODS = [(False, False, False), (True, False, False), (False, True, True), (True, True, True)]


@pytest.mark.parametrize("periodic", PERIODS, ids=lambda p: "".join("np"[b] for b in p))
@given(seed=st.integers(0, 9999), share=st.floats(0.1, 0.5), least=st.integers(1, 30))
@settings(max_examples=15, deadline=None)
def test_islands_below_a_size_go(periodic, seed, share, least):
    solid = noise(seed, share)
    labels = joined(solid, FACES, periodic)
    names, sizes = np.unique(labels[solid], return_counts=True)
    if (sizes < least).all():
        with pytest.raises(GridError, match="none would be left"):
            clean(grid_of(solid, periodic), islands=least)
        return
    made = clean(grid_of(solid, periodic), islands=least)
    kept = np.isin(labels, names[sizes >= least]) & solid
    assert np.array_equal(made.grid.solid, kept)
    (step,) = made.steps
    gone = int((sizes < least).sum())
    assert (step.pieces, step.of, step.voxels) == (gone, len(sizes), solid.sum() - kept.sum())
    assert step.volume == pytest.approx(-step.voxels * np.prod(SPACING))
    assert step.share == pytest.approx(-step.voxels / solid.sum())


@pytest.mark.parametrize("periodic", PERIODS, ids=lambda p: "".join("np"[b] for b in p))
def test_all_but_the_largest_go(periodic):
    solid = noise(3, 0.35)
    labels = joined(solid, FACES, periodic)
    names, sizes = np.unique(labels[solid], return_counts=True)
    made = clean(grid_of(solid, periodic), islands="all but the largest")
    assert sizes.max() > np.sort(sizes)[-2]
    assert np.array_equal(made.grid.solid, (labels == names[sizes.argmax()]) & solid)
    assert components(made.grid).value == 1


@pytest.mark.parametrize("periodic", PERIODS, ids=lambda p: "".join("np"[b] for b in p))
@given(seed=st.integers(0, 9999), share=st.floats(0.6, 0.95))
@settings(max_examples=15, deadline=None)
def test_closed_pores_are_filled_and_open_ones_stay(periodic, seed, share):
    solid = noise(seed, share, (6, 5, 7))
    made = clean(grid_of(solid, periodic), closed_pores="fill")
    assert np.array_equal(~made.grid.solid, naive_open(~solid, periodic))


@pytest.mark.parametrize("periodic", PERIODS, ids=lambda p: "".join("np"[b] for b in p))
def test_measures_agree_on_what_is_closed(periodic):
    given_ = grid_of(noise(11, 0.95, (12, 11, 10)), periodic)
    made = clean(given_, closed_pores="fill")
    assert closed_porosity(given_).value > 0
    assert closed_porosity(made.grid).value == 0
    assert open_porosity(made.grid).value == pytest.approx(open_porosity(given_).value)
    change = volume(made.grid).value - volume(given_).value
    assert made.steps[0].volume == pytest.approx(change)


def test_a_pore_that_winds_around_a_period_is_open():
    solid = np.ones((5, 6, 7), bool)
    solid[2, :, 3] = False  # along y
    solid[0, 0, 0] = solid[4, 5, 6] = False  # one pore across the corners, where all is periodic
    made = clean(grid_of(solid, (True, True, True)), closed_pores="fill")
    assert (made.steps[0].pieces, made.steps[0].of, made.steps[0].voxels) == (1, 2, 2)
    assert not made.grid.solid[2, :, 3].any()
    assert made.grid.solid[0, 0, 0]


def test_small_closed_pores_alone_are_filled():
    solid = np.ones((9, 8, 7), bool)
    solid[2, 2, 2] = False
    solid[5:7, 4:6, 3:5] = False
    solid[0, 4, 4] = False
    made = clean(grid_of(solid), closed_pores=8)
    assert np.array_equal(np.argwhere(made.grid.solid != solid), [[2, 2, 2]])
    assert str(made.steps[0]) == (
        "clean.closed_pores: 1 of 3 pores, closed and of fewer than 8 voxels, were filled: "
        "1 voxels, solid volume +1 um³, +0.202%"
    )


def test_pores_that_reach_the_end_of_the_bulk_are_open():
    solid = np.zeros((9, 8, 7), bool)
    solid[1:8, 1:7, 1:6] = True
    bulk = solid.copy()
    solid[3, 3, 3] = solid[7, 3, 3] = False  # one within, one at the bulk's side
    made = clean(grid_of(solid, bulk=bulk), closed_pores="fill")
    assert np.array_equal(np.argwhere(made.grid.solid != solid), [[3, 3, 3]])


def test_first_islands_go_and_then_the_pores_they_lay_in_are_filled():
    solid = np.ones((9, 8, 7), bool)
    solid[2:7, 2:6, 2:5] = False
    solid[4, 4, 3] = True  # a speck in a closed pore
    made = clean(grid_of(solid), islands=5, closed_pores="fill")
    assert made.grid.solid.all()
    assert [step.voxels for step in made.steps] == [1, 60]
    assert made.grid.hausdorff is None


def test_nothing_to_clean_changes_nothing():
    given_ = grid_of(np.pad(np.ones((4, 4, 4), bool), 1))
    made = clean(given_, islands="all but the largest", closed_pores="fill")
    assert made.grid == given_
    assert not made.is_changed
    assert [step.voxels for step in made.steps] == [0, 0]
    assert clean(given_).steps == ()


def test_voxels_of_a_part_go_with_what_they_bordered_on():
    fill = np.zeros((12, 8, 7), np.uint8)
    fill[1:4, 2:5, 2:5], fill[8, 3, 3] = 255, 200
    fill[9, 3, 3] = fill[4, 3, 3] = 90  # rims of the speck and of the body
    frame = Frame((0, 0, 0), SPACING, fill.shape)
    made = clean(VoxelGrid(frame, fill), islands=5)
    expected = fill.copy()
    expected[8:10, 3, 3] = 0
    assert np.array_equal(made.grid.fill, expected)
    assert made.steps[0].volume == pytest.approx(-(200 + 90) / 255)
    inverse = clean(VoxelGrid(frame, 255 - fill), closed_pores=5)
    assert np.array_equal(inverse.grid.fill, 255 - expected)


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ({"islands": "largest"}, 'islands: got .largest.; wanted .* or "all but the largest"'),
        ({"islands": 0}, "islands: got 0; wanted a number of voxels, at least 1"),
        ({"closed_pores": True}, "closed_pores: got True; wanted a number of voxels"),
        ({"closed_pores": 2.5}, 'closed_pores: got 2.5; .* or "fill"'),
        ({"islands": 99}, "got 99, and the largest of 1 pieces of solid has 64 voxels: none would"),
    ],
)
def test_what_cannot_be_cleaned(how, said):
    with pytest.raises(GridError, match=said):
        clean(grid_of(np.pad(np.ones((4, 4, 4), bool), 1)), **how)


def test_it_can_be_followed_and_cancelled():
    told = []
    clean(grid_of(noise(1, 0.5)), islands=2, progress=lambda *done: told.append(done))
    assert told == [("clean", 0.5), ("clean", 1.0)]


# --- recipes -----------------------------------------------------------------------------------

DUST = {"model.level": 2, "voxels.voxels": 27, "clean.islands": "all but the largest"}


def test_a_recipe_is_cleaned_and_says_so():
    result = run(load("cantor-dust", set=DUST), only="measures")
    assert result.measures["components"].value == 1
    assert {row.of for row in result.measures} == {"grid", "surface"}
    assert any("63 of 64 pieces of solid" in note for note in result.notes)
    assert "all measures are of the cleaned voxels" in result.notes[-1]
    assert result.certificate.good
    assert "clean" in result.times


def test_a_recipe_that_had_nothing_to_clean_keeps_its_closed_forms():
    result = run(load("menger", set={"model.level": 1, "clean.islands": 5}), only="voxels")
    assert "model" in {row.of for row in result.measures}
    assert "0 of 1 pieces of solid" in result.notes[-1]


def test_the_section_is_in_the_recipe_and_its_hash():
    plain = load("menger")
    assert plain.clean is None
    assert "clean" not in dump(plain)
    mended = load("menger", set={"clean.closed_pores": "fill"})
    assert '[clean]\nclosed_pores = "fill"' in dump(mended)
    assert plain.sha256 != mended.sha256


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"clean.islands": "some"}, 'clean.islands: got "some"; wanted "all but the largest"'),
        ({"clean.islands": 0}, "clean.islands: got 0; wanted"),
        ({"clean.closed_pores": "close"}, 'clean.closed_pores: got "close"; wanted "fill", or'),
        ({"clean.pores": 1}, "clean.pores: unknown key"),
        (
            {"clean.islands": 2, "surface.method": "exact"},
            'clean: cleans voxels, and surface.method = "exact" is of the model',
        ),
        ({"clean.islands": 2, "volume.method": "cells"}, 'volume.method = "cells" is of the model'),
    ],
)
def test_recipes_that_cannot_be_cleaned(change, said):
    with pytest.raises(RecipeError, match=said):
        load("menger", set=change)


def test_out_of_core_nothing_is_cleaned(tmp_path):
    recipe = load("menger", set={"clean.islands": 2})
    with pytest.raises(RecipeError, match="clean: got 'a table', which is done in memory"):
        run_stored(recipe, tmp_path, identity="0" * 64, begin=lambda: None)
