# SPDX-License-Identifier: GPL-3.0-or-later
"""Check whether a job fits into its memory, and find options with which it would."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

from mgf_engine.jobs.estimate import PhotoSummary, estimate
from mgf_engine.options.config import Config
from mgf_engine.stages import STAGE_NAMES
from mgf_engine.system.memory import GB

#: Values tried to make a job fit: number of blocks, shares of the Gaussians, size and number of the working photos.
_BLOCKS = 2, 4, 8, 16
_FEWER_GAUSSIANS = 0.75, 0.5
_LEAST_SIDE, _SIDE_STEP, _LEAST_PHOTOS, _PHOTO_STEP = 300, 50, 20, 10


def shortage(config: Config, photos: PhotoSummary, budget: float, stages: Sequence[str] = STAGE_NAMES) -> str:
    """Say in one sentence that a job needs more memory than its budget, and what would help; empty if it fits.

    Args:
        config: options of the job.
        photos: number and size of the scene's photos.
        budget: bytes that the job may use.
        stages: names of the stages that will run.
    """
    found = estimate(config, photos, stages, 1.0, 0.0)
    needed = found.memory[found.largest]
    if needed <= budget:
        return ""
    flags = remedy(config, photos, budget, stages)
    cure = f"{flags} would make it fit, or allow" if flags else "no option would make it fit: allow"
    return (
        f"The stage '{found.largest}' will need about {needed / GB:.1f} GB of memory, and the job may use "
        f"{budget / GB:.3g} GB; {cure} more with --memory."
    )


def remedy(config: Config, photos: PhotoSummary, budget: float, stages: Sequence[str] = STAGE_NAMES) -> str:
    """Find the smallest change of options that keeps a job below its budget, as command line flags; empty if none does.

    Args:
        config: options of the job.
        photos: number and size of the scene's photos.
        budget: bytes that the job may use.
        stages: names of the stages that will run.
    """
    for changes in _changes(config, photos):
        if max(estimate(replace(config, **changes), photos, stages, 1.0, 0.0).memory.values()) <= budget:
            return " ".join(f"--{name.replace('_', '-')} {value}" for name, value in changes.items())
    return ""


def _changes(config: Config, photos: PhotoSummary) -> Iterator[dict[str, Any]]:
    """Yield changes of options to try, in the order of their loss of quality."""
    sides = range(min(config.resolution, photos.size[0]) // _SIDE_STEP * _SIDE_STEP, _LEAST_SIDE - 1, -_SIDE_STEP)
    count = min(photos.count, config.max_photos or photos.count)
    fewer = range(count // _PHOTO_STEP * _PHOTO_STEP, _LEAST_PHOTOS - 1, -_PHOTO_STEP)
    if config.texture and config.texture_size > 2048:
        yield {"texture_size": 2048}
    yield from ({"blocks": number} for number in _BLOCKS if number > config.blocks)
    yield from ({"resolution": side} for side in sides if 2 * side >= config.resolution)
    yield from ({"max_gaussians": round(share * config.max_gaussians)} for share in _FEWER_GAUSSIANS)
    yield from ({"max_photos": number} for number in fewer if 2 * number >= count)
    yield from ({"max_photos": number, "resolution": side} for side in sides for number in fewer)
