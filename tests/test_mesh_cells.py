"""Meshes by construction: nodes as the complex counts them, closed boundaries, named cells."""

import itertools
import pickle
from dataclasses import replace
from functools import cache

import naive_elasticity
import numpy as np
import pytest
import systems
from scipy.spatial import cKDTree

from porous import mesh_cells
from porous.errors import MeshError, ModelError
from porous.formats import inp
from porous.guests import ccx
from porous.jobs import compression, material
from porous.models.automaton import expand, words
from porous.models.brep import (
    Adjacency,
    Boundary,
    BRep,
    CellState,
    Child,
    Incidence,
    selection,
)
from porous.models.builders import Options, Texture, build_cell
from porous.models.builders._joins import Covered, Part, Placed, joins
from porous.models.cell_folds import address
from porous.models.cell_mesh import cell_mesh
from porous.models.cell_nodes import cell_nodes
from porous.models.cell_shapes import cut
from porous.models.cell_surface import cell_boundary
from porous.models.closure import closure
from porous.models.complex import cell_complex
from porous.models.digits import DigitSet
from porous.models.solve import Solution, solve
from porous.stages import hexahedralize, name_parts
from porous.values import Block, Box, Frame, VolumeMesh, VoxelGrid
from porous.values.surface_topology import check_closed, defects, euler_number, pieces
from porous.values.volume_mesh import SHAPES
from porous.values.volume_topology import bodies, boundary_faces, faces, hung_by_faces, matched

UNEQUAL = np.array([[1.0], [1.3], [0.8]])
SETS = {
    "menger": (3, systems.MENGER),
    "full": (2, list(itertools.product(range(2), repeat=3))),
    "vicsek-9": (3, systems.VICSEK_9),
    "edges": (3, systems.EDGES_12),
    "parity": (2, systems.PARITY),
    "minus-corner": (2, systems.MINUS_CORNER),
    "mosely": (3, [d for d in itertools.product(range(3), repeat=3) if d.count(1) in (1, 2)]),
}
SHEARED = np.array([[1, 0, 0.5], [0, 1, 0.3], [0, 0, 0]])
HEX_FRAMES = {corner: [corner ^ 4, corner ^ 2, corner ^ 1] for corner in range(8)}


class System:
    """A cell's states, solved, and its complexes by level."""

    def __init__(self, brep, moves=None):
        self.brep = brep
        self.solution = solve(brep, moves or {})
        self.closure = closure(self.solution)
        self.complex = cache(lambda level: cell_complex(self.closure, level))
        self.controls = brep.states[brep.start].controls

    def automaton(self, controls=None):
        return self.solution.automaton(controls)

    def nodes(self, level, controls=None):
        placed = cell_nodes(self.solution, self.complex(level), self.automaton(controls), level)
        return placed.unfolded

    def bent(self, seed, amount=0.05):
        """Return controls of unequal axes, each displaced at random."""
        random = np.random.default_rng(seed)
        return (self.controls + random.uniform(-amount, amount, self.controls.shape)) * UNEQUAL


@cache
def hexa(name, cell="hex-8", **options):
    divisions, keep = SETS[name]
    return System(
        build_cell(Options(cell, digits=(DigitSet(divisions, np.array(keep)),), **options))
    )


@cache
def simplicial(cell, keep=None, start=None):
    return System(build_cell(Options(cell, keep=dict(keep) if keep else None, start=start)))


def straight_twin(divisions, keep, level):
    """Return the hexahedra of the voxels of a digit set."""
    solid = np.zeros((divisions,) * 3, bool)
    solid[tuple(np.array(keep).T)] = True
    grid = np.ones((1, 1, 1), bool)
    for _ in range(level):
        grid = np.kron(grid, solid)
    frame = Frame((0, 0, 0), (1 / len(grid),) * 3, grid.shape)
    return hexahedralize(VoxelGrid.of_solid(grid, frame))


def same_partition(a, b):
    """Whether two numberings of the same things put the same ones together."""
    pairs = np.unique(np.column_stack([a, b]), axis=0)
    return len(pairs) == len(np.unique(a)) == len(np.unique(b))


def slots(mesh):
    return np.concatenate([block.cells.ravel() for block in mesh.blocks])


def assert_conforming(nodes, level, system):
    """Assert what every mesh of cells has to be."""
    shared, apart = cell_mesh(nodes, contacts="shared"), cell_mesh(nodes)
    assert len(shared.points) == system.complex(level).count(0)
    assert (apart.volumes > 0).all()
    matched(faces(apart))  # raises where three cells share a face
    twin = hung_by_faces(shared)
    assert len(twin.points) == len(apart.points)
    assert same_partition(slots(twin), slots(apart))
    outer = np.vstack([p.members for n, p in apart.parts.items() if n in ("SKIN", "WALL")])
    assert np.array_equal(np.unique(outer, axis=0), np.unique(boundary_faces(apart), axis=0))
    surface = cell_boundary(nodes)
    assert not defects(surface)
    check_closed(surface)
    assert surface.volume == pytest.approx(apart.volumes.sum(), rel=1e-12)
    assert len(np.unique(pieces(surface))) >= len(np.unique(bodies(apart)))
    return shared, apart, surface


# ------------------------------------------------------------------ counts


@pytest.mark.parametrize("cell", ["hex-8", "hex-27"])
@pytest.mark.parametrize(("level", "count", "genus"), [(0, 8, 0), (1, 64, 5), (2, 896, 81)])
def test_a_bent_menger_block(cell, level, count, genus):
    system = hexa("menger", cell)
    nodes = system.nodes(level, system.bent(level))
    shared, apart, surface = assert_conforming(nodes, level, system)
    assert len(shared.points) == len(apart.points) == count
    assert apart.cells == 20**level
    assert euler_number(surface) == 2 - 2 * genus


@pytest.mark.parametrize("cell", ["hex-8", "hex-27"])
def test_a_bent_menger_block_of_level_3(cell):
    system = hexa("menger", cell)
    nodes = system.nodes(3, system.bent(7))
    mesh, surface = cell_mesh(nodes), cell_boundary(nodes)
    assert (mesh.cells, len(mesh.points)) == (8000, 15616)
    assert not defects(surface)
    assert euler_number(surface) == 2 - 2 * 1409
    assert surface.volume == pytest.approx(mesh.volumes.sum(), rel=1e-12)
    assert not cKDTree(mesh.points).query_pairs(1e-6)


@pytest.mark.slow
def test_a_bent_menger_block_of_level_4():
    system = hexa("menger", "hex-27")
    nodes = system.nodes(4, system.bent(8))
    mesh, surface = cell_mesh(nodes), cell_boundary(nodes)
    assert (mesh.cells, len(mesh.points)) == (160_000, 295_808)
    assert not defects(surface)
    assert euler_number(surface) == 2 - 2 * 26433  # 1 − χ of the closed forms: −26432
    assert surface.volume == pytest.approx(mesh.volumes.sum(), rel=1e-12)


CONTACTS = [
    # set, level, nodes, bodies, Euler number of the surface: twice that of the face-joined solid
    ("parity", 5, 8192, 1024, 2048),
    ("vicsek-9", 3, 5832, 729, 1458),
    ("edges", 3, 13824, 1728, 3456),
    ("mosely", 3, 11712, 1, 384),
    ("minus-corner", 4, None, 1, None),
]


@pytest.mark.parametrize(("name", "level", "count", "parts", "euler"), CONTACTS)
def test_contacts_of_zero_area_are_split(name, level, count, parts, euler):
    system = hexa(name)
    nodes = system.nodes(level, system.controls * UNEQUAL)
    _, apart, surface = assert_conforming(nodes, level, system)
    assert len(np.unique(bodies(apart))) == parts
    assert count in (len(apart.points), None)
    assert euler in (euler_number(surface), None)


def test_where_two_cells_meet_in_an_edge_whose_ends_are_joined():
    # The boundary has such edges at level 5 of the cube without a corner: 711 of them.
    system = hexa("minus-corner")
    nodes = system.nodes(5)
    surface = cell_boundary(nodes)
    assert not defects(surface)
    quads = int(nodes.outer.sum())
    classes = hung_by_fans(nodes)
    assert len(surface.points) - quads - classes == 2 * 711
    assert surface.volume == pytest.approx((7 / 8) ** 5, rel=1e-12)


def hung_by_fans(nodes):
    """Return how many points the boundary has, by hand: fans of outer quads around vertices."""
    group = nodes.groups[0]
    quads = np.argwhere(nodes.outer.reshape(-1, 6)).tolist()
    at_edge, above = {}, {}
    for cell, k in quads:
        for a, b in edges_of(group.cut.loops[0, k]):
            ends = frozenset(group.corners[cell, [a, b]].tolist())
            at_edge.setdefault(ends, []).append((cell, k))
            above[cell, k, group.corners[cell, a]] = (cell, k, group.corners[cell, a])

    def find(x):
        while above[x] != x:
            x = above[x]
        return x

    for edge, own in at_edge.items():
        for one, other in neighbours(group, edge, own):
            for vertex in edge:
                above[find((*one, vertex))] = find((*other, vertex))
    return len({find(x) for x in above})


def neighbours(group, edge, quads):
    """Yield the pairs of quads that are joined at an edge: alone, on one cell, across a face."""
    for one, other in itertools.combinations(quads, 2):
        if len(quads) == 2 or one[0] == other[0] or across(group, one, other, edge):
            yield one, other


def edges_of(loop):
    return zip(loop, np.roll(loop, -1), strict=True)


def across(group, one, other, edge):
    """Whether the cells of two quads share a face at an edge."""
    common = set(group.faces[one[0]]) & set(group.faces[other[0]])
    return any(
        edge <= set(group.corners[one[0], group.cut.faces[list(group.faces[one[0]]).index(f)]])
        for f in common
    )


@pytest.mark.parametrize("seed", range(10))
def test_random_digit_sets_are_the_hexahedra_of_their_voxels(seed):
    random = np.random.default_rng(seed)
    divisions = int(random.integers(2, 4))
    every = list(itertools.product(range(divisions), repeat=3))
    chosen = random.permutation(len(every))[: random.integers(3, len(every))]
    keep = [every[i] for i in chosen]
    system = System(build_cell(Options("hex-8", digits=(DigitSet(divisions, np.array(keep)),))))
    for level in (1, 2):
        nodes = system.nodes(level)
        _, apart, _ = assert_conforming(nodes, level, system)
        twin = straight_twin(divisions, keep, level)
        assert len(apart.points) == len(twin.points)
        assert np.allclose(
            np.sort(apart.points.round(9).view("f8,f8,f8").ravel()).view(float),
            np.sort(twin.points.round(9).view("f8,f8,f8").ravel()).view(float),
        )


def test_a_sierpinski_tetrahedron_hangs_together_in_points_only():
    system = simplicial("tetra")
    for level in range(4):
        nodes = system.nodes(level, system.bent(level))
        shared, apart, surface = assert_conforming(nodes, level, system)
        assert len(shared.points) == 2 * 4**level + 2
        assert len(apart.points) == 4 * 4**level
        assert euler_number(surface) == 2 * 4**level
        assert len(apart.parts["F0_FACES"].members) == 3**level


FACE_JOINED = (("tetra", ("tetra", "octa")),)


@pytest.mark.parametrize(
    ("cell", "keep", "start"),
    [("tetra-octa", None, None), ("tetra-octa", None, "octa"), ("tetra", FACE_JOINED, None)],
)
def test_octahedra_are_cut_about_a_diagonal_and_fill_space(cell, keep, start):
    system = simplicial(cell, keep, start)
    for level in range(4):
        controls = system.bent(level, 0.1)
        nodes = system.nodes(level, controls)
        _, apart, _ = assert_conforming(nodes, level, system)
        many = {system.brep.states[g.state].name: len(g.place) for g in nodes.groups}
        assert apart.cells == many.get("tetra", 0) + 4 * many.get("octa", 0)
        assert len(np.unique(bodies(apart))) == 1
        if keep is None:
            whole = cell_mesh(system.nodes(0, controls)).volumes.sum()
            assert apart.volumes.sum() == pytest.approx(whole, rel=1e-12)


def test_an_octahedron_is_cut_about_its_shortest_diagonal():
    system = simplicial("tetra-octa", None, "octa")
    for axis in range(3):
        controls = system.controls * np.where(np.arange(3) == axis, 0.5, 1.0)[:, None]
        mesh = cell_mesh(system.nodes(0, controls))
        ends = [set(map(tuple, mesh.points[cell])) for cell in mesh.blocks[0].cells]
        inner = np.array(sorted(set.intersection(*ends)))
        assert np.flatnonzero(np.ptp(inner, axis=0)).tolist() == [axis]


# ------------------------------------------------------------------ where cells lie


@pytest.mark.parametrize(
    "system",
    [hexa("menger"), hexa("menger", "hex-27"), simplicial("tetra-octa")],
    ids=["hex-8", "hex-27", "tetra-octa"],
)
def test_nodes_are_the_automatons_own_corners_to_the_last_bit(system):
    controls = system.bent(3, 0.02)
    nodes = system.nodes(2, controls)
    reached = system.brep.reached
    cells = {reached[state]: points for state, points in expand(system.automaton(controls), 2)}
    first = set()
    for group in nodes.groups:
        state = system.brep.states[group.state]
        vertices = [state.boundaries[k] for k in system.brep.of_dimension(group.state, 0)]
        weights = np.hstack([b.matrix for b in vertices])
        own = (cells[group.state] @ weights).transpose(0, 2, 1)
        spots = nodes.points[group.corners]
        assert np.abs(spots - own).max() <= 1e-12
        exact = (spots == own).all(axis=2)
        first |= set(group.corners[exact].tolist())
    assert len(first) == len(nodes.points)


def test_addresses_are_the_words_of_the_cells():
    system = hexa("menger")
    mesh = cell_mesh(system.nodes(2, system.controls * UNEQUAL))
    assert (np.diff(mesh.cell_tags["address"]) == 1).all()
    digits = np.array(SETS["menger"][1])[words(system.automaton(), 2)]
    centres = (digits[:, 0] / 3 + digits[:, 1] / 9 + 1 / 18) * UNEQUAL.T
    assert np.allclose(mesh.points[mesh.blocks[0].cells].mean(axis=1), centres)
    for place in (0, 19, 20, 137, 399):
        names = [SETS["menger"][1][i] for i in words(system.automaton(), 2)[place]]
        text = ".".join("".join(map(str, name)) for name in names)
        assert address(system.brep, 2, place) == f"cell {text} (children by name)"


def test_elements_of_several_states_are_in_the_order_of_their_addresses():
    system = simplicial("tetra-octa")
    mesh = cell_mesh(system.nodes(2))
    place, state = mesh.cell_tags["address"], mesh.cell_tags["state"]
    assert (np.diff(place) >= 0).all()
    reached = np.array(system.brep.reached)
    order = {}
    automaton = system.automaton()
    for word_place, word in enumerate(words(automaton, 2)):
        q = 0
        for letter in word:
            q = automaton.children[q][letter].target
        order[word_place] = reached[q]
    assert [order[p] for p in place.tolist()] == state.tolist()
    octa = [q for q in reached if system.brep.states[q].shape == "octa"]
    assert set(np.bincount(place).tolist()) == {1, 4}
    assert ((np.bincount(place)[place] == 4) == np.isin(state, octa)).all()


def test_transient_levels():
    digits = tuple(DigitSet(SETS[n][0], np.array(SETS[n][1])) for n in ("menger", "minus-corner"))
    system = System(build_cell(Options("hex-27", digits=digits)))
    nodes = system.nodes(3, system.bent(2))
    _, apart, _ = assert_conforming(nodes, 3, system)
    assert apart.cells == 20 * 7 * 7


@pytest.mark.parametrize("name", ["menger", "vicsek-9", "edges", "minus-corner"])
def test_parts_are_those_of_the_straight_body_whatever_the_bend(name):
    system = hexa(name)
    straight = cell_mesh(system.nodes(2))
    bare = VolumeMesh(straight.points, straight.blocks, straight.cell_tags)
    assert name_parts(bare, Box((0, 0, 0), (1, 1, 1))).parts == straight.parts
    bent = cell_mesh(system.nodes(2, system.bent(5)), unit="um")
    assert bent.parts == straight.parts
    assert bent.unit == "um"


def test_parts_that_are_empty_are_left_out():
    system = hexa("full")
    assert "WALL" not in cell_mesh(system.nodes(2)).parts
    keep = np.array([[1, 1, 1], [0, 1, 1]])
    system = System(build_cell(Options("hex-8", digits=(DigitSet(3, keep),))))
    assert set(cell_mesh(system.nodes(1)).parts) == {"XMIN", "XMIN_FACES", "SKIN", "WALL", "SOLID"}


def test_the_surface_is_labelled_by_the_level_0_cells_faces():
    system = hexa("menger", "hex-27")
    nodes = system.nodes(2, system.bent(4))
    mesh, surface = cell_mesh(nodes), cell_boundary(nodes, unit="cm")
    assert surface.names == ("WALL", "XMIN", "XMAX", "YMIN", "YMAX", "ZMIN", "ZMAX")
    assert surface.unit == "cm"
    assert surface.labels.dtype == np.int16
    for label, name in enumerate(surface.names):
        members = mesh.parts[name if name == "WALL" else f"{name}_FACES"].members
        local = np.array(SHAPES["hex8"].faces)[members[:, 1]]
        corners = mesh.points[np.take_along_axis(mesh.blocks[0].cells[members[:, 0]], local, 1)]
        own = surface.area_vectors[surface.labels == label]
        assert len(own) == 4 * len(members)
        diagonals = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]) / 2
        summed = own.reshape(-1, 4, 3).sum(axis=1)
        assert np.allclose(summed[summed[:, 0].argsort()], diagonals[diagonals[:, 0].argsort()])


# ------------------------------------------------------------------ any controls


FAMILIES = [
    ("hex-8", lambda: hexa("menger"), 0.12),
    ("hex-27", lambda: hexa("minus-corner", "hex-27"), 0.04),
    (
        "rough",
        lambda: hexa("menger", "hex-27", texture=Texture((0.3, -0.2, 0.25), (0.5, 0.4))),
        0.04,
    ),
    ("tetra", lambda: simplicial("tetra"), 0.15),
    ("tetra-octa", lambda: simplicial("tetra-octa"), 0.15),
]


@pytest.mark.parametrize(
    ("family", "amount"), [f[1:] for f in FAMILIES], ids=[f[0] for f in FAMILIES]
)
def test_random_controls_leave_meshes_conforming(family, amount):
    system = family()
    for seed in range(20):  # of each of five families
        random = np.random.default_rng([seed, 1])
        turn, _ = np.linalg.qr(random.normal(size=(3, 3)))
        controls = turn @ system.bent(seed, amount) * 10 ** random.uniform(-3, 3)
        nodes = system.nodes(1, controls)  # raises where shared corners lie apart
        assert_conforming(nodes, 1, system)


def test_random_sliders_leave_meshes_conforming():
    plain = hexa("full")
    assert len(plain.solution.sliders) == 3  # the middles of edges, of faces and of the cell
    for seed in range(25):
        random = np.random.default_rng(seed)
        moves = {}
        for slider in plain.solution.sliders:
            move = random.uniform(-0.03, 0.03, slider.size)
            moves[slider.name] = move - move.mean()
        system = System(plain.brep, moves)
        assert_conforming(system.nodes(2, plain.bent(seed, 0.02)), 2, system)


def test_cells_pickle_and_compare_by_content():
    nodes = simplicial("tetra-octa").nodes(1)
    again = pickle.loads(pickle.dumps(nodes))
    assert again == nodes
    assert cell_mesh(again) == cell_mesh(nodes)
    assert not nodes.points.flags.writeable


@pytest.mark.parametrize("cell", ["hex-8", "hex-27", "tetra"])
def test_affine_maps_of_controls_are_affine_maps_of_the_mesh(cell):
    system = simplicial("tetra") if cell == "tetra" else hexa("menger", cell)
    controls = system.bent(1, 0.02)
    plain = cell_mesh(system.nodes(2, controls))
    for seed in range(10):
        random = np.random.default_rng(seed)
        A, b = random.normal(size=(3, 3)), random.normal(size=(3, 1))
        mesh = cell_mesh(system.nodes(2, A @ controls + b))
        assert np.allclose(mesh.points, plain.points @ A.T + b.T, rtol=0, atol=1e-12 * 20)
        assert np.allclose(mesh.volumes, plain.volumes * abs(np.linalg.det(A)))
        assert (mesh.volumes > 0).all()
        if np.linalg.det(A) > 0:
            assert mesh.blocks == plain.blocks
            assert mesh.parts == plain.parts


def relabelled(brep, seed):
    """Return a hexahedral system whose children each number their controls in a frame of their own.

    The cells are the same; half of the frames are mirrored.
    """
    random = np.random.default_rng(seed)
    state = brep.states[brep.start]
    lattice = list(itertools.product(range(2), repeat=3))
    children = []
    for child in state.children:
        axes, flips = random.permutation(3), random.integers(0, 2, 3)
        order = [lattice.index(tuple(np.array(p)[axes] ^ flips)) for p in lattice]
        children.append(Child(child.name, child.state, child.guess[:, order]))

    def labels(matrix):
        return [tuple(column) for column in matrix.T.round(9).tolist()]

    parts = [
        Part(brep.states[b.state].dimension, tuple(np.argmax(b.matrix, axis=0)))
        for b in state.boundaries
    ]
    covered = [
        Covered(k, letter, labels(b.matrix @ piece.guess))
        for k, b in enumerate(state.boundaries)
        for letter, piece in enumerate(brep.states[b.state].children)
    ]
    constraints = joins([Placed(labels(c.guess), parts) for c in children], covered)
    new = CellState(
        state.name, state.shape, state.controls, state.boundaries, tuple(children), *constraints
    )
    states = [new if q == brep.start else other for q, other in enumerate(brep.states)]
    return BRep(tuple(states), brep.start)


@pytest.mark.parametrize("seed", range(4))
def test_cells_in_turned_and_mirrored_frames(seed):
    plain = hexa("menger")
    system = System(relabelled(plain.brep, seed))
    controls = plain.bent(seed)
    nodes = system.nodes(2, controls)
    assert set(nodes.groups[0].variants) == {0, 1}
    _, apart, surface = assert_conforming(nodes, 2, system)
    assert len(apart.points) == 896
    assert euler_number(surface) == 2 - 2 * 81
    assert not cKDTree(apart.points).query_pairs(1e-6)
    level_1 = cell_mesh(system.nodes(1, controls)), cell_mesh(plain.nodes(1, controls))
    assert np.allclose(level_1[0].volumes, level_1[1].volumes)
    assert level_1[0].parts["XMIN"].members.size == level_1[1].parts["XMIN"].members.size


CURVE = np.array([[[3, 1, 0], [1, 3, 3], [0, 0, 1]], [[1, 0, 0], [3, 3, 1], [0, 1, 3]]]) / 4
RULES = {"E": CURVE, "V": np.array([[[3, 1], [1, 3]]]) / 4}
ENDS = {"0": selection(3, (0, 1)), "1": selection(3, (1, 2))}
KINDS = ["".join(kind) for kind in itertools.product("EV", repeat=3)]


def kron(parts):
    return np.kron(np.kron(parts[0], parts[1]), parts[2])


def spline_state(kind):
    """Return a product of curves E and their ends V; constraints on facets imply the others."""
    sides = {"E": "01*", "V": "*"}
    names = ["".join(p) for p in itertools.product(*[sides[k] for k in kind])]
    names.remove("***")
    targets = ["".join(np.where(np.array([*name]) == "*", [*kind], "V")) for name in names]
    eyes = [np.eye(RULES[k].shape[1]) for k in kind]
    boundaries = [
        Boundary(name, KINDS.index(target), kron([ENDS.get(s, e) for s, e in pairs(name, eyes)]))
        for name, target in pairs(names, targets)
    ]
    words_ = letters(kind)
    children = [
        Child(word, KINDS.index(kind), kron([RULES[k][int(d)] for k, d in pairs(kind, word)]))
        for word in words_
    ]
    incidences, adjacencies = [], []
    facets = [(k, name) for k, name in enumerate(names) if name.count("*") == 2]
    for (i, word), (k, name) in itertools.product(enumerate(words_), facets):
        axis = max(name.find("0"), name.find("1"))
        if name[axis] == word[axis]:
            below = letters(targets[k]).index(word[:axis] + "0" + word[axis + 1 :])
            incidences.append(Incidence(i, k, k, below))
        elif name[axis] == "1":
            other = words_.index(word[:axis] + "1" + word[axis + 1 :])
            adjacencies.append(Adjacency(i, k, other, names.index(name.replace("1", "0"))))
    lattice = [(-0.5, 0.5, 1.5)[: len(eye)] for eye in eyes]
    controls = np.array(list(itertools.product(*lattice))).T
    shape = ("vertex", "edge", "quad", "hexa")[kind.count("E")]
    return CellState(kind, shape, controls, boundaries, children, incidences, adjacencies)


def letters(kind):
    return ["".join(word) for word in itertools.product(*["01" if k == "E" else "0" for k in kind])]


def pairs(a, b):
    return zip(a, b, strict=True)


def spline_volume():
    """Return the uniform quadratic B-spline volume: its vertices have eight controls."""
    return BRep(tuple(map(spline_state, KINDS)))


def test_vertices_of_several_controls_are_where_their_rule_leaves_them():
    system = System(spline_volume())
    mesh = cell_mesh(system.nodes(2))
    assert len(mesh.points) == 5**3
    lattice = np.array(list(itertools.product(range(5), repeat=3))) / 4
    assert cKDTree(mesh.points).query(lattice)[0].max() <= 1e-12
    assert_conforming(system.nodes(2, system.bent(1)), 2, system)


# ------------------------------------------------------------------ refused


def naive_folds(system, controls, level):
    """Return the places of the folded cells, corner by corner."""
    ((_, cells),) = expand(system.automaton(controls), level)
    state = system.brep.states[system.brep.start]
    vertices = [state.boundaries[k] for k in system.brep.of_dimension(system.brep.start, 0)]
    spots = cells @ np.hstack([b.matrix for b in vertices])
    bad = np.zeros(len(cells), bool)
    for corner, ends in HEX_FRAMES.items():
        edges = spots[:, :, ends] - spots[:, :, [corner]]
        bad |= (-1) ** bin(corner).count("1") * np.linalg.det(edges) <= 0
    return np.flatnonzero(bad)


def test_folded_cells_are_named():
    system = hexa("menger")
    folded = 0
    for seed in range(100):
        controls = system.bent(seed, 0.4)
        bad = naive_folds(system, controls, 1)
        if len(bad):
            folded += 1
            name = "".join(map(str, SETS["menger"][1][bad[0]]))
            with pytest.raises(ModelError, match=f"cell {name} .*so are {len(bad)} of 20 cells"):
                system.nodes(1, controls)
        else:
            assert (cell_mesh(system.nodes(1, controls)).volumes > 0).all()
    assert 10 < folded < 90


def test_folded_cells_of_a_rough_block_are_named_by_their_words():
    # Roughness grows with the level where |r| > 1/3; corners stay where they are.
    system = hexa("menger", "hex-27", texture=Texture((0.45, -0.4, 0.45), (0.5, 0.3)))
    controls = system.bent(0, 0.1)
    assert (cell_mesh(system.nodes(1, controls)).volumes > 0).all()
    with pytest.raises(
        ModelError, match=r"cell \d{3}\.\d{3}\.\d{3} \(children by name\) is folded"
    ):
        system.nodes(3, system.bent(0, 0.2))


def test_flat_and_folded_level_0_cells():
    system = hexa("full")
    with pytest.raises(ModelError, match=r"the level-0 cell is folded or flat.* 1 of 1 cells"):
        system.nodes(0, SHEARED @ system.controls)


def test_coincident_controls_are_named():
    system = hexa("menger", "hex-27")
    controls = system.controls.copy()
    controls[:, 8] = controls[:, 2]
    with pytest.raises(ModelError, match=r"controls 2 and 8 coincide at \(0, 0, 1\)"):
        system.nodes(1, controls)
    tetra = simplicial("tetra")
    with pytest.raises(ModelError, match="controls 1 and 3 coincide"):
        tetra.nodes(1, tetra.controls[:, [0, 1, 2, 1]])


def test_cells_that_are_no_volumes_are_refused():
    brep = hexa("menger").brep
    face = next(q for q, state in enumerate(brep.states) if state.shape == "quad")
    system = System(BRep(brep.states, face))
    with pytest.raises(ModelError, match="state face are of shape quad, no volumes"):
        system.nodes(1)


def changed_start(brep, **fields):
    states = list(brep.states)
    states[brep.start] = replace(states[brep.start], **fields)
    return BRep(tuple(states), brep.start)


def test_shapes_without_all_their_boundaries_are_refused():
    brep = hexa("full").brep
    bare = System(changed_start(brep, boundaries=(), incidences=(), adjacencies=()))
    wanted = "8 vertices, 12 edges and 6 faces"
    with pytest.raises(ModelError, match=f"has 0 vertices, 0 edges .* of a hexa: {wanted}"):
        bare.nodes(1)


def test_corners_that_are_no_face_of_the_shape_are_refused():
    brep = simplicial("tetra-octa", None, "octa").brep
    state = brep.states[brep.start]
    wrong = replace(state, shape="hexa")
    states = tuple(wrong if q == brep.start else s for q, s in enumerate(brep.states))
    with pytest.raises(ModelError, match=r"has 6 vertices, 12 edges and 8 faces"):
        cut(BRep(states, brep.start), brep.start)
    swapped = list(state.boundaries)
    corners = brep.of_dimension(brep.start, 0)
    a, b = corners[1], corners[2]  # no longer in opposite pairs
    swapped[a], swapped[b] = swapped[b], swapped[a]
    own = replace(state, boundaries=tuple(swapped), incidences=(), adjacencies=())
    states = tuple(own if q == brep.start else s for q, s in enumerate(brep.states))
    plain = [replace(s, children=(), incidences=(), adjacencies=()) for s in states]
    with pytest.raises(ModelError, match=r"corners \(.*\) are no face of its shape"):
        cut(BRep(tuple(plain), brep.start), brep.start)


def test_a_face_called_as_every_meshs_parts_is_refused():
    brep = hexa("full").brep
    boundaries = list(brep.states[brep.start].boundaries)
    boundaries[0] = replace(boundaries[0], name="SKIN")
    system = System(changed_start(brep, boundaries=tuple(boundaries)))
    with pytest.raises(ModelError, match="called SKIN"):
        cell_mesh(system.nodes(1))


def test_corners_that_tear_are_refused():
    system = hexa("menger", "hex-27")
    matrices = [list(own) for own in system.solution.matrices]
    matrices[0][0] = matrices[0][0] + 1e-9 * np.eye(27)[:, [26]] - 1e-9 * np.eye(27)[:, [0]]
    torn = Solution(system.brep, matrices, (), 0.0)
    with pytest.raises(ModelError, match=r"occurrences of one corner lie .* apart"):
        cell_nodes(torn, system.complex(1), torn.automaton(), 1)


def test_faces_of_three_cells_are_refused():
    nodes = hexa("full").nodes(1)
    (group,) = nodes.groups
    same = replace(nodes, groups=(replace(group, faces=np.zeros_like(group.faces)),))
    with pytest.raises(ModelError, match="1 faces are shared by three cells or more"):
        cell_mesh(same)


def test_other_contacts_are_refused():
    with pytest.raises(ModelError, match="contacts: got 'fuse'; wanted 'apart' or 'shared'"):
        cell_mesh(hexa("full").nodes(1), contacts="fuse")


def test_levels_that_need_too_much_memory_are_refused(monkeypatch):
    from porous.errors import MemoryLimitError

    system = hexa("menger")
    system.complex(2)
    monkeypatch.setenv("POROUS_MAX_MEMORY", "100K")
    with pytest.raises(MemoryLimitError, match="a mesh of level 2"):
        system.nodes(2)


def test_the_stage_asks_for_cells():
    class Cells:
        def cell_mesh(self):
            return VolumeMesh(np.eye(4, 3), (Block("tet4", np.array([[3, 0, 1, 2]])),))

    assert mesh_cells(Cells()).cells == 1
    with pytest.raises(MeshError, match=r"a int has none.*kind bcifs"):
        mesh_cells(3)


# ------------------------------------------------------------------ in the solver


def assert_runs(judge, level):
    system = hexa("menger", "hex-27")
    mesh = cell_mesh(system.nodes(level, system.bent(11, 0.08)))
    job = compression(mesh, material=material("steel"), pressure=2.0)
    assert job.mesh.cells == 20**level
    solved = ccx.solve(inp.write(job), program=judge("ccx"))  # raises unless it exits with 0
    energy, load = naive_elasticity.energy(job)
    assert solved.reaction == pytest.approx(load, abs=1e-5 * np.linalg.norm(load))
    assert solved.energy == pytest.approx(energy, rel=1e-5)
    assert solved.volume == pytest.approx(mesh.volumes.sum(), rel=1e-5)
    assert "nonpositive" not in solved.log


@pytest.mark.judge
def test_a_bent_block_bears_its_load_in_calculix(judge):
    assert_runs(judge, 2)


@pytest.mark.judge
@pytest.mark.slow
def test_a_bent_block_of_8000_cells_bears_its_load_in_calculix(judge):
    assert_runs(judge, 3)
