"""Lattices of beams are the bodies that are drawn with them."""

import pickle
from functools import cache

import numpy as np
import pytest

import porous as po
from porous.errors import MeshError, ModelError
from porous.models.automaton import of_maps
from porous.models.cifs import cifs
from porous.models.simplices import Simplices
from porous.models.struts import lattice as lattice_of
from porous.values import CENTRE, BeamLattice, Box

POINTS = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]], dtype=float)
FAR = Box((-99, -99, -99), (99, 99, 99))


@cache
def model_of(name):
    return po.build(po.load(name))


def inside(lattice, points):
    """Tell which points lie in a lattice whose beams have one radius and round ends."""
    assert lattice.cap == "sphere"
    found = np.zeros(len(points), bool)
    for (a, b), (r, s) in zip(lattice.points[lattice.beams], lattice.radii, strict=True):
        assert r == s
        along = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
        found |= np.linalg.norm(points - a - along[:, None] * (b - a), axis=1) <= r
    for centre, r in zip(lattice.points[lattice.balls], lattice.ball_radii, strict=True):
        found |= np.linalg.norm(points - centre, axis=1) <= r
    return found


def centres_of(frame):
    axes = np.meshgrid(*(frame.centres(axis) for axis in range(3)), indexing="ij")
    return np.stack(axes, axis=-1).reshape(-1, 3)


def without_plates(name):
    """Return the tree of a preset without the plate on its top."""
    section = po.load(name).model
    return po.tree(
        section.branches, section.heights, radius=section.radius, level=section.level,
        size=section.size, law=section.law,
    )  # fmt: skip


BODIES = {
    "beam-twisted": lambda: model_of("beam-twisted"),
    "doo-sabin-shell": lambda: model_of("doo-sabin-shell"),
    "support-tree": lambda: without_plates("support-tree"),
}


@pytest.mark.parametrize("name", BODIES)
def test_the_union_of_the_beams_is_the_body(name):
    model = BODIES[name]()
    lattice = po.beams(model)
    frame = po.Frame.fit(model.domain, voxels=28, unit=model.unit)
    voxels = model.sample(frame, CENTRE) > 0
    assert 0.005 < voxels.mean() < 0.5
    assert np.array_equal(inside(lattice, centres_of(frame)), voxels.ravel())
    assert lattice.unit == model.unit


@pytest.mark.parametrize("name", BODIES)
def test_nodes_are_shared_and_beams_stand_once(name):
    lattice = po.beams(BODIES[name]())
    gaps = np.linalg.norm(lattice.points[:, None] - lattice.points[None], axis=2)
    np.fill_diagonal(gaps, np.inf)
    assert gaps.min() > 1e-6
    assert len(np.unique(np.sort(lattice.beams, axis=1), axis=0)) == len(lattice.beams)
    assert np.array_equal(np.unique(lattice.beams), np.arange(len(lattice.points)))


def test_a_tree_has_the_struts_that_it_should():
    """One trunk, 3 × 3 branches, 2 × 2 on each, then 144 struts more: counted by hand."""
    lattice = po.beams(without_plates("support-tree"))
    assert len(lattice.beams) == 1 + 9 + 36 + 144
    assert len(lattice.points) == len(lattice.beams) + 1  # a tree
    radii, counts = np.unique(lattice.radii[:, 0].round(9), return_counts=True)
    assert counts.tolist() == [144, 36, 9, 1]
    assert radii == pytest.approx([0.25, 0.5, 1.0, 3.0])


def test_a_body_that_is_cut_has_its_lattice_clipped():
    model = without_plates("support-tree")
    lattice = po.beams(model)
    assert lattice.clip == model.domain
    assert lattice.box.lower[2] == model.domain.lower[2]
    assert po.beams(model_of("beam-twisted")).clip is None


def test_plates_are_left_out_on_request_only():
    model = model_of("support-tree")
    with pytest.raises(ModelError, match=r"has 576 plates beside its 190 beams; .* alone = True"):
        po.beams(model)
    assert len(po.beams(model, alone=True).beams) == 190


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("menger", "a IFS has none; models of kind cifs, tree and bcifs"),
        ("koch-wall", "drawn without any; wanted draw = { beams"),
    ],
)
def test_bodies_without_beams(name, said):
    with pytest.raises(ModelError, match=said):
        po.beams(model_of(name))


def test_ends_that_differ_by_rounding_are_one_node():
    ends = np.array([[[0, 0, 0], [1, 2, 3]], [[1, 2, 3 + 1e-14], [5, 5, 5]]], dtype=float)
    found, others = lattice_of([Simplices(capsules=ends, capsule_radii=np.ones(2))], FAR, "mm")
    assert len(found.points) == 3
    assert others == ""
    apart = ends + np.array([[[0, 0, 0], [0, 0, 0]], [[0, 0, 1e-6], [0, 0, 0]]])
    found, _ = lattice_of([Simplices(capsules=apart, capsule_radii=np.ones(2))], FAR, "mm")
    assert len(found.points) == 4


def test_beams_without_length_are_balls_and_of_two_beams_the_thicker_stays():
    ends = np.array([[[0, 0, 0], [1, 2, 3]], [[1, 2, 3], [0, 0, 0]], [[5, 5, 5]] * 2], dtype=float)
    balls = np.array([[1, 2, 3, 0.5], [1, 2, 3, 0.75], [7, 7, 7, 0.25]])
    body = Simplices(balls=balls, capsules=ends, capsule_radii=np.array([0.1, 0.2, 0.3]))
    found, _ = lattice_of([body], FAR, "cm")
    assert found.radii.tolist() == [[0.2, 0.2]]
    places = found.points[found.balls]
    assert {(*place, r) for place, r in zip(places.tolist(), found.ball_radii, strict=True)} == {
        (1, 2, 3, 0.75),
        (5, 5, 5, 0.3),
        (7, 7, 7, 0.25),
    }


def test_an_attractor_has_no_beams():
    maps = [(np.eye(3) / 2, p / 2) for p in POINTS]
    limit = cifs(of_maps(maps), ["cube"], level="limit")
    with pytest.raises(ModelError, match='"limit" has no cells'):
        po.beams(limit, alone=True)


# --- the value ---------------------------------------------------------------------------------


def lattice(**changes):
    parts = {"points": POINTS, "beams": [[0, 1], [3, 2]], "radii": [[0.1, 0.2], [0.3, 0.1]]}
    parts |= {"balls": [1], "ball_radii": [0.5], "unit": "um", **changes}
    return BeamLattice(**parts)


def test_lattices_compare_pickle_and_know_their_box():
    one = lattice()
    assert one == pickle.loads(pickle.dumps(one))
    assert one != lattice(cap="butt")
    assert one.lengths == pytest.approx([1, np.sqrt(13)])
    assert one.box.upper == pytest.approx((1.5, 2.1, 3.3))
    assert lattice(clip=Box((0, 0, 0), (1, 1, 1))).box.upper == (1, 1, 1)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"points": POINTS * np.nan}, "beam lattice points: point 0 is"),
        ({"beams": [[0, 9], [1, 2]]}, "beams: indices run from 0 to 9; there are 4 points"),
        ({"beams": [[0, 1], [2, 2]]}, "beams: beam 1 joins node 2 to itself"),
        ({"beams": [[0.5, 1], [2, 3]]}, "beams: got float64; wanted whole numbers"),
        ({"radii": [[1, 1]]}, r"radii: got shape \(1, 2\); wanted \(2, 2\)"),
        ({"radii": [[1, 1], [0, 1]]}, "radii: got 0.0; wanted lengths above zero"),
        ({"radii": [[1, 1], [1, np.inf]]}, "radii: got inf; wanted lengths above zero"),
        ({"balls": [4]}, "balls: indices run from 4 to 4"),
        ({"ball_radii": [np.nan]}, "ball_radii: got nan; wanted lengths above zero"),
        ({"cap": "round"}, "cap: got 'round'; wanted one of sphere, hemisphere, butt"),
    ],
)
def test_lattices_that_cannot_be(changes, said):
    with pytest.raises(MeshError, match=said):
        lattice(**changes)


def test_nothing_has_no_box():
    none = BeamLattice(POINTS, np.zeros((0, 2), np.int64), np.zeros((0, 2)))
    with pytest.raises(MeshError, match="no beams and no balls; nothing has no box"):
        _ = none.box
