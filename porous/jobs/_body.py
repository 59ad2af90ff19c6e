"""Which body of a mesh bears what is done between two sides, and why none does."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.values.volume_topology import bodies, extracted

if TYPE_CHECKING:
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
