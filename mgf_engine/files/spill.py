# SPDX-License-Identifier: GPL-3.0-or-later
"""Memory-mapped arrays in a file of the job folder, for data that does not fit into memory."""

from __future__ import annotations

import mmap
import tempfile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mgf_engine.system.memory import scratch, share

_SHARE = 0.15  # of what the job may use, that all arrays of one spill may take before the others go to the file
_PAGE = mmap.ALLOCATIONGRANULARITY


class Spill:
    """Keeps arrays that are only read: the first ones in memory, the others in a file without a name.

    The file ends with the arrays. Outside of a job there is no folder for it, and all arrays stay in memory.
    """

    def __init__(self) -> None:
        self._budget, self._folder = share(_SHARE, 2**62), scratch()
        self._file: Any = None
        self._maps: list[mmap.mmap] = []

    def keep(self, array: NDArray[Any]) -> NDArray[Any]:
        """Return the array or, where its place is in the file, one with the same values that cannot be written to.

        Raises:
            OSError: the disk is full.
        """
        if array.nbytes <= self._budget or self._folder is None or not array.nbytes:
            self._budget -= array.nbytes
            return array
        self._budget = 0
        if self._file is None:
            self._file = tempfile.TemporaryFile(dir=self._folder, prefix="spill-")  # noqa: SIM115 (mapped as long as the arrays)
        begin = -(-self._file.seek(0, 2) // _PAGE) * _PAGE
        self._file.seek(begin)
        self._file.write(np.ascontiguousarray(array))
        self._file.flush()
        mapped = mmap.mmap(self._file.fileno(), array.nbytes, access=mmap.ACCESS_READ, offset=begin)
        self._maps.append(mapped)
        return np.frombuffer(mapped, array.dtype).reshape(array.shape)

    def release(self) -> None:
        """Give back the memory of what has been read from the file; the system reads it again when it is asked for."""
        if hasattr(mmap, "MADV_DONTNEED"):  # elsewhere the system takes it when it needs it
            for mapped in self._maps:
                mapped.madvise(mmap.MADV_DONTNEED)
