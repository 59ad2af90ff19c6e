"""What the files of a folder are called, and how a record becomes one."""

from __future__ import annotations

import json
import math
from typing import Any

KINDS = ("tets", "hexes", "cells")
"""What the files of a volume mesh are called."""

RESULTS = ("results.json", "results.vtu", "results.png")
"""What ``solve`` puts into a folder."""


def row_of(value: Any) -> dict[str, Any]:
    """Return the fields of a flat value; JSON knows no NaN, so what is not finite becomes null."""
    row = {name: getattr(value, name) for name in value.__dataclass_fields__}
    return {
        name: None if isinstance(part, float) and not math.isfinite(part) else part
        for name, part in row.items()
    }


def rendered(record: dict[str, Any]) -> str:
    """Return a record as JSON text, the same for the same record."""
    return json.dumps(record, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def as_json(record: dict[str, Any]) -> bytes:
    """Return a record as the bytes of a JSON file."""
    return rendered(record).encode()
