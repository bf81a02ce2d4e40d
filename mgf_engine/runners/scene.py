# SPDX-License-Identifier: GPL-3.0-or-later
"""Read cameras and photos, undistort and resize them."""

from __future__ import annotations

import logging
from typing import Any

from mgf_engine.georef.adjust import fit_to_control
from mgf_engine.georef.find import find_georeference
from mgf_engine.georef.options import GeoreferenceOptions
from mgf_engine.jobs.job import Job
from mgf_engine.masks.prompts import clicked_names
from mgf_engine.messages import Reporter
from mgf_engine.scene.load import load_scene

log = logging.getLogger("mgf")


def run_scene(job: Job, reporter: Reporter) -> dict[str, Any]:
    """Read the user's photos and cameras into the job's scene; returns the numbers of photos and points."""
    clicked = clicked_names(job.inputs.clicks)
    adjust = fit_to_control if job.adjusts_to_control else None
    scene = load_scene(job.source, job.path("scene"), job.config, reporter, clicked, adjust)
    if job.inputs.tables or job.config.crs:  # what cannot be used should end the job now, not after long work
        find_georeference(scene, job.config.algorithm(GeoreferenceOptions), log.info)
    return {"photos": len(scene.views), "points": len(scene.points)}
