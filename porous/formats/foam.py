"""FOAM: a folder that is an OpenFOAM case, ``name.foam``, with all that its solver needs.

A mesh becomes ``constant/polyMesh`` and as much of ``system`` as checkMesh wants. A job gets its
fields, properties, schemes and function objects too: conduction and diffusion for laplacianFoam,
laminar flow for simpleFoam. ``sh Allrun`` runs it, and ParaView opens the empty file that bears the
case's name. All is in SI, lengths in metres. Sides of the box are patches, the rest of the boundary
is ``WALL``; all other parts are zones. Written for OpenFOAM v1912 and later.
https://www.openfoam.com/documentation/user-guide
"""

from __future__ import annotations

import textwrap
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from porous.formats._foam_case import SCHEMES, SOLUTION, case_of
from porous.formats._foam_mesh import header, poly_mesh, poly_mesh_files
from porous.formats._registry import Format
from porous.values import Job, VolumeMesh

if TYPE_CHECKING:
    from collections.abc import Iterator

    from porous.formats._foam_case import Case

    File = tuple[str, Iterator[bytes]]

WIDTH = 76
PLACE = "/usr/share/openfoam"
"""Where Debian keeps what OpenFOAM wants to find and does not look for."""


def write_files(value: Job | VolumeMesh, name: str) -> Iterator[File]:
    """Give the files of a case."""
    job = value if isinstance(value, Job) else None
    mesh = value if isinstance(value, VolumeMesh) else value.mesh
    poly = poly_mesh(mesh)
    case = case_of(job, poly)
    more = {zone: (faces, np.zeros(len(faces), bool)) for zone, faces in case.zones.items()}
    poly = replace(poly, face_zones={**poly.face_zones, **more})
    for file, chunks in poly_mesh_files(poly, case.walls):
        yield f"constant/polyMesh/{file}", chunks
    for file, text in case.properties.items():
        yield f"constant/{file}", _whole(header("dictionary", file, location="constant"), text)
    for file, (kind, text) in case.fields.items():
        yield f"0/{file}", _whole(header(kind, file, location="0"), text)
    for file, text in _system(case).items():
        yield f"system/{file}", _whole(header("dictionary", file, location="system"), text)
    yield "Allrun", _whole(b"#!/bin/sh\n", _script(job, case))
    yield name, iter(())


def _system(case: Case) -> dict[str, str]:
    control = (
        f"application {case.application};\nstartFrom startTime;\nstartTime 0;\nstopAt endTime;\n"
        f"endTime {case.iterations};\ndeltaT 1;\nwriteControl timeStep;\n"
        f"writeInterval {case.iterations};\nwriteFormat ascii;\nwritePrecision 12;\n"
        "timePrecision 6;\n"
    )
    if case.functions:
        control += f"functions\n{{\n{case.functions}}}\n"
    return {"controlDict": control, "fvSchemes": SCHEMES, "fvSolution": SOLUTION}


def _script(job: Job | None, case: Case) -> str:
    told = ["made by porous; lengths in m, all else in SI"]
    if job is not None:
        why = f"no step: {job.why_no_step}" if not job.steps else ""
        told += [text for text in (job.title, job.note, why) if text]
    comments = "".join(
        f"# {line}\n" for text in told for line in textwrap.wrap(_plain(text), WIDTH)
    )
    checked = "checkMesh -allGeometry -allTopology"
    command = checked if case.application == "checkMesh" else case.application
    return (
        f'{comments}cd "$(dirname "$0")" || exit 1\n'
        f': "${{WM_PROJECT_DIR:={PLACE}}}"; export WM_PROJECT_DIR\n{command}\n'
    )


def _plain(text: str) -> str:
    """Return one line of ASCII; textwrap and the # before each line keep it a comment."""
    return " ".join(text.split()).replace("³", "3").encode("ascii", "replace").decode()


def _whole(start: bytes, text: str) -> Iterator[bytes]:
    yield start
    yield text.encode("ascii")


FORMAT = Format(
    name="OpenFOAM case",
    suffixes=(".foam",),
    writes=(Job, VolumeMesh),
    write_files=write_files,
    folder=True,
    shapes=("tet4", "hex8", "wed6"),
    procedures=("conduction", "diffusion", "flow"),
    command="sh {name}/Allrun",
)
