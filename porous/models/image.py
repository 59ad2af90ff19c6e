"""Images of scanners and of other programs: grey values in, one phase of them the body.

An image is segmented once, when the model is built: the voxels whose grey values lie within the
threshold are one phase, all others the other. The body is the union of the solid voxels, boxes that
any lattice can ask about; the lattice of the image itself is the one that is used where a recipe
asks for no other. What was done on the way is told in the model's notes.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path  # noqa: TC003  (pydantic reads it)
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator

from porous.errors import FormatWarning, ModelError, RecipeError
from porous.memory import check_memory
from porous.models.sections import Section, Spacing
from porous.models.threshold import Levels, levels_of, otsu, within
from porous.values import Box, Frame
from porous.values.image import Image
from porous.values.units import METRES, check_unit, length_ratio
from porous.values.value import Value, adopted, frozen, vector

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from typing import Self

    from numpy.typing import NDArray

    from porous.values import Pattern

    Flags = NDArray[np.bool_]
    Threshold = float | Sequence[float] | Literal["otsu"] | None

KIND = "image"
CLOSE = 1e-6
"""How far, in voxels, a lattice may lie from the image's own and be that."""
NUDGE = 0.01
"""The part of the range of grey values by which a threshold is moved, to tell what it does."""
PICTURES = (".png", ".tif", ".tiff")
"""Suffixes of slices in a folder."""
BARE = ".raw"
"""Suffix of files that hold voxels and nothing else."""
SIZES = ("no voxel size", "no distance of layers")
"""What readers say of sizes that are missing; of no use where the recipe says them."""
REMEDY = 'wanted threshold = "otsu", or a grey value of your own'


@dataclass(frozen=True, eq=False)
class Segmented(Value):
    """The union of the solid voxels of an image.

    Parameters
    ----------
    solid
        bool, axes (x, y, z): True where a voxel is solid.
    spacing
        Edge lengths of a voxel, in ``unit``.
    lower
        Outer corner of the first voxel, in ``unit``.
    unit
        nm, um, mm, cm, m or in.
    notes
        How it came about, for who reads the results.

    Raises
    ------
    ModelError
        For an image that is flat, or has one phase alone.
    """

    solid: Flags = field(repr=False)
    spacing: tuple[float, float, float]
    lower: tuple[float, float, float] = (0.0, 0.0, 0.0)
    unit: str = "mm"
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        given = np.asarray(self.solid)
        if given.dtype != np.bool_ or given.ndim != 3:
            got = f"{given.dtype} of shape {given.shape}"
            raise ModelError(f"solid: got {got}; wanted bool on three axes")
        if min(given.shape) < 2:
            shape = _times(given.shape)
            raise ModelError(f"image: got {shape} voxels; wanted at least 2 along x, y and z")
        self._set("solid", frozen(given, np.bool_))
        count = int(np.count_nonzero(self.solid))
        if count in (0, given.size):
            what = "solid" if count else "void"
            raise ModelError(f"image: all of its {given.size} voxels are {what}; wanted both")
        check_unit(self.unit)
        self._set("spacing", vector(self.spacing, "spacing", ModelError))
        self._set("lower", vector(self.lower, "lower", ModelError))
        if min(self.spacing) <= 0:
            raise ModelError(f"spacing: got {self.spacing}; wanted three positive lengths")
        self._set("notes", tuple(self.notes))

    @cached_property
    def domain(self) -> Box:
        """The box of the image."""
        return self.lattice().box

    @property
    def bulk(self) -> Box:
        """The same box."""
        return self.domain

    def lattice(self, periodic: tuple[bool, bool, bool] = (False, False, False)) -> Frame:
        """Return the image's own lattice of voxels."""
        x, y, z = self.solid.shape
        return Frame(self.lower, self.spacing, (x, y, z), periodic, self.unit)

    def sample(self, frame: Frame, pattern: Pattern) -> NDArray[np.uint64]:
        """Return the mask of each voxel: each point is asked for at its own place."""
        from porous.kernels.boxes import masks_of

        x, y = (self._voxels(frame, axis, pattern.rows[:, axis]) for axis in range(2))
        z = self._voxels(frame, 2, pattern.depths.reshape(-1))
        return masks_of(self.solid, x, y, z.reshape(*pattern.depths.shape, -1))

    def _voxels(self, frame: Frame, axis: int, parts: NDArray[np.float64]) -> NDArray[np.int64]:
        """Return in which of the image's voxels places within a frame's lie, −1 where in none."""
        steps = frame.start[axis] + np.arange(frame.shape[axis]) + parts[:, None]
        away = frame.origin[axis] - self.lower[axis] + steps * frame.spacing[axis]
        index = np.floor(away / self.spacing[axis])
        inside = (index >= 0) & (index < self.solid.shape[axis])
        return np.where(inside, index, -1).astype(np.int64)

    def fill(
        self,
        frame: Frame,
        pattern: Pattern,  # noqa: ARG002  (of whole voxels every pattern finds the same)
        progress: Callable[[int, int], None] | None = None,
    ) -> NDArray[np.uint8] | None:
        """Return the fill of every voxel of the image's own lattice; None for other lattices."""
        first = self._first(frame)
        if first is None:
            return None
        part = tuple(slice(a, a + n) for a, n in zip(first, frame.shape, strict=True))
        result = np.multiply(self.solid[part], np.uint8(255), dtype=np.uint8)
        if progress is not None:
            progress(1, 1)
        return result

    def _first(self, frame: Frame) -> tuple[int, ...] | None:
        """Return which voxel a frame begins with, where it is a part of the image's lattice."""
        first = []
        for low, h, n, start, count, place, step in zip(
            self.lower,
            self.spacing,
            self.solid.shape,
            frame.start,
            frame.shape,
            frame.origin,
            frame.spacing,
            strict=True,
        ):
            begin = (place - low + start * step) / h
            nearest = round(begin)
            drift = abs(begin - nearest) + abs(step / h - 1) * count
            if drift > CLOSE or not 0 <= nearest <= n - count:
                return None
            first.append(nearest)
        return tuple(first)


def segment(
    image: Image,
    *,
    threshold: Threshold = None,
    phase: str = "solid",
    region: tuple[Sequence[int], Sequence[int]] | None = None,
    notes: Sequence[str] = (),
) -> Segmented:
    """Return the body that one phase of an image is.

    Parameters
    ----------
    image
        Grey values.
    threshold
        A number: values at or above it are selected. Two numbers: those from the one to the other,
        both within. ``"otsu"``: the number that parts the values of the region best. None: of an
        image of two values the larger.
    phase
        What is selected: ``"solid"`` or ``"pore"``.
    region
        First voxel and end of the part that is taken, along x, y and z; the end is not within.
    notes
        What is to be told before what is found here.

    Raises
    ------
    ModelError
        For a region outside of the image, a threshold outside of its grey values, more than two
        values without a threshold, and an image that is flat or has one phase alone.
    """
    check_memory(3 * image.values.size, "the segmented image", "Choose a region of it.")
    part, lower, told = _cut(image, region)
    if min(part.shape) < 2:
        raise ModelError(
            f"image: got {_times(part.shape)} voxels, which is flat; wanted a stack of at least 2 "
            "along x, y and z"
        )
    levels = levels_of(part)
    if threshold is None:
        _check_two_values(part, levels)
    low, high, how = _limits(levels, threshold)
    selected = within(part, low, high)
    count = int(np.count_nonzero(selected))
    if count in (0, part.size):
        raise ModelError(
            f"threshold: got {_shown(threshold)}, which selects {'all' if count else 'none'} of "
            f"{part.size} voxels; their grey values run from {levels.low:.6g} to "
            f"{levels.high:.6g}: {REMEDY} between them"
        )
    share = f"{count / part.size:.4%} of {_times(part.shape)} voxels are selected as {phase}"
    told = [*notes, *told, f"{how}: {share}{_moved(levels, low, high, threshold)}"]
    solid = selected if phase == "solid" else np.logical_not(selected, out=selected)
    if levels.bad:
        solid &= np.isfinite(part)
        told.append(f"{levels.bad} voxels hold no number; they are counted as void")
    adopted(solid)
    return Segmented(solid, image.spacing, lower, image.unit, tuple(told))


def _cut(
    image: Image, region: tuple[Sequence[int], Sequence[int]] | None
) -> tuple[NDArray[Any], tuple[float, float, float], list[str]]:
    """Return the values of a region, its outer corner, and what to tell of it."""
    if region is None:
        return image.values, image.origin, []
    first, end = (tuple(map(int, side)) for side in region)
    good = all(0 <= a < b <= n for a, b, n in zip(first, end, image.shape, strict=True))
    if not good:
        raise ModelError(
            f"region: got voxels {list(first)} to {list(end)}; wanted lower below upper, within "
            f"[0, 0, 0] to {list(image.shape)}"
        )
    part = tuple(slice(a, b) for a, b in zip(first, end, strict=True))
    corner = [o + a * h for o, a, h in zip(image.origin, first, image.spacing, strict=True)]
    told = f"region: voxels {list(first)} to {list(end)} of {_times(image.shape)}"
    return image.values[part], (corner[0], corner[1], corner[2]), [told]


def _limits(levels: Levels, threshold: Threshold) -> tuple[float, float, str]:
    """Return least and greatest value that are selected, and how they were chosen."""
    if threshold is None:
        how = f"two grey values, {levels.low:.6g} and {levels.high:.6g}, the larger"
        return levels.high, math.inf, how
    if threshold == "otsu":
        low, apart = otsu(levels)
        how = f"threshold by Otsu at {low:.6g} (between classes lies {apart:.1%} of the variance)"
        return low, math.inf, how
    if isinstance(threshold, int | float):
        return threshold, math.inf, f"threshold at {threshold:.6g}"
    low, high = threshold
    if not low <= high:
        raise ModelError(f"threshold: got {_shown(threshold)}; wanted the smaller number first")
    return low, high, f"grey values from {low:.6g} to {high:.6g}"


def _check_two_values(part: NDArray[Any], levels: Levels) -> None:
    """Refuse an image without a threshold that is not of two values."""
    if levels.bad:
        raise ModelError(
            f"threshold: got none, and {levels.bad} voxels hold no number: that is no image of two "
            f"values; {REMEDY}"
        )
    if levels.low == levels.high:
        raise ModelError(f"image: all of its voxels hold {levels.low:.6g}; wanted two phases")
    if not ((part == part.max()) | (part == part.min())).all():
        count = len(levels.counts)
        many = f"{count} grey values" if count > 2 else "more than two grey values"
        raise ModelError(
            f"threshold: got none for an image of {many}, from {levels.low:.6g} to "
            f"{levels.high:.6g}; {REMEDY}"
        )


def _moved(levels: Levels, low: float, high: float, threshold: Threshold) -> str:
    """Return what a slightly different threshold would select."""
    if threshold is None:
        return ""
    step = NUDGE * (levels.high - levels.low)
    inner, outer = (levels.share(low + by, high - by) for by in (step, -step))
    return (
        f"; {inner:.2%} to {outer:.2%} would be where the threshold lay {NUDGE:.0%} of the range "
        "of grey values higher or lower"
    )


def _shown(threshold: Threshold) -> str:
    if isinstance(threshold, int | float):
        return f"{threshold:.6g}"
    return repr(threshold if threshold == "otsu" else list(threshold or ()))


def _times(shape: Sequence[int]) -> str:
    return " × ".join(map(str, shape))


# --- the recipe's section ----------------------------------------------------------------------


Index = Annotated[int, Field(ge=0)]
Corner = Annotated[tuple[Index, Index, Index], Field(strict=False)]


class RegionSection(Section):
    """The part of an image that is taken, in voxels."""

    lower: Corner = Field(description="three whole numbers: the first voxel along x, y and z")
    upper: Corner = Field(
        description="three whole numbers: where it ends along x, y and z, not within"
    )

    @model_validator(mode="after")
    def _proper(self) -> Self:
        if any(a >= b for a, b in zip(self.lower, self.upper, strict=True)):
            raise ValueError(f"got upper {self.upper}; wanted it above lower {self.lower}")
        return self


class ImageSection(Section):
    """``[model]`` of kind image."""

    OWN_LATTICE: ClassVar[bool] = True
    FOLDERS: ClassVar[tuple[str, ...]] = ("path",)

    kind: Literal["image"] = Field(description='"image"')
    path: Path = Field(
        strict=False,
        description="a path to an image: TIFF, NRRD, MHD, VTI or NPZ, or a folder of slices",
    )
    spacing: Spacing | None = Field(
        default=None,
        description="the edge lengths of a voxel along x, y and z, above zero, or one for all; "
        "where it is missing, what the file says",
    )
    unit: Literal["nm", "um", "mm", "cm", "m", "in"] | None = Field(
        default=None,
        description=f"{', '.join(METRES)}: of all lengths; where it is missing, the file's, and mm "
        "for a spacing of the recipe's own",
    )
    phase: Literal["solid", "pore"] = Field(
        default="solid", description='"solid" or "pore": what is selected'
    )
    threshold: (
        float | Annotated[tuple[float, float], Field(strict=False)] | Literal["otsu"] | None
    ) = Field(
        default=None,
        description='a grey value, at or above which is selected, [least, greatest], or "otsu"; '
        "an image of two values needs none",
    )
    region: RegionSection | None = Field(
        default=None, description="a table with lower and upper, in voxels"
    )


def table_of(path: Path) -> dict[str, Any]:
    """Return the recipe that an image is by itself, without a threshold; empty for other files.

    Raises
    ------
    RecipeError
        For a folder without slices, and for voxels whose header is another file.
    """
    from porous.formats import images

    if path.is_dir():
        is_image = any(file.suffix.lower() in PICTURES for file in path.iterdir())
        if not is_image:
            raise RecipeError(
                f"{path}: is a folder without slices, PNG or TIFF; wanted such a one, a recipe "
                "(TOML), an image or a preset's name"
            )
    elif path.suffix.lower() == BARE and path.is_file():
        raise RecipeError(
            f"{path}: voxels without their number, type and size; wanted an .mhd or .nhdr file "
            "beside it that says these"
        )
    else:
        is_image = path.suffix not in ("", ".toml") and path.suffix.lower() in images()
    if not is_image:
        return {}
    return {"format": 1, "title": path.name, "model": {"kind": KIND, "path": path.name}}


def build(section: ImageSection, folder: Path) -> Segmented:
    """Return the model that a section describes; its file is relative to ``folder``."""
    image, notes = _read(folder / section.path)
    image, told = _sized(image, section)
    if section.spacing is not None:
        notes = [note for note in notes if not any(size in note for size in SIZES)]
    box = section.region
    return segment(
        image,
        threshold=section.threshold,
        phase=section.phase,
        region=None if box is None else (box.lower, box.upper),
        notes=(*notes, *told),
    )


def _read(path: Path) -> tuple[Image, list[str]]:
    """Return an image, and what its reader has to say of it."""
    from porous.formats import read_image

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        image = read_image(path)
    notes = []
    for warning in caught:
        if not issubclass(warning.category, FormatWarning):
            warnings.warn_explicit(
                warning.message, warning.category, warning.filename, warning.lineno
            )
        else:
            notes.append(str(warning.message).replace(str(path), path.name))
    return image, notes


def _sized(image: Image, section: ImageSection) -> tuple[Image, list[str]]:
    """Return the image with the sizes that the recipe says, else in the recipe's unit.

    Who does not believe the file's voxel size does not believe where it puts the image either.
    """
    if section.spacing is not None:
        given = section.unit or "mm"
        told = f"voxels of {_lengths(section.spacing)} {given}, as the recipe says"
        return Image(image.values, section.spacing, (0.0, 0.0, 0.0), given), [told]
    unit: str = section.unit or image.unit
    ratio = length_ratio(image.unit, unit)
    if ratio == 1:
        return image, []
    (x, y, z), (u, v, w) = image.spacing, image.origin
    spacing, origin = (ratio * x, ratio * y, ratio * z), (ratio * u, ratio * v, ratio * w)
    return Image(image.values, spacing, origin, unit), []


def _lengths(values: Sequence[float]) -> str:
    return " × ".join(f"{value:.6g}" for value in values)
