"""Fields on a mesh: what is known at each node or cell, by name, with its unit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import MeshError
from porous.values.value import Value, frozen

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from porous.values.volume_mesh import VolumeMesh

COMPONENTS = (1, 3, 6)
"""Of numbers, vectors (x, y, z) and symmetric tensors (xx, yy, zz, xy, yz, xz)."""


@dataclass(frozen=True, eq=False)
class Field(Value):
    """A quantity that varies over a mesh.

    Parameters
    ----------
    name
        One line: ``displacement``, ``von Mises stress``.
    values
        float64, shape (n,) or (n, 3) or (n, 6); NaN where nothing is known. Symmetric tensors are
        in the order xx, yy, zz, xy, yz, xz.
    unit
        ``"1"`` for pure numbers; empty where nobody said.
    at
        ``nodes`` or ``cells``.

    Raises
    ------
    MeshError
        For values of another shape, or that are infinite.
    """

    name: str
    values: NDArray[np.float64]
    unit: str = ""
    at: str = "nodes"

    def __post_init__(self) -> None:
        self._set("values", frozen(self.values, np.float64))
        if self.at not in ("nodes", "cells"):
            raise MeshError(f"field {self.name!r}: got at = {self.at!r}; wanted nodes or cells")
        shape = self.values.shape
        if len(shape) not in (1, 2) or (shape[1:] or (1,))[0] not in COMPONENTS:
            raise MeshError(
                f"field {self.name!r}: got shape {shape}; wanted (n,), (n, 3) or (n, 6)"
            )
        if np.isinf(self.values).any():
            raise MeshError(f"field {self.name!r}: got an infinite value; wanted numbers")

    @property
    def magnitude(self) -> NDArray[np.float64]:
        """The value itself, the length of a vector, or von Mises' stress of a tensor: (n,)."""
        if self.values.ndim == 1:
            return self.values
        if self.values.shape[1] == 3:
            return np.asarray(np.linalg.norm(self.values, axis=1))
        return von_mises(self.values)


def von_mises(stress: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return von Mises' stress (n,) of symmetric tensors (n, 6) in the order of ``Field``."""
    xx, yy, zz, xy, yz, xz = stress.T
    normal = (xx - yy) ** 2 + (yy - zz) ** 2 + (zz - xx) ** 2
    return np.asarray(np.sqrt(normal / 2 + 3 * (xy**2 + yz**2 + xz**2)))


@dataclass(frozen=True, eq=False)
class MeshFields(Value):
    """A mesh with fields on it.

    Parameters
    ----------
    mesh
        Nodes and cells.
    fields
        Each name once, with a row for each node or cell.

    Raises
    ------
    MeshError
        For a field that is not of this mesh, or a name that stands twice.
    """

    mesh: VolumeMesh
    fields: tuple[Field, ...] = ()

    def __post_init__(self) -> None:
        self._set("fields", tuple(self.fields))
        for field in self.fields:
            wanted = len(self.mesh.points) if field.at == "nodes" else self.mesh.cells
            if len(field.values) != wanted:
                raise MeshError(
                    f"field {field.name!r}: got {len(field.values)} rows; wanted one for each of "
                    f"{wanted} {field.at}"
                )
        if len(set(self.names)) < len(self.names):
            raise MeshError(f"fields: got {', '.join(self.names)}; wanted each name once")

    def __getitem__(self, name: str) -> Field:
        for field in self.fields:
            if field.name == name:
                return field
        raise KeyError(f"no field {name!r}; there are {', '.join(self.names) or 'none'}")

    def __iter__(self) -> Iterator[Field]:
        return iter(self.fields)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the fields, in their order."""
        return tuple(field.name for field in self.fields)
