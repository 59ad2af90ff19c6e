"""What a recipe's work takes, said before any of it is done: memory, disk and time.

Memory is meant to be enough, time is a guess.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import count
from typing import TYPE_CHECKING

from porous.errors import MemoryLimitError, PorousError, RecipeError, nearest
from porous.memory import readable
from porous.recipe import build
from porous.scale.costs import OVERHEAD, WANTED, Cost, Work
from porous.values.value import Value

if TYPE_CHECKING:
    from porous.models.model import Model
    from porous.recipe import Recipe
    from porous.values import Frame

FACTOR = 10
"""Times are within this factor of what is said, mostly."""


@dataclass(frozen=True, eq=False)
class Estimate(Value):
    """What a recipe's work takes, stage by stage.

    Parameters
    ----------
    frame
        Where the voxels will lie; None where none are made.
    costs
        Of the stages in their order.
    limit
        Bytes of memory that may be taken.
    out_of_core
        Whether voxels and surface are to go to the disk.
    recipe, only, model
        What was asked for, and the recipe's model.
    """

    frame: Frame | None
    costs: tuple[Cost, ...]
    limit: int
    out_of_core: bool
    recipe: Recipe | None = None
    only: str | None = None
    model: Model | None = None

    @property
    def memory(self) -> int:
        """Bytes at the peak of all stages."""
        return max(cost.memory for cost in self.costs)

    @property
    def disk(self) -> int:
        """Bytes of all files."""
        return sum(cost.disk for cost in self.costs)

    @property
    def seconds(self) -> float:
        """Of all stages, about."""
        return sum(cost.seconds for cost in self.costs)

    @property
    def uncertainty(self) -> str:
        """How far off ``seconds`` may be."""
        return f"within a factor of {FACTOR}"

    @property
    def fits(self) -> bool:
        """Whether no more memory is needed than may be taken."""
        return self.memory <= self.limit

    @property
    def rows(self) -> tuple[tuple[str, str, str, str], ...]:
        """Stage, memory, disk and time, for people."""
        return tuple(
            (
                cost.stage,
                readable(cost.memory),
                readable(cost.disk) if cost.disk else "–",
                _duration(cost.seconds),
            )
            for cost in self.costs
        )

    def __str__(self) -> str:
        table = [("stage", "memory", "disk", "time"), *self.rows]
        widths = [max(map(len, column)) for column in zip(*table, strict=True)]
        lines = ["  ".join(map(str.ljust, row, widths)).rstrip() for row in table]
        return "\n".join([*lines, self.summary])

    @property
    def summary(self) -> str:
        """All of it in a line."""
        what = "no voxels" if self.frame is None else f"{_shape(self.frame)} voxels"
        where = " out of core" if self.out_of_core else ""
        return (
            f"{what}{where}: {readable(self.memory)} of memory at most ({readable(self.limit)} may "
            f"be used), {readable(self.disk)} on disk, about {_duration(self.seconds)} "
            f"({self.uncertainty})"
        )


def estimate(
    recipe: Recipe,
    *,
    only: str | None = None,
    out_of_core: bool = False,
    model: Model | None = None,
) -> Estimate:
    """Return what a recipe's work will take, in about a second and next to no memory.

    Parameters
    ----------
    recipe
        What is to be made.
    only
        model, voxels, surface, volume, simulation or measures, as ``run`` takes it.
    out_of_core
        Whether voxels and surface are to go to the disk.
    model
        The recipe's, where it has been built already.

    Raises
    ------
    RecipeError, ModelError, GridError
        As the stages do.
    MemoryLimitError
        Where even a few voxels of the model would be too much, for it has too many pieces.
    """
    if only is not None and only not in WANTED:
        raise RecipeError(f"--only: got {only!r}{nearest(only, WANTED)}")
    built = build(recipe) if model is None else model
    work = Work(recipe, built, only, out_of_core=out_of_core)
    return Estimate(work.frame, work.costs(), work.limit, out_of_core, recipe, only, built)


def check(estimate: Estimate) -> None:
    """Raise ``MemoryLimitError`` where more memory is needed than may be taken.

    It names the stage, the largest resolution that would fit and, where that would help, working
    out of core.
    """
    if estimate.fits:
        return
    cost = next(cost for cost in estimate.costs if cost.memory > estimate.limit)
    frame = estimate.frame
    what = f"{cost.stage} of {_shape(frame)} voxels" if frame else cost.stage
    raise MemoryLimitError(
        f"{what} would need {readable(cost.memory)} of memory; {readable(estimate.limit)} may be "
        f"used. {_remedy(estimate)}"
    )


def _remedy(estimate: Estimate) -> str:
    remedies = []
    if estimate.frame is not None and (voxels := largest(estimate)):
        remedies.append(f"choose voxels.voxels = {voxels} or fewer (along the longest edge)")
    if not estimate.out_of_core and _fits_stored(estimate):
        remedies.append("make it out of core: --out-of-core")
    if not remedies:
        lower = "choose a lower level, or " if estimate.limit > 2 * OVERHEAD else ""
        remedies.append(f"{lower}allow more: --max-memory")
    text = ", or ".join(remedies)
    return f"{text[0].upper()}{text[1:]}."


def _fits_stored(given: Estimate) -> bool:
    assert given.recipe is not None
    try:
        stored = estimate(given.recipe, only=given.only, out_of_core=True, model=given.model)
    except PorousError:
        return False
    return stored.memory <= given.limit


def largest(given: Estimate) -> int:
    """Return the largest ``voxels.voxels`` whose own estimate fits while one more's does not.

    0 where none fits.
    """
    recipe, frame = given.recipe, given.frame
    assert recipe is not None
    assert frame is not None
    model = given.model

    def memory(voxels: int) -> int:
        changed = _with_voxels(recipe, voxels)
        found = estimate(changed, only=given.only, out_of_core=given.out_of_core, model=model)
        return found.memory

    # Between one that fits and one that does not; memory is about a power of the resolution.
    low, least = 0, 0
    high, most = max(frame.shape), given.memory
    for turn in count():
        if high - low <= 1:
            return low
        guess = _between((low, least), (high, most), given.limit, halve=turn % 3 == 2)
        needed = memory(guess)
        if needed <= given.limit:
            low, least = guess, needed
        else:
            high, most = guess, needed
    raise AssertionError


def _between(low: tuple[int, int], high: tuple[int, int], wanted: int, *, halve: bool) -> int:
    """Return where a power law through two points is as wanted; or their middle."""
    (a, below), (b, above) = low, high
    if halve or not a:
        guess = b * (wanted / above) ** (1 / 3) if not halve else (a + b) / 2
    else:
        power = math.log(b / a) / math.log(above / below)
        guess = a * (wanted / below) ** power
    return min(b - 1, max(a + 1, int(guess)))


def _with_voxels(recipe: Recipe, voxels: int) -> Recipe:
    old = recipe.voxels
    change = {"voxels": voxels, "spacing": None, "per_feature": None}
    return recipe.model_copy(update={"voxels": old.model_copy(update=change)})


def _shape(frame: Frame) -> str:
    return " × ".join(map(str, frame.shape))


def _duration(seconds: float) -> str:
    """Return a time for people, in one or two digits: it is not known better."""
    for most, unit, size in ((90, "s", 1), (5400, "min", 60), (172_800, "h", 3600)):
        if seconds < most:
            return f"{seconds / size:.2g} {unit}"
    return f"{seconds / 86_400:.3g} days"
