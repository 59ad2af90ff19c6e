"""What an OpenFOAM case says beside its mesh: solver, schemes, properties, fields; always in SI.

Heat and what diffuses are solved by laplacianFoam. Its field is T and its diffusivity DT; of a
steady state only the product of DT and the slope of T counts, so DT bears the number of the
conductivity, and rates come out in W. Flow is solved by simpleFoam, laminar; its pressure is
divided by the density. Function objects write after each iteration what leaves the body through
each side that is held, and of a flow the mean pressure there in Pa.
https://www.openfoam.com/documentation/user-guide
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import FormatError
from porous.formats._foam_mesh import WALL, held_patch, word
from porous.values.units import SYSTEMS, system_ratio

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from numpy.typing import NDArray

    from porous.formats._foam_mesh import PolyMesh
    from porous.values import Held, Job, Step

    Rates = Mapping[str, float]

SI = SYSTEMS[1]
SCALARS = {
    "conduction": ("conductivity", "temperature", "[0 0 0 1 0 0 0]"),
    "diffusion": ("diffusivity", "concentration", "[0 0 0 0 0 0 0]"),
}
"""What laplacianFoam does: what it needs of a material, what is held, and the dimensions of T."""
OUT, PRESSURE = "out-", "pressure-"
"""How the names of the function objects begin; the patch follows."""
ROUNDS = 200
"""The most rounds in which laplacianFoam corrects for faces that are not orthogonal."""
ITERATIONS = 3000
"""The most of simpleFoam."""

SCHEMES = """\
ddtSchemes { default steadyState; }
gradSchemes { default Gauss linear; }
divSchemes
{
    default none;
    div(phi,U) bounded Gauss linearUpwind grad(U);
    div((nuEff*dev2(T(grad(U))))) Gauss linear;
}
laplacianSchemes { default Gauss linear corrected; laplacian(DT,T) Gauss harmonic corrected; }
interpolationSchemes { default linear; }
snGradSchemes { default corrected; }
"""

SOLUTION = """\
solvers
{
    T { solver PCG; preconditioner DIC; tolerance 1e-11; relTol 0; maxIter 20000; }
    p { solver GAMG; smoother DICGaussSeidel; tolerance 1e-14; relTol 0.01; }
    U { solver PBiCGStab; preconditioner DILU; tolerance 1e-14; relTol 0.01; }
}
SIMPLE
{
    consistent yes;
    nNonOrthogonalCorrectors 0;
    pRefCell 0;
    pRefValue 0;
    residualControl { T 1e-8; p 1e-6; U 1e-5; }
}
relaxationFactors { equations { U 0.9; } }
"""


@dataclass(frozen=True)
class Case:
    """What stands in the files of a case beside its mesh."""

    application: str = "checkMesh"
    iterations: int = 1
    properties: Mapping[str, str] = field(default_factory=dict)
    """Of ``constant``: a dictionary's name, and what stands in it."""
    fields: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    """Of ``0``: a field's name, its class, and what stands in it."""
    functions: str = ""
    walls: frozenset[str] = frozenset()
    zones: Mapping[str, NDArray[np.int64]] = field(default_factory=dict)
    """Zones of boundary faces besides those of the mesh."""


def case_of(job: Job | None, poly: PolyMesh) -> Case:
    """Return the case of a job; of a mesh, or of a job without a step, one that is only checked.

    Raises
    ------
    FormatError
        For what a case cannot hold: several steps, tied sides, pressed faces, several fluids.
    """
    if job is None or not job.steps:
        return Case()
    if len(job.steps) > 1:
        raise FormatError(f"a case holds one step; got {len(job.steps)}")
    step = job.steps[0]
    if job.tied or step.gradient:
        raise FormatError(f"a case cannot hold tied sides; got {', '.join(job.tied)}")
    if step.pressed:
        raise FormatError(f"step {step.name!r}: got pressed faces; wanted a pressure that is held")
    if not step.held:
        raise FormatError(f"step {step.name!r}: nothing is held, so nothing would happen")
    return _flow(job, step, poly) if step.procedure == "flow" else _scalar(job, step, poly)


# --- heat, and what diffuses ---------------------------------------------------------------------


def _scalar(job: Job, step: Step, poly: PolyMesh) -> Case:
    needed, quantity, dimensions = SCALARS[step.procedure]
    values: dict[str, float] = {}
    for held in step.held:
        patch = held_patch(job.mesh, held.part)
        if held.quantity != quantity:
            _cannot(step, held, quantity)
        if patch in values:
            raise FormatError(f"step {step.name!r}: {patch} is held twice")
        values[patch] = held.value
    ratio = system_ratio(SI, needed)
    rates = {name: made.known(needed) * ratio for name, made in job.materials.items()}
    boundary = {
        name: _fixed(repr(values[name])) if name in values else "type zeroGradient;"
        for name in poly.patches
    }
    start = f"uniform {(min(values.values()) + max(values.values())) / 2!r}"
    fields = {"T": ("volScalarField", _field(dimensions, start, boundary))}
    several = len(set(rates.values())) > 1
    if several:
        fields["DT"] = ("volScalarField", _rates(job, rates, poly))
    sides = _sides(job, poly, tuple(values)) if several else {}
    places = {name: ("faceZone", rates[part]) for name, (part, _) in sides.items()}
    first = next(iter(rates.values()))
    return Case(
        "laplacianFoam",
        ROUNDS,
        {"transportProperties": f"DT {first!r};\n"},
        fields,
        "".join(_slopes(places or dict.fromkeys(values, ("patch", first)))),
        zones={name: faces for name, (_, faces) in sides.items()},
    )


def _rates(job: Job, rates: Rates, poly: PolyMesh) -> str:
    """Return the field of a conductivity that is not everywhere the same."""
    known = np.full(poly.cells, np.nan)
    for name, rate in rates.items():
        known[job.mesh.parts[name].members] = rate
    if np.isnan(known).any():
        raise FormatError(f"{int(np.isnan(known).sum())} cells are of no material")
    listed = "\n".join(map(repr, known.tolist()))
    start = f"nonuniform List<scalar>\n{poly.cells}\n(\n{listed}\n)\n"
    return _field("[0 2 -1 0 0 0 0]", start, dict.fromkeys(poly.patches, "type zeroGradient;"))


def _sides(
    job: Job, poly: PolyMesh, patches: tuple[str, ...]
) -> dict[str, tuple[str, NDArray[np.int64]]]:
    """Return zones of each patch's faces by the part of cells behind them, which is named."""
    zones = {}
    for patch in patches:
        place = np.arange(poly.patches[patch].start, poly.patches[patch].stop)
        for part in job.materials:
            behind = np.isin(poly.owner[place], job.mesh.parts[part].members)
            if behind.any():
                zones[f"{patch}-{word(part)}"] = part, place[behind]
    return zones


def _slopes(places: Mapping[str, tuple[str, float]]) -> Iterator[str]:
    """Give the function objects of what leaves through patches or zones of one conductivity."""
    yield (
        '    slope\n    {\n        type grad;\n        libs ("libfieldFunctionObjects.so");\n'
        "        field T;\n        executeControl timeStep;\n        writeControl none;\n    }\n"
    )
    for name, (kind, rate) in places.items():
        yield _on_face(OUT + name, kind, name, "grad(T)", "areaNormalIntegrate", -rate)


# --- flow ----------------------------------------------------------------------------------------


def _flow(job: Job, step: Step, poly: PolyMesh) -> Case:
    fluids = set(job.materials.values())
    if len(fluids) != 1:
        raise FormatError(f"a case of simpleFoam holds one fluid; got {len(fluids)} materials")
    fluid = next(iter(fluids))
    density = fluid.known("density") * system_ratio(SI, "density")
    viscosity = fluid.known("viscosity") * system_ratio(SI, "viscosity")
    ratio = system_ratio(SI, "pressure") / density
    speed, head, ends = {}, {}, []
    for patch, held in _by_patch(job, step).items():
        speed[patch], head[patch] = _at(step, patch, held, ratio)
        ends += [patch] if speed[patch] != "type slip;" else []
    walls = [patch for patch in poly.patches if patch not in speed]
    still = dict.fromkeys(walls, "type noSlip;")
    closed = dict.fromkeys(walls, "type zeroGradient;")
    return Case(
        "simpleFoam",
        ITERATIONS,
        {
            "transportProperties": f"transportModel Newtonian;\nnu {viscosity / density!r};\n"
            f"// density {density!r} kg/m3: p is the pressure divided by it\n",
            "turbulenceProperties": "simulationType laminar;\n",
        },
        {
            "p": ("volScalarField", _field("[0 2 -2 0 0 0 0]", "uniform 0", head | closed)),
            "U": ("volVectorField", _field("[0 1 -1 0 0 0 0]", "uniform (0 0 0)", speed | still)),
        },
        "".join(_streams(ends, density)),
        frozenset((*walls, WALL)),
    )


def _by_patch(job: Job, step: Step) -> dict[str, list[Held]]:
    found: dict[str, list[Held]] = {}
    for held in step.held:
        found.setdefault(held_patch(job.mesh, held.part), []).append(held)
    return found


def _at(step: Step, patch: str, held: list[Held], ratio: float) -> tuple[str, str]:
    """Return the conditions of velocity and pressure on a patch."""
    first = held[0]
    if len(held) == 1 and first.quantity == "pressure":
        return "type zeroGradient;", _fixed(repr(first.value * ratio))
    for other in held:
        if other.quantity != "velocity":
            _cannot(step, other, "a pressure, or a velocity")
    normal = "XYZ".index(patch[0])
    if len(held) == 1 and first.components == (normal,) and not first.value:
        return "type slip;", "type zeroGradient;"
    parts = {axis: other.value for other in held for axis in other.components}
    if len(parts) != 3 or len(parts) != sum(len(other.components) for other in held):
        raise FormatError(
            f"step {step.name!r}: the velocity on {patch} is held in part; wanted all three "
            "components once, or nothing but zero across the side, where it slips"
        )
    speed = [parts[axis] * system_ratio(SI, "velocity") for axis in range(3)]
    return _fixed("({!r} {!r} {!r})".format(*speed)), "type zeroGradient;"


def _streams(patches: list[str], density: float) -> Iterator[str]:
    for patch in patches:
        yield _on_face(OUT + patch, "patch", patch, "phi", "sum", 1.0)
        yield _on_face(PRESSURE + patch, "patch", patch, "p", "areaAverage", density)


# --- pieces --------------------------------------------------------------------------------------


def _cannot(step: Step, held: Held, wanted: str) -> None:
    raise FormatError(
        f"step {step.name!r}: got {held.quantity} held on {held.part}; wanted {wanted}"
    )


def _fixed(value: str) -> str:
    return f"type fixedValue; value uniform {value};"


def _field(dimensions: str, start: str, boundary: Mapping[str, str]) -> str:
    patches = "".join(f"    {name} {{ {held} }}\n" for name, held in boundary.items())
    return f"dimensions {dimensions};\ninternalField {start};\nboundaryField\n{{\n{patches}}}\n"


def _on_face(name: str, region: str, place: str, of: str, operation: str, scale: float) -> str:
    return (
        f"    {name}\n    {{\n        type surfaceFieldValue;\n"
        '        libs ("libfieldFunctionObjects.so");\n'
        f"        regionType {region};\n        name {place};\n        fields ({of});\n"
        f"        operation {operation};\n        scaleFactor {scale!r};\n"
        "        writeFields no;\n        log no;\n"
        "        writeControl timeStep;\n        writeInterval 1;\n    }\n"
    )
