"""What ITK makes of images: those it is given, and some of its own for us to read."""

import json
import sys
import zlib
from pathlib import Path

import numpy as np
import SimpleITK as sitk

SPACING, ORIGIN = (0.25, 1.5, 3.0), (-2.0, 0.125, 7.5)
TYPES = ("uint8", "int8", "uint16", "int16", "uint32", "int32", "uint64", "float32", "float64")


def told(path):
    image = sitk.ReadImage(path)
    values = sitk.GetArrayFromImage(image)
    return {
        "size": image.GetSize(),
        "spacing": image.GetSpacing(),
        "origin": image.GetOrigin(),
        "direction": image.GetDirection(),
        "type": str(values.dtype),
        "crc32": zlib.crc32(np.ascontiguousarray(values)),
    }


def written(folder):
    """Write an image of each type in each format, packed and not; and one that was changed."""
    for name in TYPES:
        z, y, x = np.meshgrid(np.arange(7), np.arange(6), np.arange(5), indexing="ij")
        image = sitk.GetImageFromArray(((x * 31 + y * 7 + z * 3) % 120).astype(name))
        image.SetSpacing(SPACING)
        image.SetOrigin(ORIGIN)
        for suffix in (".nrrd", ".nhdr", ".mhd", ".mha"):
            for packed in (False, True):
                path = Path(folder) / f"{name}-{packed}{suffix}"
                sitk.WriteImage(image, str(path), useCompression=packed)
                yield path.name


def changed(path, folder):
    """Read one of ours and write it again: as it is, cropped, and with a threshold."""
    image = sitk.ReadImage(path)
    for suffix in (".nrrd", ".mha"):
        sitk.WriteImage(image, str(Path(folder) / f"same{suffix}"))
        others = {"cropped": image[1:, 2:, :]}
        others["binary"] = sitk.BinaryThreshold(image, 128, 255, 1, 0)
        for name, other in others.items():
            for key in image.GetMetaDataKeys():
                other.SetMetaData(key, image.GetMetaData(key))
            sitk.WriteImage(other, str(Path(folder) / f"{name}{suffix}"))


command, *paths = sys.argv[1:]
if command == "write":
    json.dump(list(written(*paths)), sys.stdout)
elif command == "change":
    json.dump(changed(*paths), sys.stdout)
else:
    json.dump([told(path) for path in paths], sys.stdout)
