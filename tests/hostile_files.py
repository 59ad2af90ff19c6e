"""Every hostile file of the tests, by the suffix of its reader."""

import test_hostile
import test_hostile_3mf
import test_hostile_frd
import test_hostile_images


def hostile():
    """Return for each reader's suffix what is wrong with files, and the files by their names.

    The first file is the one that is read; where the reader is to accept it, the tests say so.
    """
    found: dict[str, dict[str, dict[str, bytes]]] = {}
    for name, (suffix, data, _) in test_hostile.CASES.items():
        found.setdefault(suffix, {})[name.partition(", ")[2]] = {f"it{suffix}": data}
    for name, (files, _) in test_hostile_images.CASES.items():
        suffix = "." + name.partition(",")[0]
        found.setdefault(suffix, {})[name.partition(", ")[2]] = files
    for name, (data, _) in test_hostile_3mf.FILES.items():
        found.setdefault(".3mf", {})[name] = {"it.3mf": data}
    found[".frd"] = {name: {"it.frd": data} for name, (data, _) in test_hostile_frd.FRD.items()}
    found[".mhd"] = found.pop(".mha")
    return found
