# SPDX-License-Identifier: GPL-3.0-or-later
"""Work on the photos of a scene in parallel, as many at a time as memory allows."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

from mgf_engine.model.scene import Scene, most_pixels
from mgf_engine.native.parallel import parallel_map

T = TypeVar("T")
_BYTES_PER_PIXEL = 90  # of a photo whose mask is corrected or whose elements are segmented (measured)


def map_photos(scene: Scene, task: Callable[[int], T], indices: Iterable[int], threads: int) -> Iterator[tuple[int, T]]:
    """Do a task for photos in parallel, as many at a time as memory allows.

    Args:
        scene: photos.
        task: view index -> its result.
        indices: of the views.
        threads: maximum number of photos at a time.

    Returns:
        each index and its result, in order.
    """
    indices, each = list(indices), _BYTES_PER_PIXEL * most_pixels(scene.views)
    return zip(indices, parallel_map(task, indices, threads, each), strict=True)
