# SPDX-License-Identifier: GPL-3.0-or-later
"""Gives a job its georeference: while it is delivered, and later with ``mgf georef`` without redoing anything."""

from __future__ import annotations

import json
from typing import Any

from mgf_engine.errors import BadInput
from mgf_engine.geometry.mesh_files import IMAGE, read_texture
from mgf_engine.georef.export import write_georeferenced
from mgf_engine.georef.find import GeoreferenceFit, find_georeference
from mgf_engine.georef.model import write_georeference
from mgf_engine.georef.options import GeoreferenceOptions
from mgf_engine.georef.report import georeference_figures, georeference_html, replace_section
from mgf_engine.job import Job
from mgf_engine.messages import Reporter
from mgf_engine.model.mesh import Mesh, Texture
from mgf_engine.model.scene import Scene
from mgf_engine.results import load_mesh, load_scene_of
from mgf_engine.runs import current_run
from mgf_engine.stages import MANIFEST, STAGE_NAMES, stage_of_section
from mgf_engine.system import write_json


def georeference_job(job: Job, scene: Scene, reporter: Reporter) -> GeoreferenceFit:
    """Find a job's georeference and write its ``georef.json``."""
    fit = find_georeference(scene, job.config.algorithm(GeoreferenceOptions), reporter.warning)
    write_georeference(fit.georeference, job.folder)
    return fit


def write_models(job: Job, mesh: Mesh, fit: GeoreferenceFit, texture: Texture | None) -> None:
    """Write the job's mesh (scene frame) in true coordinates.

    Args:
        job: a finished job.
        mesh: scene frame.
        fit: scene frame to local frame.
        texture: of the mesh, where it has one.
    """
    config = job.config
    write_georeferenced(mesh, fit.georeference, job.folder, texture, config.export_obj, config.export_glb)


def apply_to_finished(job: Job, reporter: Reporter) -> GeoreferenceFit:
    """Find the georeference of a finished job anew, by its present options; nothing else of it changes.

    Raises:
        BadInput: the job is not finished, or what the user gave cannot be used; the job is then as it was.
    """
    last = stage_of_section("georef").name  # its options are what may have changed
    unfinished = next((s for s in STAGE_NAMES if s not in job.stages or (s != last and not job.done(s))), None)
    if unfinished == STAGE_NAMES[0] and job.config.control and all(name in job.stages for name in STAGE_NAMES):
        raise BadInput(
            f"The scene of the job in '{job.folder}' was made with other control points, marks or photos; 'mgf "
            "reconstruct --resume' with these moves its cameras anew."
        )
    if unfinished is not None or not (job.folder / MANIFEST).exists():
        raise BadInput(
            f"The job in '{job.folder}' is not finished with these options; run 'mgf reconstruct --resume' with them."
        )
    scene, mesh = load_scene_of(job), load_mesh(job)
    warnings: list[str] = []
    fit = find_georeference(scene, job.config.algorithm(GeoreferenceOptions), warnings.append)
    texture = read_texture(job.folder) if (job.folder / IMAGE).exists() else None
    write_georeference(fit.georeference, job.folder)
    write_models(job, mesh, fit, texture)
    replace_section(job.path("report.html"), georeference_html(fit, scene))
    figures = json.loads(job.path("report.json").read_text(encoding="utf-8"))
    write_json(job.path("report.json"), {**figures, "georeference": plain(fit)})
    run = current_run(job.folder)
    if run is not None:
        write_georeference(fit.georeference, run)
    job.stages[last]["key"] = job.keys[last]
    job.save()
    for text in warnings:
        reporter.warning(text)
    return fit


def plain(fit: GeoreferenceFit) -> dict[str, Any]:
    """Return the figures of a fit with null for what is not finite, as JSON has no such numbers."""
    from mgf_engine.evaluation.report import plain_data

    found: dict[str, Any] = plain_data(georeference_figures(fit))
    return found
