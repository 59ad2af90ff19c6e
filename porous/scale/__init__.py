"""How work goes on where memory ends: tiles, and the store that they are written to."""

from porous.scale.codec import crc32c_of
from porous.scale.files import read_sealed
from porous.scale.rasterise import fill_store
from porous.scale.sealed import seal
from porous.scale.store import CHUNK, Store
from porous.scale.stored_grid import StoredGrid
from porous.scale.tally import Tally

__all__ = [
    "CHUNK",
    "Store",
    "StoredGrid",
    "Tally",
    "crc32c_of",
    "fill_store",
    "read_sealed",
    "seal",
]
