"""What a whole store consists of: every file with its size and CRC32C, written last of all."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from porous.errors import FormatError
from porous.scale.plan import FORMAT
from porous.values.value import Value

if TYPE_CHECKING:
    from collections.abc import Mapping

    from porous.scale.plan import Plan


@dataclass(frozen=True, eq=False)
class Manifest(Value):
    """Size and CRC32C of every file of a store, and what it is of.

    Parameters
    ----------
    files
        By name relative to the store: bytes, and CRC32C; of a chunk, that of its body alone,
        which is what its last four bytes say (``codec.check`` tells why).
    recipe_sha256, version
        As in ``Plan``.
    """

    files: Mapping[str, tuple[int, int]]
    recipe_sha256: str
    version: str

    def __post_init__(self) -> None:
        self._set("files", MappingProxyType(dict(self.files)))

    def record(self) -> dict[str, Any]:
        """Return the manifest as plain data for JSON."""
        return {
            "format": FORMAT,
            "recipe_sha256": self.recipe_sha256,
            "version": self.version,
            "files": {name: [size, f"{sum_:08x}"] for name, (size, sum_) in self.files.items()},
        }

    @classmethod
    def of_record(cls, record: dict[str, Any], plan: Plan, names: list[str]) -> Manifest:
        """Return the manifest that a record tells of.

        Raises
        ------
        FormatError
            Where it is of another plan, or does not list just the files ``names``.
        """
        files = record.get("files")
        if not isinstance(files, dict) or list(files) != names:
            raise FormatError("does not list the files that the plan asks for")
        try:
            read = {name: (int(size), int(sum_, 16)) for name, (size, sum_) in files.items()}
            found = cls(read, record["recipe_sha256"], record["version"])
        except (KeyError, TypeError, ValueError) as error:
            raise FormatError(f"is no manifest: {error}") from None
        same = (found.recipe_sha256, found.version) == (plan.recipe_sha256, plan.version)
        if found.record() != record or not same or read["plan.json"][1] != plan.crc32c:
            raise FormatError("is of another plan than plan.json")
        return found
