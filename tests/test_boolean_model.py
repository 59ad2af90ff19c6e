"""The Boolean model of balls: what voxels tell of it is what its formulas say, over many seeds.

Balls of radius R lie about points of a Poisson process with η = 4/3 π R³ ρ balls' volume by volume;
of what they leave free are known (S. Torquato, Random Heterogeneous Materials, 2002, chapter 5) the
porosity exp(−η), the surface 3 η/R exp(−η), S₂(r) = exp(−η (1 + 3r/4R − r³/16R³)), and so the mean
chord and the correlation length.
"""

import math

import numpy as np
import pytest
from test_chords import grid_of, overlapping

from porous.measures import (
    Sample,
    Survey,
    chord_lengths,
    chords,
    correlation_length,
    intercepts,
    pore_chord_mean,
    porosity,
    surface_area,
    two_point,
)
from porous.measures._material import _errors, material
from porous.values import Measures

ALL = (True, True, True)
ETA = 0.7
CASES = [
    pytest.param((64, 60, 70), 5.0, 6, id="6 seeds"),
    pytest.param((96, 90, 100), 8.0, 20, id="20 seeds", marks=pytest.mark.slow),
]


def bodies(shape, radius, seeds):
    count = ETA * math.prod(shape) / (4 / 3 * math.pi * radius**3)
    for seed in range(seeds):
        yield overlapping(shape, radius, count, seed)[0]


def correlated(r, radius):
    r = np.minimum(r, 2 * radius)
    return np.exp(-ETA * (1 + 3 * r / (4 * radius) - r**3 / (16 * radius**3)))


def taken(solid, radius):
    """Numbers of one body, and what each is uncertain by besides the seed."""
    grid, cut = grid_of(solid, periodic=ALL), grid_of(solid)
    crossings, missed = intercepts(grid).mean
    crofton, chord = surface_area(grid), pore_chord_mean(grid)
    pairs, box = two_point(grid, longest=24.0), two_point(cut, longest=24.0)
    along = np.mean([row.value for row in chords(chord_lengths(grid))])
    near = np.searchsorted(pairs.distances, np.array([0.5, 1, 1.5, 2.2]) * radius)
    numbers = {
        "porosity": (porosity(grid, method="voxel count").value, 0.0),
        "surface by lattice lines": (2 * crossings, 2 * missed),
        "surface by crofton": (crofton.value / solid.size, crofton.uncertainty / solid.size),
        "mean chord by crofton": (chord.value, chord.uncertainty),
        "correlation length": (correlation_length(pairs).value, 0.0),
    }
    # Along axes chords end at stairs, and creases between voxels are missed: that of a voxel.
    numbers["mean chord along axes"] = (along, 1 / along)
    for name, found in (("periodic", pairs), ("box", box)):
        for k in near:
            numbers[f"S2 {name} {k}"] = (found.values[k], 0.0)
    return numbers, pairs.distances, near


def exactly(radius, distances, near):
    share, surface = math.exp(-ETA), 3 * ETA / radius * math.exp(-ETA)
    r = np.linspace(0, 2 * radius, 1001)
    left = (correlated(r, radius) - share**2) / (share - share**2)
    known = {
        "porosity": share,
        "surface by lattice lines": surface,
        "surface by crofton": surface,
        "mean chord by crofton": 4 * share / surface,
        "mean chord along axes": 4 * share / surface,
        "correlation length": np.trapezoid(left, r),
    }
    for name in ("periodic", "box"):
        known |= {f"S2 {name} {k}": correlated(distances[k], radius) for k in near}
    return known


@pytest.mark.parametrize(("shape", "radius", "seeds"), CASES)
def test_numbers_are_those_of_the_formulas(shape, radius, seeds):
    all_numbers = []
    for solid in bodies(shape, radius, seeds):
        numbers, distances, near = taken(solid, radius)
        all_numbers.append(numbers)
    for name, known in exactly(radius, distances, near).items():
        values, doubts = np.array([numbers[name] for numbers in all_numbers]).T
        error = values.std(ddof=1) / math.sqrt(seeds)
        assert abs(values.mean() - known) <= 3 * error + doubts.mean(), name
        assert error < 0.1 * known, name
    lines = [numbers["surface by lattice lines"] for numbers in all_numbers]
    assert np.mean(lines, axis=0)[1] < 0.02 * known_surface(radius)


def known_surface(radius):
    return 3 * ETA / radius * math.exp(-ETA)


@pytest.mark.slow
def test_a_sample_says_how_far_another_one_may_differ():
    """Standard errors by blocks are those that samples have among each other."""
    shape, radius = (50, 48, 52), 2.5
    rows = []
    for solid in bodies(shape, radius, 8):
        sample = Sample(grid_of(solid), how=Survey(beyond="unknown"))
        lines = intercepts(sample.grid)
        length = correlation_length(two_point(sample.grid, longest=16.0)).value
        told = material(sample, lines, Measures(), length, 64**3)
        errors = _errors(sample, lines, sample.grid, 3)
        some = zip(told, errors.values(), strict=False)
        rows.append([(r.value, error, r.uncertainty) for r, error in some])
    values, errors, doubts = np.moveaxis(np.array(rows), -1, 0)
    ratio = errors.mean(axis=0) / values.std(axis=0, ddof=1)
    assert ((ratio > 0.4) & (ratio < 2.5)).all()
    # Rows are as doubtful as their blocks and the voxels together.
    assert (doubts > errors).all()
    assert [r.name for r in told][:2] == ["material_porosity", "material_specific_surface"]
    # Blocks are too small: nobody knows.
    assert all(math.isinf(r.uncertainty) for r in material(sample, lines, Measures(), 10.0, 64**3))
