# SPDX-License-Identifier: GPL-3.0-or-later
"""Fill the report of a finished job from its folder: metrics of held-out views, counts, times and images."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mgf_engine.errors import BadInput
from mgf_engine.evaluation.advice import JobFacts, advice
from mgf_engine.evaluation.confidence_colors import colored_by_confidence
from mgf_engine.evaluation.curve import curve_svg
from mgf_engine.evaluation.evenness import Evenness, measure_evenness, typical_pixel
from mgf_engine.evaluation.images import Scores, mean_scores, score
from mgf_engine.evaluation.lpips import Lpips, find_lpips
from mgf_engine.evaluation.pictures import error_picture, mask_overlay, normal_picture, on_white, turntable
from mgf_engine.evaluation.report import ReportData, StageReport, ViewReport, limit_side, write_report
from mgf_engine.evaluation.surface_source import explain_surface
from mgf_engine.evaluation.surfaces import Surface
from mgf_engine.export.views import render_view
from mgf_engine.geometry.rasterize import shaded
from mgf_engine.georef.find import GeoreferenceFit
from mgf_engine.georef.report import georeference_figures, georeference_html
from mgf_engine.jobs.job import Job
from mgf_engine.masks.segmenters.messages import describe_used_segmenter
from mgf_engine.mesh.confidence import measure_confidence
from mgf_engine.messages import Reporter
from mgf_engine.model.gaussians import Gaussians
from mgf_engine.model.masks import MaskSet, building
from mgf_engine.model.mesh import Mesh, Texture
from mgf_engine.model.scene import Scene, most_pixels
from mgf_engine.native.library import variant
from mgf_engine.native.parallel import parallel_map
from mgf_engine.options.config import as_dict
from mgf_engine.raster.device import choose_device, each_view
from mgf_engine.stages import outputs
from mgf_engine.system.machine import cores, cpu_name, peak_memory, total_memory, versions
from mgf_engine.system.memory import GB
from mgf_engine.texture.draw import draw_textured

_TRAINING_VIEWS_SHOWN = 3
_RELIEF_SIDES = 4
_CONFIDENCE_SIDES = 4
_BYTES_PER_PIXEL = 300  # of a photo while it is compared with its rendering (measured)


@dataclass(frozen=True)
class JobResults:
    """What the stages of a job have made.

    Attributes:
        scene: photos, cameras and sparse points.
        masks: the building in each photo.
        field: normalised frame.
        mesh: normalised frame.
    """

    scene: Scene
    masks: MaskSet
    field: Gaussians
    mesh: Mesh


def report_job(
    job: Job,
    results: JobResults,
    texture: Callable[[], Texture | None],
    fit: GeoreferenceFit,
    reporter: Reporter,
) -> dict[str, Any]:
    """Measure and write ``report.html`` and ``report.json``; returns the headline figures.

    Args:
        job: open job.
        results: of its stages.
        texture: waits for the mesh's texture, which may still be in the making; all files it belongs to are there then.
        fit: where the building is.
        reporter: for progress, warnings and the request to cancel.
    """
    scene, masks, field, mesh = results.scene, results.masks, results.field, results.mesh
    lpips = find_lpips(Path(job.config.weights) if job.config.weights else None)
    views = _view_reports(job, results, lpips, reporter)
    drawing = curve_svg(job.stages["field"]["figures"]["curve"])
    turned = turntable(mesh, scene)  # this and the next two beside the texture
    reporter.check()
    relief = turntable(mesh, scene, _RELIEF_SIDES, relief=True)
    reporter.check()
    evenness = _evenness(mesh, scene)
    reporter.check()
    made = texture()
    reporter.progress(0.8)
    quality = None if made is None else _show_texture(mesh, made, scene, masks, views)
    reporter.progress(0.9)
    data = _report_data(job, scene, masks, mesh, views)
    data.lpips = lpips.name if lpips else ""
    data.curve_drawing, data.turntable = drawing, list(turned)
    data.relief, data.evenness = list(relief), evenness
    confidence = measure_confidence(mesh)
    if confidence is not None:
        data.confidence = confidence.shares
        data.confidence_pictures = list(
            turntable(colored_by_confidence(mesh), scene, _CONFIDENCE_SIDES, grey_behind=True)
        )
    reporter.check()
    data.pixel = _pixel(evenness, fit)
    data.advice = advice(_facts(scene, masks, data))
    data.georeference, data.georeference_html = georeference_figures(fit), georeference_html(fit, scene)
    if quality is not None:
        data.counts["PSNR of the textured mesh, held-out photos (dB)"] = round(quality, 2)
    write_report(job.folder, data)
    held_out = mean_scores([v.scores for v in views if v.held_out and v.scores])
    return {
        "psnr": _rounded(held_out.psnr, 2), "ssim": _rounded(held_out.ssim, 4),
        "lpips": _rounded(held_out.lpips, 4), "held_out": len(scene.held_out) or None,
        "gaussians": len(field), "faces": len(mesh.faces),
    }  # fmt: skip


def _view_reports(job: Job, results: JobResults, lpips: Lpips | None, reporter: Reporter) -> list[ViewReport]:
    """Report on every view, see :func:`_view_report`."""
    scene, shown = results.scene, _shown_views(results.scene, results.masks)
    sh_degree = job.config.sh_degree if job.stages["field"]["figures"]["iterations"] else None

    def report(index: int) -> ViewReport:
        return _view_report(index, results, sh_degree, index in shown, lpips)

    views: list[ViewReport] = []
    each = _BYTES_PER_PIXEL * most_pixels(scene.views)
    for made in each_view(report, range(len(scene.views)), results.field.positions.device, each):
        reporter.progress(0.3 + 0.5 * len(views) / len(scene.views))
        views.append(made)
    return views


def _show_texture(mesh: Mesh, texture: Texture, scene: Scene, masks: MaskSet, views: list[ViewReport]) -> float | None:
    """Add a picture of the textured mesh to the views with pictures; returns its mean PSNR in held-out photos, dB."""

    def draw(index: int) -> Scores | None:
        picture = draw_textured(mesh, texture, scene.views[index])[0]
        views[index].pictures["texture"] = limit_side(picture)
        measured = views[index].held_out and masks.used[index]
        return score(scene.photo(index), picture, building(masks.labels[index])) if measured else None

    shown = [index for index, view in enumerate(views) if view.pictures]
    each = _BYTES_PER_PIXEL * most_pixels(scene.views)
    return mean_scores([scores for scores in parallel_map(draw, shown, bytes_each=each) if scores]).psnr


def _evenness(mesh: Mesh, scene: Scene) -> Evenness | None:
    """Measure the evenness of the mesh (normalised frame), working pixels; None without their size or a plane."""
    points, owner = scene.points, scene.track_point
    seen = [owner[scene.observations(index)] for index in range(len(scene.views))]
    away = [np.linalg.norm(points[s] - v.centre, axis=1) for s, v in zip(seen, scene.views, strict=True)]
    try:
        pixel = typical_pixel(away, [view.fx for view in scene.views])
        found = measure_evenness(Surface(mesh.vertices, mesh.faces.astype(np.int64)), pixel)
    except BadInput:
        return None
    return replace(found, ground_pixel=pixel / scene.to_normalised.scale)


def _pixel(evenness: Evenness | None, fit: GeoreferenceFit) -> str:
    """Return what a pixel of the working photos covers on the building, in millimetres where lengths are true."""
    if evenness is None:
        return ""
    size = evenness.ground_pixel * fit.georeference.scale
    return f"{1000 * size:.3g} mm" if fit.georeference.metric else f"{size:.3g} units"


def _facts(scene: Scene, masks: MaskSet, data: ReportData) -> JobFacts:
    """Collect what advice depends on."""
    return JobFacts(
        data.confidence,
        photo_side=max(max(view.original_width, view.original_height) for view in scene.views),
        working_side=max(max(view.width, view.height) for view in scene.views),
        weak_masks=tuple(view.name for view, used in zip(scene.views, masks.used, strict=True) if not used),
        trained=data.iterations > 0,
    )


def _shown_views(scene: Scene, masks: MaskSet) -> set[int]:
    """Choose the views that get pictures: those kept out of training, and a few others."""
    training = [i for i in range(len(scene.views)) if masks.used[i] and i not in scene.held_out]
    step = max(1, len(training) // _TRAINING_VIEWS_SHOWN)
    return {*scene.held_out, *training[::step][:_TRAINING_VIEWS_SHOWN]}


def _view_report(
    index: int, results: JobResults, sh_degree: int | None, shown: bool, lpips: Lpips | None = None
) -> ViewReport:
    """Score and draw a held-out or shown view; others only appear in the table, with a note when left out.

    Args:
        index: of the view.
        results: of the job's stages.
        sh_degree: of the field; None for one that nothing was trained in, which shows nothing worth a look.
        shown: whether the view gets pictures.
        lpips: the network, if there is one.
    """
    scene, masks = results.scene, results.masks
    view = scene.views[index]
    note = "" if masks.used[index] else "mask too weak, not used"
    report = ViewReport(view.name, index in scene.held_out, note=note)
    if not shown:
        return report
    photo, mask = scene.photo(index), building(masks.labels[index])
    pictures = {"photo": photo, "mask": mask_overlay(photo, masks.labels[index])}
    if sh_degree is not None:
        rendering = render_view(results.field, view, sh_degree)
        render = _to_picture(rendering.color.numpy())
        if masks.used[index]:
            report.scores = score(photo, render, mask, lpips)
        assert rendering.normal is not None
        normals = rendering.normal.permute(1, 2, 0).numpy()
        pictures["render"] = on_white(render, mask)
        pictures["normals"] = normal_picture(normals, rendering.alpha.numpy())
        pictures["error"] = error_picture(photo, render, mask)
    pictures["mesh"] = shaded(results.mesh, view, from_side=True)
    # Of a thousand photos a hundred are kept out: in full size these would take gigabytes until the page is written.
    report.pictures = {caption: limit_side(picture) for caption, picture in pictures.items()}
    return report


def _report_data(job: Job, scene: Scene, masks: MaskSet, mesh: Mesh, views: list[ViewReport]) -> ReportData:
    trained = job.stages["field"]["figures"]
    stages = [StageReport(n, s["seconds"], s["peak_memory"], s.get("cpu_seconds")) for n, s in job.stages.items()]
    contact = job.path("masks", "contact_sheet.jpg")
    return ReportData(
        title=job.source.name,
        command=_command(job),
        config=as_dict(job.config),
        user_options=job.user_options,
        views=views,
        counts={
            "photos": len(scene.views), "photos left out": len(scene.left_out),
            "photos with a usable mask": int(masks.used.sum()),
            "sparse points": len(scene.points), "points on the building": int(masks.point_mask.sum()),
            "Gaussians at the start": trained["start_gaussians"], "Gaussians": trained["gaussians"],
            "vertices": len(mesh.vertices), "faces": len(mesh.faces), **_confidence(job),
        },
        stages=stages,
        iterations=trained["iterations"],
        seconds_per_part=trained["seconds_per_part"],
        mesh_seconds_per_part=job.stages["mesh"]["figures"].get("seconds_per_part", {}),
        curve=trained["curve"],
        versions=versions(),
        machine={
            "processor": cpu_name(), "cores": str(cores()), "threads": str(job.config.threads or cores()),
            "memory": f"{total_memory() / GB:.1f} GB",
            "device": choose_device(job.config.device).text.removeprefix("Device: "),
            "segmenter of the masks": describe_used_segmenter(job.path("masks")),
        },
        kernel=variant(),
        peak_memory=max([peak_memory(), *(s.peak_memory or 0 for s in stages)]),
        warnings=[text for s in job.stages.values() for text in s.get("warnings", [])],
        contact_sheet=contact if contact.exists() else None,
        surface_source=explain_surface(job.config, trained["iterations"]),
        files=_files(job),
    )  # fmt: skip


def _confidence(job: Job) -> dict[str, float]:
    """Summarise the confidence of the mesh, where its surface has one (see ``TsdfField.observations``)."""
    figures = job.stages["mesh"]["figures"]
    names = {"confidence": "confidence of the mesh (0..1, mean)", "unseen_share": "share of it that no photo shows"}
    return {text: figures[name] for name, text in names.items() if name in figures}


def _files(job: Job) -> dict[str, str]:
    """Return what the report links to: all that the job offers but itself."""
    named = {o.name: o.path for o in outputs() if o.name and o.name != "report"}
    return {name: path for name, path in {**named, "log": "log.txt"}.items() if job.path(path).exists()}


def _command(job: Job) -> str:
    parts = ["mgf", "reconstruct", str(job.source)]
    for flag, path in (("--prompts", job.prompts), ("--masks", job.masks)):
        parts += [flag, str(path)] if path else []
    for name, value in job.user_options.items():
        parts += ["--set", f"{name}={value}"]
    join = shlex.join if sys.platform != "win32" else " ".join
    return join([*parts, "--out", str(job.folder)])


def _to_picture(color: NDArray[np.float32]) -> NDArray[np.uint8]:
    picture: NDArray[np.uint8] = (color.clip(0, 1).transpose(1, 2, 0) * 255).round().astype(np.uint8)
    return picture


def _rounded(value: float | None, digits: int) -> float | None:
    return None if value is None else round(value, digits)
