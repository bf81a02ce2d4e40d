# SPDX-License-Identifier: GPL-3.0-or-later
"""Store the results of finished blocks in the job folder, so that an interrupted job resumes at the next block.

File names contain a hash of the inputs, so that results of other photos or options are never used.
"""

from __future__ import annotations

import hashlib
import shutil
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mgf_engine.memory import scratch
from mgf_engine.safe_npz import read_arrays
from mgf_engine.system import atomic_path

FOLDER = "blocks"  # in the job folder


class BlockStore:
    """Keeps the arrays of finished blocks; outside of a job there is no folder, and nothing is kept.

    Args:
        kind: of the work, part of the files' names.
        made_from: all that decides what the blocks give.
    """

    def __init__(self, kind: str, *made_from: NDArray[Any]) -> None:
        folder, digest = scratch(), hashlib.sha256()
        self._folder = None if folder is None else folder / FOLDER
        if self._folder is not None:
            for array in made_from:
                digest.update(np.ascontiguousarray(array).data)
        self._name = f"{kind}-{digest.hexdigest()[:16]}"

    def load(self, number: int) -> dict[str, NDArray[Any]] | None:
        """Read the arrays of a block; None where it is not done, or its file is damaged."""
        if self._folder is None:
            return None
        try:
            return read_arrays(self._folder / f"{self._name}-{number}.npz")
        except (OSError, ValueError, KeyError):
            return None

    def save(self, number: int, **arrays: NDArray[Any]) -> None:
        """Write the arrays of a finished block; a stop half way leaves no file.

        Raises:
            OSError: the disk is full.
        """
        if self._folder is None:
            return
        with atomic_path(self._folder / f"{self._name}-{number}.npz") as part:
            np.savez(part, **arrays)  # type: ignore[arg-type]


def clear_blocks() -> None:
    """Remove what was kept, when all blocks are part of a result."""
    folder = scratch()
    if folder is not None:
        shutil.rmtree(folder / FOLDER, ignore_errors=True)
