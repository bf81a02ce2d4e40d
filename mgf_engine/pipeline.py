# SPDX-License-Identifier: GPL-3.0-or-later
"""The stages in order, each reading what the one before left in the job folder."""

from __future__ import annotations

import logging
import random
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from mgf_engine import __version__
from mgf_engine.errors import BadInput
from mgf_engine.estimate import Photos, estimate, inspect_photos, learn, shortage, with_clicks
from mgf_engine.job import Job
from mgf_engine.memory import GB, MemoryMonitor, allow, allowed, budget_of, share
from mgf_engine.messages import STAGES, Reporter
from mgf_engine.system import cores, cpu_seconds
from mgf_engine.terminal import duration

if TYPE_CHECKING:
    from mgf_engine.model.gaussians import Gaussians
    from mgf_engine.model.masks import MaskSet
    from mgf_engine.model.mesh import Mesh
    from mgf_engine.model.scene import Scene

log = logging.getLogger("mgf")
#: Mean confidence of a mesh below which its F1 is about half of what the scene allows (docs/stability.md).
DOUBTFUL = 0.5
#: Seconds: what shorter jobs took is mostly their start.
TELLING = 30.0
Figures = dict[str, Any]


def run_job(job: Job, reporter: Reporter, until: str = "deliver") -> None:
    """Run the stages up to and including ``until``, using those that are done already.

    Raises:
        BadInput, Cancelled: see :mod:`mgf_engine.errors`.
    """
    import os

    stages = STAGES[: STAGES.index(until) + 1]
    reporter.stages = stages
    reporter.send("started", job=str(job.folder), pid=os.getpid(), version=__version__, stages=list(stages))
    _prepare(job, reporter)
    lost = job.lost(until)
    to_run = [name for name in stages if name in lost or not job.done(name)]
    photos = _look_ahead(job, to_run, reporter) if to_run else None
    for place, name in enumerate(stages):
        reporter.check()
        reporter.stage(name, cached=name not in to_run)
        if name in to_run:
            _run_stage(job, name, reporter)
            if name == "masks" and photos is not None:
                photos = _look_again(job, photos, list(stages[place + 1 :]), reporter)
    speed = learn_from(job, photos) if photos is not None and to_run == list(STAGES) else None
    reporter.send(
        "result", path=str(job.folder), files=result_files(job), figures=job.stages[until]["figures"], speed=speed
    )


def result_files(job: Job) -> dict[str, str]:
    """What a finished job offers, name -> path, for the files that exist."""
    names = {
        "mesh": "mesh.ply", "obj": "mesh.obj", "glb": "mesh.glb", "texture": "texture.jpg", "field": "field.ply",
        "report": "report.html", "figures": "report.json", "renders": "renders", "masks": "masks/contact_sheet.jpg",
    }  # fmt: skip
    return {name: str(job.path(file)) for name, file in names.items() if job.path(file).exists()}


def load_scene_of(job: Job) -> Scene:
    """The scene of a job; as every ``load_`` here, BadInput where its stage left nothing that can be used.

    Which views are kept out of training is the field's matter: the scene may have been made under another choice.
    """
    from mgf_engine.scene.roots import choose_held_out
    from mgf_engine.scene.store import read_scene

    with _made_by(job, "scene"):
        scene = read_scene(job.path("scene"))
    return replace(scene, held_out=choose_held_out(len(scene.views), scene.roots, job.config.holdout_every))


def load_inputs(job: Job) -> tuple[Scene, MaskSet]:
    """The scene and masks of a job whose first two stages are done."""
    from mgf_engine.masks.store import read_masks

    scene = load_scene_of(job)
    with _made_by(job, "masks"):
        return scene, read_masks(job.path("masks"), scene)


def load_field(job: Job) -> Gaussians:
    """The trained field, normalised frame."""
    from mgf_engine.field.checkpoint import read_field

    with _made_by(job, "field"):
        return read_field(job.path("checkpoints", "field.npz"))


def load_mesh(job: Job) -> Mesh:
    """The mesh, scene frame."""
    from mgf_engine.geometry.mesh_files import read_ply

    with _made_by(job, "mesh"):
        try:
            return read_ply(job.path("mesh.ply"))
        except BadInput as error:
            raise BadInput(f"The mesh in '{job.folder}' is missing or damaged; run 'mgf mesh' again.") from error


@contextmanager
def _made_by(job: Job, stage: str) -> Iterator[None]:
    """Results of a stage are read here; when they cannot be used, the stage runs again at the next occasion."""
    try:
        yield
    except BadInput:
        job.forget(stage)
        raise


def _prepare(job: Job, reporter: Reporter) -> None:
    """Device, seed and thread counts; one place, so that a job repeats itself.

    Raises:
        BadInput: CUDA is asked for, and no card can be used; or the kernels cannot be loaded.
    """
    import cv2
    import torch

    from mgf_engine.native.library import set_threads, variant
    from mgf_engine.raster.device import choose_device

    log.info("kernel variant %s", variant())  # loads the kernels: better now than after the first stages
    choice = choose_device(job.config.device)
    log.info("%s", choice.text)
    # A surprise is a warning, which the panel shows and the report keeps; it need not be read twice.
    text = "Device: CPU." if choice.surprising else choice.text
    reporter.send("device", device=choice.device.type, text=text)
    if choice.surprising:
        reporter.warning(choice.text)

    threads = job.config.threads or cores()
    torch.set_num_threads(1)  # the kernels have threads of their own; torch's would only wait for the cores
    cv2.setNumThreads(threads)
    set_threads(threads)
    random.seed(job.config.seed)
    np.random.seed(job.config.seed)
    torch.manual_seed(job.config.seed)
    cv2.setRNGSeed(job.config.seed)


def _look_ahead(job: Job, stages: list[str], reporter: Reporter) -> Photos | None:
    """Say what the stages to come will take, and set how much memory they may use.

    Returns:
        The photos; None where they cannot be looked at: whichever stage needs them says why.

    Raises:
        BadInput: they need more memory than the user allows.
    """
    from mgf_engine.model.photo_cache import PHOTOS, ROOM

    allow(budget_of(job.config.memory))
    PHOTOS.room = share(0.1, ROOM)
    try:
        photos = with_clicks(inspect_photos(job.source, job.folder), job.inputs.clicks)
    except BadInput:
        return None
    if "masks" not in stages:
        photos = _with_masks(job, photos)
    found = estimate(job.config, photos, stages)
    reporter.expect(found.seconds)
    seconds, memory = sum(found.seconds.values()), max(found.memory.values())
    _check_memory(job, photos, stages, reporter)
    reporter.send(
        "estimate", seconds=round(seconds, 1), bytes=round(memory), allowed=round(allowed()),
        stages={name: round(value, 1) for name, value in found.seconds.items()},
        text=f"About {duration(seconds)} and {memory / GB:.1f} GB of memory; {allowed() / GB:.1f} GB may be used.",
    )  # fmt: skip
    return photos


def _look_again(job: Job, photos: Photos, stages: list[str], reporter: Reporter) -> Photos:
    """The same once the masks tell how much of the photos the building fills, before the long work begins."""
    if not stages:
        return photos
    before, photos = photos, _with_masks(job, photos)
    reporter.expect(estimate(job.config, photos, stages).seconds)
    if not shortage(job.config, before, allowed(), stages):  # else it has been said
        _check_memory(job, photos, stages, reporter)
    return photos


def _with_masks(job: Job, photos: Photos) -> Photos:
    share_of_building = job.stages.get("masks", {}).get("figures", {}).get("building")
    return photos if share_of_building is None else replace(photos, building=float(share_of_building))


def _check_memory(job: Job, photos: Photos, stages: list[str], reporter: Reporter) -> None:
    """Refuse what needs more memory than the user allows, warn of what needs more than is usual."""
    lacking = shortage(job.config, photos, allowed(), stages)
    if lacking and job.config.memory:
        raise BadInput(lacking)
    if lacking:
        reporter.warning(lacking)


def learn_from(job: Job, photos: Photos) -> float | None:
    """What a whole job on the CPU tells of this machine's speed; None where it was too short, or on a card."""
    from mgf_engine.raster.device import choose_device

    seconds = {name: float(entry["seconds"]) for name, entry in job.stages.items()}
    if sum(seconds.values()) < TELLING or choose_device(job.config.device).device.type != "cpu":
        return None
    return learn(job.config, photos, seconds)


def _run_stage(job: Job, name: str, reporter: Reporter) -> None:
    key = job.begin(name)
    log.info("stage %s begins", name)
    started, cpu_before = time.perf_counter(), cpu_seconds()
    reporter.warnings.clear()
    with MemoryMonitor() as memory:
        figures = _RUNNERS[name](job, reporter)
    seconds, cpu = time.perf_counter() - started, cpu_seconds() - cpu_before
    if job.config.memory and memory.peak > allowed():
        reporter.warning(
            f"The stage '{name}' took {memory.peak / GB:.1f} GB of memory instead of at most {allowed() / GB:.1f} GB, "
            "more than was foreseen; lower the resolution if that is too much."
        )
    reporter.progress(1.0, 0.0, **{k: v for k, v in figures.items() if isinstance(v, int | float | str)})
    job.finish(name, key, seconds, cpu, memory.peak, figures, list(reporter.warnings))
    log.info("stage %s took %.1f s and %.2f GB: %s", name, seconds, memory.peak / GB, figures)


def _run_scene(job: Job, reporter: Reporter) -> Figures:
    from mgf_engine.masks.prompts import clicked_names
    from mgf_engine.scene.load import load_scene

    scene = load_scene(job.source, job.path("scene"), job.config, reporter, clicked_names(job.inputs.clicks))
    if job.inputs.tables or job.config.crs:  # what cannot be used should end the job now, not after long work
        from mgf_engine.georef.find import find_georeference

        find_georeference(scene, job.config, log.info)
    return {"photos": len(scene.views), "points": len(scene.points)}


def _run_masks(job: Job, reporter: Reporter) -> Figures:
    from mgf_engine.masks.build import build_masks
    from mgf_engine.model.masks import building

    scene = load_scene_of(job)
    job.keep_clicks()
    masks = build_masks(scene, job.inputs.clicks, job.masks, job.path("masks"), job.config, reporter)
    return {
        "used": int(masks.used.sum()), "masked_points": int(masks.point_mask.sum()),
        "building": round(float(np.mean([building(labels).mean() for labels in masks.labels])), 4),
    }  # fmt: skip


def _run_field(job: Job, reporter: Reporter) -> Figures:
    from mgf_engine.field.export import write_splats
    from mgf_engine.field.trainer import CHECKPOINT, train

    scene, masks = load_inputs(job)
    field, figures = train(scene, masks, job.config, job.path("checkpoints"), reporter)
    write_splats(field, scene.to_normalised, job.path("field.ply"))
    job.path("checkpoints", CHECKPOINT).unlink(missing_ok=True)
    return figures


def _run_mesh(job: Job, reporter: Reporter) -> Figures:
    from mgf_engine.geometry.clean import vertex_areas
    from mgf_engine.geometry.mesh_files import in_scene, write_ply
    from mgf_engine.mesh.extract import extract_mesh
    from mgf_engine.mesh.parts import FILE as PARTS_FILE
    from mgf_engine.mesh.parts import face_parts, named_parts, write_parts
    from mgf_engine.start.store import FILE as START
    from mgf_engine.start.store import read_start
    from mgf_engine.timing import PartTimes

    scene, masks = load_inputs(job)
    times = PartTimes()
    start = read_start(job.path("checkpoints", START)) if job.config.start == "surface" else None
    mesh = extract_mesh(load_field(job), scene, masks, job.config, reporter, times, start)
    write_ply(in_scene(mesh, scene.to_normalised), job.path("mesh.ply"))
    named = named_parts(job.path("masks"), scene)
    if named:
        write_parts(list(named), face_parts(mesh, scene, masks, list(named.values())), job.path(PARTS_FILE))
    figures: Figures = {"vertices": len(mesh.vertices), "faces": len(mesh.faces), **times.figures()}
    if "confidence" in mesh.values:
        # By area: vertices are many where the surface is rough, and there it is least certain.
        areas = vertex_areas(mesh)
        figures["confidence"] = round(float(np.average(mesh.values["confidence"], weights=areas)), 3)
        figures["unseen_share"] = round(float(np.average(mesh.values["views"] == 0, weights=areas)), 4)
        if figures["confidence"] < DOUBTFUL:
            reporter.warning(weak_surface(figures["confidence"], figures["unseen_share"]))
    return figures


def weak_surface(confidence: float, unseen: float) -> str:
    """What to say of a mesh that the photos hardly confirm."""
    return (
        f"The photos confirm the mesh only weakly (mean confidence {confidence:.2f} of 1, {unseen:.0%} of it seen by "
        "no photo): do not measure on it; more and sharper photos closer together, or better cameras, would help."
    )


def _run_deliver(job: Job, reporter: Reporter) -> Figures:
    from mgf_engine.export.stage import deliver

    return deliver(job, reporter)


_RUNNERS: dict[str, Callable[[Job, Reporter], Figures]] = {
    "scene": _run_scene,
    "masks": _run_masks,
    "field": _run_field,
    "mesh": _run_mesh,
    "deliver": _run_deliver,
}
