"""Subdivision matrices that satisfy every constraint, nearest to a guess, and what stays free.

The states are solved from vertices to volumes: what is asked of a state's children is then known,
since it is made of the matrices of its boundaries (``models.constraints``). A designer moves what
is free by sliders and tears nothing: what an edge becomes, it is in every face and volume.
"""

from __future__ import annotations

import difflib
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import ModelError
from porous.models.automaton import Automaton, State, Transition, numbers
from porous.models.constraints import (
    CONTRADICTION,
    RANK,
    directions,
    nearest_matrices,
    right_side,
    summing_to,
    system_of,
)
from porous.models.rational import ROWS, scaled
from porous.values.value import Value, frozen

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import ArrayLike, NDArray

    from porous.models.automaton import Cells
    from porous.models.brep import BRep, CellState
    from porous.models.constraints import System

    Floats = NDArray[np.float64]

LATTICES = {2: (1, 2), 4: (2, 2), 8: (3, 2), 3: (1, 3), 9: (2, 3), 27: (3, 3)}
"""Cells whose controls are a lattice: number of axes and of controls along each."""


@dataclass(frozen=True, eq=False)
class Slider(Value):
    """A free point of a state's subdivision: the slots that a move takes along.

    Parameters
    ----------
    name
        ``state.child.control`` of its first slot.
    state
        Index of the state.
    size
        How many numbers a move has: the controls m of the state. They sum to zero.
    slots, values
        The slots that it moves, in order, and how far: the point's own by 1.
    width
        Number of slots of the state.
    """

    name: str
    state: int
    size: int
    slots: NDArray[np.int64]
    values: NDArray[np.float64]
    width: int

    def __post_init__(self) -> None:
        self._set("slots", frozen(self.slots, np.int64))
        self._set("values", frozen(self.values, np.float64))

    @property
    def direction(self) -> NDArray[np.float64]:
        """The pattern over the slots, (width,), of which C keeps nothing: direction·C = 0."""
        result = np.zeros(self.width)
        result[self.slots] = self.values
        return result


@dataclass(frozen=True, eq=False)
class Solution(Value):
    """Subdivision matrices of a boundary representation, and what is free in them.

    Parameters
    ----------
    brep
        What was solved.
    matrices
        For each state, the matrix (m, m_child) of each of its children.
    sliders
        The free points of all states, vertices first. Vertices of one control have none: a point
        has nowhere to go.
    residual
        Largest |X·C − D| of all constraints of all states.
    """

    brep: BRep
    matrices: tuple[tuple[NDArray[np.float64], ...], ...]
    sliders: tuple[Slider, ...]
    residual: float

    def __post_init__(self) -> None:
        self._set(
            "matrices",
            tuple(tuple(frozen(T, np.float64) for T in group) for group in self.matrices),
        )
        self._set("sliders", tuple(self.sliders))

    def __setstate__(self, state: dict[str, object]) -> None:
        super().__setstate__(state)
        self.__post_init__()

    def free_points(self, state: int) -> int:
        """Return the number of free subdivision points of a state."""
        return sum(slider.state == state for slider in self.sliders)

    def degrees_of_freedom(self, state: int) -> int:
        """Return (m − 1) for each free point: its weights sum to one."""
        return (self.brep.states[state].size - 1) * self.free_points(state)

    def automaton(
        self,
        controls: ArrayLike | None = None,
        *,
        scale: float = 1.0,
        roots: tuple[Cells, ...] = (),
    ) -> Automaton:
        """Return the automaton of the states that come of the start, the start first.

        Parameters
        ----------
        controls
            Control points of the start, in place of its reference positions: (3, m), or with
            weights (4, m), homogeneous.
        scale
            Factor of all controls: the length of a model unit.
        roots
            The level-0 cells where there are several, by their places among ``brep.reached``.

        Raises
        ------
        ModelError
            For controls of a wrong shape, or a start without children.
        """
        states = [self.brep.states[q] for q in self.brep.reached]
        places = [state.controls for state in states]
        if controls is not None:
            places[0] = numbers(controls, f"controls of {states[0].name}")
            if places[0].shape not in [(rows, states[0].size) for rows in ROWS]:
                raise ModelError(
                    f"controls of {states[0].name}: got shape {places[0].shape}; "
                    f"wanted {states[0].controls.shape}"
                )
        kinds = [
            State(q.name, scaled(place, scale)) for q, place in zip(states, places, strict=True)
        ]
        return Automaton(tuple(kinds), self._transitions, roots=roots)

    @cached_property
    def _transitions(self) -> tuple[Transition, ...]:
        place = {q: index for index, q in enumerate(self.brep.reached)}
        return tuple(
            Transition(place[q], place[child.state], matrix)
            for q in self.brep.reached
            for child, matrix in zip(self.brep.states[q].children, self.matrices[q], strict=True)
        )


def solve(brep: BRep, moves: Mapping[str, ArrayLike] | None = None) -> Solution:
    """Return the matrices nearest to the children's guesses under all constraints, then moved.

    Nearest in the Frobenius norm: X = G + (D − G·C)·C⁺ with G the guesses. A point that several
    children share without a constraint on its place gets the mean of their guesses; one on the
    boundary gets what the boundary's matrices say.

    Parameters
    ----------
    brep
        Cells, their boundaries and what they share.
    moves
        For names of sliders, what is added to the weights of the free point: m numbers that sum
        to zero, or three, where m is not three: a displacement in the reference cell (see
        ``displacement_weights``). Moves of an edge move it in all faces and volumes it is in.

    Raises
    ------
    ModelError
        For constraints that contradict each other, naming a smallest set of them; a slider that
        is not there, naming the nearest; moves of a wrong length or sum.
    """
    given = moves or {}
    systems = [system_of(brep, index) for index in range(len(brep.states))]
    sliders = [slider for q in brep.by_dimension for slider in _sliders(brep, systems[q])]
    _check_names(given, sliders)
    matrices: list[tuple[Floats, ...]] = [()] * len(brep.states)
    residual = 0.0
    for q in brep.by_dimension:
        wanted = right_side(brep, systems[q], matrices)
        nearest = nearest_matrices(brep, systems[q], wanted)
        X = nearest.copy()
        for slider in sliders:
            if slider.state == q and slider.name in given:
                move = _move(brep.states[q], slider, given[slider.name], nearest)
                X[:, slider.slots] += np.outer(move, slider.values)
        gap = np.abs((systems[q].C.T @ X.T).T - wanted)
        residual = max(residual, float(gap.max(initial=0.0)))
        matrices[q] = tuple(np.split(X, systems[q].starts[1:-1], axis=1))[: systems[q].children]
    return Solution(brep, tuple(matrices), tuple(sliders), residual)


# --- what is free ----------------------------------------------------------------------------


def _sliders(brep: BRep, system: System) -> list[Slider]:
    state = brep.states[system.state]
    if state.size == 1 or not len(system.part):
        return []
    found = sorted(directions(system), key=lambda pair: int(pair[0][0]))
    width = len(system.part)
    return [
        Slider(_slot_name(state, system, slots[0]), system.state, state.size, slots, values, width)
        for slots, values in found
    ]


def _slot_name(state: CellState, system: System, slot: np.int64) -> str:
    child = int(np.searchsorted(system.starts, slot, side="right")) - 1
    return f"{state.name}.{state.children[child].name}.{slot - int(system.starts[child])}"


# --- moves -----------------------------------------------------------------------------------


def _check_names(moves: Mapping[str, ArrayLike], sliders: list[Slider]) -> None:
    known = [slider.name for slider in sliders]
    for name in moves:
        if known.count(name) > 1:
            raise ModelError(f"slider {name!r}: is {known.count(name)} sliders; wanted one")
        if name not in known:
            close = difflib.get_close_matches(name, known, n=1, cutoff=0.0)
            hint = f"the nearest of {len(known)} is {close[0]!r}" if close else "nothing is free"
            raise ModelError(f"slider {name!r} is not there; {hint}")


def _move(state: CellState, slider: Slider, value: ArrayLike, nearest: Floats) -> Floats:
    move = numbers(value, f"slider {slider.name}")
    if move.shape == (3,) and state.size != 3:
        return displacement_weights(state, nearest[:, slider.slots[0]], move)
    if move.shape != (state.size,):
        raise ModelError(
            f"slider {slider.name}: got numbers of shape {move.shape}; wanted {state.size} weights "
            "that sum to zero" + ("" if state.size == 3 else ", or 3 of a displacement")
        )
    if abs(move.sum()) > CONTRADICTION * max(1.0, np.abs(move).sum()):
        raise ModelError(
            f"slider {slider.name}: got weights that sum to {move.sum():.9g}; wanted 0"
        )
    return summing_to(0.0, move[:, None])[:, 0]


def displacement_weights(
    state: CellState, point: ArrayLike, displacement: ArrayLike
) -> NDArray[np.float64]:
    """Return what to add to a point's weights so that it is displaced in the reference cell.

    N(x + d) − N(x) with x = controls·point and N the shape functions of the reference cell:
    tensor Lagrange polynomials where its controls are a lattice of 2 or 3 along each axis,
    barycentric coordinates in triangles and tetrahedra; elsewhere the smallest weights that do.

    Parameters
    ----------
    state
        The cell; its reference controls (3, m).
    point
        Weights (m,) of the point.
    displacement
        Three numbers, in the units of the reference controls.

    Returns
    -------
    float64 (m,), with sum 0 and controls·result = displacement.

    Raises
    ------
    ModelError
        Where the cell has no extent in that direction.
    """
    start = state.controls @ np.asarray(point, np.float64)
    step = np.asarray(displacement, np.float64)
    axes = _lattice(state)
    if axes is None:
        lifted = np.vstack([state.controls, np.ones(state.size)])
        result = np.linalg.pinv(lifted, rcond=RANK) @ np.append(step, 0.0)
    else:
        inverse = np.linalg.pinv(axes)
        local = [inverse @ (x - state.controls[:, 0]) for x in (start, start + step)]
        result = _lagrange(state.size, local[1]) - _lagrange(state.size, local[0])
    if np.abs(state.controls @ result - step).max() > CONTRADICTION * max(1.0, np.abs(step).max()):
        raise ModelError(
            f"state {state.name}: got displacement {step.tolist()}; wanted one along its "
            f"{state.shape}, which is all that its {state.size} controls reach"
        )
    return summing_to(0.0, result[:, None])[:, 0]


def _lattice(state: CellState) -> Floats | None:
    # The axes (3, k) of controls that are a lattice, lexicographic; None where they are not.
    if state.size not in LATTICES or state.shape in {"triangle", "tetra"}:
        return None
    dimension, along = LATTICES[state.size]
    ends = [(along - 1) * along**axis for axis in reversed(range(dimension))]
    axes = state.controls[:, ends] - state.controls[:, [0]]
    steps = np.indices((along,) * dimension).reshape(dimension, -1) / (along - 1)
    gap = np.abs(state.controls[:, [0]] + axes @ steps - state.controls).max()
    flat = np.linalg.matrix_rank(axes) < dimension
    return None if flat or gap > CONTRADICTION * np.abs(axes).max() else np.asarray(axes)


def _lagrange(size: int, local: Floats) -> Floats:
    along = LATTICES[size][1]
    result = np.ones(1)
    for u in local:
        two, three = [1 - u, u], [(1 - u) * (1 - 2 * u), 4 * u * (1 - u), u * (2 * u - 1)]
        result = np.kron(result, two if along == 2 else three)
    return result
