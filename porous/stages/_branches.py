"""Which branch of a fractal each cell of a mesh belongs to: sets by the beginnings of addresses."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np

from porous.errors import ModelError
from porous.models.automaton import Cells, cells, count_cells, product, refined, words
from porous.values import Part, VolumeMesh
from porous.values.volume_mesh import ADDRESS

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from porous.models.automaton import Automaton
    from porous.models.cifs import CIFS
    from porous.models.drawing import Drawing
    from porous.models.ifs import IFS

    Indices = NDArray[np.int64]
    Floats = NDArray[np.float64]
    Flags = NDArray[np.bool_]

MOST_WORDS = 4096
"""Sets that a mesh may have."""

MOST_LEAVES = 1 << 17
"""Cells of the model that are looked at: all of a level that has no more, else those of the last
level that has not."""

DEEP = 64
"""Levels below which cells of one map only are followed no more."""

FLAT = 1e-12
"""Images of less volume, relative to the cube of their size, hold no point."""


def branches(mesh: VolumeMesh, model: object, *, length: int) -> VolumeMesh:
    """Return the mesh with a part of cells for each beginning of an address: ``WORD_0`` … .

    A model's cells have words as addresses: which map, or which child, level by level. The cells
    of ``WORD_3_17`` have words that begin with 3 and 17: numbers of maps from 0 on, in the order of
    the recipe, or the names of a boundary-controlled cell's children. With several level-0 cells a
    word begins with the number of one. A cell's word may end early; then so does the name.

    A model's own cells have addresses, and are told apart exactly. Other cells belong to the first
    word whose images hold their middle: the solids that the model draws in the cells below it, or
    else the one that it draws in the word's own cell, where each level lies within the one before.
    If none does, as in what an offset has added, then to the one with the nearest corner or middle
    of a solid. Of an attractor, and of cells of about one size, the latter two are asked only.
    Every cell is in one part; words that no cell belongs to have none.

    Parameters
    ----------
    mesh
        Of the model: its cells, or tetrahedra or hexahedra that fill it. Other parts are kept.
    model
        Of kind ifs or cifs, or bcifs with a mesh of its own cells.
    length
        How many letters, from 1 to the model's level.

    Raises
    ------
    ModelError
        For another length, more than ``MOST_WORDS`` words, models without addresses, and a mesh
        whose addresses are not the model's.
    """
    automaton = _automaton(model, mesh)
    level = getattr(model, "level", None)
    _check_length(automaton, level, length)
    if mesh.is_of_cells:
        assert isinstance(level, int)
        word = _by_address(automaton, mesh.cell_tags[ADDRESS], level, length)
    else:
        word = _Places.of(cast("IFS | CIFS", model), length).words_of(_middles(mesh))
    order = np.argsort(word, kind="stable")
    there, first = np.unique(word[order], return_index=True)
    names = _names(model, automaton, length)
    parts = {
        f"WORD_{names[index]}": Part("cells", np.sort(members))
        for index, members in zip(there, np.split(order, first[1:]), strict=False)
    }
    kept = {name: part for name, part in mesh.parts.items() if not name.startswith("WORD_")}
    return VolumeMesh(mesh.points, mesh.blocks, mesh.cell_tags, {**kept, **parts}, mesh.unit)


def _automaton(model: object, mesh: VolumeMesh) -> Automaton:
    from porous.models.cell_system import CellSystem
    from porous.models.cifs import CIFS
    from porous.models.ifs import IFS

    if isinstance(model, IFS | CIFS) and not mesh.is_of_cells:
        return model.automaton
    if isinstance(model, CellSystem) and mesh.is_of_cells:
        return model.automaton
    kind = type(model).__name__
    if isinstance(model, IFS | CIFS):
        raise ModelError(
            f"branches: the mesh is of the cells of another model: {kind} has none of its own"
        )
    if isinstance(model, CellSystem):
        raise ModelError(
            f"branches: of a {kind} only its own cells have addresses; wanted a mesh of them, as "
            'volume.method = "cells" makes of solid cells'
        )
    raise ModelError(
        f"branches: a {kind} has no addresses; wanted a model of kind ifs, cifs or bcifs, or "
        "length 0 (volume.branches = 0)"
    )


def _check_length(automaton: Automaton, level: Any, length: int) -> None:
    whole = isinstance(length, int) and not isinstance(length, bool) and length >= 1
    if not whole or (isinstance(level, int) and length > level):
        most = f"1 … {level}, the model's level" if isinstance(level, int) else "1 or more"
        raise ModelError(f"branches: got length {length!r}; wanted {most}")
    many = next((n for n in range(1, length + 1) if count_cells(automaton, n) > MOST_WORDS), None)
    if many is not None:
        raise ModelError(
            f"branches: there are {count_cells(automaton, many)} words of length {many}; wanted a "
            f"length with at most {MOST_WORDS}"
        )


def _names(model: object, automaton: Automaton, length: int) -> list[str]:
    """Return what each word is called, in lexicographic order."""
    from porous.models.cell_system import CellSystem

    labels = {id(t): str(i) for of in automaton.children for i, t in enumerate(of)}
    if isinstance(model, CellSystem):
        brep = model.brep
        called = [child.name for q in brep.reached for child in brep.states[q].children]
        labels = {id(t): name for t, name in zip(automaton.transitions, called, strict=True)}
    starts = sorted(
        (int(place), group.state) for group in automaton.level_zero for place in group.place
    )
    result = []
    roots = _roots(automaton, length)
    for word, root in zip(words(automaton, length).tolist(), roots.tolist(), strict=True):
        name, state = [str(root)] if len(starts) > 1 else [], starts[root][1]
        for letter in (letter for letter in word if letter >= 0):
            step = automaton.children[state][letter]
            name.append(labels[id(step)])
            state = step.target
        result.append("_".join(name))
    return result


def _roots(automaton: Automaton, length: int) -> Indices:
    """Return which level-0 cell each word is of."""
    return _beginnings(automaton, automaton.level_zero, length)


def _beginnings(automaton: Automaton, above: tuple[Cells, ...], depth: int) -> Indices:
    """Return for each cell ``depth`` levels below others the place of the one that it is of."""
    count = np.empty(sum(len(group.place) for group in above), np.int64)
    for group in above:
        one = Cells(group.state, group.points[:1], np.zeros(1, np.int64))
        count[group.place] = count_cells(automaton, depth, [one])
    return np.repeat(np.arange(len(count)), count)


def _by_address(automaton: Automaton, address: Indices, level: int, length: int) -> Indices:
    word = _beginnings(automaton, cells(automaton, length), level - length)
    if address.size and not 0 <= address.min() <= address.max() < len(word):
        raise ModelError(
            f"branches: the mesh's addresses run from {address.min()} to {address.max()}; the "
            f"model has {len(word)} cells"
        )
    return np.asarray(word[address])


def _middles(mesh: VolumeMesh) -> Floats:
    middles = [mesh.points[block.cells].mean(axis=1) for block in mesh.blocks]
    return np.concatenate([np.zeros((0, 3)), *middles])


class _Layer(NamedTuple):
    """Cells below the words, in lexicographic order, and which word each is of."""

    cells: tuple[Cells, ...]
    word: Indices

    def by_word(self) -> Iterator[list[Cells]]:
        """Yield the cells of each word."""
        ends = np.searchsorted(self.word, np.arange(self.word[-1] + 2))
        for ends_of in pairwise(ends.tolist()):
            spans = [np.searchsorted(group.place, ends_of) for group in self.cells]
            yield [
                Cells(group.state, group.points[a:b], group.place[a:b])
                for group, (a, b) in zip(self.cells, spans, strict=True)
                if b > a
            ]


class _Places(NamedTuple):
    """Where the images of each word lie: what holds points, and what points are near to."""

    drawings: tuple[Drawing, ...]
    solids: tuple[_Layer, ...]
    finest: _Layer

    @classmethod
    def of(cls, model: IFS | CIFS, length: int) -> _Places:
        """Return them for words of so many letters."""
        from porous.models.cifs import CIFS
        from porous.models.drawing import image

        automaton = model.automaton
        if isinstance(model, CIFS):
            drawings = model.drawings
        else:
            drawings = tuple(image(model.primitive, state) for state in automaton.states)
        whole = isinstance(model.level, int)
        most = model.level - length if isinstance(model.level, int) else DEEP
        depth = 0
        while depth < most and count_cells(automaton, length + depth + 1) <= MOST_LEAVES:
            depth += 1
        above = leaves = cells(automaton, length)
        for _ in range(depth):
            leaves = refined(automaton, leaves)
        finest = _Layer(leaves, _beginnings(automaton, above, depth))
        bulk = _Layer(above, _beginnings(automaton, above, 0))
        solids = [finest] * whole + [bulk] * _are_nested(automaton, drawings)
        return cls(drawings, tuple(solids), finest)

    def words_of(self, points: Floats) -> Indices:
        """Return the word that each point (n, 3) belongs to."""
        result = np.full(len(points), -1)
        order = np.argsort(points[:, 0], kind="stable")
        x = points[order, 0]
        for layer in self.solids:
            for word, groups in enumerate(layer.by_word()):
                for group in groups:
                    drawing = self.drawings[group.state]
                    box = _box(drawing, group.points)
                    first, last = np.searchsorted(x, box[:, 0])
                    near = order[first:last]
                    near = near[result[near] < 0]
                    spots = points[near]
                    near = near[((spots >= box[0]) & (spots <= box[1])).all(axis=1)]
                    result[near[_holds(drawing, group.points, points[near])]] = word
        left = np.flatnonzero(result < 0)
        if len(left):
            result[left] = self._nearest(points[left])
        return result

    def _nearest(self, points: Floats) -> Indices:
        from scipy.spatial import cKDTree

        spots, words_ = [], []
        for group in self.finest.cells:
            corners = product(group.points, self.drawings[group.state].corners)
            if not corners.shape[2]:
                corners = group.points
            corners = np.concatenate([corners, corners.mean(axis=2, keepdims=True)], axis=2)
            spots.append(corners.swapaxes(1, 2).reshape(-1, 3))
            words_.append(np.repeat(self.finest.word[group.place], corners.shape[2]))
        _, nearest = cKDTree(np.concatenate(spots)).query(points)
        return np.asarray(np.concatenate(words_)[nearest])


def _are_nested(automaton: Automaton, drawings: tuple[Drawing, ...]) -> bool:
    """Tell whether the level-0 cells hold all that is drawn in their children."""
    below = []
    for group in cells(automaton, 1):
        corners = product(group.points, drawings[group.state].corners)
        below.append(corners.swapaxes(1, 2).reshape(-1, 3))
    points = np.concatenate(below)
    held = [_holds(drawings[g.state], g.points, points) for g in cells(automaton, 0)]
    return bool(np.logical_or.reduce(held).all())


def _box(drawing: Drawing, controls: Floats) -> Floats:
    """Return a box (2, 3) about the solids that are drawn on controls (k, 3, m), and a bit more."""
    corners = product(controls, drawing.corners)
    if not corners.size:
        return np.full((2, 3), np.nan)
    slack = FLAT * float(np.abs(corners).max())
    return np.stack([corners.min(axis=(0, 2)) - slack, corners.max(axis=(0, 2)) + slack])


def _holds(drawing: Drawing, controls: Floats, points: Floats) -> Flags:
    """Tell which points (n, 3) lie in the solids that are drawn on controls (k, 3, m)."""
    from porous.models.drawing import SPLITS
    from porous.models.inside import Images, tetrahedra

    if len(points) and drawing.primitive is not None:
        frames = drawing.frames(controls)
        size = np.linalg.norm(frames[:, :, :3], axis=(1, 2))
        frames = frames[np.abs(np.linalg.det(frames[:, :, :3])) > FLAT * size**3]
        if len(frames):
            return Images(drawing.primitive, frames, np.zeros((0, 4))).contains(points)
    if len(points) and drawing.solid:
        corners = product(controls, drawing.mix)[:, :, list(drawing.solid)].swapaxes(1, 2)
        return tetrahedra(SPLITS[len(drawing.solid)](corners)).contains(points)
    return np.zeros(len(points), np.bool_)
