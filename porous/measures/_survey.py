"""All that takes longer: families of measures, one file each."""

from __future__ import annotations

import importlib
import pkgutil
from functools import cache
from typing import TYPE_CHECKING

from porous.errors import GridError, nearest
from porous.measures._sample import Family, Findings, Sample
from porous.measures._together import taken

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from porous.measures._sample import Survey
    from porous.models.model import Model
    from porous.values import VoxelGrid

    Progress = Callable[[str, float], None]


@cache
def families() -> tuple[Family, ...]:
    """Return the families of measures that a survey takes, in their order."""
    import porous.measures as room

    modules = (importlib.import_module(f"{room.__name__}.{i.name}") for i in _files(room.__path__))
    found = (vars(module).get("FAMILY") for module in modules)
    return tuple(sorted((f for f in found if isinstance(f, Family)), key=lambda f: f.place))


def _files(path: Sequence[str]) -> tuple[pkgutil.ModuleInfo, ...]:
    return tuple(info for info in pkgutil.iter_modules(path) if info.name.startswith("_"))


def survey(
    subject: VoxelGrid | Sample,
    *,
    model: Model | None = None,
    how: Survey | None = None,
    only: Sequence[str] | None = None,
    progress: Progress | None = None,
) -> Findings:
    """Return what families of measures find out about a grid: sizes, access, transport and more.

    What ``measure`` tells costs a pass over the grid or two. This is the rest, which takes longer.

    Parameters
    ----------
    subject
        A grid in memory, or a sample of one, which then keeps what was worked out.
    model
        What the grid samples, for what is known of models alone.
    how
        What is asked for besides; see ``Survey``.
    only
        Names of families to take, all where not given.
    progress
        Called with a family's name and its share done, from 0 to 1; raising in it cancels. Two are
        under way at a time, and told of in turns.

    Returns
    -------
    Findings
        Measures, curves and notes, family by family.

    Raises
    ------
    GridError
        For an unknown family.
    MemoryLimitError
        Where there is too little memory.
    """
    known = {family.name: family for family in families()}
    for name in only or ():
        if name not in known:
            raise GridError(f"only: got {name!r}{nearest(name, known)}")
    if isinstance(subject, Sample):
        sample = subject
    else:
        sample = Sample(subject, model=model, how=how, progress=progress)
    wanted = [family for name, family in known.items() if only is None or name in only]
    return sum((each.findings for each in taken(wanted, sample).values()), Findings())
