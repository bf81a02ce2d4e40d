# SPDX-License-Identifier: GPL-3.0-or-later
"""Give a job its georeference: when it is delivered, or later with ``mgf georef`` without repeating stages."""

from __future__ import annotations

import json
from typing import Any

from mgf_engine.errors import BadInput
from mgf_engine.files.atomic import write_json
from mgf_engine.files.html_section import replace_section
from mgf_engine.geometry.mesh_files import IMAGE, read_texture
from mgf_engine.georef.export import FOLDER, write_georeferenced
from mgf_engine.georef.find import GeoreferenceFit, find_georeference
from mgf_engine.georef.model import FILE, write_georeference
from mgf_engine.georef.options import GeoreferenceOptions
from mgf_engine.georef.report import BEGIN, END, georeference_figures, georeference_html
from mgf_engine.jobs.job import Job
from mgf_engine.jobs.results import load_mesh, load_scene_of
from mgf_engine.jobs.runs import delivered, renew_run
from mgf_engine.masks.store import read_up
from mgf_engine.messages import Reporter
from mgf_engine.model.mesh import Mesh, Texture
from mgf_engine.model.scene import Scene
from mgf_engine.model.up_direction import UpDirection
from mgf_engine.stages import MANIFEST, STAGE_NAMES, STAGES, stage_of_section


def georeference_job(job: Job, scene: Scene, up: UpDirection | None, reporter: Reporter) -> GeoreferenceFit:
    """Find a job's georeference and write its ``georef.json``.

    Args:
        job: whose scene and masks are done.
        scene: of the job.
        up: direction up, as the masks know it; None to find it.
        reporter: for warnings.
    """
    fit = find_georeference(scene, job.config.algorithm(GeoreferenceOptions), reporter.warning, up)
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

    It may be finished by another version, with other options or photos: what lies in its folder is placed.

    Raises:
        BadInput: the job is not finished, or what the user gave cannot be used; the job is then as it was.
    """
    check_finished(job)
    last = stage_of_section("georef").name  # its options are what may have changed
    scene, mesh = load_scene_of(job), load_mesh(job)
    warnings: list[str] = []
    up = read_up(job.path("masks")) if job.done("masks") else None  # found by other options else
    fit = find_georeference(scene, job.config.algorithm(GeoreferenceOptions), warnings.append, up)
    texture = read_texture(job.folder) if (job.folder / IMAGE).exists() else None
    write_models(job, mesh, fit, texture)  # first: they are what a disk may have no room for
    write_georeference(fit.georeference, job.folder)
    replace_section(job.path("report.html"), georeference_html(fit, scene), BEGIN, END)
    figures = json.loads(job.path("report.json").read_text(encoding="utf-8"))
    write_json(job.path("report.json"), {**figures, "georeference": plain(fit)})
    renew_run(job.folder, (FILE, FOLDER))
    if all(job.done(name) for name in STAGE_NAMES if name != last):  # or the next run has to redo the last one as well
        job.stages[last]["key"] = job.keys[last]
    job.save()
    for text in warnings:
        reporter.warning(text)
    return fit


def check_finished(job: Job) -> None:
    """Check that every stage is on record, and that the files are there which the job's result consists of.

    Raises:
        BadInput: a stage never ended, or a file is missing.
    """
    undone = [name for name in STAGE_NAMES if name not in job.stages]
    if undone:
        raise BadInput(
            f"The job in '{job.folder}' is not finished (its stage '{undone[0]}' has not ended); run 'mgf reconstruct "
            "--resume' first."
        )
    required = (name for stage in STAGES for name in stage.required_outputs if stage.user_facing)
    lost = [name for name in ("scene/scene.npz", *required) if not job.path(name).exists()]
    if lost or not delivered(job.folder):
        what = f"'{lost[0]}'" if lost else f"a file that its {MANIFEST} names"
        raise BadInput(f"The job in '{job.folder}' has lost {what}; run 'mgf reconstruct --resume' to make it again.")


def plain(fit: GeoreferenceFit) -> dict[str, Any]:
    """Return the figures of a fit with null for what is not finite, as JSON has no such numbers."""
    from mgf_engine.evaluation.report import plain_data

    found: dict[str, Any] = plain_data(georeference_figures(fit))
    return found
