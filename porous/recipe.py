"""TOML ⇄ Recipe: what a recipe may say, and what is wrong with one that cannot be understood.

A recipe is data, never code: nothing is evaluated, unknown keys are errors that name the nearest
known one. The ``[model]`` section belongs to the file in ``porous/models`` that its kind names, the
``[simulation]`` section to the file in ``porous/jobs`` that its analysis names.
"""

from __future__ import annotations

import contextlib
import copy
import hashlib
import importlib
import pkgutil
import re
from functools import cache
from itertools import pairwise
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal, get_args

from pydantic import (
    BaseModel,
    Field,
    InstanceOf,
    SerializeAsAny,
    ValidationError,
    model_validator,
)

import porous.models
from porous import jobs, presets
from porous.errors import RecipeError, nearest
from porous.jobs import SimulationSection  # noqa: TC001  (pydantic reads it)
from porous.models.image import table_of
from porous.models.sections import CleanSection, Section
from porous.models.stage_sections import (
    ReportSection,
    SurfaceSection,
    VolumeSection,
    VoxelsSection,
)
from porous.toml import parse_value, read_table, render_table, shown

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from porous.models.model import Model

ALTERNATIVES = (
    ("voxels.voxels", "voxels.spacing", "voxels.per_feature"),
    ("model.digits", "model.maps"),
    ("model.cell", "model.states"),
    ("simulation.pressure", "simulation.strain"),
    ("simulation.pressure_drop", "simulation.velocity"),
)
"""Keys of which a recipe has one: setting one removes the others."""


class Expected(Section):
    """What a measure is to be, give or take."""

    value: float = Field(description="a number")
    tolerance: float = Field(ge=0, description="a number, zero or more")


class Recipe(Section):
    """What is to be made and how fine; ``load`` makes one, ``dump`` writes it out in full.

    Relative paths in it are those of the folder that porous runs in: ``load`` has resolved them.
    """

    format: Literal[1] = Field(default=1, description="1")
    title: str = Field(default="", description="a line of text")
    source: str = Field(default="", description="a line of text: whose idea this is")
    seed: int = Field(default=0, ge=0, description="a whole number, zero or more")
    model: SerializeAsAny[InstanceOf[BaseModel]] = Field(description="a table [model]")
    voxels: VoxelsSection = Field(default=VoxelsSection(), description="a table [voxels]")
    clean: CleanSection | None = Field(default=None, description="a table [clean]")
    surface: SurfaceSection = Field(default=SurfaceSection(), description="a table [surface]")
    volume: VolumeSection = Field(default=VolumeSection(), description="a table [volume]")
    simulation: SerializeAsAny[InstanceOf[SimulationSection]] | None = Field(
        default=None, description="a table [simulation]"
    )
    report: ReportSection | None = Field(default=None, description="a table [report]")
    expect: dict[str, Expected] = Field(
        default_factory=dict, description="a table [expect] of measures"
    )

    @model_validator(mode="after")
    def _is_of_voxels(self) -> Recipe:
        for where, method in (("surface", self.surface.method), ("volume", self.volume.method)):
            if self.clean is not None and method in ("exact", "cells"):
                raise ValueError(
                    f'clean: cleans voxels, and {where}.method = "{method}" is of the model; '
                    'wanted "auto" there'
                )
        return self

    @property
    def phase(self) -> str:
        """What the volume mesh is of: ``"solid"``, ``"pore"`` or ``"both"``."""
        if self.volume.phase != "auto":
            return self.volume.phase
        needed: str = getattr(type(self.simulation), "PHASE", "solid")
        # Pores that are not filled with anything are not simulated.
        filled = getattr(self.simulation, "pore_material", None) is not None
        return "solid" if needed == "both" and not filled else needed

    @property
    def detail(self) -> str:
        """How much is measured: ``"brief"`` or ``"full"``; images in full where nothing is said."""
        asked = self.report.detail if self.report else None
        return asked or ("full" if self.model.kind == "image" else "brief")  # type: ignore[attr-defined]

    @property
    def sha256(self) -> str:
        """The hash of the recipe in full, as written by ``dump``."""
        return hashlib.sha256(dump(self).encode()).hexdigest()


def load(recipe: str | Path, *, set: Mapping[str, object] | None = None) -> Recipe:  # noqa: A002
    """Return the recipe of a preset's name or a path.

    Parameters
    ----------
    recipe
        ``"menger"``, or a path to a TOML file; an image is a recipe of its own (``table_of``).
    set
        Values to put in place of the recipe's own, by key path: ``{"model.level": 3}``. What the
        recipe expects is left out then, since it speaks of the recipe as it was.

    Raises
    ------
    RecipeError
        Where there is no such recipe, it is not TOML, or a key or a value is not understood; names
        the file, the key path, what was got and what was wanted.
    """
    path = find(recipe)
    table = table_of(path) or read_table(path)
    _forget(table, (set or {}).get("simulation.analysis"))
    for key, value in (set or {}).items():
        _put(table, key, value)
    spoken = {key.partition(".")[0] for key in set or ()}
    if spoken - {"report"} and "expect" not in spoken:
        table.pop("expect", None)
    return parse(table, name=str(path), folder=path.parent)


def _forget(table: dict[str, Any], analysis: object) -> None:
    """Drop what another analysis than the recipe's own knows nothing of."""
    section, there = jobs.sections().get(str(analysis)), table.get("simulation")
    if section is not None and isinstance(there, dict):
        table["simulation"] = {k: v for k, v in there.items() if k in section.model_fields}


def find(recipe: str | Path) -> Path:
    """Return where the recipe lies that a preset's name or a path means."""
    text = str(recipe)
    is_path = isinstance(recipe, Path) or Path(text).suffix or "/" in text
    if is_path or (text not in presets.names() and Path(text).exists()):
        return Path(recipe)
    return presets.path_of(text)


def parse(table: Mapping[str, Any], *, name: str = "recipe", folder: Path | None = None) -> Recipe:
    """Return the recipe that a table says.

    Parameters
    ----------
    table
        Plain dictionaries, lists, strings and numbers, as TOML has them.
    name
        What errors call it.
    folder
        Where its relative paths start; the folder that porous runs in where not given.

    Raises
    ------
    RecipeError
        As ``load``.
    """
    content = copy.deepcopy(dict(table))
    if not isinstance(content.get("model"), dict):
        raise RecipeError(f"{name}: model: got {_got(content, ('model',))}; wanted a table [model]")
    section = section_of(content["model"], name)
    _resolve_files(content["model"], section, folder or Path(), name, "model")
    content["model"] = _validated(section, content["model"], name, ("model",))
    if "simulation" in content:
        content["simulation"] = _simulation(content["simulation"], folder or Path(), name)
    recipe = _validated(Recipe, content, name, ())
    assert isinstance(recipe, Recipe)
    return _settled(recipe, name)


def build(recipe: Recipe) -> Model:
    """Return the model that a recipe describes.

    Raises
    ------
    ModelError
        Where there is no such model: maps without an attractor, a primitive that is not closed, …
    """
    if not isinstance(recipe, Recipe):
        raise RecipeError(f"build: got {recipe!r:.80}; wanted a recipe, such as load('menger')")
    kind: str = recipe.model.kind  # type: ignore[attr-defined]
    model: Model = importlib.import_module(f"porous.models.{kind}").build(recipe.model, Path())
    return model


def dump(recipe: Recipe) -> str:
    """Return the recipe as TOML, every default said; the same recipe gives the same text."""
    table = recipe.model_dump(mode="json", exclude_none=True)
    return render_table({key: value for key, value in table.items() if value != {}})


def schema() -> dict[str, Any]:
    """Return the JSON Schema of recipes, with the models of every kind."""
    result = Recipe.model_json_schema(mode="serialization")
    for place, choices in (("model", sections()), ("simulation", jobs.sections())):
        one_of = []
        for name, section in choices.items():
            part = section.model_json_schema(ref_template="#/$defs/{model}")
            definitions = result.setdefault("$defs", {})
            definitions.update(part.pop("$defs", {}))
            definitions[f"{place}_{name}"] = part
            one_of.append({"$ref": f"#/$defs/{place}_{name}"})
        result["properties"][place] = {"oneOf": one_of}
    return result


@cache
def sections() -> Mapping[str, type[BaseModel]]:
    """Return the model sections there are, by kind: the kind is the name of its file."""
    names = sorted(info.name for info in pkgutil.iter_modules(porous.models.__path__))
    found = {name: _section_in(name) for name in names}
    return MappingProxyType({kind: section for kind, section in found.items() if section})


def _simulation(table: Any, folder: Path, name: str) -> BaseModel:
    section = jobs.section_of(table, name)
    _resolve_files(table, section, folder, name, "simulation")
    return _validated(section, table, name, ("simulation",))


def section_of(table: Mapping[str, Any], name: str) -> type[BaseModel]:
    """Return the section class of a ``[model]`` table, or raise ``RecipeError`` listing kinds."""
    kind = table.get("kind")
    if not isinstance(kind, str) or kind not in sections():
        got = f"unknown kind {shown(kind)}" if "kind" in table else "missing"
        raise RecipeError(f"{name}: model.kind: {got}; there is {', '.join(sections())}")
    return sections()[kind]


def _section_in(module: str) -> type[BaseModel] | None:
    for value in vars(importlib.import_module(f"porous.models.{module}")).values():
        if isinstance(value, type) and issubclass(value, BaseModel):
            kind = value.model_fields.get("kind")
            if kind is not None and get_args(kind.annotation) == (module,):
                return value
    return None


def _settled(recipe: Recipe, name: str) -> Recipe:
    """Return the recipe with what follows from the rest filled in."""
    voxels = recipe.voxels
    limit = getattr(recipe.model, "level", None) == "limit"
    bare = limit and not getattr(recipe.model, "offset", 0)
    own = getattr(recipe.model, "OWN_LATTICE", False) and not any(
        (voxels.voxels, voxels.spacing, voxels.per_feature)
    )
    usual = "cover" if bare else "centre" if own else "fill"
    change: dict[str, object] = {"sampling": voxels.sampling or usual}
    if voxels.voxels is None and voxels.spacing is None and not own:
        if limit:
            raise RecipeError(
                f'{name}: voxels.per_feature: level = "limit" has no smallest feature to count '
                "across; wanted voxels.voxels = 100, say, or voxels.spacing"
            )
        change["per_feature"] = voxels.per_feature or 4
    return recipe.model_copy(update={"voxels": voxels.model_copy(update=change)})


def _put(table: dict[str, Any], path: str, value: object) -> None:
    """Set a value by its path, in place of its alternatives and of anything that is no table."""
    for group in ALTERNATIVES:
        mine = [key for key in group if path == key or path.startswith(f"{key}.")]
        for other in group if mine else ():
            section, _, key = other.partition(".")
            if other not in mine and isinstance(there := table.get(section), dict):
                there.pop(key, None)
    steps = _steps(path)
    here: Any = table
    for step, below in pairwise(steps):
        here = _entered(here, step, below, path)
    here[_index(here, steps[-1], path)] = value


def _steps(path: str) -> list[str]:
    """Return the keys of a path; one in quotation marks may hold dots, as in TOML."""
    outside = r'\.(?=(?:[^"]*"[^"]*")*[^"]*$)'
    return [re.sub(r'^"(.*)"$', r"\1", step) for step in re.split(outside, path)]


def _entered(here: Any, step: str, below: str, path: str) -> Any:
    key = _index(here, step, path)
    inner = here[key] if isinstance(here, list) else here.get(key)
    if not isinstance(inner, dict) and not (isinstance(inner, list) and below.isdigit()):
        inner = here[key] = {}
    return inner


def _index(here: Any, step: str, path: str) -> Any:
    if not step:
        raise RecipeError(f"--set {path}: got an empty key; wanted a path such as model.level")
    if isinstance(here, dict):
        return step
    if not step.isdigit() or int(step) >= len(here):
        raise RecipeError(f"--set {path}: got {step}; wanted 0 … {len(here) - 1}")
    return int(step)


def assignment(text: str) -> tuple[str, object]:
    """Return key path and value of ``path=VALUE``; the value is TOML, a bare word is a string."""
    path, equals, value = text.partition("=")
    if not equals or not path.strip():
        raise RecipeError(f"--set: got {text!r}; wanted path=VALUE, such as model.level=3")
    return path.strip(), parse_value(value.strip(), f"--set {path.strip()}")


def _resolve_files(
    table: Any, section: type[BaseModel], folder: Path, name: str, path: str
) -> None:
    """Make the paths in a table whole: relative to the recipe, else to the presets."""
    if not isinstance(table, dict):
        return
    for key, value in table.items():
        field = section.model_fields.get(key)
        for part in _models_in(field.annotation if field else None):
            _resolve_files(value, part, folder, name, f"{path}.{key}")
        kinds = (field.annotation, *get_args(field.annotation)) if field else ()
        if str in kinds and not str(value).endswith(presets.SUFFIX):
            continue  # a name among the presets
        if Path in kinds and isinstance(value, str):
            folders = key in getattr(section, "FOLDERS", ())
            table[key] = str(_resolved(value, folder, f"{name}: {path}.{key}", folders=folders))


def _resolved(value: str, folder: Path, where: str, *, folders: bool) -> Path:
    for place in (folder / value, presets.folder() / value):
        with contextlib.suppress(OSError, ValueError):  # a name too long, a null character
            if place.is_file() or (folders and place.is_dir()):
                return place.resolve()
    raise RecipeError(f"{where}: not found: {shown(value)}; wanted a file, relative to the recipe")


def files(recipe: Recipe) -> dict[str, Path]:
    """Return the files that a recipe reads, by key path."""
    found = dict(_files_in(recipe.model, "model"))
    if recipe.simulation is not None:
        found |= _files_in(recipe.simulation, "simulation")
    return found


def _files_in(section: BaseModel, path: str) -> Iterable[tuple[str, Path]]:
    for name in type(section).model_fields:
        value = getattr(section, name)
        if isinstance(value, Path):
            yield f"{path}.{name}", value
        elif isinstance(value, BaseModel):
            yield from _files_in(value, f"{path}.{name}")


def with_files(recipe: Recipe, names: Mapping[str, Path]) -> Recipe:
    """Return the recipe with other files in place of those at these key paths."""
    changed: Any = recipe
    for path, name in names.items():
        changed = _replaced(changed, path.split("."), name)
    assert isinstance(changed, Recipe)
    return changed


def _replaced(section: BaseModel, steps: list[str], value: object) -> BaseModel:
    step, *rest = steps
    inner = _replaced(getattr(section, step), rest, value) if rest else value
    return section.model_copy(update={step: inner})


def _validated(
    section: type[BaseModel], table: Mapping[str, Any], name: str, above: tuple[str, ...]
) -> BaseModel:
    try:
        return section.model_validate(table)
    except ValidationError as error:
        problems = [_problem(section, table, detail, above) for detail in error.errors()]
        # Unknown keys come first: a missing key is most often a misspelt one.
        first = min(problems, key=lambda problem: not problem[0])
        raise RecipeError(f"{name}: {first[1]}") from None


def _problem(
    section: type[BaseModel], table: Mapping[str, Any], detail: Any, above: tuple[str, ...]
) -> tuple[bool, str]:
    """Return whether one problem is an unknown key, and what to say of it."""
    where = _place(table, detail["loc"])
    if detail["type"] == "missing" and isinstance(detail["loc"][-1], str):
        where += (detail["loc"][-1],)
    path = ".".join(map(str, above + where))
    if detail["type"] == "extra_forbidden":
        known = sorted({key for part in _parts(section, where[:-1]) for key in part.model_fields})
        return True, f"{path}: unknown key{nearest(str(where[-1]), known)}"
    if detail["type"] == "value_error":
        return False, f"{path}: {detail['ctx']['error']}" if path else str(detail["msg"])
    wanted = _wanted(section, where) or detail["msg"].lower()
    return False, f"{path}: got {_got(table, where)}; wanted {wanted}"


def _place(table: Any, loc: tuple[int | str, ...]) -> tuple[int | str, ...]:
    """Return the part of a location that is there: pydantic puts branches of unions between."""
    result: list[int | str] = []
    for step in loc:
        if isinstance(table, dict):
            inside = step in table
        else:
            inside = isinstance(table, list) and isinstance(step, int) and step < len(table)
        if inside:
            table = table[step]
            result.append(step)
    return tuple(result)


def _got(table: Any, where: tuple[int | str, ...]) -> str:
    for step in where:
        if isinstance(table, dict) and step not in table:
            return "nothing"
        table = table[step]
    return shown(table)


def _wanted(section: type[BaseModel], where: tuple[int | str, ...]) -> str:
    """Return the description of the innermost field on a path, if it has one."""
    for end in range(len(where), 0, -1):
        for part in _parts(section, where[: end - 1]):
            field = part.model_fields.get(str(where[end - 1]))
            if field is not None and field.description:
                return field.description.rstrip(".")
    return ""


def _parts(section: type[BaseModel], where: tuple[int | str, ...]) -> list[type[BaseModel]]:
    """Return the sections that the table at a place may be."""
    here = [section]
    for step in where:
        if isinstance(step, int):
            continue
        fields = [part.model_fields[step] for part in here if step in part.model_fields]
        deeper = [part for field in fields for part in _models_in(field.annotation)]
        here = deeper or here
    return here


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [part for inner in get_args(annotation) for part in _models_in(inner)]
