"""Which body of a mesh bears what is done between two sides, and why none does."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.values.surface_topology import joined
from porous.values.volume_topology import (
    Faces,
    bodies,
    boundary_faces,
    extracted,
    matched,
    nodes_of,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from porous.values import VolumeMesh

    Indices = NDArray[np.int64]


class Between(NamedTuple):
    """What reaches from one side to another, or why nothing does."""

    mesh: VolumeMesh
    """Cut down to what reaches, or as it was where nothing does."""
    note: str
    """What was left out."""
    why_not: str
    """Empty where there is something to do a step with."""


def between(mesh: VolumeMesh, first: str, last: str, *, several: bool = False) -> Between:
    """Return the body, joined across faces, that has faces on both of two sides.

    Whatever hangs on it by a point or an edge, or not at all, bears no load and would leave a
    solver with a mechanism.

    Parameters
    ----------
    mesh
        With the parts that ``name_parts`` gives.
    first, last
        Names of sides: ``"ZMIN"``, ``"ZMAX"``.
    several
        Whether several bodies side by side are as good as one: heat flows in each by itself, but
        pressed side by side they are not one material.
    """
    body = bodies(mesh)
    reaching = np.intersect1d(_on(mesh, body, first), _on(mesh, body, last))
    if len(reaching) != 1 and not (several and len(reaching)):
        return Between(mesh, "", _why_not(mesh, body, first, last, len(reaching)))
    kept = np.isin(body, reaching)
    return Between(extracted(mesh, kept), left_out(body, kept), "")


def left_out(body: Indices, kept: NDArray[np.bool_]) -> str:
    """Return a note on the bodies that are not kept; nothing where all are."""
    count = len(np.unique(body[~kept]))
    if not count:
        return ""
    which = "the body that bears the load" if len(np.unique(body[kept])) == 1 else "what bears load"
    return f"{count} bodies of {int((~kept).sum())} cells left out: no face joins them to {which}"


def _on(mesh: VolumeMesh, body: Indices, side: str) -> Indices:
    """Return the bodies with faces on a side; one that stands on a point or an edge tips over."""
    part = mesh.parts.get(f"{side}_FACES")
    return np.zeros(0, np.int64) if part is None else np.unique(body[part.members[:, 0]])


def _why_not(mesh: VolumeMesh, body: Indices, first: str, last: str, reaching: int) -> str:
    count = int(body.max()) + 1
    apart = f"the mesh falls into {count} bodies that no face joins" if count > 1 else ""
    joins = "where they only touch, contacts = 'fuse' or an offset joins them"
    if reaching:
        return (
            f"{apart}, and {reaching} of them reach from {first} to {last}, each by itself: a "
            f"step would press them side by side, not one material; {joins}"
        )
    bare = [side for side in (first, last) if not len(_on(mesh, body, side))]
    if bare:
        flat = (
            f"no face lies on {' or '.join(bare)}, and a point or an edge can be neither held nor "
            "pressed: choose a domain whose sides cut the body flat"
        )
        return f"{apart}: {joins}; {flat}" if apart else flat
    return (
        f"no face-connected body joins {first} and {last}: {apart}, and touching in a point or "
        f"an edge bears no load; {joins}"
    )


def largest(mesh: VolumeMesh, side: str = "") -> Between:
    """Return the body of the largest volume, of those with faces on a side where one is named."""
    body = bodies(mesh)
    there = _on(mesh, body, side) if side else np.arange(int(body.max()) + 1)
    if not len(there):
        return Between(mesh, "", f"no face lies on {side}, and a point or an edge holds nothing")
    volume = np.bincount(body, weights=mesh.volumes)
    kept = body == there[np.argmax(volume[there])]
    return Between(extracted(mesh, kept), left_out(body, kept), "")


def going_on(mesh: VolumeMesh, names: Sequence[str], *, least: int) -> tuple[Between, Indices]:
    """Return what is one with copies of itself across faces, by parts of pairs.

    Left out are islands, which bear nothing from one copy to the next.

    Parameters
    ----------
    mesh
        Any.
    names
        Parts of pairs.
    least
        In how many independent directions each body has to go on so that it is held: two against
        turning, one for what is a number.

    Returns
    -------
    What goes on, and a node of each of its bodies.
    """
    body = bodies(mesh)
    edges = _across(mesh, body, names)
    whole, rank = _windings(int(body.max()) + 1, edges, len(names))
    own = whole[body]
    kept = rank[own] > 0
    if not kept.any():
        why = "no body goes on across faces from one copy of the cell to the next"
        return Between(mesh, "", why), np.zeros(0, np.int64)
    if (rank[own[kept]] < least).any():
        why = (
            "a body goes on in one direction only, and nothing keeps it from turning about that "
            "direction: as a material it has no stiffness"
        )
        return Between(mesh, "", why), np.zeros(0, np.int64)
    cut = extracted(mesh, kept)
    nodes = np.concatenate([block.cells[:, 0] for block in cut.blocks])
    _, firsts = np.unique(own[kept], return_index=True)
    return Between(cut, left_out(own, kept), ""), nodes[firsts]


def _across(mesh: VolumeMesh, body: Indices, names: Sequence[str]) -> Indices:
    """Return which bodies meet across faces a period on: (n, 3), first, second and part."""
    members = boundary_faces(mesh)
    nodes = nodes_of(mesh, members)
    rows = [np.zeros((0, 3), np.int64)]
    for index, name in enumerate(names):
        partner = np.full(len(mesh.points) + 1, -2)  # the last is that of a triangle's fourth
        first, second = mesh.parts[name].members.T
        partner[second], partner[-1] = first, -1
        moved = partner[nodes]
        whole = (moved > -2).all(axis=1)
        both = np.concatenate([nodes, moved[whole]])
        source = np.concatenate([members, members[whole]])
        a, b = matched(Faces(source, both))
        a, b = np.minimum(a, b), np.maximum(a, b)
        ends = body[source[a, 0]], body[source[b, 0]]
        rows.append(np.column_stack([*ends, np.full(len(a), index)]))
    return np.asarray(np.unique(np.concatenate(rows), axis=0))


def _windings(count: int, edges: Indices, parts: int) -> tuple[Indices, Indices]:
    """Return the body that each is of once copies are joined, and in how many ways that goes on.

    A closed way through bodies leads so many periods on; the rank of all such ways counts.
    """
    whole = joined(count, edges[:, 0], edges[:, 1])
    _, firsts = np.unique(whole, return_index=True)
    place = {first: np.zeros(parts, np.int64) for first in firsts.tolist()}
    steps = np.eye(parts, dtype=np.int64)
    while len(place) < count:
        for a, b, part in edges.tolist():
            if a in place and b not in place:
                place[b] = place[a] + steps[part]
            elif b in place and a not in place:
                place[a] = place[b] - steps[part]
    ways: dict[int, list[Indices]] = {}
    for a, b, part in edges.tolist():
        ways.setdefault(int(whole[a]), []).append(place[a] + steps[part] - place[b])
    rank = np.zeros(int(whole.max()) + 1, dtype=np.int64)
    for own, found in ways.items():
        rank[own] = np.linalg.matrix_rank(np.array(found))
    return whole, rank
