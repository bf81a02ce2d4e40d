# SPDX-License-Identifier: GPL-3.0-or-later
"""What a job will take, said before it starts: ``mgf estimate``, the first message of a job, and whether it fits.

Times are those of the machine that :mod:`mgf_engine.costs` was fitted on, times what this one was found to need in
its own jobs (:func:`learn`).
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mgf_engine.config import Config
from mgf_engine.costs import COSTS, amount, bytes_of, least_bytes_of, seconds_of
from mgf_engine.errors import BadInput
from mgf_engine.images import UnreadablePhoto, read_infos
from mgf_engine.masks.building_share import building_share
from mgf_engine.masks.prompts import PromptsFile
from mgf_engine.memory import GB
from mgf_engine.scene.colmap import FEWEST, find_model, find_photos, list_photos, photo_names, too_few_photos
from mgf_engine.stages import STAGE_NAMES
from mgf_engine.system import cores, user_cache, write_json
from mgf_engine.terminal import duration

_HEADERS = 12  # photos whose size is looked at
_SPEED = "speed.json"
_NEWEST = 5  # jobs whose median is what is known of this machine
#: What is tried to make a job fit, in steps: blocks, working photos, their number, the texture.
_FEWER_GAUSSIANS = 0.75, 0.5
_BLOCKS = 2, 4, 8, 16
_LEAST_SIDE, _SIDE_STEP, _LEAST_PHOTOS, _PHOTO_STEP = 300, 50, 20, 10


@dataclass(frozen=True)
class Photos:
    """The photos of a scene.

    Attributes:
        count: how many there are.
        size: their usual long and short side in pixels.
        placed: whether their cameras are known.
        building: share of their pixels that shows the building; a usual one before there are masks.
    """

    count: int
    size: tuple[int, int]
    placed: bool = True
    building: float = COSTS["building"]


@dataclass(frozen=True)
class Estimate:
    """Seconds and bytes of each stage, stage -> number."""

    seconds: dict[str, float]
    memory: dict[str, float]

    @property
    def largest(self) -> str:
        """The stage that needs most memory."""
        return max(self.memory, key=lambda stage: self.memory[stage])


@dataclass(frozen=True)
class Took:
    """What a stage took: seconds by the clock, and of processor time in all threads and workers."""

    seconds: float
    cpu_seconds: float


def inspect_photos(source: Path, exclude: Path | None = None) -> Photos:
    """Look at a scene's folder without reading a photo.

    Args:
        exclude: the job's own folder.

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
        if len(paths) < FEWEST:
            raise too_few_photos(root, len(paths), FEWEST, exclude)
    else:
        paths = find_photos(photo_names(model), model, source, exclude)
    infos = read_infos([paths[k] for k in np.unique(np.linspace(0, len(paths) - 1, _HEADERS).astype(int))])
    looked_at = [info for info in infos if not isinstance(info, UnreadablePhoto)]
    if not looked_at:
        raise BadInput(str(infos[0]))
    long, short = (np.median([f((i.width, i.height)) for i in looked_at]) for f in (max, min))
    return Photos(len(paths), (int(long), int(short)), model is not None)


def with_clicks(photos: Photos, clicks: PromptsFile | None) -> Photos:
    """Return the same with the share of the building that the clicks speak of."""
    found = None if clicks is None else building_share(clicks, photos.size)
    return photos if found is None else replace(photos, building=found)


def quantities(config: Config, photos: Photos) -> dict[str, float]:
    """Return what the costs of a job depend on, see :mod:`mgf_engine.costs`."""
    count = min(photos.count, config.max_photos or photos.count)
    long, short = photos.size
    pixels = min(config.resolution, long) ** 2 * short / long / 1e6
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
        "unplaced": 0 if photos.placed else photos.count,
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
    photos: Photos,
    stages: Sequence[str] = STAGE_NAMES,
    speed: float | None = None,
    budget: float = math.inf,
) -> Estimate:
    """Estimate time and memory of the stages of a job with these options.

    Args:
        config: options of the job.
        photos: number and size of the scene's photos.
        stages: those that are to run.
        speed: time of this machine over that of the measured one; what is known of it when None.
        budget: bytes that may be used: fewer photos are worked on at a time where all threads together would take more.
    """
    asked, factor = quantities(config, photos), known_speed() if speed is None else speed
    memory = {s: max(least_bytes_of(s, asked), min(budget, bytes_of(s, asked))) for s in stages}
    return Estimate({s: factor * seconds_of(s, asked) for s in stages}, memory)


def remedy(config: Config, photos: Photos, budget: float, stages: Sequence[str] = STAGE_NAMES) -> str:
    """Find the least change of options that keeps a job below a budget, as flags; empty where none does.

    Args:
        config: options of the job.
        photos: number and size of the scene's photos.
        budget: bytes that the job may use.
        stages: those that are to run.
    """
    for changes in _changes(config, photos):
        if max(estimate(replace(config, **changes), photos, stages, 1.0, 0.0).memory.values()) <= budget:
            return " ".join(f"--{name.replace('_', '-')} {value}" for name, value in changes.items())
    return ""


def _changes(config: Config, photos: Photos) -> Iterator[dict[str, Any]]:
    """Yield options to try, those that cost least quality first."""
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


def shortage(config: Config, photos: Photos, budget: float, stages: Sequence[str] = STAGE_NAMES) -> str:
    """Return one sentence where a job needs more than a budget; empty where it fits.

    Args:
        config: options of the job.
        photos: number and size of the scene's photos.
        budget: bytes that the job may use.
        stages: those that are to run.
    """
    found = estimate(config, photos, stages, 1.0, 0.0)
    needed = found.memory[found.largest]
    if needed <= budget:
        return ""
    flags = remedy(config, photos, budget, stages)
    cure = f"{flags} would make it fit, or allow" if flags else "no option would make it fit: allow"
    return (
        f"The stage '{found.largest}' will need about {needed / GB:.1f} GB of memory, and the job may use "
        f"{budget / GB:.1f} GB; {cure} more with --memory."
    )


def known_speed() -> float:
    """Return the time of this machine over that of the measured one: the median of its last whole jobs; 1 before the
    first."""
    ratios = _known_ratios()
    return float(np.median(ratios)) if ratios else 1.0


def learn(config: Config, photos: Photos, took: dict[str, Took]) -> float | None:
    """Take in what the stages of a whole job took; the new factor, None where they tell nothing.

    Processor time tells how fast the cores are, however many other programs they serve; the clock tells it better
    where two threads share a core, which makes processor time longer than the work. So the smaller ratio counts.
    """
    asked = quantities(config, photos)
    usual_cpu = sum(amount(COSTS["stages"][stage]["cpu"], asked) for stage in took)
    usual = sum(seconds_of(stage, asked) for stage in took)
    if not usual:
        return None
    ratio = min(sum(t.cpu_seconds for t in took.values()) / usual_cpu, sum(t.seconds for t in took.values()) / usual)
    if not _plausible(ratio):
        return None
    ratios = [*_known_ratios(), round(ratio, 4)][-_NEWEST:]
    try:
        write_json(_speed_file(), {"ratios": ratios})
    except OSError:
        return None  # an estimate that does not get better is no reason to bother anyone
    return float(np.median(ratios))


def _known_ratios() -> list[float]:
    """Return the ratios of the last whole jobs on this machine, oldest first."""
    try:
        found = [float(ratio) for ratio in json.loads(_speed_file().read_text(encoding="utf-8"))["ratios"]]
    except (OSError, ValueError, KeyError, TypeError):
        return []
    return [ratio for ratio in found if _plausible(ratio)][-_NEWEST:]


def _plausible(ratio: float) -> bool:
    low, high = COSTS["speed"]
    return bool(low <= ratio <= high)


def _speed_file() -> Path:
    return user_cache() / _SPEED


def as_data(found: Estimate, config: Config, photos: Photos, budget: float) -> dict[str, Any]:
    """Return all of an estimate as plain data: seconds, bytes.

    Args:
        found: the estimate.
        config: options of the job.
        photos: number and size of the scene's photos.
        budget: bytes that the job may use.
    """
    asked = quantities(config, photos)
    return {
        "photos": photos.count, "used": asked["photos"], "size": list(photos.size), "cameras_known": photos.placed,
        "building": round(photos.building, 3),
        "iterations": asked["passes"], "threads": asked["threads"],
        "stages": {s: {"seconds": round(found.seconds[s], 1), "bytes": round(found.memory[s])} for s in found.seconds},
        "seconds": round(sum(found.seconds.values()), 1), "bytes": round(max(found.memory.values())),
        "allowed": round(budget), "shortage": shortage(config, photos, budget, list(found.seconds)),
    }  # fmt: skip


def as_table(data: dict[str, Any]) -> str:
    """Arrange :func:`as_data` for people."""
    known = "" if data["cameras_known"] else ", cameras to be found"
    used = "" if data["used"] == data["photos"] else f", {data['used']} of them used"
    lines = [f"{data['photos']} photos of {data['size'][0]} x {data['size'][1]} px{used}{known}; the building fills "
             f"{data['building']:.0%} of them; {data['threads']} threads, {data['iterations']} iterations", "",
             f"{'stage':<10}{'time':>14}{'memory':>12}"]  # fmt: skip
    for name, stage in data["stages"].items():
        lines.append(f"{name:<10}{duration(stage['seconds']):>14}{stage['bytes'] / GB:>9.1f} GB")
    lines.append(f"{'together':<10}{duration(data['seconds']):>14}{data['bytes'] / GB:>9.1f} GB")
    lines += ["", f"{data['allowed'] / GB:.1f} GB may be used."]
    return "\n".join([*lines, data["shortage"]] if data["shortage"] else lines)
