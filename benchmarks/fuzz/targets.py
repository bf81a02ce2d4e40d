# SPDX-License-Identifier: GPL-3.0-or-later
"""The readers to fuzz: for each a folder of sound files, which of them are damaged, and the call that reads them.

A reader may return or raise :class:`BadInput` with one clear sentence. What it returns is handed on to what a job does
next (:mod:`benchmarks.fuzz.uses`), which may only raise BadInput, too. Anything else is a finding.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.fuzz.uses import all_inside, use_field, use_mesh, use_scene
from benchmarks.synthetic.colmap_scene import reconstruction, write_model, write_scene
from mgf_engine.errors import BadInput
from mgf_engine.model.gaussians import Gaussians
from mgf_engine.model.masks import MaskSet
from mgf_engine.model.scene import Scene, Similarity, View


@dataclass(frozen=True)
class Target:
    """One reader.

    Attributes:
        prepare: writes sound files into an empty folder.
        files: name in the folder -> kind of damage, see :mod:`benchmarks.fuzz.mutate`.
        read: reads the folder.
        weight: share of the cases, relative to the other targets; slow readers get fewer.
    """

    prepare: Callable[[Path], None]
    files: dict[str, str]
    read: Callable[[Path], Any]
    weight: float = 1.0


def small_scene(folder: Path) -> Scene:
    """Two views of 16 x 12 pixels and three points, in memory."""
    views = tuple(
        View(f"a/p{i}.jpg", f"images/{i:04d}_p{i}.png", 16, 12, 15.0, 15.0, 8.0, 6.0, np.eye(3),
             np.array([0, 0, 5.0 + i]), 32, 24)
        for i in range(2)
    )  # fmt: skip
    return Scene(
        views, np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0.2]], float), np.zeros((3, 3), np.uint8),
        np.zeros(3, np.float32), np.array([0, 2, 4, 6]), np.array([0, 1, 0, 1, 0, 1], np.int32),
        np.full((6, 2), 5, np.float32), Similarity(1.0, np.eye(3), np.zeros(3)), (0,), (1,), folder,
    )  # fmt: skip


# ---- COLMAP --------------------------------------------------------------------------------------------------------

_PARTS = ("cameras", "images", "points3D", "rigs", "frames")


def _colmap(kind: str) -> Target:
    def prepare(folder: Path) -> None:
        write_model(reconstruction("OPENCV", rigs=1, sensors=2, frames=2, points=6), folder, kind)

    def read(folder: Path) -> Any:
        from mgf_engine.scene.cameras import plan_camera
        from mgf_engine.scene.colmap import read_model

        model = read_model(folder)
        if len(model.cameras) < 4 and all(max(c.width, c.height) < 500 for c in model.cameras.values()):
            for camera in model.cameras.values():
                plan_camera(camera, (camera.width, camera.height), 64)
        return model

    return Target(prepare, dict.fromkeys((p + kind for p in _PARTS), "binary" if kind == ".bin" else "text"), read)


def _whole_scene() -> Target:
    """A COLMAP scene through the whole scene stage: names that lead out of the folder, photos that are none."""

    def prepare(folder: Path) -> None:
        write_scene(reconstruction(frames=3, points=12), folder / "source", ".txt")

    def read(folder: Path) -> Any:
        from benchmarks.synthetic.colmap_scene import load

        job = folder / "job"
        try:
            use_scene(load(folder / "source", job, resolution=64), job)
        finally:
            check_contained(folder, {"source", "job"})

    photo = "source/images/camera000001_frame000000.png"
    names = {f"source/sparse/0/{p}.txt": "text" for p in ("cameras", "images", "points3D")}
    return Target(prepare, {**names, photo: "png"}, read, weight=0.02)


def check_contained(folder: Path, allowed: set[str]) -> None:
    """Raise when a reader wrote beside the folders it was given."""
    extra = {p.name for p in folder.iterdir()} - allowed
    if extra:
        raise AssertionError(f"written outside the job: {sorted(extra)}")


# ---- meshes --------------------------------------------------------------------------------------------------------

_VERTICES = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
_FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]], np.int32)
_ASCII_PLY = """ply
format ascii 1.0
comment a tetrahedron
element vertex 4
property float x
property float y
property float z
property uchar red
property uchar green
property uchar blue
element face 4
property list uchar int vertex_indices
end_header
0 0 0 255 0 0
1 0 0 255 0 0
0 1 0 255 0 0
0 0 1 255 0 0
3 0 2 1
3 0 1 3
3 1 2 3
3 0 3 2
"""


def _write_photos(scene: Scene) -> None:
    (scene.folder / "images").mkdir()
    for view in scene.views:
        cv2.imwrite(str(scene.folder / view.file), np.full((12, 16, 3), 90, np.uint8))


def _prepare_ply(folder: Path) -> None:
    from mgf_engine.geometry.mesh_files import write_ply
    from mgf_engine.model.mesh import Mesh

    _write_photos(small_scene(folder))
    write_ply(Mesh(_VERTICES, _FACES, np.full((4, 3), 7, np.uint8)), folder / "binary.ply")
    (folder / "ascii.ply").write_text(_ASCII_PLY)
    (folder / "plain.ply").write_text(re.sub(r"property uchar .*\n| (255|0) 0 0$", "", _ASCII_PLY, flags=re.MULTILINE))


def _read_ply(folder: Path) -> Any:
    from mgf_engine.evaluation.geometry import ComparisonOptions, compare_surfaces
    from mgf_engine.evaluation.surfaces import read_surface
    from mgf_engine.geometry.mesh_files import read_ply

    scene = small_scene(folder)
    truth = read_surface(_sound_surface(folder))

    def use(path: Path) -> None:
        use_mesh(read_ply(path), scene, all_inside(scene), folder)

    def compare(path: Path) -> None:
        compare_surfaces(read_surface(path), truth, ComparisonOptions(100))

    for name in ("binary.ply", "ascii.ply", "plain.ply"):
        _ignore_bad_input(use, folder / name)
        _ignore_bad_input(compare, folder / name)


def _sound_surface(folder: Path) -> Path:
    from mgf_engine.geometry.mesh_files import write_ply
    from mgf_engine.model.mesh import Mesh

    if not (folder / "truth.ply").exists():
        write_ply(Mesh(_VERTICES, _FACES, np.full((4, 3), 7, np.uint8)), folder / "truth.ply")
    return folder / "truth.ply"


def _ignore_bad_input(reader: Callable[[Path], Any], path: Path) -> None:
    try:
        reader(path)
    except BadInput as error:
        check_sentence(error)


def check_sentence(error: BadInput) -> None:
    """One line that ends like a sentence."""
    text = str(error)
    if not text or "\n" in text or not text.endswith("."):
        raise AssertionError(f"not one sentence: {text!r}")


# ---- prompts, options, masks ---------------------------------------------------------------------------------------


def _prepare_prompts(folder: Path) -> None:
    data = {"a/p0.jpg": {"positive": [[3, 4], [8.5, 6]], "negative": [[1, 1]], "parts": {"window": [[4, 4]]}},
            "p1.jpg": {"positive": [[5, 5]]}}  # fmt: skip
    (folder / "prompts.json").write_text(json.dumps(data))


def _read_prompts(folder: Path) -> Any:
    from mgf_engine.masks.prompts import read_clicks_of, read_prompts

    scene = small_scene(folder)
    _ignore_bad_input(lambda p: read_clicks_of(p, scene.views[0]), folder / "prompts.json")
    return read_prompts(folder / "prompts.json", scene)


def _prepare_config(folder: Path) -> None:
    data = {"preset": "draft", "iterations": 20, "use_masks": "true", "opacity_level": 0.5,
            "segmenter": "random_walker", "weights": "x", "crop_box": "0 0 0 1 1 1", "threads": 2}  # fmt: skip
    (folder / "config.json").write_text(json.dumps(data))
    (folder / "box.txt").write_text("[1 0 0 0, 0 2 0 0, 0 0 1 5, 0 0 0 1]\n")


def _read_config(folder: Path) -> Any:
    from mgf_engine.config import make_config
    from mgf_engine.option_input import read_config
    from mgf_engine.scene.crop import parse_crop_box, read_crop_box

    _ignore_bad_input(lambda p: read_crop_box(str(p)), folder / "box.txt")
    config = make_config(read_config(folder / "config.json"))
    parse_crop_box(config.crop_box)
    return config


def _prepare_masks(folder: Path) -> None:
    mask = np.zeros((24, 32), np.uint8)
    mask[5:15, 8:20] = 255
    _write_photos(small_scene(folder))
    cv2.imwrite(str(folder / "p0.png"), mask)
    cv2.imwrite(str(folder / "p1.png"), np.dstack([mask, mask, mask, mask]))


def _read_masks(folder: Path) -> Any:
    from mgf_engine.masks.user_masks import read_supplied

    scene = small_scene(folder)
    given = read_supplied(folder, scene)
    nothing = np.zeros((12, 16), np.uint8)
    _use_masks(replace(all_inside(scene), labels=tuple(nothing if m is None else m for m in given)), scene, folder)


def _use_masks(masks: MaskSet, scene: Scene, folder: Path) -> None:
    """Train a step on the masks, and paint a mesh from what they show."""
    from mgf_engine.model.mesh import Mesh

    use_field(_field(), scene, masks, folder)
    mesh = Mesh(_VERTICES, _FACES, np.full((4, 3), 7, np.uint8))
    use_mesh(mesh, scene, masks, folder)


def _field() -> Gaussians:
    import torch

    from mgf_engine.field.initialise import initial_field

    points = np.random.default_rng(0).normal(size=(6, 3))
    torch.manual_seed(0)
    return initial_field(points, np.full((6, 3), 90, np.uint8), np.tile([[0.0, 0, -5]], (6, 1)))


def _prepare_photos(folder: Path) -> None:
    rng = np.random.default_rng(0)
    photo = cv2.resize(rng.integers(0, 255, (6, 8, 3)).astype(np.uint8), (32, 24))
    for name in ("a.jpg", "a.png", "a.tif", "a.webp", "a.bmp"):
        cv2.imwrite(str(folder / name), photo)


def _read_photos(folder: Path) -> Any:
    from mgf_engine.images import read_info, read_rgb

    for path in sorted(folder.iterdir()):
        try:
            info = read_info(path)
            if info.width * info.height < 1 << 20:
                read_rgb(path)
        except BadInput as error:
            check_sentence(error)


# ---- the job folder ------------------------------------------------------------------------------------------------


def _prepare_job(folder: Path) -> None:
    from mgf_engine.job import Job

    (folder / "photos").mkdir()
    with Job.start(folder / "job", folder / "photos", given={"seed": 3}) as job:
        for stage in ("scene", "masks"):
            job.finish(stage, job.begin(stage), 1.0, 2.0, 5, {"photos": 3}, ["a warning"])


def _read_job(folder: Path) -> Any:
    from mgf_engine.job import Job

    with Job.start(folder / "job", folder / "photos", resume=True) as job:
        return [job.done(stage) for stage in ("scene", "masks", "deliver")]


def _prepare_scene(folder: Path) -> None:
    from mgf_engine.scene.store import save_scene

    scene = small_scene(folder)
    _write_photos(scene)
    save_scene(scene)


def _read_scene(folder: Path) -> Any:
    from mgf_engine.scene.store import read_scene

    scene = read_scene(folder)
    for index in range(len(scene.views)):
        if folder.resolve() not in (folder / scene.views[index].file).resolve().parents:
            raise AssertionError(f"leads out of the folder: {scene.views[index].file}")
    use_scene(scene, folder)
    return scene


def _prepare_saved_masks(folder: Path) -> None:
    from mgf_engine.masks.store import save_masks
    from mgf_engine.model.masks import MaskSet

    scene = small_scene(folder)
    _write_photos(scene)
    labels = tuple(np.ones((12, 16), np.uint8) for _ in scene.views)
    clicks = (np.array([[3.5, 4.25], [6, 7]], np.float32), np.zeros((0, 2), np.float32))
    masks = MaskSet(labels, np.ones(2, bool), np.ones(2, np.float32), np.ones(3, bool), clicks)
    save_masks(masks, scene, folder, ["", ""])


def _read_saved_masks(folder: Path) -> Any:
    from mgf_engine.masks.store import read_masks
    from mgf_engine.mesh.parts import named_parts

    scene = small_scene(folder)
    named_parts(folder, scene)
    masks = read_masks(folder, scene)
    _use_masks(masks, scene, folder)
    return masks


def _prepare_checkpoint(folder: Path) -> None:
    from mgf_engine.field.checkpoint import Checkpoint, write_checkpoint, write_field
    from mgf_engine.field.optimiser import Optimiser
    from mgf_engine.raster.api import RenderStats

    field = _field()
    _write_photos(small_scene(folder))
    write_field(field, folder / "field.npz")
    figures = {"start_gaussians": 6, "curve": [], "seconds": {"render": 1.0}}
    write_checkpoint(Checkpoint(Optimiser(field), RenderStats.zeros(6), 40, figures), folder / "training.npz")


def _read_checkpoint(folder: Path) -> Any:
    from mgf_engine.field.checkpoint import read_checkpoint, read_field

    scene = small_scene(folder)
    checkpoint = read_checkpoint(folder / "training.npz")
    if checkpoint is not None:
        dict(checkpoint.figures["seconds"])
        use_field(checkpoint.optimiser.field, scene, all_inside(scene), folder)
    field = read_field(folder / "field.npz")
    use_field(field, scene, all_inside(scene), folder)
    return field


TARGETS: dict[str, Target] = {
    "colmap-bin": _colmap(".bin"),
    "colmap-txt": _colmap(".txt"),
    "scene-stage": _whole_scene(),
    "ply": Target(_prepare_ply, dict.fromkeys(("binary.ply", "ascii.ply", "plain.ply"), "text"), _read_ply, 0.3),
    "prompts": Target(_prepare_prompts, {"prompts.json": "json"}, _read_prompts, 2.0),
    "config": Target(_prepare_config, {"config.json": "json", "box.txt": "text"}, _read_config, 2.0),
    "masks": Target(_prepare_masks, {"p0.png": "png", "p1.png": "png"}, _read_masks, 1.0),
    "photos": Target(_prepare_photos, {f"a.{e}": "binary" for e in ("jpg", "tif", "webp", "bmp")} | {"a.png": "png"},
                     _read_photos, 0.5),
    "job": Target(_prepare_job, {"job/job.json": "json"}, _read_job, 0.5),
    "scene": Target(_prepare_scene, {"scene.npz": "npz", "images/0000_p0.png": "png"}, _read_scene, 0.5),
    "saved-masks": Target(
        _prepare_saved_masks,
        {"scores.json": "json", "parts.json": "json", "points.bin": "binary", "labels/p0.png": "png"},
        _read_saved_masks, 1.0,
    ),
    "checkpoint": Target(_prepare_checkpoint, {"training.npz": "npz", "field.npz": "npz"}, _read_checkpoint, 0.3),
}  # fmt: skip
