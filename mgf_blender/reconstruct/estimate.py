# SPDX-License-Identifier: GPL-3.0-or-later
"""What a job will roughly take, said before it starts: time of training, the largest part, and memory."""

from __future__ import annotations

import os

import bpy

#: Measured on two cores with AVX-512: milliseconds per training iteration at 375x250 with a 30 % building mask
#: (fixed cost of 100,000 Gaussians) and what every further megapixel of photo adds.
_BASE_MS, _PIXEL_MS, _GAUSSIANS = 62.0, 203.0, 100_000
_CORES = 2
#: Bytes: the engine with torch at rest, per pixel and photo, per Gaussian with its optimiser state.
_REST, _PER_PIXEL, _PER_GAUSSIAN = 0.9e9, 5.0, 1500.0


def estimate(options: bpy.types.PropertyGroup, photos: int, aspect: float = 1.5) -> tuple[float, float]:
    """Seconds and bytes for a job with these options; within a factor of two on ordinary machines."""
    pixels = options.resolution**2 / aspect
    gaussians = options.max_gaussians
    per_iteration = (_BASE_MS * gaussians / _GAUSSIANS + _PIXEL_MS * pixels / 1e6) / 1000
    if options.coarse_to_fine:
        per_iteration *= 0.7
    speed = min(8, max(1, options.threads or os.cpu_count() or 1)) / _CORES
    masks = 1.5 * photos
    seconds = options.iterations * per_iteration / speed + masks + 60
    return seconds, _REST + photos * pixels * _PER_PIXEL + gaussians * _PER_GAUSSIAN


def duration(seconds: float | None) -> str:
    """Seconds as people say them: ``40 s``, ``12 min``, ``2 h 5 min``; empty for None."""
    if seconds is None:
        return ""
    if seconds < 90:
        return f"{max(0, round(seconds))} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60} min"
