"""What crosses the border: one file per format, reader and writer side by side, values only."""

from porous.formats._registry import (
    Format,
    check,
    formats,
    images,
    members,
    read,
    read_image,
    write,
)

__all__ = ["Format", "check", "formats", "images", "members", "read", "read_image", "write"]
