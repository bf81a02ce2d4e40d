# SPDX-License-Identifier: GPL-3.0-or-later
"""LRU cache of decoded photos: every stage reads all photos several times.

All scenes share one cache (:data:`PHOTOS`), so that a stage finds the photos that the previous one has read.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

CAPACITY = 256 << 20  # bytes: some 230 photos of 750 x 500


class PhotoCache:
    """Keeps what was read last while it fits into ``capacity`` bytes; any number of threads may ask.

    Larger sets than fit, read in order again and again, gain nothing and lose nothing.
    """

    def __init__(self, capacity: int = CAPACITY) -> None:
        self.capacity = capacity
        self._held: OrderedDict[Path, tuple[tuple[int, int], NDArray[np.uint8]]] = OrderedDict()
        self._bytes = 0
        self._lock = threading.Lock()

    def get(self, path: Path, read: Callable[[Path], NDArray[np.uint8]]) -> NDArray[np.uint8]:
        """Return the photo at ``path``, read-only; ``read`` reads it where the file is not held or has changed."""
        try:
            found = path.stat()
        except OSError:
            return read(path)  # which says what is wrong
        state = found.st_mtime_ns, found.st_size
        with self._lock:
            held = self._held.get(path)
            if held is not None and held[0] == state:
                self._held.move_to_end(path)
                return held[1]
        photo = read(path)  # outside the lock: others decode at the same time
        photo.flags.writeable = False
        with self._lock:
            if photo.nbytes <= self.capacity:
                self._drop(path)
                self._held[path] = state, photo
                self._bytes += photo.nbytes
            while self._bytes > self.capacity:
                self._drop(next(iter(self._held)))
        return photo

    def clear(self) -> None:
        """Let go of all photos."""
        with self._lock:
            self._held.clear()
            self._bytes = 0

    def _drop(self, path: Path) -> None:
        if path in self._held:
            self._bytes -= self._held.pop(path)[1].nbytes


PHOTOS = PhotoCache()
