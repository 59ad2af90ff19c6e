"""How Gmsh's versions 4.1 and 2.2 are written, both as text.

4.1 holds every part: an entity may be of several groups. In 2.2 an element is of one group only:
the first part that it is in, phases before all others and the skin after them; to list it once for
each of its groups, as Gmsh does, would make it several elements to most who read it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from porous.formats._lines import lines_of
from porous.formats._msh_tiers import (
    TYPES,
    Link,
    Tier,
    links_of,
    name_lines,
    names_of,
    section,
    tiers_of,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from porous.values import VolumeMesh

    Indices = NDArray[np.int64]


def write_4(mesh: VolumeMesh) -> Iterator[bytes]:
    """Write version 4.1."""
    tiers = tiers_of(mesh)
    names = names_of(tiers)
    yield section("MeshFormat", "4.1 0 8\n")
    yield section("Comments", f"made by porous; lengths in {mesh.unit}\n")
    yield name_lines([(t.dimension, *names[key]) for t in tiers for key in t.groups.sets])
    yield section("Entities", "".join(_entities(tiers, names, mesh)))
    yield b"$Nodes\n"
    yield from _nodes_4(tiers, mesh)
    yield b"$EndNodes\n$Elements\n"
    yield from _elements_4(tiers)
    yield b"$EndElements\n"
    yield from _periodic(links_of(mesh, tiers[1]), "0\n")


def _entities(
    tiers: tuple[Tier, Tier, Tier], names: dict[str, tuple[int, str]], mesh: VolumeMesh
) -> Iterator[str]:
    points, faces, cells = tiers
    yield f"{len(points.entities)} 0 {len(faces.entities)} {len(cells.entities)}\n"
    for tier in tiers:
        boxes = tier.boxes(mesh.points)[:, : 3 if tier is points else 6].tolist()
        for number, (parts, box) in enumerate(zip(tier.entities, boxes, strict=True), 1):
            groups = [len(parts), *sorted(names[part][0] for part in parts)]
            bounds = [] if tier is points else [0]
            yield " ".join(map(str, [number, *box, *groups, *bounds])) + "\n"


def _nodes_4(tiers: tuple[Tier, ...], mesh: VolumeMesh) -> Iterator[bytes]:
    """Give nodes by the entity of faces that they lie on, else of cells.

    To Gmsh all nodes of an entity of points lie in one place, so these own none.
    """
    tiers = tiers[1:]
    entities = [(t.dimension, number) for t in tiers for number in range(1, 1 + len(t.entities))]
    owner = np.full(len(mesh.points), entities.index((3, 1)))
    for tier in reversed(tiers):
        first = entities.index((tier.dimension, 1)) if tier.entities else 0
        for _, rows, nodes in tier.pieces:
            owner[nodes.ravel()] = np.repeat(first + tier.label[rows], nodes.shape[1])
    order = np.argsort(owner, kind="stable")
    counts = np.bincount(owner, minlength=len(entities)).tolist()
    yield f"{len(entities)} {len(order)} 1 {len(order)}\n".encode()
    start = 0
    for (dimension, number), count in zip(entities, counts, strict=True):
        own = order[start : start + count]
        yield f"{dimension} {number} 0 {count}\n".encode()
        yield from lines_of(own + 1)
        yield from lines_of(mesh.points[own])
        start += count


def _elements_4(tiers: tuple[Tier, ...]) -> Iterator[bytes]:
    blocks = [
        (tier, number, kind, rows[tier.label[rows] == number], nodes[tier.label[rows] == number])
        for tier in tiers
        for kind, rows, nodes in tier.pieces
        for number in np.unique(tier.label[rows]).tolist()
    ]
    total = sum(len(rows) for *_, rows, _ in blocks)
    yield f"{len(blocks)} {total} 1 {total}\n".encode()
    for tier, number, kind, rows, nodes in blocks:
        yield f"{tier.dimension} {number + 1} {TYPES[kind]} {len(rows)}\n".encode()
        yield from lines_of(rows + tier.first, nodes + 1)


def write_2(mesh: VolumeMesh) -> Iterator[bytes]:
    """Write version 2.2."""
    tiers = tiers_of(mesh)
    names = names_of(tiers)
    leading = [tier.groups.leading() for tier in tiers]
    shown = [
        (t.dimension, *names[key])
        for t, (_, keys) in zip(tiers, leading, strict=True)
        for key in keys
    ]
    yield section("MeshFormat", "2.2 0 8\n")
    yield section("Comments", "".join(_comments(mesh, tiers, leading, names)))
    yield name_lines(sorted(shown, key=lambda row: row[:2]))
    yield f"$Nodes\n{len(mesh.points)}\n".encode()
    yield from lines_of(np.arange(1, 1 + len(mesh.points)), mesh.points)
    yield f"$EndNodes\n$Elements\n{sum(len(tier.label) for tier in tiers)}\n".encode()
    for tier, (label, keys) in zip(tiers, leading, strict=True):
        groups = np.array([*(names[key][0] for key in keys), 0])[label]
        for kind, rows, nodes in tier.pieces:
            ones = np.ones_like(rows)
            yield from lines_of(
                rows + tier.first,
                np.stack([TYPES[kind] * ones, 2 * ones, groups[rows], tier.label[rows] + 1], 1),
                nodes + 1,
            )
    yield b"$EndElements\n"
    yield from _periodic(links_of(mesh, tiers[1]), "")


def _comments(
    mesh: VolumeMesh,
    tiers: tuple[Tier, ...],
    leading: list[tuple[Indices, list[str]]],
    names: dict[str, tuple[int, str]],
) -> Iterator[str]:
    yield f"made by porous; lengths in {mesh.unit}\n"
    for tier, (label, keys) in zip(tiers, leading, strict=True):
        for key, members in tier.groups.sets.items():
            lead = int((label[members] == keys.index(key)).sum()) if key in keys else 0
            if lead < len(members):
                yield (
                    f"{names[key][1]}: {lead} of its {len(members)} elements are listed so, the "
                    "others under a part that comes before; version 4.1 holds it whole\n"
                )


def _periodic(links: list[Link], affine: str) -> Iterator[bytes]:
    """Give the nodes that match; of the map between them ``affine`` says that none is given.

    Gmsh 4.15 moves nodes of triangles where it is given one, though it is right.
    """
    if not links:
        return
    yield f"$Periodic\n{len(links)}\n".encode()
    for link in links:
        yield f"2 {link.slave + 1} {link.master + 1}\n{affine}{len(link.pairs)}\n".encode()
        yield from lines_of(link.pairs + 1)
    yield b"$EndPeriodic\n"
