"""What a job adds to the mesh of a CalculiX or Abaqus deck: ties, materials, steps.

Elements of heat are of type DC3D…: Abaqus needs these, CalculiX takes them for its own. A field of
temperature has the degree of freedom 11 in both.
"""

from __future__ import annotations

import re
import textwrap
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import FormatError
from porous.values.ties import ties
from porous.values.units import length_ratio, system_length, system_ratio

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from porous.values import Held, Job, Material, Step, VolumeMesh
    from porous.values.ties import Ties

PROCEDURES = ("static", "modal", "conduction")
"""What steps are written."""

REFERENCE, FAR = "REF_", "FAR_"
"""How the names begin of the sets of a reference node, and of the nodes that lie a period on; then
comes the part of pairs."""
TEMPERATURE = 11
SLAB = 10_000
PER_LINE = 16
TERMS = 4
"""Terms of an equation in a line."""
WIDTH = 78

UNITS = {
    "mm-N-MPa": "lengths in mm, forces in N, stresses in MPa, densities in t/mm3, heat in mW",
    "m-SI": "lengths in m, forces in N, stresses in Pa, densities in kg/m3, heat in W",
}


class Deck:
    """A job on its way into a deck: its names there, its ratio of units, its tied nodes.

    Parameters
    ----------
    job
        With steps of ``PROCEDURES``.
    names
        Of the mesh's parts, in the deck.
    everything
        The name of the set of all elements.
    """

    def __init__(self, job: Job, names: Mapping[str, str], everything: str) -> None:
        self.job, self.names, self.everything = job, names, everything
        self.mesh: VolumeMesh = job.mesh
        self.ties: Ties | None = ties(job.mesh, job.tied) if job.tied else None

    def ratio(self, dimension: str) -> float:
        """Return how many of the deck's units one of the job's is."""
        return system_ratio(self.job.system, dimension)

    @property
    def is_thermal(self) -> bool:
        """Whether steps are of heat; a deck's elements are of heat or of stress."""
        kinds = {step.procedure == "conduction" for step in self.job.steps}
        if len(kinds) > 1:
            raise FormatError("steps of heat and of stress; a deck holds one kind")
        return kinds == {True}

    def references(self) -> Iterator[bytes]:
        """Give the reference nodes, one for each part of pairs, numbered after all others.

        Their displacement, or temperature, is what a field gains over one period.
        """
        if self.ties is None:
            return
        where = self.mesh.points.min(axis=0) + self.ties.periods
        where = where * length_ratio(self.mesh.unit, system_length(self.job.system))
        for index, (name, (x, y, z)) in enumerate(zip(self.job.tied, where.tolist(), strict=True)):
            number = len(self.mesh.points) + 1 + index
            yield lines(f"*NODE, NSET={self._reference(name)}")
            yield lines(f"{number}, {x:.9e}, {y:.9e}, {z:.9e}")

    def far(self) -> Iterator[bytes]:
        """Give the sets on which the forces are added up that drive each part of pairs.

        CalculiX prints no reaction at a reference node: its RF are the forces of the elements.
        """
        for index, name in enumerate(self.job.tied if self.ties else ()):
            assert self.ties is not None
            yield from node_set("NSET", FAR + self.names[name], self.ties.far(index) + 1)

    def equations(self) -> Iterator[bytes]:
        """Give the equation of every node that is tied: u = u(root) + whole numbers of u(REF_…).

        No node is on the left of two: whatever is in several pairs is tied to one root.
        """
        if self.ties is None:
            return
        tied = np.flatnonzero(self.ties.root != np.arange(len(self.ties.root)))
        offset = self.ties.offset[tied]
        yield lines("*EQUATION")
        for pattern in np.unique(offset != 0, axis=0):
            own = tied[((offset != 0) == pattern).all(axis=1)]
            yield from self._equations(own, np.flatnonzero(pattern))

    def _equations(self, own: NDArray[np.int64], parts: NDArray[np.int64]) -> Iterator[bytes]:
        assert self.ties is not None
        freedoms = (TEMPERATURE,) if self.is_thermal else (1, 2, 3)
        offset = self.ties.offset[own][:, parts]
        ends = [np.column_stack([own + 1, np.ones(len(own))])]
        ends.append(np.column_stack([self.ties.root[own] + 1, -np.ones(len(own))]))
        for index, part in enumerate(parts.tolist()):
            reference = np.full(len(own), len(self.mesh.points) + 1 + part)
            ends.append(np.column_stack([reference, -offset[:, index]]))
        table = np.concatenate(ends, axis=1).astype(np.int64)
        form = "".join(_equation(len(ends), freedom) for freedom in freedoms)
        yield from rows(np.tile(table, (1, len(freedoms))), form)

    def materials(self) -> Iterator[bytes]:
        """Give each material with what is known of it, and what is made of it."""
        told: dict[str, Material] = {}
        for part, material in self.job.materials.items():
            name = set_name(material.name)
            if told.setdefault(name, material) != material:
                raise FormatError(f"two materials would both be {name} in a deck")
            yield b"" if part != self._first_of(material) else self._material(name, material)
            yield lines(f"*SOLID SECTION, ELSET={self._cells(part)}, MATERIAL={name}")

    def _first_of(self, material: Material) -> str:
        return next(part for part, other in self.job.materials.items() if other == material)

    def _cells(self, part: str) -> str:
        return self.names[part]

    def _material(self, name: str, material: Material) -> bytes:
        def told(key: str, dimension: str) -> str:
            value: float = getattr(material, key)
            return f"{value * self.ratio(dimension):.9e}"

        said = [f"*MATERIAL, NAME={name}"]
        if material.youngs_modulus is not None and material.poissons_ratio is not None:
            said += ["*ELASTIC", f"{told('youngs_modulus', 'pressure')}, "]
            said[-1] += told("poissons_ratio", "number")
        for key, card in (
            ("density", "*DENSITY"),
            ("conductivity", "*CONDUCTIVITY"),
            ("specific_heat", "*SPECIFIC HEAT"),
        ):
            if getattr(material, key) is not None:
                said += [card, told(key, key)]
        return comment(material.source) + lines(*said)

    def steps(self) -> Iterator[bytes]:
        """Give the steps, or why there are none."""
        if not self.job.steps:
            yield comment(f"no step: {self.job.why_no_step}")
        for index, step in enumerate(self.job.steps):
            yield comment(f"step {step.name}")
            yield lines("*STEP", *_procedure(step))
            yield from self._held(step, new=index > 0)
            yield from self._pressed(step, new=index > 0)
            yield lines(*self._wanted(step), "*END STEP")

    def _held(self, step: Step, *, new: bool) -> Iterator[bytes]:
        said = [line for held in step.held for line in self._boundary(held)]
        if step.gradient and self.ties is not None:
            gain = self._gain(step, self.ties)
            for name, values in zip(self.job.tied, gain.tolist(), strict=True):
                first = TEMPERATURE if len(values) == 1 else 1
                said += [
                    f"{self._reference(name)}, {freedom}, {freedom}, {value:.9e}"
                    for freedom, value in enumerate(values, first)
                ]
        if said:
            yield lines(f"*BOUNDARY{', OP=NEW' if new else ''}", *said)

    def _gain(self, step: Step, tied: Ties) -> NDArray[np.float64]:
        """Return what a field gains over each period, in the deck's units: (parts, components)."""
        periods = tied.periods * length_ratio(self.mesh.unit, "mm")
        slope = np.array(step.gradient).reshape(-1, 3)
        unit = "temperature" if step.procedure == "conduction" else "length"
        return np.asarray(periods @ slope.T * self.ratio(unit))

    def _boundary(self, held: Held) -> Iterator[str]:
        name = self.names[held.part]
        if held.quantity == "temperature":
            value = held.value * self.ratio("temperature")
            yield f"{name}, {TEMPERATURE}, {TEMPERATURE}, {value:.9e}"
        elif held.quantity == "displacement":
            value = held.value * self.ratio("length")
            tail = f", {value:.9e}" if value else ""
            for first, last in _runs(held.components):
                yield f"{name}, {first + 1}, {last + 1}{tail}"
        else:
            raise FormatError(f"a .inp file cannot hold a {held.quantity} at nodes")

    def _pressed(self, step: Step, *, new: bool) -> Iterator[bytes]:
        before = any(other.pressed for other in self.job.steps)
        if step.pressed or (new and before):
            yield lines(f"*DLOAD{', OP=NEW' if new else ''}")
        for pressed in step.pressed:
            faces = self.mesh.parts[pressed.part].members + 1
            value = pressed.pressure * self.ratio("pressure")
            yield from rows(faces, f"%d, P%d, {value:.9e}\n")

    def _wanted(self, step: Step) -> Iterator[str]:
        """Give what is printed, and what is kept for pictures."""
        heat, modal = step.procedure == "conduction", step.procedure == "modal"
        sets = [self.names[name] for name in dict.fromkeys(held.part for held in step.held)]
        sets += [FAR + self.names[name] for name in (self.job.tied if step.gradient else ())]
        for name in () if modal else sets:
            yield f"*NODE PRINT, NSET={name}, TOTALS=ONLY"
            yield "RFL" if heat else "RF"
        if not modal:
            yield f"*EL PRINT, ELSET={self.everything}, TOTALS=ONLY"
            yield "EVOL" if heat else "ELSE, EVOL"
        yield "*NODE FILE"
        yield "U" if modal else "NT, RFL" if heat else "U, RF"
        if not modal:
            yield "*EL FILE"
            yield "HFL" if heat else "S, E"

    def _reference(self, part: str) -> str:
        return REFERENCE + self.names[part]


def _procedure(step: Step) -> tuple[str, ...]:
    if step.procedure == "conduction":
        return ("*HEAT TRANSFER, STEADY STATE",)
    return ("*FREQUENCY", str(step.modes)) if step.procedure == "modal" else ("*STATIC",)


def _runs(components: Sequence[int]) -> Iterator[tuple[int, int]]:
    """Give first and last of each run of components: 0 and 2 are two runs."""
    for first in sorted(components):
        if first - 1 not in components:
            last = first
            while last + 1 in components:
                last += 1
            yield first, last


def _equation(terms: int, freedom: int) -> str:
    said = [f"%d, {freedom}, %d." for _ in range(terms)]
    broken = (", ".join(said[i : i + TERMS]) for i in range(0, terms, TERMS))
    return f"{terms}\n" + ",\n".join(broken) + "\n"


def rows(table: NDArray[np.int64], line: str = "") -> Iterator[bytes]:
    """Give a table of integers line by line: as ``line`` says, else with commas, 16 at most."""
    form = line or _broken(table.shape[1])
    for start in range(0, len(table) if table.size else 0, SLAB):
        slab = table[start : start + SLAB]
        yield (form * len(slab) % tuple(slab.ravel().tolist())).encode()


def _broken(count: int) -> str:
    parts = (["%d"] * min(PER_LINE, count - i) for i in range(0, count, PER_LINE))
    return ",\n".join(", ".join(part) for part in parts) + "\n"


def node_set(
    kind: str, name: str, numbers: NDArray[np.int64], *, ordered: bool = False
) -> Iterator[bytes]:
    """Give a set of nodes (``NSET``) or elements (``ELSET``).

    Where it is to stay ``ordered`` Abaqus is told so; CalculiX warns of the word and reads on.
    """
    mixed = ordered and (np.diff(numbers) < 0).any()
    yield lines(f"*{kind}, {kind}={name}{', UNSORTED' if mixed else ''}")
    whole = len(numbers) // PER_LINE * PER_LINE
    yield from rows(numbers[:whole].reshape(-1, PER_LINE))
    yield from rows(numbers[None, whole:])


def set_name(text: str) -> str:
    """Return a set's name: capitals, digits, _ and -, a letter first, at most 60."""
    name = re.sub(r"[^A-Z0-9_-]", "_", text.upper())[:60]
    return name if name[:1].isalpha() else f"N_{name}"


def plain(text: str) -> str:
    """Return one line of ASCII: no text of the user can become a card."""
    words = " ".join(text.split()).lstrip("*")
    return words.replace("³", "3").encode("ascii", "replace").decode()


def comment(text: str) -> bytes:
    """Return a comment of as many lines as it takes."""
    return lines(*(f"** {line}" for line in textwrap.wrap(plain(text), WIDTH)))


def lines(*texts: str) -> bytes:
    """Return lines."""
    return "".join(f"{line}\n" for line in texts).encode()
