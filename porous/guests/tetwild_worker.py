"""The process in which pytetwild works: ``python -m porous.guests.tetwild_worker IN.npz OUT.npz``.

A file of its own, started afresh: pytetwild may die by a signal, hangs in a forked child, and
writes files into the current folder.
"""

from __future__ import annotations

import ctypes
import importlib
import math
import signal
import sys
from typing import Any

import numpy as np

FIELD = {"bg_vertices": np.float64, "bg_tets": np.int32, "bg_values": np.float64}
"""A field of wanted edge lengths, in the surface's own unit, linear in each tetrahedron."""

PR_SET_PDEATHSIG = 1


def _end_with_parent() -> None:
    """Have the kernel end this process with the one that started it, where it is Linux."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)


def main(source: str, target: str) -> None:
    """Mesh the surface in ``source`` and write ``points`` and ``tets`` to ``target``."""
    with np.load(source, allow_pickle=False) as given:
        points, triangles = given["points"], given["triangles"]
        options: dict[str, Any] = {
            key: float(given[key])
            for key in ("edge_length_abs", "epsilon", "stop_energy")
            if key in given
        }
        options["disable_filtering"] = bool(given["disable_filtering"])
        options["num_opt_iter"] = int(given["num_opt_iter"])
        for key, dtype in FIELD.items():
            if key in given:
                options[key] = np.array(given[key], dtype=dtype)
        # Should nobody be left to end this process, the kernel does.
        signal.alarm(math.ceil(float(given["time_limit"])) + 10)
        _end_with_parent()
    engine: Any = importlib.import_module("pytetwild")
    nodes, tets = engine.tetrahedralize(
        np.array(points, dtype=np.float64),
        np.array(triangles, dtype=np.int32),
        vtk_ordering=True,
        quiet=True,
        **options,
    )
    np.savez(target, points=np.asarray(nodes, np.float64), tets=np.asarray(tets, np.int64))


if __name__ == "__main__":
    main(*sys.argv[1:])
