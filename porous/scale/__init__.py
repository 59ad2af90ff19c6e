"""How work goes on where memory ends: tiles, and the store that they are written to."""

from porous.scale.store import Store
from porous.scale.stored_grid import StoredGrid

__all__ = ["Store", "StoredGrid"]
