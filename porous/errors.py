"""Everything that can go wrong, drawn as a tree.

::

    PorousError                 what was wrong, what was got, what would be right
    ├── RecipeError             a recipe, an option or a preset's name (exit code 2)
    ├── ModelError              a model that does not exist: no attractor, singular controls (2)
    ├── GridError               a frame or a voxel grid that cannot be (2)
    ├── MeshError               an open, empty, tangled or degenerate mesh (2)
    ├── FormatError             a file that is not what it says, or no format for it (2)
    ├── MemoryLimitError        the work would need more memory than there is (2)
    ├── GuestError              a foreign engine failed, died or ran out of time (1)
    ├── DiskError               the disk refused to take a file (1)
    ├── ViewError               this machine cannot draw (1)
    └── Cancelled               progress asked for the end (130)

    UserWarning
    └── FormatWarning           a file was read, though not all of it is as it should be

Programming mistakes stay ``TypeError`` and ``ValueError``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

if TYPE_CHECKING:
    from collections.abc import Iterable


class PorousError(Exception):
    """Whatever porous refuses to do; its text is for the user."""

    exit_code: ClassVar[int] = 2


class RecipeError(PorousError):
    """A recipe, an option or a preset's name cannot be understood; names the key path."""


class ModelError(PorousError):
    """The model asked for does not exist: maps without attractor, singular controls."""


class GridError(PorousError):
    """A frame or a voxel grid cannot be: zero spacing, no voxels, unequal shapes."""


class MeshError(PorousError):
    """A mesh is open, empty, not manifold or degenerate where the work needs otherwise."""


class FormatError(PorousError):
    """A file is not what its name says, is damaged, or has a format that is not known."""


class MemoryLimitError(PorousError):
    """The work would need more memory than there is; nothing has been allocated."""


class FormatWarning(UserWarning):
    """A file was read, though not all of it is as it should be; says what was made of it."""


class GuestError(PorousError):
    """A foreign engine failed, died by a signal or ran out of its time limit."""

    exit_code: ClassVar[int] = 1


class DiskError(PorousError):
    """The disk refused to take a file: full, read-only, not permitted."""

    exit_code: ClassVar[int] = 1


class ViewError(PorousError):
    """Pictures cannot be drawn on this machine; names the packages that would mend it."""

    exit_code: ClassVar[int] = 1


class Cancelled(PorousError):  # noqa: N818  (it is a wish, not an error)
    """The caller's progress function asked for the end of the work."""

    exit_code: ClassVar[int] = 130


def nearest(word: str, known: Iterable[str]) -> str:
    """Return the end of a message about an unknown word: the nearest known one, else all."""
    import difflib

    words = sorted(known)
    close = difflib.get_close_matches(word, words, n=1)
    return f"; did you mean {close[0]!r}?" if close else f"; there is {', '.join(words)}"
