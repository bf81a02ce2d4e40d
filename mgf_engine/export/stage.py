# SPDX-License-Identifier: GPL-3.0-or-later
"""Last stage: novel views, the texture, ``deliver.json`` for Blender and scripts, and the report."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.export.report import JobResults, report_job
from mgf_engine.export.views import render_view, straight_rgba
from mgf_engine.field.export import offset_of
from mgf_engine.files.atomic import atomic_path
from mgf_engine.geometry.mesh_files import write_glb, write_obj, write_texture
from mgf_engine.georef.apply import georeference_job, write_models
from mgf_engine.georef.report import rms_figures
from mgf_engine.jobs.job import CLICKS, Job
from mgf_engine.jobs.results import load_field, load_inputs, load_mesh
from mgf_engine.jobs.runs import keep_run
from mgf_engine.messages import Reporter
from mgf_engine.model.gaussians import Gaussians
from mgf_engine.model.masks import MaskSet
from mgf_engine.model.mesh import Mesh, Texture
from mgf_engine.model.scene import Scene, View, most_pixels
from mgf_engine.raster.api import Rendering
from mgf_engine.raster.device import choose_device, each_view
from mgf_engine.stages import outputs
from mgf_engine.texture.texture_pipeline import TextureOptions, make_texture

#: What people take from a job, and the clicks it was made with.
_RESULT = [*(output.path for output in outputs() if output.kept), CLICKS]
_BYTES_PER_PIXEL = 100  # of a rendering in the making
_RENDERED = 0.3  # share of the stage, for the progress bar


def deliver(job: Job, reporter: Reporter) -> dict[str, Any]:
    """Render, measure and write everything people look at; returns the headline figures.

    The texture is made beside all that does not show it: both have long stretches that one core works on alone.
    """
    scene, masks = load_inputs(job)
    rated = load_mesh(job, ("confidence", "views"))
    mesh = replace(rated, values={})
    # First: files that cannot be used should end the job before long work.
    fit = georeference_job(job, scene, masks.up, reporter)
    reporter.check()
    field = load_field(job).to(choose_device(job.config.device).device)
    normalised = replace(mesh, vertices=scene.to_normalised.apply(mesh.vertices))
    shown = replace(normalised, values=rated.values)
    with ThreadPoolExecutor(1, "mgf-texture") as beside:
        warnings: list[str] = []  # this thread reports them: who listens expects all messages from one
        make = partial(_texture, job, scene, masks, normalised, warnings.append, reporter.check)
        painting = beside.submit(make) if job.config.texture else None
        renders = _render_views(job, scene, field, reporter)

        def texture() -> Texture | None:
            made = painting.result() if painting else None
            for text in warnings:
                reporter.warning(text)
            _write_other_formats(mesh, made, job)
            write_models(job, mesh, fit, made)
            return made

        figures = report_job(job, JobResults(scene, masks, field, shown), texture, fit, reporter)
    figures = {**figures, **rms_figures(fit)}
    manifest = {**_manifest(job, scene, renders, figures), **_offset(field, scene)}
    keep_run(job.folder, _RESULT, manifest, job.user_options)
    return figures


def _render_views(job: Job, scene: Scene, field: Gaussians, reporter: Reporter) -> dict[int, str]:
    """Render the views that the options choose; returns the path in the job folder of each one's render."""
    if job.stages["field"]["figures"].get("iterations") == 0:
        return {}  # a field that nothing was trained in shows nothing worth a look
    chosen = range(len(scene.views)) if job.config.render_all else scene.held_out or scene.roots

    def write(index: int) -> str:
        name = f"renders/{Path(scene.views[index].file).stem}.png"
        _write_render(render_view(field, scene.views[index], job.config.sh_degree), job.path(name))
        return name

    renders: dict[int, str] = {}
    written = each_view(write, chosen, field.positions.device, _BYTES_PER_PIXEL * most_pixels(scene.views))
    for index, name in zip(chosen, written, strict=True):
        reporter.progress(_RENDERED * len(renders) / len(chosen))
        renders[index] = name
    return renders


def _texture(
    job: Job, scene: Scene, masks: MaskSet, mesh: Mesh, warn: Callable[[str], None], check: Callable[[], None]
) -> Texture:
    texture = make_texture(
        mesh, scene, masks, job.config.texture_size, warn, lambda share: check(), job.config.algorithm(TextureOptions)
    )
    write_texture(texture, job.folder)
    return texture


def _offset(field: Gaussians, scene: Scene) -> dict[str, list[float]]:
    """Return what is to be added to the positions of ``field.ply``, where that is anything."""
    offset = offset_of(field, scene.to_normalised)
    return {"field_offset": list(offset)} if any(offset) else {}


def _write_other_formats(mesh: Mesh, texture: Texture | None, job: Job) -> None:
    if job.config.export_obj:
        write_obj(mesh, job.path("mesh.obj"), texture)
    if job.config.export_glb:
        write_glb(mesh, job.path("mesh.glb"), texture)


def camera_to_scene(view: View, scene: Scene) -> NDArray[np.float64]:
    """Return the matrix [4, 4] from COLMAP camera axes to the scene frame, in the scene's own units."""
    matrix = np.eye(4)
    matrix[:3, :3] = scene.to_normalised.rotation.T @ view.rotation.T
    matrix[:3, 3] = scene.to_normalised.invert(view.centre)
    return matrix


def _write_render(rendering: Rendering, path: Path) -> None:
    ok, data = cv2.imencode(".png", cv2.cvtColor(straight_rgba(rendering), cv2.COLOR_RGBA2BGRA))
    if not ok:
        raise RuntimeError(f"could not encode {path.name}")
    with atomic_path(path) as temporary:
        temporary.write_bytes(data.tobytes())


def _manifest(job: Job, scene: Scene, renders: dict[int, str], figures: dict[str, Any]) -> dict[str, Any]:
    held_out = set(scene.held_out)
    views = [
        {
            "name": view.name, "file": "scene/" + view.file, "width": view.width, "height": view.height,
            "fx": view.fx, "fy": view.fy, "cx": view.cx, "cy": view.cy,
            "camera_to_world": camera_to_scene(view, scene).tolist(), "held": view.held,
            "render": renders.get(index), "held_out": index in held_out,
        }
        for index, view in enumerate(scene.views)
    ]  # fmt: skip
    files = {o.manifest: o.path for o in outputs() if o.manifest and job.path(o.path).exists()}
    return {"views": views, **files, "figures": figures}
