"""The slow, obvious twin of cell complexes: one instance per thing, united one by one.

Every cell of a level is an instance with an instance for each of its boundaries. Splitting makes
fresh instances for the children and unites what the constraints say is one. Also small systems of
their own, so that neither builders nor tables are trusted.
"""

import functools
import itertools

import numpy as np

from porous.models.brep import (
    Adjacency,
    Boundary,
    BRep,
    CellState,
    Child,
    Incidence,
    selection,
)


class Instance:
    def __init__(self, state):
        self.state = state
        self.bounds = []  # of (instance, order), one for each boundary of the state
        self.children = None
        self.above = None  # (instance, order) once united with another


def then(outer, inner):
    return tuple(outer[t] for t in inner)


def back(order):
    return tuple(order.index(t) for t in range(len(order)))


def match(wanted, candidates):
    """Which candidate has the columns of ``wanted``, and wanted = candidate·I[:, order]."""
    for index, matrix in candidates:
        for order in itertools.permutations(range(matrix.shape[1])):
            if np.abs(matrix[:, order] - wanted).max() < 1e-9:
                return index, order
    raise AssertionError("no match")


class Twin:
    """Cells of a BRep; ``glue`` is a list of (cell, boundary, other, its boundary, order)."""

    def __init__(self, brep, matrices, cells=1, glue=()):
        self.brep, self.matrices = brep, matrices
        self.cells = [self.fresh(brep.start) for _ in range(cells)]
        for a, k, b, m, order in glue:
            one, other = self.view(self.cells[a]), self.view(self.cells[b])
            self.unite(self.bound(one, k), self.bound(other, m), order)

    @functools.cache  # noqa: B019
    def nested(self, state):
        """For each boundary of a state, and each of its own, which boundary of the state it is."""
        bounds = self.brep.states[state].boundaries
        result = []
        for outer in bounds:
            uses = []
            for inner in self.brep.states[outer.state].boundaries:
                same = [(e, b.matrix) for e, b in enumerate(bounds) if b.state == inner.state]
                uses.append(match(outer.matrix @ inner.matrix, same))
            result.append(uses)
        return result

    def fresh(self, state):
        """A new instance; boundaries of boundaries are boundaries of the cell."""
        cell = Instance(state)
        for bound in self.brep.states[state].boundaries:
            cell.bounds.append((Instance(bound.state), tuple(range(bound.matrix.shape[1]))))
        for (instance, _), uses in zip(cell.bounds, self.nested(state), strict=True):
            instance.bounds = [(cell.bounds[e][0], order) for e, order in uses]
        return cell

    def view(self, instance, order=None):
        """The root of an instance and the order in which it is seen."""
        if order is None:
            order = tuple(range(self.brep.states[instance.state].size))
        while instance.above:
            instance, step = instance.above
            order = then(step, order)
        return instance, order

    @functools.cache  # noqa: B019
    def turned(self, state, order, what):
        """Which boundary or child of a state is seen where part k is: Π·W_k = W_k'·Π'."""
        parts = getattr(self.brep.states[state], what)
        weights = [p.matrix for p in parts] if what == "boundaries" else self.matrices[state]
        result = []
        for part, matrix in zip(parts, weights, strict=True):
            moved = np.empty_like(matrix)
            moved[list(order)] = matrix
            same = [(j, w) for j, w in enumerate(weights) if parts[j].state == part.state]
            result.append(match(moved, same))
        return result

    def bound(self, view, k):
        instance, order = view
        j, seen = self.turned(instance.state, order, "boundaries")[k]
        inner, mine = instance.bounds[j]
        return self.view(inner, then(mine, seen))

    def child(self, view, i):
        instance, order = view
        j, seen = self.turned(instance.state, order, "children")[i]
        return self.view(instance.children[j], seen)

    def unite(self, one, other, order):
        """one = other·I[:, order], with all boundaries and all children."""
        (a, p), (b, r) = one, (other[0], then(other[1], order))
        step = then(r, back(p))
        if a is b:
            assert step == tuple(range(len(step)))
            return
        a.above = b, step
        size = tuple(range(len(step)))
        for k in range(len(self.brep.states[a.state].boundaries)):
            self.unite(self.bound((a, size), k), self.bound((b, step), k), self.plain(a, k))
        if a.children:
            assert b.children
            for i, child in enumerate(a.children):
                same = tuple(range(self.brep.states[child.state].size))
                self.unite(self.view(child), self.child((b, step), i), same)

    def plain(self, instance, k):
        bound = self.brep.states[instance.state].boundaries[k].state
        return tuple(range(self.brep.states[bound].size))

    def split(self, instance):
        """Boundaries first, then fresh children, then what the constraints say."""
        state = self.brep.states[instance.state]
        if instance.children or not state.children:
            return
        for k in range(len(state.boundaries)):
            self.split(self.bound(self.view(instance), k)[0])
        instance.children = [self.fresh(child.state) for child in state.children]
        views = lambda i, k: self.bound(self.view(instance.children[i]), k)  # noqa: E731
        plain = lambda i, k: self.plain(instance.children[i], k)  # noqa: E731
        for at in state.incidences:
            face = self.bound(self.view(instance), at.face)
            order = at.order or plain(at.child, at.boundary)
            self.unite(views(at.child, at.boundary), self.child(face, at.letter), order)
        for to in state.adjacencies:
            order = to.order or plain(to.child, to.boundary)
            target = views(to.other, to.other_boundary)
            self.unite(views(to.child, to.boundary), target, order)

    def refine(self):
        for cell in self.cells:
            self.split(cell)
        # A terminal cell stays, on what its boundaries have become: their only children.
        finer = []
        for cell in self.cells:
            if not cell.children:
                for k in range(len(cell.bounds)):
                    view = self.bound(self.view(cell), k)
                    self.split(view[0])
                    cell.bounds[k] = self.child(view, 0) if view[0].children else view
            finer += cell.children or [cell]
        self.cells = finer

    def used(self):
        """The roots that the level's cells use, with the cells that use them."""
        result = {}
        for cell in self.cells:
            result.setdefault(cell, []).append(cell)
            for k in range(len(cell.bounds)):
                result.setdefault(self.bound(self.view(cell), k)[0], []).append(cell)
        return result

    def counts(self):
        dimensions = [self.brep.states[i.state].dimension for i in self.used()]
        return tuple(dimensions.count(d) for d in range(4))


def box_system(divisions, keep):
    """Straight hexahedra of a digit set: a vertex, an edge, a quadrilateral, a hexahedron."""
    lines = []
    for c in range(divisions):
        ends = np.array([c, c + 1]) / divisions
        lines.append(np.array([1 - ends, ends]))
    every = [list(itertools.product(range(divisions), repeat=d)) for d in range(3)]
    digits = [*every, [tuple(map(int, d)) for d in keep]]
    return BRep(tuple(_box(d, divisions, lines, digits[d]) for d in range(4)), 3)


def fits(fixed, coordinate):
    return fixed in (coordinate, "*")


def _box(dimension, n, lines, digits):
    patterns = sorted(itertools.product((0, 1, "*"), repeat=dimension), key=str)
    patterns = [p for p in patterns if p.count("*") < dimension]
    corners = list(itertools.product((0, 1), repeat=dimension))
    boundaries = []
    for p in patterns:
        on = [i for i, c in enumerate(corners) if all(map(fits, p, c))]
        boundaries.append(Boundary(name("", p), p.count("*"), selection(len(corners), on)))
    children, incidences, adjacencies, first = [], [], [], {}
    for i, digit in enumerate(digits):
        matrix = np.ones((1, 1))
        for c in digit:
            matrix = np.kron(matrix, lines[c])
        children.append(Child(name("c", digit), dimension, matrix))
        for k, p in enumerate(patterns):
            # Along each axis a boundary lies on a plane, or between two where it is free.
            spot = [(c, "*") if a == "*" else c + a for c, a in zip(digit, p, strict=True)]
            planes = [s for s in spot if not isinstance(s, tuple)]
            if all(plane in (0, n) for plane in planes):
                face = tuple("*" if isinstance(s, tuple) else s // n for s in spot)
                free = tuple(s[0] for s in spot if isinstance(s, tuple))
                letter = list(itertools.product(range(n), repeat=len(free))).index(free)
                incidences.append(Incidence(i, k, patterns.index(face), letter))
            elif tuple(spot) in first:
                adjacencies.append(Adjacency(i, k, *first[tuple(spot)]))
            first.setdefault(tuple(spot), (i, k))
    controls = np.zeros((3, len(corners)))
    controls[:dimension] = np.array(corners, float).reshape(len(corners), dimension).T
    shape = ("vertex", "edge", "quad", "hexa")[dimension]
    return CellState(shape, shape, controls, boundaries, children, incidences, adjacencies)


def vertex_state():
    """A vertex of one control: its own only child."""
    return CellState("vertex", "vertex", np.zeros((3, 1)), (), (Child("0", 0, np.eye(1)),))


def edge_state(at=0.5):
    """An edge in two halves, its ends in state 0; in other parts where ``at`` says so."""
    ends = [Boundary(str(v), 0, selection(2, [v])) for v in (0, 1)]
    middle = np.array([1 - at, at])
    matrices = [np.stack([[1, 0], middle], 1), np.stack([middle, [0, 1]], 1)]
    children = [Child(str(i), 1, matrix) for i, matrix in enumerate(matrices)]
    incidences = [Incidence(0, 0, 0, 0), Incidence(1, 1, 1, 0)]
    return CellState(
        "edge",
        "edge",
        np.array([[0, 1.0], [0, 0], [0, 0]]),
        ends,
        children,
        incidences,
        [Adjacency(0, 1, 1, 0)],
    )


def name(letter, corners):
    return letter + "".join(map(str, corners))


def halves(size, child):
    """Weights of a simplex's child at a corner: midpoints of the edges there."""
    return np.stack([(np.eye(size)[child] + np.eye(size)[j]) / 2 for j in range(size)], axis=1)


def triangle_state(kept=(0, 1, 2, 3)):
    """A triangle in four: one at each corner, and between them one whose edges run backwards."""
    edges = [(0, 1), (0, 2), (1, 2)]
    boundaries = [Boundary(name("E", e), 1, selection(3, e)) for e in edges]
    boundaries += [Boundary(f"V{v}", 0, selection(3, [v])) for v in range(3)]
    matrices = [halves(3, i) for i in range(3)]
    # The middle one names the midpoint opposite each corner as that corner.
    matrices.append((np.ones((3, 3)) - np.eye(3)) / 2)
    incidences, adjacencies = [], []
    for i, j in itertools.permutations(range(3), 2):
        edge = edges.index((min(i, j), max(i, j)))
        incidences.append(Incidence(kept.index(i), edge, edge, int(i > j)))
    for i in range(3):
        edge = next(k for k, e in enumerate(edges) if i not in e)
        if 3 in kept:
            # Corner i's edge jk runs from the middle of ij to that of ik; the middle one's back.
            adjacencies.append(Adjacency(kept.index(3), edge, kept.index(i), edge, (1, 0)))
    for i, j in [] if 3 in kept else edges:
        adjacencies.append(Adjacency(i, 3 + j, j, 3 + i))
    controls = np.array([[0, 1.0, 0], [0, 0, 1], [0, 0, 0]])
    children = [Child(str(i), 2, matrices[i]) for i in kept]
    return CellState(
        "triangle", "triangle", controls, boundaries, children, incidences, adjacencies
    )


def tetra_system():
    """Sierpinski's tetrahedron: T → 4 T, faces cut in four, edges in two."""
    faces = list(itertools.combinations(range(4), 3))
    edges = list(itertools.combinations(range(4), 2))
    boundaries = [Boundary(name("F", f), 2, selection(4, f)) for f in faces]
    boundaries += [Boundary(name("E", e), 1, selection(4, e)) for e in edges]
    boundaries += [Boundary(f"V{v}", 0, selection(4, [v])) for v in range(4)]
    children = [Child(str(i), 3, halves(4, i)) for i in range(4)]
    incidences = [Incidence(i, k, k, face.index(i)) for k, face in enumerate(faces) for i in face]
    adjacencies = [Adjacency(i, 10 + j, j, 10 + i) for i, j in edges]
    controls = np.hstack([np.zeros((3, 1)), np.eye(3)])
    tetra = CellState("tetra", "tetra", controls, boundaries, children, incidences, adjacencies)
    return BRep((vertex_state(), edge_state(), triangle_state(), tetra), 3)
