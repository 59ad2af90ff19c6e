"""The boundaries of lines, quadrilaterals and hexahedra: their order and their names."""

from __future__ import annotations

from itertools import combinations, product

Pattern = tuple[int | None, ...]

SHAPES = ("vertex", "edge", "quad", "hexa")
AXES = {1: "U", 2: "UV", 3: "XYZ"}
"""Names of the axes of a line, a quadrilateral and a hexahedron."""


def patterns(dimension: int) -> list[Pattern]:
    """Return the boundaries of a cube: each axis at an end (0 or 1) or free (None).

    Facets by axis, the edges of a hexahedron by the axis along which they run, vertices last,
    those of a kind lexicographically.
    """
    result: list[Pattern] = []
    for free in range(dimension - 1, -1, -1):
        groups = list(combinations(range(dimension), free))
        if free == dimension - 1:
            groups.reverse()
        for axes in groups:
            ends = ((None,) if axis in axes else (0, 1) for axis in range(dimension))
            result += list(product(*ends))
    return result


def pattern_name(pattern: Pattern) -> str:
    """Return what people call a boundary: XMIN, the edge Z01, the vertex V011."""
    axes = AXES[len(pattern)]
    fixed = [axis for axis, side in enumerate(pattern) if side is not None]
    sides = "".join(str(pattern[axis]) for axis in fixed)
    if len(fixed) == len(pattern):
        return "V" + sides
    if len(fixed) == 1:
        return axes[fixed[0]] + ("MIN", "MAX")[int(sides)]
    return axes[pattern.index(None)] + sides
