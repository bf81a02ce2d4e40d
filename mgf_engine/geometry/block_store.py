# SPDX-License-Identifier: GPL-3.0-or-later
"""Store the results of finished blocks in the job folder, so that an interrupted job resumes at the next block.

The folder of each kind of block is an output of its stage: :meth:`mgf_engine.jobs.job.Job.begin` removes it before the
stage runs with other inputs or options. File names contain a hash of the points, so that blocks of a run on another
machine, which rounds in other ways, are not mixed with those of this one.
"""

from __future__ import annotations

import hashlib
import shutil
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mgf_engine.files.atomic import atomic_path
from mgf_engine.files.safe_npz import read_arrays
from mgf_engine.system.memory import scratch

FOLDER = "blocks"  # in the job folder


class BlockStore:
    """Keeps the arrays of finished blocks; outside of a job there is no folder, and nothing is kept.

    Args:
        kind: folder of the blocks, ``start`` or ``mesh``.
        made_from: points that the blocks divide, and how.
    """

    def __init__(self, kind: str, *made_from: NDArray[Any]) -> None:
        folder, digest = scratch(), hashlib.sha256()
        self._folder = None if folder is None else folder / FOLDER / kind
        if self._folder is not None:
            for array in made_from:
                digest.update(np.ascontiguousarray(array).data)
        self._name = digest.hexdigest()[:16]

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
