"""Which formats there are, and the two doors through which files come and go.

A format is one file of this folder that defines ``FORMAT``, and nothing else anywhere::

    FORMAT = Format(
        name="Wavefront OBJ",
        suffixes=(".obj",),          # the first one is the file's own name: obj.py
        reads=SurfaceMesh,           # None where there is no reader
        read=read,                   # (gate.Source) -> value
        writes=(SurfaceMesh,),
        write=write,                 # (value) -> chunks of bytes
    )

Some formats are several files: those have ``write_files``, which gives names and chunks, in place
of ``write``. They stand beside each other, the one that the user named last, or with
``folder=True`` all in a folder of that name.

The folder is listed, not imported: a format is imported when its suffix is asked for. Readers get
the file's bytes and see no path, so none can open another file but by ``Source.beside``; writers
give bytes, so every file appears whole or not at all (``disk``). Whatever a reader refuses, this
file puts the path before.
"""

from __future__ import annotations

import pkgutil
from dataclasses import dataclass, replace
from difflib import get_close_matches
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from porous import disk
from porous.errors import FormatError, GridError, MemoryLimitError, MeshError
from porous.formats.gate import Source, open_source
from porous.values import Job, VolumeMesh

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from porous.values.image import Image
    from porous.values.value import Value

    File = tuple[str, Iterable[bytes]]

T = TypeVar("T")

LONGEST = 400
"""The longest message about a file, in characters."""
HELPERS = ("gate",)
"""Files of this folder that are no format; so are those whose name begins with an underscore."""
FOLDER = "pngs"
"""The format that folders are read by."""
SPELLED = {"3mf": "threemf"}
"""The one suffix that begins with a digit, as no module's name may."""


@dataclass(frozen=True)
class Format:
    """One way of keeping a value in a file.

    Parameters
    ----------
    name
        What the field calls it.
    suffixes
        With the dot, in lower case; the first one names the module, its inner dots underscores
        (and ``SPELLED`` where it begins with a digit).
    reads, read
        The type of value a file holds, and the function from a ``Source`` to it.
    writes, write
        The types that can be written, and the function from a value to chunks of bytes.
    write_files
        Of a format of several files: from a value and the name that the user gave to pairs of a
        name, which may have folders in it where ``folder`` is true, and chunks of bytes.
    folder
        Whether what is written is a folder of files.
    shapes
        Of formats of volume meshes: the elements that are written; empty where all are.
    procedures
        What steps of a job are written; all else of a job is a mesh with its parts.
    needs
        Modules that are not always there, by the name that ``import`` knows.
    command
        The command line that runs a job's steps in the folder that ``{name}`` lies in, where there
        is one; ``{stem}`` is the name without its suffix.
    read_image
        Of formats of images: the function from a ``Source`` to the grey values as they are. Of a
        folder the source has no bytes.
    members
        Of images in several files: the names of the others, which lie beside it, or in the folder.
    """

    name: str
    suffixes: tuple[str, ...]
    reads: type[Value] | None = None
    read: Callable[[Source], Value] | None = None
    writes: tuple[type[Value], ...] = ()
    write: Callable[[Any], Iterable[bytes]] | None = None
    write_files: Callable[[Any, str], Iterable[File]] | None = None
    folder: bool = False
    shapes: tuple[str, ...] = ()
    procedures: tuple[str, ...] = ()
    needs: tuple[str, ...] = ()
    command: str = ""
    read_image: Callable[[Source], Image] | None = None
    members: Callable[[Source], tuple[str, ...]] | None = None

    @property
    def suffix(self) -> str:
        """The suffix that names the format."""
        return self.suffixes[0]


def formats() -> tuple[Format, ...]:
    """Return every format there is, by suffix."""
    return tuple(sorted(map(_load, _stems()), key=lambda form: form.suffix))


def read(path: str | Path) -> Value:
    """Read a file; its suffix says what it is.

    Parameters
    ----------
    path
        A regular file.

    Returns
    -------
    A ``SurfaceMesh``, ``VoxelGrid`` or ``VolumeMesh``, as ``formats()`` says.

    Raises
    ------
    FormatError
        Where the file is missing, damaged, or of a format that is not known.
    MemoryLimitError
        Where what it holds would not fit into memory.
    """
    form = _find(Path(path))
    if form.read is None:
        there = ", ".join(f.suffix for f in formats() if f.read)
        raise FormatError(f"{path}: {form.suffix} files are written, not read; wanted {there}")
    return _read(path, form.read)


def read_image(path: str | Path) -> Image:
    """Read the grey values of an image as they are; the suffix says which format it is.

    Parameters
    ----------
    path
        A regular file, or a folder of slices.

    Raises
    ------
    FormatError
        Where the file is missing, damaged, or of a format that holds no image.
    MemoryLimitError
        Where what it holds would not fit into memory.
    """
    form = _image_format(path)
    if form.read_image is None:
        raise FormatError(
            f"{path}: a {form.suffix} file holds no image; wanted one of {', '.join(images())}"
        )
    return _read(path, form.read_image, _image_source)


def members(path: str | Path) -> tuple[str, ...]:
    """Return the names of the other files that an image consists of, beside it or in the folder.

    Raises
    ------
    FormatError
        As ``read_image``.
    """
    form = _image_format(path)
    return _read(path, form.members, _image_source) if form.members else ()


def _image_format(path: str | Path) -> Format:
    return _load(FOLDER) if Path(path).is_dir() else _find(Path(path))


def _image_source(path: str | Path) -> Source:
    return Source(str(path), b"", Path(path)) if Path(path).is_dir() else open_source(path)


def images() -> tuple[str, ...]:
    """Return the suffixes of files that ``read_image`` reads."""
    return tuple(suffix for form in formats() if form.read_image for suffix in form.suffixes)


def _read(
    path: str | Path,
    reader: Callable[[Source], T],
    opened: Callable[[str | Path], Source] = open_source,
) -> T:
    """Return what a reader makes of a file; what it refuses is said with the path before it."""
    try:
        return reader(opened(path))
    except (FormatError, GridError, MeshError) as error:
        raise FormatError(f"{path}: {_plain(error)}") from None
    except MemoryLimitError as error:
        raise MemoryLimitError(f"{path}: {_plain(error)}") from None


def write(value: Value, path: str | Path) -> None:
    """Write a value; suffix and type pick the writer. The file appears whole or not at all.

    Parameters
    ----------
    value
        A ``SurfaceMesh``, ``VoxelGrid``, ``VolumeMesh`` or ``Job``.
    path
        A file of that name is replaced.

    Raises
    ------
    FormatError
        For a suffix that is not known or cannot hold that value; for a folder that is there
        already.
    DiskError
        Where the disk refuses.
    """
    form = _find(Path(path))
    try:
        _check_writable(form, value)
        _check_free(form, path)
        if form.write_files is None:
            assert form.write is not None
            disk.write_bytes(path, form.write(value))
        elif form.folder:
            disk.write_folder(path, form.write_files(value, Path(path).name))
        else:
            disk.write_files(Path(path).parent, form.write_files(value, Path(path).name))
    except FormatError as error:
        raise FormatError(f"{path}: {error}") from None


def check(value: Value, suffix: str) -> None:
    """Refuse what ``write`` would refuse to write, for a suffix without its dot; write nothing.

    Raises
    ------
    FormatError
        As ``write``.
    """
    form = _find(Path(f"it.{suffix}"))
    _check_writable(form, value)
    if form.write_files is not None:
        pieces = chain.from_iterable(some for _, some in form.write_files(value, f"it.{suffix}"))
    else:
        assert form.write is not None
        pieces = chain(form.write(value))
    for _ in pieces:
        pass


def _check_writable(form: Format, value: Value) -> None:
    """Refuse a value that a format cannot hold."""
    if not isinstance(value, form.writes):
        what = type(value).__name__
        homes = ", ".join(f.suffix for f in formats() if isinstance(value, f.writes))
        if not homes:
            raise TypeError(f"write: no format holds a {what}")
        raise FormatError(f"a {form.suffix} file cannot hold a {what}; wanted one of {homes}")
    missing = [name for name in form.needs if find_spec(name) is None]
    if missing:
        raise FormatError(
            f"{form.suffix} files need {' and '.join(missing)}; wanted pip install 'porous[io]'"
        )
    mesh = value.mesh if isinstance(value, Job) else value
    if form.shapes and isinstance(mesh, VolumeMesh):
        _check_all(form, "elements", (block.shape for block in mesh.blocks), "shapes")
    if isinstance(value, Job):
        _check_all(form, "a step of", (step.procedure for step in value.steps), "procedures")


def _check_free(form: Format, path: str | Path) -> None:
    """Refuse to write a folder where something is: that may be more than we know of."""
    if form.folder and (why := disk.taken(path)):
        raise FormatError(why)


def _check_all(form: Format, what: str, got: Iterable[str], name: str) -> None:
    for one in got:
        if one not in getattr(form, name):
            homes = [f.suffix for f in formats() if one in getattr(f, name) and f.writes]
            raise FormatError(
                f"a {form.suffix} file cannot hold {what} {one}; wanted one of "
                f"{', '.join(homes) or 'none: no format can'}"
            )


def _plain(error: Exception) -> str:
    """Return a message on one line; what a file calls itself must not steer the terminal."""
    line = " ".join(str(error).split())
    return "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in line)[:LONGEST]


def _find(path: Path) -> Format:
    """Return the format of a name; the suffix that it was found by is its first."""
    for suffix in ("".join(path.suffixes[-2:]).lower(), path.suffix.lower()):
        stem = suffix[1:].replace(".", "_")
        if (stem := SPELLED.get(stem, stem)) in _stems():
            return _load(stem)
    known = {s: form for form in formats() for s in form.suffixes}
    if suffix in known:
        form = known[suffix]
        return replace(form, suffixes=tuple(dict.fromkeys((suffix, *form.suffixes))))
    alike = [other for other in sorted(known) if other[:2] == suffix[:2]]
    near = get_close_matches(suffix, alike, n=1)
    hint = f"did you mean {near[0]}? There are" if near else "there are"
    got = f"unknown format {suffix!r}" if suffix else "the name has no suffix to tell its format"
    raise FormatError(f"{path}: {got}; {hint} {', '.join(sorted(known))}")


@cache
def _stems() -> tuple[str, ...]:
    names = sorted(module.name for module in pkgutil.iter_modules([str(Path(__file__).parent)]))
    return tuple(name for name in names if name not in HELPERS and not name.startswith("_"))


def _load(stem: str) -> Format:
    form: Format = import_module(f"porous.formats.{stem}").FORMAT
    return form
