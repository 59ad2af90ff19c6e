"""Model, grid, surface and mesh held against each other."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import TYPE_CHECKING

from porous.measures import measure
from porous.models.model import HasBoundary
from porous.values import Measures
from porous.values.measure import SUBJECTS
from porous.values.value import Value

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from porous.models.model import Model
    from porous.stages import StreamedSurface
    from porous.values import Measure, SurfaceMesh, Tiled, VolumeMesh

TARGETS: Mapping[str, float] = MappingProxyType(
    {
        "volume": 0.01,
        "surface_area": 0.05,
        "components": 0.0,
        "euler_number": 0.0,
        "components_26": 0.0,
        "euler_number_26": 0.0,
    }
)
"""What is compared, and by what part of its value a surface or a mesh may be off. The closed
union's topology (26) is held up only to a surface that is its boundary and to cells that make it.
"""

BY_CONSTRUCTION = ("exact boundary", "cells")
"""Methods of surfaces and meshes that are the body itself."""

ORDERS: Mapping[str, float] = MappingProxyType({"volume": 2.0, "surface_area": 1.0})
"""How fast the error of a surface from voxels falls with their size: edges and corners that are
cut off lose volume with its square and area in proportion."""

THIN = 1.6
"""That of the volume where the smallest feature has three voxels or fewer."""

MADE = {"surface", "volume"}

COVERAGE = 2.0
"""Standard uncertainties by which an estimate may be off: about 95 %."""

ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class Check(Value):
    """One quantity of the model, the grid, the surface and the volume mesh side by side.

    Parameters
    ----------
    quantity, unit
        What is compared.
    model, grid, surface, volume
        Its values, None where it is not known.
    width
        How far the grid's own estimate may be off, in ``unit``.
    tolerance
        How far surface and mesh may be off, in ``unit``.
    verdict
        ``agree``; ``differ``; ``unknown`` where there is nothing to compare with, or what there is
        is not known well enough.
    remedy
        What would mend it or explains it, empty where nothing needs to be.
    """

    quantity: str
    unit: str
    model: float | None
    grid: float | None
    surface: float | None
    volume: float | None
    width: float
    tolerance: float
    verdict: str
    remedy: str = ""


@dataclass(frozen=True, eq=False)
class Certificate(Value):
    """Every check of a result; ``str()`` gives a table."""

    rows: tuple[Check, ...] = ()

    def __post_init__(self) -> None:
        self._set("rows", tuple(self.rows))

    @property
    def good(self) -> bool:
        """Whether no quantity differs."""
        return all(row.verdict != "differ" for row in self.rows)

    def __str__(self) -> str:
        head = ("certificate", *SUBJECTS, "tolerance", "verdict")
        lines = [head, *(_cells(row) for row in self.rows)]
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        table = ["  ".join(map(str.ljust, line, widths)).rstrip() for line in lines]
        return "\n".join(
            table + [f"{row.quantity}: {row.remedy}" for row in self.rows if row.remedy]
        )


def certify(
    model: Model | None = None,
    grid: Tiled | None = None,
    surface: SurfaceMesh | StreamedSurface | None = None,
    volume: VolumeMesh | None = None,
    *,
    measures: Measures | None = None,
) -> Certificate:
    """Return volume, area, components and Euler number of all that there is, side by side.

    What is known exactly (a closed form, an exact boundary, a model's own cells) is the reference,
    else the grid. A surface or a mesh agrees where it is within ``TARGETS`` of it, and what is
    exact where it is equal; what is measured on the grid is an estimate, and agrees where it is
    within that or twice its standard uncertainty.

    Where cells meet in points and edges alone, or voids in points, voxels that lie anyhow do not
    resolve their topology: a grid that alone differs in it is then not judged.

    Parameters
    ----------
    model, grid, surface, volume
        What was made; None where there is none.
    measures
        What is known of them. Where not given it is measured now, and surface and mesh are taken
        to be made from the grid.
    """
    if measures is None:
        measures = _measured(model, grid, surface, volume)
    periodic = grid is not None and any(grid.frame.periodic)
    voxels = max(grid.frame.shape) if grid is not None else None
    lattice = _lattice(measures, grid)
    found = {quantity: _rows_of(measures, quantity, periodic=periodic) for quantity in TARGETS}
    asked = {q: r for q, r in found.items() if r and (not q.endswith("_26") or {*r} & MADE)}
    # Where the volume is known in closed form, so is where the boundary lies.
    exact = isinstance(model, HasBoundary) and "model" in found["volume"]
    checks = []
    for quantity, rows in asked.items():
        check = _check(quantity, rows)
        check = replace(check, remedy=_remedy(check, rows, voxels, lattice, exact=exact))
        checks.append(_with_contacts(check, rows, measures))
    return Certificate(tuple(checks))


def _with_contacts(check: Check, rows: dict[str, Measure], measures: Measures) -> Check:
    """Return the check as what it is where cells touch without sharing a face."""
    if check.tolerance or "pinched_nodes" not in measures:
        return check
    count = measures["pinched_nodes"].value
    if check.verdict == "differ" and (count or _touching(measures)) and _only_grid_differs(rows):
        why = "cells meet in points or edges alone, which voxels do not resolve wherever they lie"
        return replace(check, verdict="unknown", remedy=why)
    if check.quantity == "euler_number" and check.verdict == "agree" and count:
        why = (
            f"at {count:g} points voids meet, which voxels join there; a boundary goes round each "
            "of them, and half of its own number is so much higher"
        )
        return replace(check, remedy=why)
    return check


def _touching(measures: Measures) -> bool:
    """Tell whether some number of the closed union is not that of what faces join."""
    for name in ("components", "euler_number"):
        joined, closed = (
            {row.value for row in measures.all(which) if _by_construction(row)}
            for which in (name, f"{name}_26")
        )
        if joined and closed and joined != closed:
            return True
    return False


def _only_grid_differs(rows: dict[str, Measure]) -> bool:
    return len({row.value for row in rows.values() if _by_construction(row)}) == 1


def _measured(
    model: Model | None,
    grid: Tiled | None,
    surface: SurfaceMesh | StreamedSurface | None,
    volume: VolumeMesh | None,
) -> Measures:
    subjects = [subject for subject in (model, grid, surface, volume) if subject is not None]
    return sum((measure(s, model=model, grid=grid) for s in subjects), start=Measures())


def _rows_of(measures: Measures, quantity: str, *, periodic: bool) -> dict[str, Measure]:
    """Return the best row of each subject; along periodic axes only the interface is area."""
    name = "interface_area" if periodic and quantity == "surface_area" else quantity
    by_subject = {s: Measures(tuple(r for r in measures if r.of == s)) for s in SUBJECTS}
    return {s: table[name] for s, table in by_subject.items() if name in table}


def _check(quantity: str, rows: dict[str, Measure]) -> Check:
    reference = _reference(list(rows.values()))
    tolerance = TARGETS[quantity] * abs(reference.value)
    verdicts = {
        _verdict(row, reference, tolerance) for row in rows.values() if row is not reference
    }
    verdict = next((v for v in ("differ", "unknown", "agree") if v in verdicts), "unknown")
    values = {subject: row.value for subject, row in rows.items()}
    return Check(
        quantity,
        reference.unit,
        values.get("model"),
        values.get("grid"),
        values.get("surface"),
        values.get("volume"),
        _width(rows["grid"]) if "grid" in rows else 0.0,
        tolerance,
        verdict,
    )


def _reference(rows: Sequence[Measure]) -> Measure:
    """Return the row that is held to be true: of the model, of the body itself, of the grid."""
    trusted = [row for row in rows if _by_construction(row)]
    return (trusted or list(rows))[0]


def _by_construction(row: Measure) -> bool:
    return row.of == "model" or row.method in BY_CONSTRUCTION


def _certain(row: Measure) -> bool:
    return _by_construction(row) or row.kind == "exact"


def _width(row: Measure) -> float:
    return (COVERAGE if row.kind == "standard" else 1.0) * row.uncertainty


def _verdict(row: Measure, reference: Measure, tolerance: float) -> str:
    gap = abs(row.value - reference.value)
    both_exact = row.kind == reference.kind == "exact"
    allowed = (0.0 if both_exact else tolerance) + ROUNDING * abs(reference.value)
    if row.of == "grid":
        allowed = max(allowed, _width(row))
    if gap <= allowed:
        return "agree"
    return "differ" if _certain(reference) or gap > allowed + _width(reference) else "unknown"


def _lattice(measures: Measures, grid: Tiled | None) -> int | None:
    """Return how many smallest features make the longest edge, where that is a whole number."""
    if grid is None or "smallest_feature" not in measures:
        return None
    count = max(grid.frame.box.lengths) / measures["smallest_feature"].value
    return round(count) if math.isclose(count, round(count), rel_tol=1e-6) else None


def _remedy(
    check: Check,
    rows: dict[str, Measure],
    voxels: int | None,
    lattice: int | None,
    *,
    exact: bool,
) -> str:
    if check.verdict == "agree":
        return ""
    if len(rows) < 2:
        return "there is nothing to compare it with"
    made = [row for row in rows.values() if row.of in MADE]
    if all(map(_by_construction, rows.values())):
        return "all of these are exact, and one is wrong: that is a fault of porous; tell us"
    if exact and made and all(row.method not in BY_CONSTRUCTION for row in made):
        return 'surface.method = "exact" takes the boundary from the model, without voxels' + (
            f"; or {_finer(check, rows, voxels, lattice)}" if voxels else ""
        )
    tetrahedra = any(row.method == "tetrahedra" for row in made)
    if tetrahedra and any(row.method in BY_CONSTRUCTION for row in made):
        return "the tetrahedra depart from their surface: wanted a shorter volume.edge_length"
    if not voxels:
        return "wanted more voxels, or a shorter volume.edge_length"
    return _finer(check, rows, voxels, lattice)


def _finer(check: Check, rows: dict[str, Measure], voxels: int, lattice: int | None) -> str:
    """Name the resolution at which the difference would be within its tolerance."""
    if not check.tolerance:
        return (
            f"more than {2 * voxels} voxels along the longest edge keep thin walls and gaps apart"
        )
    reference = _reference(list(rows.values()))
    gap = max(abs(row.value - reference.value) for row in rows.values())
    whole = any(row.method == "hexahedra" for row in rows.values())  # whole voxels: first order
    thin = lattice is not None and voxels <= 3 * lattice
    order = 1.0 if whole else min(ORDERS[check.quantity], THIN if thin else 2.0)
    needed = math.ceil(voxels * max((gap / check.tolerance) ** (1 / order), 1.2))
    fits = ""
    if lattice is not None:
        # Off the lattice a face may come out a twelfth of a voxel away from where it is.
        needed, fits = -(-needed // lattice) * lattice, f" (a multiple of {lattice})"
    return (
        f"about {needed} voxels along the longest edge{fits} would be within {check.tolerance:.2g}"
    )


def _cells(row: Check) -> tuple[str, ...]:
    values = (row.model, row.grid, row.surface, row.volume)
    unit = "" if row.unit == "1" else f" {row.unit}"
    shown = ["—" if value is None else f"{value:.7g}" for value in values]
    shown[1] += f" ± {row.width:.2g}" if row.width else ""
    return (f"{row.quantity}{unit}", *shown, f"{row.tolerance:.2g}", row.verdict)
