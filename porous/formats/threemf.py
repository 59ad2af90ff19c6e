"""3MF: triangles or beams with a unit, in a zip archive; what printers and slicers take.

Written with all digits, one object and one item to build; lengths in nm are written in micron.
Points keep their order and their doubles, for a surface that is a manifold stays one. Beams follow
the beam lattice extension, with balls at nodes and a clipping mesh where the lattice has them.

Read are triangles of all that is built, with its copies, transforms and unit; feet become inches.
Each object that is built is a part. Colours, materials and slices are passed over; beams are too,
with a warning. Nothing outside the archive is ever opened.
"""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING
from xml.etree.ElementTree import ParseError

import numpy as np

from porous.errors import FormatError
from porous.formats._registry import Format
from porous.formats._threemf import BALLS, BEAMS, CORE, MODEL, UNITS, ModelPart
from porous.formats._zip import checked, damage, opened, written
from porous.formats.gate import HEADER, markup, refuse
from porous.memory import check_memory
from porous.values import BeamLattice, Box, SurfaceMesh

if TYPE_CHECKING:
    from collections.abc import Iterator
    from zipfile import ZipFile, ZipInfo

    from numpy.typing import NDArray

    from porous.formats.gate import Source

PLACE = "3D/3dmodel.model"
RELATIONS = "_rels/.rels"
PARTS = 2**15 - 1
MOST = 2**31 - 1
"""Vertices that the format can number."""
SLAB = 50_000
RATIO = 100
"""Bytes of a model that one byte of the archive may hold: ours hold 5 to 10."""
SMALL = 1 << 21
"""So long a model is read whatever it is packed to."""
NANO = 1e-3
"""Microns; the format has no smaller unit."""
NAMES = {own: name for name, own in UNITS.items() if name != "foot"} | {"nm": "micron"}

TYPES = b"""<?xml version="1.0" encoding="UTF-8"?>
<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">\
<Default Extension="rels" \
ContentType="application/vnd.openxmlformats-package.relationships+xml"/>\
<Default Extension="model" \
ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/></Types>
"""
ROOTS = f"""<?xml version="1.0" encoding="UTF-8"?>
<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">\
<Relationship Target="/{PLACE}" Id="rel0" Type="{MODEL}"/></Relationships>
""".encode()
HEAD = f"""<?xml version="1.0" encoding="UTF-8"?>
<model unit="%s" xml:lang="en-US" xmlns="{CORE}"%s>
<metadata name="Title">%s</metadata>
<metadata name="Application">porous</metadata>
<resources>
"""
TAIL = '</resources>\n<build>\n<item objectid="%d"/>\n</build>\n</model>\n'
EXTENSIONS = f' xmlns:b="{BEAMS}"{{}} requiredextensions="b{{}}"'
WITH_BALLS = f' xmlns:bb="{BALLS}"', " bb"

VERTEX = '<vertex x="%r" y="%r" z="%r"/>\n'
TRIANGLE = '<triangle v1="%d" v2="%d" v3="%d"/>\n'
BEAM = '<b:beam v1="%d" v2="%d" r1="%r" r2="%r"/>\n'
BALL = '<bb:ball vindex="%d" r="%r"/>\n'
LONG_ROW = 100
"""Bytes of the longest rows, about."""


def read(source: Source) -> SurfaceMesh:
    """Read the triangles of all that is built; each object that is built is a part."""
    with opened(source.data) as archive:
        info = _model(archive)
        checked(info, max(RATIO * info.compress_size, SMALL), "the model")
        check_memory(2 * info.file_size, "the model", "Cut it into parts.")
        part = ModelPart()
        with damage("the model"), archive.open(info) as member:
            part.feed(member)
    return _surface(part, source, info.compress_size)


def write(value: SurfaceMesh | BeamLattice) -> Iterator[bytes]:
    """Write triangles or beams as one object, and build it."""
    if isinstance(value, BeamLattice):
        rows, what, pieces = len(value.beams), "beams", _beams(value)
    else:
        rows, what, pieces = len(value.triangles), "triangles", _triangles(value)
    if not rows:
        raise FormatError(f"nothing to build: got no {what}; wanted at least one")
    if len(value.points) > MOST:
        raise FormatError(f"{len(value.points)} points; wanted at most {MOST} for 3MF")
    members = (
        ("[Content_Types].xml", (TYPES,), len(TYPES)),
        (RELATIONS, (ROOTS,), len(ROOTS)),
        (PLACE, pieces, LONG_ROW * (len(value.points) + rows) + HEADER),
    )
    return written(members)


# --- reading


def _model(archive: ZipFile) -> ZipInfo:
    """Return the model part: the one that the archive's own relations name."""
    members = {info.filename.lower(): info for info in archive.infolist()}
    if RELATIONS not in members:
        raise FormatError(f"no {RELATIONS}, which names the model; wanted a 3MF package")
    checked(members[RELATIONS], HEADER, RELATIONS)
    with damage(RELATIONS):
        text = archive.read(members[RELATIONS])
    try:
        rows = [row for row in markup(text).iter() if row.get("Type") == MODEL]
    except ParseError as error:
        raise FormatError(f"{RELATIONS}: {error}") from None
    if len(rows) != 1 or rows[0].get("TargetMode", "Internal") != "Internal":
        refuse(RELATIONS, f"{len(rows)} models", "one model inside the archive")
    target = rows[0].get("Target", "").removeprefix("/")
    if target.lower() not in members:
        refuse(f"the model that {RELATIONS} names", target, "a file of the archive")
    return members[target.lower()]


def _surface(part: ModelPart, source: Source, packed: int) -> SurfaceMesh:
    names: dict[str, int] = {}
    points, triangles, labels, count = [], [], [], 0
    several = len(part.built) > 1
    for number, (name, places, corners) in enumerate(part.surfaces(packed), 1):
        label = names.setdefault(name or (f"object {number}" if several else "WALL"), len(names))
        if label >= PARTS:
            raise FormatError(f"more than {PARTS} parts")
        points.append(places)
        triangles.append(corners + count)
        labels.append(np.full(len(corners), label, np.int16))
        count += len(places)
    if not triangles:
        what = f"{part.beams} beams and no triangles" if part.beams else "no triangles"
        raise FormatError(f"{what}; wanted at least one triangle")
    if part.beams:
        source.note(f"{part.beams} beams are left out")
    return SurfaceMesh(
        np.concatenate(points),
        np.concatenate(triangles),
        part.unit,
        np.concatenate(labels),
        tuple(names),
    )


# --- writing


def _triangles(surface: SurfaceMesh) -> Iterator[bytes]:
    scale = _scale(surface.unit)
    yield (HEAD % (NAMES[surface.unit], "", "porous surface")).encode()
    yield from _mesh(1, surface.points * scale, surface.triangles)
    yield b"</mesh>\n</object>\n"
    yield (TAIL % 1).encode()


def _beams(lattice: BeamLattice) -> Iterator[bytes]:
    scale, balls = _scale(lattice.unit), len(lattice.balls) > 0
    more = EXTENSIONS.format(*(WITH_BALLS if balls else ("", "")))
    yield (HEAD % (NAMES[lattice.unit], more, "porous beams")).encode()
    if lattice.clip is not None:
        corners, sides = _box(lattice.clip)
        yield from _mesh(1, corners * scale, sides)
        yield b"</mesh>\n</object>\n"
    number = 1 if lattice.clip is None else 2
    yield from _mesh(number, lattice.points * scale, np.zeros((0, 3), np.int64))
    yield _lattice_head(lattice, scale, balls=balls).encode()
    ends, radii = lattice.beams, lattice.radii * scale
    yield from _rows(BEAM, "b:beams", ends[:, 0], ends[:, 1], radii[:, 0], radii[:, 1])
    if balls:
        yield from _rows(BALL, "bb:balls", lattice.balls, lattice.ball_radii * scale)
    yield b"</b:beamlattice>\n</mesh>\n</object>\n"
    yield (TAIL % number).encode()


def _lattice_head(lattice: BeamLattice, scale: float, *, balls: bool) -> str:
    """Return the opening tag; beams shorter than ``minlength`` are no beams to a reader."""
    shortest = float(lattice.lengths.min()) * scale
    words = {"radius": repr(float(lattice.radii[0, 0] * scale)), "minlength": repr(shortest / 2)}
    words["cap"] = lattice.cap
    if lattice.clip is not None:
        words |= {"clippingmode": "inside", "clippingmesh": "1"}
    if balls:
        words |= {"ballmode": "mixed", "ballradius": repr(float(lattice.ball_radii[0] * scale))}
    given = " ".join(f'{name}="{word}"' for name, word in words.items())
    return f"<b:beamlattice {given}>\n"


def _mesh(
    number: int, points: NDArray[np.float64], triangles: NDArray[np.int64]
) -> Iterator[bytes]:
    yield f'<object id="{number}" type="model">\n<mesh>\n'.encode()
    yield from _rows(VERTEX, "vertices", *points.T)
    yield from _rows(TRIANGLE, "triangles", *triangles.T)


def _rows(row: str, name: str, *columns: NDArray[np.generic]) -> Iterator[bytes]:
    yield f"<{name}>\n".encode()
    count, width = len(columns[0]), len(columns)
    for start in range(0, count, SLAB):
        parts = [column[start : start + SLAB].tolist() for column in columns]
        words: list[object] = [None] * (width * len(parts[0]))
        for place, part in enumerate(parts):
            words[place::width] = part
        yield ((row * len(parts[0])) % tuple(words)).encode()
    yield f"</{name}>\n".encode()


def _scale(unit: str) -> float:
    return NANO if unit == "nm" else 1.0


def _box(box: Box) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the corners of a box, (8, 3), and its sides in triangles, outward, (12, 3)."""
    corners = np.array(list(product(*zip(box.lower, box.upper, strict=True))))
    quads = np.array(
        [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    )
    return corners, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


FORMAT = Format("3MF", (".3mf",), SurfaceMesh, read, (SurfaceMesh, BeamLattice), write)
