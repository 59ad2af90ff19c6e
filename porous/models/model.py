"""What a model is: a small protocol, and what it may be able to do besides."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np
    from numpy.typing import NDArray

    from porous.models.lines import LineBody
    from porous.values import BeamLattice, Box, Frame, Measure, Pattern, SurfaceMesh, VolumeMesh


@runtime_checkable
class Model(Protocol):
    """A set of space that can be asked which sample points lie in it.

    ``domain`` is the box that is sampled, ``bulk`` the box that porosity refers to; neither
    depends on the level. Lengths are in ``unit``.
    """

    @property
    def unit(self) -> str:
        """Unit of length."""

    @property
    def domain(self) -> Box:
        """The box that is sampled."""

    @property
    def bulk(self) -> Box:
        """The body that porosity refers to."""

    def sample(self, frame: Frame, pattern: Pattern) -> NDArray[np.uint64]:
        """Return the mask of each voxel of ``frame``, shape ``frame.shape``.

        Bit r·C + c is set where the pattern's point (r, c) of that voxel lies in the set.
        Depends on nothing but its arguments, so tiles can be sampled in any order.
        """


@runtime_checkable
class HasCover(Protocol):
    """A model whose closed set can be covered with a certificate."""

    def cover(self, frame: Frame) -> tuple[NDArray[np.unsignedinteger[Any]], float]:
        """Return a mark for every voxel that the set touches, possibly a few more, and a bound.

        The bound is on the Hausdorff distance between the marked voxels and the set, in the
        model's unit.
        """


@runtime_checkable
class HasBoundary(Protocol):
    """A model whose boundary can be computed exactly."""

    def boundary(self) -> SurfaceMesh:
        """Return the closed, oriented boundary.

        Raises ``ModelError`` where its topology would not be certain.
        """


@runtime_checkable
class HasCells(Protocol):
    """A model whose level-n cells are a conforming mesh by construction."""

    def cell_mesh(self) -> VolumeMesh:
        """Return the cells with shared nodes, named parts and their addresses as tags.

        Raises ``ModelError`` where cells are folded (naming the address) or are no volumes.
        """


@runtime_checkable
class HasBeams(Protocol):
    """A model that is drawn with beams and balls, if it is."""

    def beam_lattice(self) -> tuple[BeamLattice, str]:
        """Return beams and balls, ends where they lie, and what of the body is neither, in words.

        Two beams may name nodes of their own at the same place. The words are empty where the
        lattice is the whole body. Raises ``ModelError`` where there are no beams.
        """


@runtime_checkable
class HasBulk(Protocol):
    """A model whose bulk is another body than the box ``bulk``, which encloses it."""

    @property
    def bulk_volume(self) -> float:
        """Volume of the body that porosity refers to, in ``unit`` cubed."""

    def sample_bulk(self, frame: Frame, pattern: Pattern) -> NDArray[np.uint64]:
        """Return the masks of the body that porosity refers to, as ``Model.sample`` does."""


@runtime_checkable
class HasExact(Protocol):
    """A model with measures in closed form."""

    def exact(
        self, periodic: tuple[bool, bool, bool] = (False, False, False)
    ) -> tuple[Measure, ...]:
        """Return what is known in closed form for this level and periodicity, if anything."""


@runtime_checkable
class HasFill(Protocol):
    """A model that knows a short cut to the fill of some frames, at memory speed."""

    def fill(
        self,
        frame: Frame,
        pattern: Pattern,
        progress: Callable[[int, int], None] | None = None,
    ) -> NDArray[np.uint8] | None:
        """Return the fill of every voxel, shape ``frame.shape``, or None without a short cut.

        The same bytes as counting ``sample``'s bits gives. ``progress`` is called with the work
        done and the whole of it; raising in it cancels.
        """


@runtime_checkable
class HasMembership(Protocol):
    """A model that may be asked about any points, not those of a lattice alone."""

    def check_membership(self) -> None:
        """Raise ``ModelError`` where points cannot be asked for after all; says why."""

    def contains(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Tell which points (n, 3), in ``unit``, lie in the closed set.

        Raises ``ModelError`` as ``check_membership`` does.
        """


@runtime_checkable
class HasLines(Protocol):
    """A model that may know where a straight line is inside it."""

    def line_body(self) -> LineBody | None:
        """Return the body for lines, None where it is known by its voxels alone."""


@runtime_checkable
class HasDoubts(Protocol):
    """A model that knows where its voxels say less than they seem to."""

    @property
    def is_cut(self) -> bool:
        """Whether the domain leaves out a part of the set."""

    def sampling_error(self, frame: Frame) -> float:
        """Return how far the boundary that is sampled may lie from the set's, in ``unit``."""


@runtime_checkable
class HasLattice(Protocol):
    """A model that is made of voxels already."""

    def lattice(self, periodic: tuple[bool, bool, bool] = (False, False, False)) -> Frame:
        """Return its own voxels: they are sampled where nobody asks for others."""


@runtime_checkable
class HasNotes(Protocol):
    """A model that was made from something else, and knows how."""

    @property
    def notes(self) -> tuple[str, ...]:
        """What was done on the way, for who reads the results."""


@runtime_checkable
class HasFeature(Protocol):
    """A model that may know how small its details are."""

    @property
    def feature_size(self) -> float | None:
        """Length that ``per_feature`` divides, in ``unit``; None where details have no end."""
