# SPDX-License-Identifier: GPL-3.0-or-later
"""Estimate time and memory of a job before it starts, from the engine's own table of costs.

The table (``mgf_engine/costs.py`` says what it holds) comes with the options; ``mgf estimate`` tells the same of the
same photos. What this machine makes of the times is learned: the engine says so at the end of a job that ran in one go.
"""

from __future__ import annotations

import json
import math
import os
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import bpy

from ..common.addon import user_folder
from ..common.json_cache import JsonCache
from ..common.options import COSTS, RUN_LENGTH
from ..scene_import.cameras import SIZE_KEY, find_source

_FILE = "speed.json"
_learned = JsonCache(lambda path, data: float(data["factor"]))


@dataclass(frozen=True)
class Estimate:
    """Seconds and bytes a job will take."""

    seconds: float
    memory: float


@dataclass(frozen=True)
class PhotoSizes:
    """How many photos there are, and their long and short side in pixels (not known: of 27 megapixels)."""

    count: int
    size: tuple[int, int] = (6000, 4500)

    def at_work(self, options: bpy.types.PropertyGroup) -> tuple[int, float]:
        """Return how many of them a job with these options takes, and the megapixels of one while working."""
        count = min(self.count, options.max_photos or self.count)
        long, short = self.size
        return count, min(options.resolution, long) ** 2 * short / long / 1e6


def photos_of(scene: bpy.types.Scene) -> PhotoSizes:
    """Return the photos a job on this scene gets; before an import, what the marked ones tell (a fifth is marked)."""
    imported = find_source(scene)
    cameras = imported.objects("Cameras") if imported is not None else []
    sizes = [tuple(camera[SIZE_KEY]) for camera in cameras if SIZE_KEY in camera]
    if not sizes:
        return PhotoSizes(max(1, len(cameras) or 5 * len(scene.mgf.photos)))
    return PhotoSizes(len(cameras), (int(median(map(max, sizes))), int(median(map(min, sizes)))))


def estimate(options: bpy.types.PropertyGroup, photos: PhotoSizes, factor: float | None = None) -> Estimate:
    """Return what a job with these options takes here.

    Args:
        factor: time of this machine over that of the measured one; the learned one when None.
    """
    known, stages = quantities(options, photos), COSTS["stages"].values()
    threads = min(COSTS["threads"], known["threads"])
    seconds = sum(_amount(s["cpu"], known) * (s["serial"] + (1 - s["serial"]) / threads) for s in stages)
    return Estimate(
        seconds * (speed() if factor is None else factor),
        max(_amount(s["bytes"], {**known, "threads": threads}) for s in stages),
    )


def quantities(options: bpy.types.PropertyGroup, photos: PhotoSizes) -> dict[str, float]:
    """Return what the costs depend on, as ``mgf_engine/jobs/estimate.py`` counts it; cameras are known once photos are
    here."""
    count, pixels = photos.at_work(options)
    held_out = count // options.holdout_every if options.holdout_every else 0
    trained = min(RUN_LENGTH["most"], max(RUN_LENGTH["fewest"], count - held_out))
    passes, usual = options.iterations or options.passes * trained, COSTS["gaussians"]
    most = usual["grown" if passes else "untrained"] * options.max_gaussians
    building = count * pixels * (COSTS["building"] if options.use_masks and options.masked_images else 1.0)
    surface = building if options.start == "surface" and options.use_masks else 0
    of_error = usual["least"] + usual["per_pixel"] * building * 1e6
    gaussians = min(most, of_error if options.densify_by == "error" else usual["by_gradient"]) / 1e5
    return {
        "photos": count, "pixels": pixels, "taken": photos.size[0] * photos.size[1] / 1e6, "building": building,
        "surface": surface, "block_surface": surface / options.blocks,
        "unplaced": 0, "found": 0, "pairs": 0,
        "passes": passes,
        "measured": held_out + COSTS["measured"],
        "gaussians": gaussians, "block_gaussians": gaussians / options.blocks,
        "threads": options.threads or os.cpu_count() or 1,
        "textured": building if options.texture else 0,
        "texture": options.texture_size**2 / 1e6 if options.texture else 0,
    }  # fmt: skip


def _amount(terms: dict[str, float], known: dict[str, float]) -> float:
    return sum(number * math.prod(known[q] for q in name.split()) for name, number in terms.items())


def speed() -> float:
    """Return the time of this machine over that of the measured one, as the engine learned it from jobs; 1 before the
    first."""
    found = _learned.get(_path())
    low, high = COSTS["speed"]
    return found if found is not None and low <= found <= high else 1.0


def remember(factor: float) -> None:
    """Keep what the engine says of this machine's speed."""
    try:
        _path().write_text(json.dumps({"factor": factor}), encoding="utf-8")
    except OSError:
        return  # an estimate that does not get better is no reason to bother anyone
    _learned.clear()  # the file's time need not have changed


def _path() -> Path:
    return user_folder() / _FILE
