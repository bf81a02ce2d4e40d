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

#: Seconds on two cores with AVX-512. MP: megapixels of a working photo, G: 100,000 Gaussians.
_MASK_PHOTO, _MASK_PIXELS = 0.24, 1.57  # per photo; per photo and MP
_FIELD_STEP, _FIELD_GAUSSIANS, _FIELD_PIXELS = 0.035, 0.060, 1.05  # per iteration; and G; per photo and MP
_MESH, _MESH_GAUSSIANS, _MESH_VIEWS = 2.2, 13.3, 1.36  # once; per G; per G and photo
_START, _DELIVER_PHOTO = 10.0, 0.15  # once; per photo
_CORES = 2
#: Bytes: the engine at rest, per Gaussian, per pixel of all photos together.
_REST, _PER_GAUSSIAN, _PER_PIXEL = 0.42e9, 11_700.0, 33.0
_GROWN = 0.9  # share of the allowed Gaussians that a field usually reaches
_PER_PHOTO_PIXEL = 0.02  # and no more than this per pixel of all photos
_FILE = "speed.json"
_LEARN = 0.5  # weight of the newest job
_LIMITS = (0.05, 20.0)


@dataclass(frozen=True)
class Estimate:
    """Seconds and bytes a job will take."""

    seconds: float
    memory: float


def estimate(
    options: bpy.types.PropertyGroup, photos: int, aspect: float = 4 / 3, factor: float | None = None
) -> Estimate:
    """What a job with these options takes here.

    Args:
        aspect: long side over short side of the photos.
        factor: time of this machine over that of the reference; the learned one when None.
    """
    return Estimate(_seconds(options, photos, aspect) * (speed_factor(options) if factor is None else factor),
                    _memory(options, photos, aspect))  # fmt: skip


def speed_factor(options: bpy.types.PropertyGroup) -> float:
    """Time of this machine over that of the reference: learned from jobs, else by the number of cores."""
    try:
        learned = float(json.loads(_path().read_text(encoding="utf-8"))["factor"])
        if _LIMITS[0] <= learned <= _LIMITS[1]:
            return learned
    except (OSError, ValueError, KeyError, TypeError):
        pass
    return _CORES / min(8, max(1, options.threads or os.cpu_count() or 1))


def learn(options: bpy.types.PropertyGroup, folder: Path) -> float | None:
    """Take in the true time of a finished job; returns the new factor, None when the report cannot be used."""
    try:
        report: dict[str, Any] = json.loads((folder / "report.json").read_text(encoding="utf-8"))
        photos = int(report["counts"]["photos"])
        actual = float(report["seconds"])
    except (OSError, ValueError, KeyError, TypeError):
        return None
    ratio = (actual + _START + _DELIVER_PHOTO * photos) / _seconds(options, photos, 4 / 3)
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


def _seconds(options: bpy.types.PropertyGroup, photos: int, aspect: float) -> float:
    """Seconds of a whole job on the reference machine."""
    megapixels = options.resolution**2 / aspect / 1e6
    gaussians = _gaussians(options, photos, aspect) / 1e5
    masks = photos * (_MASK_PHOTO + _MASK_PIXELS * megapixels)
    field = options.iterations * (_FIELD_STEP + _FIELD_GAUSSIANS * gaussians) + _FIELD_PIXELS * photos * megapixels
    mesh = _MESH + gaussians * (_MESH_GAUSSIANS + _MESH_VIEWS * photos)
    return _START + masks + field + mesh + _DELIVER_PHOTO * photos


def _gaussians(options: bpy.types.PropertyGroup, photos: int, aspect: float) -> float:
    return min(_GROWN * options.max_gaussians, _PER_PHOTO_PIXEL * photos * options.resolution**2 / aspect)


def _memory(options: bpy.types.PropertyGroup, photos: int, aspect: float) -> float:
    pixels = photos * options.resolution**2 / aspect
    return _REST + _gaussians(options, photos, aspect) * _PER_GAUSSIAN + pixels * _PER_PIXEL


def _path() -> Path:
    return user_folder() / _FILE
