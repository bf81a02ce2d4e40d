# SPDX-License-Identifier: GPL-3.0-or-later
"""One measured run: the process with its own time and memory, then the scores of its mesh."""

from __future__ import annotations

import json
import os
import shlex
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.job_scores import held_out_scores, mean_mask_iou
from benchmarks.stage_cache import Stages, cache_entry, restore_stages, saved_cost, stages_of, store_stages
from benchmarks.suites import Run
from benchmarks.true_masks import write_elements
from mgf_engine import __version__
from mgf_engine.errors import BadInput
from mgf_engine.evaluation.geometry import ComparisonOptions, compare_surfaces
from mgf_engine.evaluation.materials import read_materials
from mgf_engine.evaluation.model_cameras import cameras_of
from mgf_engine.evaluation.surfaces import MaskedView, Points, Surface, read_surface
from mgf_engine.geometry.mesh_files import read_ply, write_ply
from mgf_engine.model.masks import IGNORE
from mgf_engine.system.machine import cores, cpu_name

#: Thresholds in metres always reported; one ground pixel and its double are added.
THRESHOLDS = (0.05, 0.10, 0.20)
SAMPLES = 300_000  # points sampled on each mesh
#: Whole-picture reconstructions are cut to the true mesh's box, grown by this much, metres.
CROP_MARGIN = 0.5
#: Nobody can see below the ground: what lies lower is left out of every mesh (``outside_crop`` says how much).
CROP_FOOT = 0.1
#: The scores of a row, and how tables name them.
SCORED = {"geometry": "F1", "without_steelwork": "F1 without steelwork"}


def f1_at(row: dict[str, Any], threshold: float, part: str = "geometry") -> float:
    """Return F1 in percent at one of a row's thresholds, metres; ``part`` is the key of its scores."""
    return float(row[part]["f1"][row[part]["thresholds"].index(threshold)])


def origin() -> dict[str, str]:
    """Return what a figure was measured with and when: ``commit``, ``machine`` and ``date``."""
    git = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty", "--abbrev=7", "--exclude=*"]
    try:
        found = subprocess.run(git, capture_output=True, text=True, timeout=20, check=True).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        found = f"version {__version__}"
    return {"commit": found, "machine": f"{cpu_name()}, {cores()} cores", "date": time.strftime("%Y-%m-%d")}


@dataclass(frozen=True)
class Prepared:
    """A scene ready to be reconstructed and scored; ``cameras`` are the true ones with their masks.

    ``scale`` and ``offset`` lead from the true frame to the scene's: ``scene = scale * true + offset``.
    """

    folder: Path
    cameras: list[MaskedView]
    ground_pixel: float
    crop: Points  # [2, 3], true frame
    steelwork: Surface | None = None  # its open steelwork, which is scored along with the rest and left out, too
    scale: float = 1.0
    offset: tuple[float, ...] = (0.0, 0.0, 0.0)

    @property
    def truth(self) -> Path:
        return self.folder / "truth.ply"


def prepare_scene(name: str, photos: int | None = None, width: int | None = None) -> Prepared:
    """Render the named scene if need be (or take a folder that was made before) and read what scoring needs.

    Raises:
        BadInput: no such scene, or its record is damaged.
    """
    from benchmarks.catalogue import scene_spec
    from benchmarks.scenes import make_scene

    if (Path(name) / "scene.json").exists():
        return prepare_folder(Path(name).resolve())
    return prepare_folder(make_scene(name, scene_spec(name, photos=photos, width=width)))


def prepare_folder(folder: Path) -> Prepared:
    """Return what scoring needs of a rendered scene.

    Raises:
        BadInput: its record is damaged.
    """
    ground_pixel = _ground_pixel(folder / "scene.json")
    truth = read_surface(folder / "truth.ply").vertices
    low, high = truth.min(0) - CROP_MARGIN, truth.max(0) + CROP_MARGIN
    low[2] = CROP_FOOT
    return Prepared(folder, true_cameras(folder), ground_pixel, np.stack([low, high]), true_steelwork(folder))


def true_steelwork(folder: Path) -> Surface | None:
    """Return the open steelwork of a generated building; None where it has none."""
    from benchmarks.buildings import BUILDINGS, STEELWORK
    from benchmarks.shapes import true_mesh

    spec = json.loads((folder / "scene.json").read_text(encoding="utf-8")).get("spec", {})
    build = BUILDINGS.get(spec.get("building"))
    parts = [] if build is None else [p for p in build(spec["wall"]) if p.element.startswith(STEELWORK)]
    if not parts:
        return None
    vertices, faces = true_mesh(parts)
    return Surface(vertices, faces.astype(np.int64))


def _ground_pixel(path: Path) -> float:
    """Metres on the ground that a pixel covers, from a scene's record."""
    try:
        return float(json.loads(path.read_text(encoding="utf-8"))["ground_pixel"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise BadInput(f"Cannot read the scene's record '{path}' ({error!r}); make the scene again.") from error


def true_cameras(folder: Path) -> list[MaskedView]:
    """Return the scene's true cameras; each sees the building only where its true mask shows no occluder."""

    def nothing_in_front(name: str) -> NDArray[np.bool_]:
        labels = cv2.imread(str(folder / "masks" / (Path(name).stem + ".png")), cv2.IMREAD_UNCHANGED)
        if labels is None:
            raise BadInput(f"The mask of '{name}' in '{folder}' is missing; delete the folder and make it again.")
        return np.asarray(labels != IGNORE)

    return cameras_of(folder / "sparse_truth", nothing_in_front)


def measure(
    run: Run, scene: Prepared, job: Path, samples: int, keep_job: bool, cache: Path | None = None
) -> dict[str, Any]:
    """Run and score; a plain row for tables, with ``failed`` (one sentence) instead of scores if the run failed.

    Args:
        samples: points on each mesh.
        keep_job: keep the whole job folder, not only what people look at.
        cache: folder of :mod:`benchmarks.stage_cache`; what a run takes from there is added to its cost.
    """
    row: dict[str, Any] = {"variant": run.variant, "scene": run.scene, "seed": run.seed, "group": run.group,
                           "options": run.options, "masks": run.masks, "poses": run.poses, "samples": samples,
                           **origin()}  # fmt: skip
    code, tail, cost = _make_mesh(run, scene, job, cache)
    row.update(cost)
    if code != 0 or not (job / "mesh.ply").exists():
        return {**row, "code": code, "failed": tail or f"exit code {code}"}
    row.update(_mesh_scores(run, scene, job / "mesh.ply", samples))
    if not run.command:
        row.update(job_figures(job))
        row["mask_iou"] = mean_mask_iou(job, scene.folder)
        pictures = held_out_scores(job, scene.folder)
        row.update(psnr=pictures.psnr, ssim=pictures.ssim, psnr_frame=pictures.psnr_frame, lpips=pictures.lpips)
    if not keep_job:
        _slim(job)
    return row


def _make_mesh(run: Run, scene: Prepared, job: Path, cache: Path | None) -> tuple[int, str, dict[str, Any]]:
    """Run the engine or an external tool in an empty folder; returns its exit code, last line and cost."""
    shutil.rmtree(job, ignore_errors=True)
    job.mkdir(parents=True)
    if run.command:
        return _timed(_external(run, _source(scene.folder, run.poses, job), job, job / "mesh.ply"), job)
    entry, restored = None, Stages()
    if cache is not None:
        entry = cache_entry(cache, scene.folder, run.masks, run.poses, run.seed, run.options)
    source = _source(scene.folder, run.poses, job if entry is None else entry.parent)
    job.rmdir()  # the engine makes it
    if entry is not None:
        restored = restore_stages(entry, job)
    code, tail, cost = _timed(_engine(run, source, scene.folder, job), job)
    if code == 0 and entry is not None:
        _add_saved(cost, saved_cost(restored, job))
        store_stages(job, entry)
    return code, tail, cost


def _mesh_scores(run: Run, scene: Prepared, mesh: Path, samples: int) -> dict[str, Any]:
    """Move a mesh into the true frame and compare it with the true one; as columns of a row."""
    whole_picture = bool(run.command) or str(run.options.get("use_masks", True)).lower() in ("false", "0", "off", "no")
    thresholds = sorted({*THRESHOLDS, round(scene.ground_pixel, 4), round(2 * scene.ground_pixel, 4)})
    crop = scene.crop if whole_picture else above_ground(scene.crop)
    _to_true_frame(mesh, scene)
    truth = read_surface(scene.truth)
    found = compare_surfaces(read_surface(mesh), truth, ComparisonOptions(samples, scene.cameras, crop))
    scores = found.scores(thresholds, read_materials(scene.truth, len(truth.faces)))
    row: dict[str, Any] = {}
    if scene.steelwork is not None:
        row["without_steelwork"] = found.without(scene.steelwork).scores(thresholds).as_dict()
    row["whole_picture"] = whole_picture
    row["in_box"] = found.inside(scene.crop).scores(thresholds).as_dict()
    return {**row, "geometry": scores.as_dict(), "ground_pixel": scene.ground_pixel, "faces": scores.hygiene.faces}


def _add_saved(row: dict[str, Any], cost: dict[str, float]) -> None:
    """Add the cost of stages from the cache, so that runs compare as if each had begun from nothing."""
    row["seconds"] += cost["seconds"]
    row["cpu_seconds"] += cost["cpu_seconds"]
    row["peak_memory"] = max(row["peak_memory"], cost["peak_memory"])


def _to_true_frame(path: Path, scene: Prepared) -> None:
    """Rewrite a mesh that was made in a scaled or moved frame."""
    if scene.scale == 1.0 and not any(scene.offset):
        return
    mesh = read_ply(path)
    write_ply(replace(mesh, vertices=(mesh.vertices - np.array(scene.offset)) / scene.scale), path)


def above_ground(crop: Points) -> Points:
    """Return the crop without its sides and top."""
    low = np.array([-np.inf, -np.inf, crop[0, 2]])
    return np.stack([low, np.full(3, np.inf)])


def job_figures(job: Path) -> dict[str, Any]:
    """Return what the job itself recorded: seconds and peak memory per stage, number of Gaussians, warnings."""
    stages = stages_of(job)
    figures: dict[str, Any] = {"stages": {name: entry["seconds"] for name, entry in stages.items()}}
    merged = {k: v for entry in stages.values() for k, v in entry["figures"].items()}
    for name in ("gaussians", "iterations"):
        figures[name] = merged.get(name)
    figures["figures"] = merged
    figures["warnings"] = [text for entry in stages.values() for text in entry["warnings"]]
    return figures


def _source(folder: Path, poses: str, job: Path) -> Path:
    """A view of the scene with the wanted cameras alone, where the engine looks for them first."""
    view = job.with_name(f"{job.name}-{poses}-poses")
    shutil.rmtree(view, ignore_errors=True)
    (view / "sparse").mkdir(parents=True)
    for entry in folder.iterdir():
        if not entry.name.startswith("sparse"):
            (view / entry.name).symlink_to(entry, target_is_directory=entry.is_dir())
    model = folder / ("sparse/0" if poses == "sfm" else "sparse_truth")
    (view / "sparse/0").symlink_to(model, target_is_directory=True)
    return view


def _engine(run: Run, source: Path, scene: Path, job: Path) -> list[str]:
    command = [sys.executable, "-m", "mgf_engine", "reconstruct", str(source), "--out", str(job), "--progress", "json"]
    command.append("--resume")
    if run.masks == "true":
        command += ["--masks", str(scene / "masks")]
    elif run.masks == "true elements":
        command += ["--masks", str(write_elements(scene, source.with_name(source.name + "-elements")))]
    else:
        command += ["--prompts", str(scene / "prompts.json")]
    for name, value in {**run.options, "seed": run.seed}.items():
        command += ["--set", f"{name}={value}"]
    return command


def _external(run: Run, source: Path, job: Path, mesh: Path) -> list[str]:
    names = {"images": source / "images", "scene": source, "work": job, "mesh": mesh}
    return [part.format(**names) for part in shlex.split(run.command)]


def _timed(command: list[str], job: Path) -> tuple[int, str, dict[str, float]]:
    """Run a command; exit code, its last sentence, and wall seconds, CPU seconds and peak memory in bytes."""
    output = job.with_name(job.name + ".out")
    output.parent.mkdir(parents=True, exist_ok=True)
    started = time.perf_counter()
    with output.open("w", encoding="utf-8") as stream:
        process = subprocess.Popen(command, stdout=stream, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL)
        try:
            _, status, used = os.wait4(process.pid, 0)
        except BaseException:
            process.kill()
            raise
    seconds = time.perf_counter() - started
    process.returncode = code = os.waitstatus_to_exitcode(status)
    lines = [line for line in output.read_text(encoding="utf-8", errors="replace").splitlines() if line.strip()]
    usage = {"seconds": seconds, "cpu_seconds": used.ru_utime + used.ru_stime, "peak_memory": used.ru_maxrss * 1024.0}
    return code, _sentence(lines[-1]) if lines else "", usage


def _sentence(line: str) -> str:
    try:
        message = json.loads(line)
        return str(message.get("text", line))
    except (ValueError, AttributeError):
        return line


def _slim(job: Path) -> None:
    """Keep what people look at: the mesh, the report, the log and the sheet of masks."""
    for name in ("checkpoints", "scene", "field.ply", "runs"):
        path = job / name
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)
