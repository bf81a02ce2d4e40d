# SPDX-License-Identifier: GPL-3.0-or-later
"""Estimate time and memory of a job from the number and size of its photos, before it starts.

The estimate is the one of the reference machine (:mod:`mgf_engine.costs`) times the relative time of this machine
(:mod:`mgf_engine.jobs.machine_speed`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mgf_engine.costs import COSTS, bytes_of, least_bytes_of, second_attempt_seconds, seconds_of
from mgf_engine.errors import BadInput
from mgf_engine.files.images import UnreadablePhoto, read_infos
from mgf_engine.jobs.machine_speed import known_speed
from mgf_engine.masks.building_share import building_share
from mgf_engine.masks.prompts import PromptsFile
from mgf_engine.options.config import Config
from mgf_engine.scene.colmap import MIN_SFM_PHOTOS, find_model, find_photos, list_photos, photo_names, too_few_photos
from mgf_engine.stages import STAGE_NAMES
from mgf_engine.system.machine import cores

_HEADERS = 12  # photos whose headers are read for the usual size


@dataclass(frozen=True)
class PhotoSummary:
    """Number and size of the photos of a scene.

    Attributes:
        count: number of photos.
        size: median of their long and of their short side, pixels.
        placed: whether their cameras are known.
        building: share of their pixels that shows the building; a typical value before there are clicks or masks.
    """

    count: int
    size: tuple[int, int]
    placed: bool = True
    building: float = COSTS["building"]


@dataclass(frozen=True)
class Estimate:
    """What a job will take.

    Attributes:
        seconds: of each stage, by its name.
        memory: peak of each stage in bytes, by its name.
        second_attempt: seconds that the stage ``scene`` takes longer where structure from motion runs twice; 0 where
            the cameras are known.
    """

    seconds: dict[str, float]
    memory: dict[str, float]
    second_attempt: float = 0.0

    @property
    def largest(self) -> str:
        """Name of the stage with the largest peak memory."""
        return max(self.memory, key=lambda stage: self.memory[stage])


def inspect_photos(source: Path, exclude: Path | None = None) -> PhotoSummary:
    """Find number and size of a scene's photos; only headers are read.

    Args:
        source: COLMAP scene or folder of photos.
        exclude: the job folder, which may lie inside ``source``.

    Raises:
        BadInput: there are no photos, or the model or a photo cannot be read.
    """
    source = source.resolve()
    if not source.is_dir():
        raise BadInput(f"The scene '{source}' is not a folder; give a COLMAP scene or a folder of photos.")
    model = find_model(source, exclude)
    if model is None:
        root, names = list_photos(source, exclude)
        paths = [root / name for name in names]
        if len(paths) < MIN_SFM_PHOTOS:
            raise too_few_photos(root, len(paths), MIN_SFM_PHOTOS, exclude)
    else:
        paths = find_photos(photo_names(model), model, source, exclude)
    infos = read_infos([paths[k] for k in np.unique(np.linspace(0, len(paths) - 1, _HEADERS).astype(int))])
    looked_at = [info for info in infos if not isinstance(info, UnreadablePhoto)]
    if not looked_at:
        raise BadInput(str(infos[0]))
    long, short = (np.median([f((i.width, i.height)) for i in looked_at]) for f in (max, min))
    return PhotoSummary(len(paths), (int(long), int(short)), model is not None)


def with_clicks(photos: PhotoSummary, clicks: PromptsFile | None) -> PhotoSummary:
    """Set the share of the building as estimated from the clicks."""
    found = None if clicks is None else building_share(clicks, photos.size)
    return photos if found is None else replace(photos, building=found)


def quantities(config: Config, photos: PhotoSummary) -> dict[str, float]:
    """Compute the quantities that the costs of a job depend on, name -> value, see :mod:`mgf_engine.costs`."""
    count = min(photos.count, config.max_photos or photos.count)
    long, short = photos.size
    pixels = min(config.resolution, long) ** 2 * short / long / 1e6
    found = min(COSTS["features_side"], long) ** 2 * short / long / 1e6
    held_out = count // config.holdout_every if config.holdout_every else 0
    all_pairs = photos.count * (photos.count - 1) / 2
    passes = config.run_length(max(1, count - held_out))
    usual = COSTS["gaussians"]
    building = count * pixels * (photos.building if config.use_masks and config.masked_images else 1.0)
    most = usual["grown" if passes else "untrained"] * config.max_gaussians
    surface = building if config.start == "surface" and config.use_masks else 0
    of_error = usual["least"] + usual["per_pixel"] * building * 1e6
    gaussians = min(most, of_error if config.densify_by == "error" else usual["by_gradient"]) / 1e5
    return {
        "photos": count, "pixels": pixels, "taken": long * short / 1e6, "building": building,
        "surface": surface, "block_surface": surface / config.blocks,
        "unplaced": 0 if photos.placed else photos.count, "found": found,
        "pairs": 0 if photos.placed else min(all_pairs, COSTS["pairs"] * photos.count),
        "passes": passes,
        "measured": held_out + COSTS["measured"],
        "gaussians": gaussians, "block_gaussians": gaussians / config.blocks,
        "threads": config.threads or cores(),
        "textured": building if config.texture else 0,
        "texture": config.texture_size**2 / 1e6 if config.texture else 0,
    }  # fmt: skip


def estimate(
    config: Config,
    photos: PhotoSummary,
    stages: Sequence[str] = STAGE_NAMES,
    speed: float | None = None,
    budget: float = math.inf,
) -> Estimate:
    """Estimate time and memory of the stages of a job with these options.

    Args:
        config: options of the job.
        photos: number and size of the scene's photos.
        stages: names of the stages that will run.
        speed: time of this machine divided by that of the reference machine; None takes the measured one.
        budget: bytes that may be used; if all threads together would need more, fewer photos are processed at a time.
    """
    amounts, factor = quantities(config, photos), known_speed() if speed is None else speed
    memory = {s: max(least_bytes_of(s, amounts), min(budget, bytes_of(s, amounts))) for s in stages}
    twice = factor * second_attempt_seconds(amounts) if "scene" in stages else 0.0
    return Estimate({s: factor * seconds_of(s, amounts) for s in stages}, memory, twice)
