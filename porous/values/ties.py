"""What pairs of nodes say together: which node stands for all that a period leads to."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.errors import MeshError
from porous.values.surface_topology import joined

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from porous.values.volume_mesh import VolumeMesh

    Indices = NDArray[np.int64]


class Ties(NamedTuple):
    """Nodes of a body that goes on in copies of itself, each tied straight to one root.

    A field with the mean gradient H differs from a node's root by H·(offset · periods).
    """

    root: Indices
    """(nodes,): the lowest node of those that periods lead to, which may be the node itself."""
    offset: Indices
    """(nodes, parts): how many periods of each part a node lies on from its root."""
    periods: NDArray[np.float64]
    """(parts, 3): from the first node of a pair to the second, in the mesh's unit."""

    def far(self, part: int) -> Indices:
        """Return the tied nodes that lie a period on from others of their root, along one part.

        Forces on the nodes of a root add up to nothing, so the sum of those on these nodes, times
        the period, is the moment of all: the mean stress times the volume.

        Raises
        ------
        MeshError
            Where nodes lie several periods apart.
        """
        own = self.offset[:, part]
        least = np.zeros(len(own), dtype=np.int64)
        np.minimum.at(least, self.root, own)
        steps = own - least[self.root]
        if steps.max(initial=0) > 1:
            raise MeshError("pairs: nodes tied to each other lie several periods apart")
        return np.flatnonzero(steps)


def ties(mesh: VolumeMesh, names: Sequence[str]) -> Ties:
    """Return what parts of pairs tie; edges and corners, which are in several, are tied once.

    Raises
    ------
    MeshError
        For a part without pairs, and for pairs that contradict each other.
    """
    count = len(mesh.points)
    pairs = [mesh.parts[name].members for name in names]
    for name, members in zip(names, pairs, strict=True):
        if not len(members):
            raise MeshError(f"part {name!r}: has no pairs; wanted some")
    first, second = np.concatenate([np.zeros((0, 2), np.int64), *pairs]).T
    part = np.repeat(np.arange(len(names)), [len(members) for members in pairs])
    step = np.eye(len(names), dtype=np.int64)[part]
    label = joined(count, first, second)
    lowest = np.full(label.max(initial=-1) + 1, count)
    np.minimum.at(lowest, label, np.arange(count))
    root = lowest[label]
    offset = _offsets(root, first, second, step)
    if (offset[second] - offset[first] != step).any():
        raise MeshError(f"{', '.join(names)}: pairs lead from a node to itself, a period on")
    periods = np.array(
        [(mesh.points[two[:, 1]] - mesh.points[two[:, 0]]).mean(axis=0) for two in pairs]
    )
    return Ties(root, offset, periods.reshape(-1, 3))


def _offsets(root: Indices, first: Indices, second: Indices, step: Indices) -> Indices:
    """Return how far each node lies from its root, by walking along pairs from what is known."""
    known = root == np.arange(len(root))
    offset = np.zeros((len(root), step.shape[1]), dtype=np.int64)
    while not known.all():
        onward, back = known[first] & ~known[second], known[second] & ~known[first]
        offset[second[onward]] = offset[first[onward]] + step[onward]
        offset[first[back]] = offset[second[back]] - step[back]
        known[second[onward]] = True
        known[first[back]] = True
    return offset
