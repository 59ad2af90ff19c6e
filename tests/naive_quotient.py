"""Cells that share their boundaries, one instance after the other: union-find, no closure table."""

from functools import cache

import numpy as np

from porous.models.brep import column_order


def compose(outer, inner):
    return tuple(outer[t] for t in inner)


class Quotient:
    """Instances of states; ``(instance, order)`` names an instance's controls in an order."""

    def __init__(self, brep):
        self.brep, self.state, self.parts, self.kids, self.above = brep, [], [], [], []
        self.act = cache(self.act)
        self.turn = cache(self.turn)
        self.cells = [self.fresh(brep.start)]
        self.borders = [[instance] for instance, _ in self.parts[self.cells[0]]]

    def refine(self):
        self.cells = self.refined(self.cells)
        self.borders = [self.refined(border) for border in self.borders]

    def refined(self, cells):
        return [kid for cell in cells for kid in self.split(cell)]

    def roots(self, cells):
        """What the boundaries of cells are, and the cells themselves, cell by cell."""
        uses = [use for cell in cells for use in (*self.parts[cell], (cell, self.own(cell)))]
        return [self.find(use)[0] for use in uses]

    def own(self, instance):
        return self.same(self.state[instance])

    def same(self, state):
        return tuple(range(self.brep.states[state].size))

    def new(self, state, parts):
        self.state.append(state)
        self.parts.append(parts)
        self.kids.append(None)
        self.above.append(None)
        return len(self.state) - 1

    def fresh(self, state):
        boundaries = self.brep.states[state].boundaries
        own = [None] * len(boundaries)
        dimension = [self.brep.states[b.state].dimension for b in boundaries]
        for k in sorted(range(len(own)), key=dimension.__getitem__):
            parts = [(own[e][0], order) for e, order in self.brep.sub[state][k]]
            own[k] = self.new(boundaries[k].state, parts), self.same(boundaries[k].state)
        return self.new(state, own)

    def find(self, use):
        instance, order = use
        while self.above[instance] is not None:
            instance, outer = self.above[instance]
            order = compose(outer, order)
        return instance, order

    def act(self, state, order, child):
        """Which child, in which order, a child is for whom names the state's controls otherwise."""
        return self.match(state, order, child, "children", "guess")

    def turn(self, state, order, boundary):
        return self.match(state, order, boundary, "boundaries", "matrix")

    def match(self, state, order, index, many, matrix):
        items = getattr(self.brep.states[state], many)
        wanted = np.eye(len(order))[:, order] @ getattr(items[index], matrix)
        for other, item in enumerate(items):
            found = column_order(wanted, getattr(item, matrix))
            if found is not None and item.state == items[index].state:
                return other, found
        raise AssertionError(f"{self.brep.states[state].name} has no symmetry {order}")

    def child(self, use, letter):
        instance, order = self.find(use)
        other, inner = self.act(self.state[instance], order, letter)
        return self.split(instance)[other], inner

    def unite(self, a, b):
        (e, g), (f, h) = self.find(a), self.find(b)
        order = compose(h, tuple(np.argsort(g).tolist()))
        if e == f:
            assert order == self.own(e)
            return
        if self.kids[f] is None and self.kids[e] is not None:
            self.split(f)
        self.above[e] = f, order
        for k, part in enumerate(self.parts[e]):
            other, inner = self.turn(self.state[e], order, k)
            use, outer = self.parts[f][other]
            self.unite(part, (use, compose(outer, inner)))
        for letter, kid in enumerate(self.kids[e] or ()):
            self.unite((kid, self.own(kid)), self.child((f, order), letter))

    def split(self, instance):
        root, _ = self.find((instance, self.own(instance)))
        if self.kids[root] is not None:
            return self.kids[root]
        for part in self.parts[root]:
            self.split(self.find(part)[0])
        state = self.brep.states[self.state[root]]
        kids = self.kids[root] = [self.fresh(child.state) for child in state.children]
        for at in state.incidences:
            kid, inner = self.child(self.parts[root][at.face], at.letter)
            order = compose(inner, at.order) if at.order else inner
            self.unite(self.parts[kids[at.child]][at.boundary], (kid, order))
        for at in state.adjacencies:
            use, outer = self.parts[kids[at.other]][at.other_boundary]
            order = compose(outer, at.order) if at.order else outer
            self.unite(self.parts[kids[at.child]][at.boundary], (use, order))
        return kids
