"""Betti numbers of a cell complex: its pieces, tunnels and cavities, exactly.

Over the field of two elements the boundary of a cell is the set of its faces. The rank of each
boundary matrix follows by elimination, first of rows and columns with a single entry, which costs
nothing and is the collapse of a cell through a free face.
"""

from __future__ import annotations

from heapq import heapify, heappop, heappush
from typing import TYPE_CHECKING

import numpy as np

from porous.memory import check_memory

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from porous.models.complex import Complex

    Ints = NDArray[np.int64]

BYTES_PER_ENTITY = 800
"""Of an edge, a face or a cell: Python's sets of what bounds it and of what it bounds."""


def betti(complex_: Complex) -> tuple[int, int, int]:
    """Return the numbers of pieces, of independent tunnels and of cavities, b₀, b₁ and b₂.

    Of the closed complex over the field of two elements: cells that share a vertex are joined.
    b₃, the number of pieces without any boundary, is zero in space; it is part of the sums.

    Raises
    ------
    MemoryLimitError
        Before anything is allocated.
    """
    vertices, edges, faces, cells = (complex_.count(dimension) for dimension in range(4))
    needed = BYTES_PER_ENTITY * (edges + faces + cells)
    check_memory(needed, f"Betti numbers of {cells} cells", "Choose a lower level.")
    pieces = complex_.components
    tree = vertices - pieces
    volumes, free = rank(boundaries(complex_, 3))
    # The boundary of a volume has none: the faces that elimination took are sums of the others.
    surfaces, _ = rank([row for f, row in enumerate(boundaries(complex_, 2)) if f not in free])
    return pieces, edges - tree - surfaces, faces - surfaces - volumes


def boundaries(complex_: Complex, dimension: int) -> list[set[int]]:
    """Return for each entity of a dimension its boundary, of those of one dimension less.

    Both numbered over all states; what an entity is bounded by twice does not bound it.
    """
    brep, offsets = complex_.brep, complex_.offsets
    found: list[set[int]] = [set() for _ in range(complex_.count(dimension))]
    seen = np.zeros(len(found), bool)
    for group in complex_.cells:
        ids = complex_.ids_of(group, dimension - 1)
        column = {k: j for j, k in enumerate(brep.of_dimension(group.state, dimension - 1))}
        slots = [*(b.state for b in brep.states[group.state].boundaries), group.state]
        for k, state in enumerate(slots):
            if brep.states[state].dimension == dimension:
                inner = brep.of_dimension(state, dimension - 1)
                if k < len(slots) - 1:
                    inner = tuple(brep.sub[group.state][k][m].boundary for m in inner)
                new, first = np.unique(group.ids[:, k] + offsets[state], return_index=True)
                first, new = first[~seen[new]], new[~seen[new]]
                seen[new] = True
                rows = ids[first][:, [column[e] for e in inner]]
                for entity, row in zip(new.tolist(), rows.tolist(), strict=True):
                    found[entity] = _odd(row)
    return found


def _odd(row: list[int]) -> set[int]:
    result = set(row)
    if len(result) < len(row):
        result = {e for e in result if row.count(e) % 2}
    return result


def rank(chains: Iterable[set[int]]) -> tuple[int, set[int]]:
    """Return the rank of sets of elements under symmetric difference, and the pivots.

    Parameters
    ----------
    chains
        The sets are consumed.

    Returns
    -------
    int, set of int
        The rank, and as many elements: each is, up to such sets, a sum of elements that are none
        of them.
    """
    left = [chain for chain in chains if chain]
    about: dict[int, set[int]] = {}
    for number, chain in enumerate(left):
        for element in chain:
            about.setdefault(element, set()).add(number)
    queue = [(len(users), element) for element, users in about.items()]
    heapify(queue)
    pivots: set[int] = set()
    # The element in the fewest chains is taken first: one in a single chain leaves no trace.
    while queue:
        believed, element = heappop(queue)
        users = about.get(element, ())
        if len(users) != believed:
            continue
        if users:
            pivots.add(element)
            changed = _eliminate(left, about, element)
            for other in changed:
                heappush(queue, (len(about[other]), other))
    return len(pivots), pivots


def _eliminate(left: list[set[int]], about: dict[int, set[int]], element: int) -> set[int]:
    """Take the shortest chain with an element and the element away; return what else changed."""
    users = about.pop(element)
    shortest = min(users, key=lambda number: (len(left[number]), number))
    users.discard(shortest)
    rest = left[shortest]
    rest.discard(element)
    left[shortest] = set()
    for other in rest:
        about[other].discard(shortest)
    for number in users:
        left[number].discard(element)
        left[number] ^= rest
        for other in rest:
            about[other] ^= {number}
    return rest
