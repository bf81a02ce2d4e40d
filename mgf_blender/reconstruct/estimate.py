# SPDX-License-Identifier: GPL-3.0-or-later
"""What a job will roughly take, said before it starts: time and memory, from photos, pixels, iterations, Gaussians.

The costs were fitted to the reports of finished jobs (see docs/blender.md for the errors). What this machine makes of
them is learned: every job that ran in one go leaves the ratio of its true time to the estimate in the user's folder.
"""

from __future__ import annotations

import json
import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy

from ..common.addon import user_folder
from ..common.options import RUN_LENGTH
from ..scene_import.cameras import SIZE_KEY
from ..scene_import.tree import Tree

#: Seconds on two cores with AVX-512. MP: megapixels of a working photo, G: 100,000 Gaussians.
_MASK_PHOTO, _MASK_PIXELS = 0.12, 0.65  # per photo; per photo and MP
_STEP, _STEP_GAUSSIANS, _STEP_PIXELS = 0.002, 0.015, 0.085  # per iteration; and G; and MP
_STEREO = 0.3  # per photo and MP
_MESH, _MESH_GAUSSIANS, _MESH_VIEWS = 2.0, 7.5, 0.365  # once; per G; per G and photo
_START, _DELIVER_PHOTO = 7.0, 0.07  # once; per photo
_CORES = 2
#: Bytes: the engine at rest, per Gaussian, per pixel of all photos together.
_REST, _PER_GAUSSIAN, _PER_PIXEL = 0.42e9, 8_500.0, 33.0
_GROWN = 0.9  # share of the allowed Gaussians that a field usually reaches
_PER_PHOTO_PIXEL = 0.015  # and no more than this per pixel of all photos
_FILE = "speed.json"
_LEARN = 0.5  # weight of the newest job
_LIMITS = (0.05, 20.0)


@dataclass(frozen=True)
class Estimate:
    """Seconds and bytes a job will take."""

    seconds: float
    memory: float


@dataclass(frozen=True)
class Photos:
    """How many photos there are, and their long and short side in pixels (not known: large ones, 4 to 3)."""

    count: int
    size: tuple[int, int] = (1 << 16, 3 << 14)

    def at_work(self, options: bpy.types.PropertyGroup) -> tuple[int, float]:
        """How many of them a job with these options takes, and the megapixels of one while working."""
        count = min(self.count, options.max_photos or self.count)
        long, short = self.size
        return count, min(options.resolution, long) ** 2 * short / long / 1e6


def photos_of(scene: bpy.types.Scene) -> Photos:
    """The photos a job on this scene gets; before an import, what the marked ones tell (a fifth is marked)."""
    tree = Tree.find(scene)
    cameras = tree.objects("Cameras") if tree is not None else []
    sizes = [tuple(camera[SIZE_KEY]) for camera in cameras if SIZE_KEY in camera]
    if not sizes:
        return Photos(max(1, len(cameras) or 5 * len(scene.mgf.photos)))
    largest = max(sizes, key=max)
    return Photos(len(cameras), (max(largest), min(largest)))


def estimate(options: bpy.types.PropertyGroup, photos: Photos, factor: float | None = None) -> Estimate:
    """What a job with these options takes here.

    Args:
        factor: time of this machine over that of the reference; the learned one when None.
    """
    work = photos.at_work(options)
    return Estimate(_seconds(options, *work) * (speed_factor(options) if factor is None else factor),
                    _memory(options, *work))  # fmt: skip


def speed_factor(options: bpy.types.PropertyGroup) -> float:
    """Time of this machine over that of the reference: learned from jobs, else by the number of cores."""
    try:
        learned = float(json.loads(_path().read_text(encoding="utf-8"))["factor"])
        if _LIMITS[0] <= learned <= _LIMITS[1]:
            return learned
    except (OSError, ValueError, KeyError, TypeError):
        pass
    return _CORES / min(8, max(1, options.threads or os.cpu_count() or 1))


def learn(options: bpy.types.PropertyGroup, photos: Photos, folder: Path) -> float | None:
    """Take in the true time of a finished job; returns the new factor, None when the report cannot be used."""
    try:
        report: dict[str, Any] = json.loads((folder / "report.json").read_text(encoding="utf-8"))
        actual = float(report["seconds"])
    except (OSError, ValueError, KeyError, TypeError):
        return None
    count, megapixels = photos.at_work(options)
    ratio = (actual + _around(count)) / _seconds(options, count, megapixels)
    if not _LIMITS[0] <= ratio <= _LIMITS[1]:
        return None
    known = speed_factor(options) if _path().is_file() else ratio
    factor = math.exp(_LEARN * math.log(ratio) + (1 - _LEARN) * math.log(known))
    try:
        _path().write_text(json.dumps({"factor": round(factor, 4)}), encoding="utf-8")
    except OSError:
        return None  # an estimate that does not get better is no reason to bother anyone
    return factor


def duration(seconds: float | None) -> str:
    """Seconds as people say them: ``40 s``, ``12 min``, ``2 h 5 min``; empty for None."""
    if seconds is None:
        return ""
    if seconds < 90:
        return f"{max(0, round(seconds))} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60} min"


def _seconds(options: bpy.types.PropertyGroup, count: int, megapixels: float) -> float:
    """Seconds of a whole job on the reference machine."""
    gaussians = _gaussians(options, count, megapixels) / 1e5
    masks = count * (_MASK_PHOTO + _MASK_PIXELS * megapixels)
    step = _STEP + _STEP_GAUSSIANS * gaussians + _STEP_PIXELS * megapixels
    field = _iterations(options, count) * step + _STEREO * count * megapixels
    mesh = _MESH + gaussians * (_MESH_GAUSSIANS + _MESH_VIEWS * count)
    return masks + field + mesh + _around(count)


def _iterations(options: bpy.types.PropertyGroup, count: int) -> int:
    """Of the training; the engine's own choice where the option is 0."""
    held_out = count // options.holdout_every if options.holdout_every else 0
    photos = min(RUN_LENGTH["most"], max(RUN_LENGTH["fewest"], count - held_out))
    return options.iterations or options.passes * photos


def _around(count: int) -> float:
    """Seconds that the report of a job does not count: the engine's start, and what comes after the mesh."""
    return _START + _DELIVER_PHOTO * count


def _gaussians(options: bpy.types.PropertyGroup, count: int, megapixels: float) -> float:
    return min(_GROWN * options.max_gaussians, _PER_PHOTO_PIXEL * count * megapixels * 1e6)


def _memory(options: bpy.types.PropertyGroup, count: int, megapixels: float) -> float:
    return _REST + _gaussians(options, count, megapixels) * _PER_GAUSSIAN + count * megapixels * 1e6 * _PER_PIXEL


def _path() -> Path:
    return user_folder() / _FILE
