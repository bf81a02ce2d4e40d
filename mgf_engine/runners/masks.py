# SPDX-License-Identifier: GPL-3.0-or-later
"""Find the building in every photo."""

from __future__ import annotations

from typing import Any

import numpy as np

from mgf_engine.jobs.job import Job
from mgf_engine.jobs.results import load_scene_of
from mgf_engine.masks.build import build_masks
from mgf_engine.messages import Reporter
from mgf_engine.model.masks import building


def run_masks(job: Job, reporter: Reporter) -> dict[str, Any]:
    """Make the masks of the scene's photos; returns how many are used, and the share of the building."""
    scene = load_scene_of(job)
    job.keep_clicks()
    masks = build_masks(scene, job.inputs.clicks, job.masks, job.path("masks"), job.config, reporter)
    return {
        "used": int(masks.used.sum()), "masked_points": int(masks.point_mask.sum()),
        "building": round(float(np.mean([building(labels).mean() for labels in masks.labels])), 4),
    }  # fmt: skip
