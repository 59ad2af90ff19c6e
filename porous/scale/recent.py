"""The last few things made, kept while there is room: neighbours of a tile are asked for again."""

from __future__ import annotations

from collections import OrderedDict
from threading import Lock
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np
    from numpy.typing import NDArray


class Recent:
    """Arrays by name, the least recently used ones forgotten first; for any number of threads.

    Parameters
    ----------
    room
        Bytes that are kept at most.
    """

    def __init__(self, room: int) -> None:
        self._room, self._taken = room, 0
        self._arrays: OrderedDict[str, NDArray[np.uint8]] = OrderedDict()
        self._lock = Lock()

    def get(self, name: str, make: Callable[[str], NDArray[np.uint8]]) -> NDArray[np.uint8]:
        """Return the array of a name, read-only; made anew where it is not known any more."""
        with self._lock:
            if name in self._arrays:
                self._arrays.move_to_end(name)
                return self._arrays[name]
        array = make(name)  # unlocked: two threads may make the same, none waits for another
        array.flags.writeable = False
        with self._lock:
            self._keep(name, array)
        return array

    def _keep(self, name: str, array: NDArray[np.uint8]) -> None:
        if name in self._arrays or array.nbytes > self._room:
            return
        self._arrays[name] = array
        self._taken += array.nbytes
        while self._taken > self._room:
            _, old = self._arrays.popitem(last=False)
            self._taken -= old.nbytes
