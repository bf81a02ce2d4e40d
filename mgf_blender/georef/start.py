# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs of ``mgf georef`` for a scene: the one that places the job, and the quick one that predicts places in photos."""

from __future__ import annotations

import bpy

from ..common import runner
from ..common.errors import UserError
from ..common.job import DONE, Job
from ..job_folder import has_job_file, job_folder
from ..jobs.start import tool_job
from ..operator_calls import run_in
from ..scene_keys import scene_key, scene_of
from .files import marks_path, marks_text, places_path, read_known_points, read_placement, write_marks


def georef_job(scene: bpy.types.Scene) -> Job:
    """Return the job that finds the scene's true coordinates; writes the marks beside the job folder, starts nothing.

    Raises:
        UserError: control points are given but none is marked, or there is no engine.
    """
    state, folder = scene.mgf.georef, job_folder(scene)
    control, bars, marks = bpy.path.abspath(state.control_file), bpy.path.abspath(state.scale_bars), ""
    if len(state.marks):
        write_marks(scene, marks_path(folder))
        marks = str(marks_path(folder))
    elif bars or (control and not control.lower().endswith(".txt")):
        raise UserError("No point is marked yet; mark each in two photos or more in the Image Editor.")
    command = ["georef", str(folder), "--crs", state.crs.strip(), "--control", control, "--marks", marks]
    return tool_job(scene, "georef", [*command, "--scale-bars", bars], on_end=ended)


def places_job(scene: bpy.types.Scene) -> Job:
    """Return the job that reads the control points and predicts where they appear.

    Raises:
        UserError: there is no file of points, or no engine.
    """
    state, folder = scene.mgf.georef, job_folder(scene)
    if not state.control_file:
        raise UserError("No file of control points is chosen; choose a CSV with name, east, north, height.")
    command = ["georef", str(folder), "--crs", state.crs.strip()]
    command += ["--predict", str(places_path(folder)), "--control", bpy.path.abspath(state.control_file)]
    write_marks(scene, marks_path(folder))
    if len(state.marks):
        command += ["--marks", str(marks_path(folder))]
    return tool_job(scene, "places", command, on_end=ended)


def predict_again(scene: bpy.types.Scene) -> None:
    """Predict anew after a mark was made, unless a job runs; one that ends looks whether there are newer marks."""
    state = scene.mgf.georef
    wanted = state.follow and state.control_file and has_job_file(scene) and not bpy.app.background
    if wanted and not runner.live_job(scene_key(scene)):
        try:
            runner.submit(places_job(scene))
        except UserError:  # no engine: the panel says so
            return


def ended(job: Job) -> None:
    """Take over what a run found, in the scene that asked for it."""
    scene = scene_of(job.scene_key)
    if job.status != DONE or scene is None:
        return
    if job.kind == "georef":
        found = read_placement(job.folder)
        if found is not None and found.metric:
            run_in(scene, "place_scene")
        return
    state, there = scene.mgf.georef, read_known_points(job.folder)
    if [(p.name, p.role) for p in state.points] != [(k.name, k.role) for k in there.values()]:
        run_in(scene, "take_control_points")
    known = marks_path(job.folder)
    if not bpy.app.background and known.is_file() and known.read_text(encoding="utf-8") != marks_text(scene):
        predict_again(scene)
