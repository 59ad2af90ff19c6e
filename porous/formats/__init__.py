"""What crosses the border: one file per format, reader and writer side by side, values only."""

from porous.formats._registry import Format, formats, read, write

__all__ = ["Format", "formats", "read", "write"]
