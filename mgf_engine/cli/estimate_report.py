# SPDX-License-Identifier: GPL-3.0-or-later
"""The estimate of a job as plain data and as a table (``mgf estimate``)."""

from __future__ import annotations

from typing import Any

from mgf_engine.console.terminal import format_duration
from mgf_engine.jobs.estimate import Estimate, PhotoSummary, quantities
from mgf_engine.jobs.memory_check import shortage
from mgf_engine.options.config import Config
from mgf_engine.system.memory import GB


def estimate_to_dict(estimate: Estimate, config: Config, photos: PhotoSummary, budget: float) -> dict[str, Any]:
    """Return an estimate as plain data (seconds, bytes), as ``mgf estimate --json`` prints it.

    Args:
        estimate: of all stages.
        config: options of the job.
        photos: number and size of the scene's photos.
        budget: bytes that the job may use.
    """
    amounts, seconds, memory = quantities(config, photos), estimate.seconds, estimate.memory
    return {
        "photos": photos.count, "used": amounts["photos"], "size": list(photos.size), "cameras_known": photos.placed,
        "building": round(photos.building, 3),
        "iterations": amounts["passes"], "threads": amounts["threads"],
        "stages": {s: {"seconds": round(seconds[s], 1), "bytes": round(memory[s])} for s in seconds},
        "seconds": round(sum(seconds.values()), 1), "bytes": round(max(memory.values())),
        "second_attempt": round(estimate.second_attempt, 1),
        "allowed": round(budget), "shortage": shortage(config, photos, budget, list(seconds)),
    }  # fmt: skip


def format_estimate(data: dict[str, Any]) -> str:
    """Format an estimate, given as :func:`estimate_to_dict` returns it, as a table for the terminal."""
    known = "" if data["cameras_known"] else ", cameras to be found"
    used = "" if data["used"] == data["photos"] else f", {data['used']} of them used"
    lines = [f"{data['photos']} photos of {data['size'][0]} x {data['size'][1]} px{used}{known}; the building fills "
             f"{data['building']:.0%} of them; {data['threads']} threads, {data['iterations']} iterations", "",
             f"{'stage':<10}{'time':>14}{'memory':>12}"]  # fmt: skip
    for name, stage in data["stages"].items():
        lines.append(f"{name:<10}{format_duration(stage['seconds']):>14}{stage['bytes'] / GB:>9.1f} GB")
    lines.append(f"{'together':<10}{format_duration(data['seconds']):>14}{data['bytes'] / GB:>9.1f} GB")
    if data["second_attempt"]:
        longer = format_duration(data["second_attempt"])
        lines += ["", f"{longer} more where structure from motion has to run twice, because photos are far apart."]
    lines += ["", f"{data['allowed'] / GB:.1f} GB may be used."]
    return "\n".join([*lines, data["shortage"]] if data["shortage"] else lines)
