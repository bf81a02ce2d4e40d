# SPDX-License-Identifier: GPL-3.0-or-later
"""Train the masked Gaussian field."""

from __future__ import annotations

from typing import Any

from mgf_engine.field.export import write_splats
from mgf_engine.field.trainer import CHECKPOINT, train
from mgf_engine.jobs.job import Job
from mgf_engine.jobs.results import load_inputs
from mgf_engine.messages import Reporter


def run_field(job: Job, reporter: Reporter) -> dict[str, Any]:
    """Train the field and write it for Blender and viewers; returns the training's figures."""
    scene, masks = load_inputs(job)
    field, figures = train(scene, masks, job.config, job.path("checkpoints"), reporter)
    write_splats(field, scene.to_normalised, job.path("field.ply"))
    job.path("checkpoints", CHECKPOINT).unlink(missing_ok=True)
    return figures
