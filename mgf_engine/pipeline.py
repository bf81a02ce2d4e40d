# SPDX-License-Identifier: GPL-3.0-or-later
"""Run the stages in order; each reads the results of earlier ones from the job folder."""

from __future__ import annotations

import logging
import random
import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mgf_engine import __version__
from mgf_engine.console.terminal import format_duration
from mgf_engine.errors import BadInput
from mgf_engine.jobs.estimate import PhotoSummary, estimate, inspect_photos, quantities, with_clicks
from mgf_engine.jobs.job import Job
from mgf_engine.jobs.machine_speed import StageTime, record_speed
from mgf_engine.jobs.memory_check import shortage
from mgf_engine.masks.prompts import check_prompts, no_clicks
from mgf_engine.masks.user_masks import no_mask_fits
from mgf_engine.messages import Reporter
from mgf_engine.options.config import Config
from mgf_engine.scene.colmap import find_model, find_photos, list_photos, photo_names
from mgf_engine.stages import STAGE_NAMES, outputs, stage_named
from mgf_engine.system.machine import cores, cpu_seconds, release_memory
from mgf_engine.system.memory import GB, MemoryMonitor, allow, allowed, budget_of, share

log = logging.getLogger("mgf")
#: CPU seconds of a job below which its times, mostly those of starting up, do not measure the speed of the machine.
_LEAST_CPU_SECONDS = 30.0


def run_job(job: Job, reporter: Reporter, until: str = STAGE_NAMES[-1], *, suggest: bool = True) -> None:
    """Run the stages up to and including ``until``; stages that are done already are skipped.

    Args:
        job: opened.
        reporter: for progress, warnings and the result.
        until: name of the last stage.
        suggest: name photos worth clicking where the scene was read without clicks or masks.

    Raises:
        BadInput, Cancelled: see :mod:`mgf_engine.errors`.
    """
    import os

    stages = STAGE_NAMES[: STAGE_NAMES.index(until) + 1]
    reporter.stages = stages
    reporter.send("started", job=str(job.folder), pid=os.getpid(), version=__version__, stages=list(stages))
    prepare(job.config, reporter)
    allow(budget_of(job.config.memory), job.folder, strict=bool(job.config.memory))
    try:
        _run_stages(job, stages, reporter, suggest)
    finally:
        allow(0.0)  # limit and folder are of this job only


def _run_stages(job: Job, stages: Sequence[str], reporter: Reporter, suggest: bool) -> None:
    """Run those of the first stages of a job that are not done, and report the result of the last.

    Args:
        job: opened.
        stages: names of the first stages.
        reporter: for progress, warnings and the result.
        suggest: name photos worth clicking.

    Raises:
        BadInput, Cancelled: see :mod:`mgf_engine.errors`.
    """
    until = stages[-1]
    missing = job.missing_results(until)
    to_run = [name for name in stages if name in missing or not job.done(name)]
    photos = _estimate_job(job, to_run, reporter) if to_run else None
    lacks_clicks = job.config.use_masks and not (job.inputs.clicks or job.masks)
    if photos is not None and "masks" in to_run and lacks_clicks:
        raise no_clicks()  # before the cameras are found, which can take long
    if photos is not None and {"scene", "masks"} <= set(to_run) and job.config.use_masks:
        _check_prompts(job, photos)
    for place, name in enumerate(stages):
        reporter.check()
        reporter.stage(name, cached=name not in to_run)
        if name in to_run:
            _run_stage(job, name, reporter)
            if name == "masks" and photos is not None:
                photos = _update_estimate(job, photos, list(stages[place + 1 :]), reporter)
    speed = measure_speed(job, photos) if photos is not None and to_run == list(STAGE_NAMES) else None
    guide = {"suggested": suggested_photos(job)} if suggest and until == "scene" and lacks_clicks else {}
    reporter.send(
        "result", path=str(job.folder), files=result_files(job), figures=job.stages[until]["figures"], speed=speed,
        **guide,
    )  # fmt: skip


def suggested_photos(job: Job) -> list[str]:
    """Return names of photos that are worth clicking: a fifth of all, spread around the building."""
    from mgf_engine.jobs.results import load_scene_of

    scene = load_scene_of(job)
    return [scene.views[i].name for i in scene.roots]


def result_files(job: Job) -> dict[str, str]:
    """Return the result files of a finished job that exist, name -> path (names as in :mod:`mgf_engine.stages`)."""
    return {o.name: str(job.path(o.path)) for o in outputs() if o.name and job.path(o.path).exists()}


def prepare(config: Config, reporter: Reporter) -> None:
    """Set device, random seeds and thread counts for this process, so that a job is reproducible.

    Raises:
        BadInput: CUDA is asked for, and no GPU can be used; or the kernels cannot be loaded.
    """
    import cv2
    import torch

    from mgf_engine.native.library import set_threads, variant
    from mgf_engine.raster.device import choose_device

    log.info("kernel variant %s", variant())  # loads the kernels: better now than after the first stages
    choice = choose_device(config.device)
    log.info("%s", choice.text)
    # An unexpected choice is a warning, which the panel shows and the report keeps; the message need not repeat it.
    text = "Device: CPU." if choice.surprising else choice.text
    reporter.send("device", device=choice.device.type, text=text)
    if choice.surprising:
        reporter.warning(choice.text)

    threads = config.threads or cores()
    torch.set_num_threads(1)  # the kernels have threads of their own; torch's would compete with them for the cores
    cv2.setNumThreads(threads)
    set_threads(threads)
    random.seed(config.seed)
    np.random.seed(config.seed)
    torch.manual_seed(config.seed)
    cv2.setRNGSeed(config.seed)


def _estimate_job(job: Job, stages: list[str], reporter: Reporter) -> PhotoSummary | None:
    """Report the expected time and memory of the stages that will run.

    Returns:
        Number and size of the photos; None if they cannot be read, which the scene stage reports.

    Raises:
        BadInput: they need more memory than the user allows.
    """
    from mgf_engine.model.photo_cache import CAPACITY, PHOTOS

    PHOTOS.capacity = share(0.1, CAPACITY)
    try:
        photos = with_clicks(inspect_photos(job.source, job.folder), job.inputs.clicks)
    except BadInput:
        return None
    if "masks" not in stages:
        photos = _with_masks(job, photos)
    found = estimate(job.config, photos, stages, budget=allowed())
    reporter.expect(found.seconds)
    seconds, memory = sum(found.seconds.values()), max(found.memory.values())
    _check_memory(job, photos, stages, reporter)
    reporter.send(
        "estimate", seconds=round(seconds, 1), bytes=round(memory), allowed=round(allowed()),
        stages={name: round(value, 1) for name, value in found.seconds.items()},
        text=f"About {format_duration(seconds)} and {memory / GB:.1f} GB of memory; "
        f"{allowed() / GB:.1f} GB may be used.",
    )  # fmt: skip
    return photos


def _update_estimate(job: Job, photos: PhotoSummary, stages: list[str], reporter: Reporter) -> PhotoSummary:
    """Repeat the estimate with the share of the photos that the finished masks cover; returns the updated photos."""
    if not stages:
        return photos
    before, photos = photos, _with_masks(job, photos)
    reporter.expect(estimate(job.config, photos, stages).seconds)
    if not shortage(job.config, before, allowed(), stages):  # else the user was warned before
        _check_memory(job, photos, stages, reporter)
    return photos


def _check_prompts(job: Job, photos: PhotoSummary) -> None:
    """Refuse unusable clicks or masks before the photos are read and their cameras found.

    Raises:
        BadInput: no mask belongs to a photo, or the clicks are malformed or outside their photos.
    """
    if job.masks is not None and not job.inputs.masks and job.inputs.names:
        raise no_mask_fits(job.masks, job.inputs.names[0])
    if job.masks is not None or job.inputs.clicks is None:
        return
    model = find_model(job.source, job.folder) if photos.placed else None
    if model is not None:
        names = photo_names(model)
        files = dict(zip(names, find_photos(names, model, job.source, job.folder), strict=True))
    else:
        root, names = list_photos(job.source, job.folder)
        files = {name: root / name for name in names}
    check_prompts(job.inputs.clicks, files, placed=photos.placed)


def _with_masks(job: Job, photos: PhotoSummary) -> PhotoSummary:
    """Set the share of the photos that the building fills, if the job has masks already."""
    share_of_building = job.stages.get("masks", {}).get("figures", {}).get("building")
    return photos if share_of_building is None else replace(photos, building=float(share_of_building))


def _check_memory(job: Job, photos: PhotoSummary, stages: list[str], reporter: Reporter) -> None:
    """Raise BadInput if the job needs more memory than the user allows; warn if it needs more than is free."""
    lacking = shortage(job.config, photos, allowed(), stages)
    if lacking and job.config.memory:
        raise BadInput(lacking)
    if lacking:
        reporter.warning(lacking)


def measure_speed(job: Job, photos: PhotoSummary) -> float | None:
    """Measure the speed of this machine from a whole job on the CPU; None if the job was too short or ran on a GPU."""
    from mgf_engine.raster.device import choose_device

    times = {name: StageTime(float(of["seconds"]), float(of["cpu_seconds"])) for name, of in job.stages.items()}
    too_short = sum(t.cpu_seconds for t in times.values()) < _LEAST_CPU_SECONDS
    if too_short or choose_device(job.config.device).device.type != "cpu":
        return None
    return record_speed(quantities(job.config, photos), times)


def _run_stage(job: Job, name: str, reporter: Reporter) -> None:
    """Run one stage and record its time, peak memory, figures and warnings."""
    from mgf_engine.native.buffers import release_buffers  # loads torch, as every stage does

    key = job.begin(name)
    log.info("stage %s begins", name)
    started, cpu_before = time.perf_counter(), cpu_seconds()
    reporter.warnings.clear()
    release_buffers()  # so that memory of the previous stage does not count for this one
    release_memory()
    with MemoryMonitor() as memory:
        figures = stage_named(name).runner()(job, reporter)
    seconds, cpu = time.perf_counter() - started, cpu_seconds() - cpu_before
    if job.config.memory and memory.peak > allowed():
        reporter.warning(
            f"The stage '{name}' took {memory.peak / GB:.1f} GB of memory instead of at most {allowed() / GB:.1f} GB, "
            "more than was foreseen; lower the resolution if that is too much."
        )
    reporter.progress(1.0, 0.0, **{k: v for k, v in figures.items() if isinstance(v, int | float | str)})
    job.finish(name, key, seconds, cpu, memory.peak, figures, list(reporter.warnings))
    short = {key: value for key, value in figures.items() if not isinstance(value, list)}  # no curve of the training
    log.info("stage %s took %.1f s and %.2f GB: %s", name, seconds, memory.peak / GB, short)
