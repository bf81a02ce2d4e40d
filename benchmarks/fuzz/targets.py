# SPDX-License-Identifier: GPL-3.0-or-later
"""The readers to fuzz: for each a folder of sound files, which of them are damaged, and the call that reads them.

A reader may return or raise :class:`BadInput` with one clear sentence. What it returns is handed on to what a job does
next (:mod:`benchmarks.fuzz.uses`), which may only raise BadInput, too. Anything else is a finding.
"""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.fuzz.job_files import JOB_TARGETS
from benchmarks.fuzz.target import (
    FACES,
    VERTICES,
    Target,
    check_contained,
    check_sentence,
    ignore_bad_input,
    small_scene,
    write_photos,
)
from benchmarks.fuzz.uses import all_inside, use_masks, use_mesh, use_scene
from benchmarks.synthetic.colmap_scene import reconstruction, write_model, write_scene
from mgf_engine.errors import BadInput

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


# ---- meshes --------------------------------------------------------------------------------------------------------

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


def _prepare_ply(folder: Path) -> None:
    from mgf_engine.geometry.mesh_files import write_ply
    from mgf_engine.model.mesh import Mesh

    write_photos(small_scene(folder))
    write_ply(Mesh(VERTICES, FACES, np.full((4, 3), 7, np.uint8)), folder / "binary.ply")
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
        ignore_bad_input(use, folder / name)
        ignore_bad_input(compare, folder / name)


def _sound_surface(folder: Path) -> Path:
    from mgf_engine.geometry.mesh_files import write_ply
    from mgf_engine.model.mesh import Mesh

    if not (folder / "truth.ply").exists():
        write_ply(Mesh(VERTICES, FACES, np.full((4, 3), 7, np.uint8)), folder / "truth.ply")
    return folder / "truth.ply"


# ---- prompts, options, masks ---------------------------------------------------------------------------------------


def _prepare_prompts(folder: Path) -> None:
    data = {"a/p0.jpg": {"positive": [[3, 4], [8.5, 6]], "negative": [[1, 1]], "parts": {"window": [[4, 4]]}},
            "p1.jpg": {"positive": [[5, 5]]}}  # fmt: skip
    (folder / "prompts.json").write_text(json.dumps(data))


def _read_prompts(folder: Path) -> Any:
    from mgf_engine.masks.prompts import read_clicks_of, read_prompts

    scene = small_scene(folder)
    ignore_bad_input(lambda p: read_clicks_of(p, scene.views[0]), folder / "prompts.json")
    return read_prompts(folder / "prompts.json", scene)


def _prepare_config(folder: Path) -> None:
    data = {"preset": "draft", "iterations": 20, "use_masks": "true", "opacity_level": 0.5,
            "segmenter": "random_walker", "weights": "x", "crop_box": "0 0 0 1 1 1", "threads": 2}  # fmt: skip
    (folder / "config.json").write_text(json.dumps(data))
    (folder / "box.txt").write_text("[1 0 0 0, 0 2 0 0, 0 0 1 5, 0 0 0 1]\n")


def _read_config(folder: Path) -> Any:
    from mgf_engine.options.config import make_config
    from mgf_engine.options.user_input import read_config
    from mgf_engine.scene.crop import parse_crop_box, read_crop_box

    ignore_bad_input(lambda p: read_crop_box(str(p)), folder / "box.txt")
    config = make_config(read_config(folder / "config.json"))
    parse_crop_box(config.crop_box)
    return config


def _prepare_masks(folder: Path) -> None:
    mask = np.zeros((24, 32), np.uint8)
    mask[5:15, 8:20] = 255
    write_photos(small_scene(folder))
    cv2.imwrite(str(folder / "p0.png"), mask)
    cv2.imwrite(str(folder / "p1.png"), np.dstack([mask, mask, mask, mask]))


def _read_masks(folder: Path) -> Any:
    from mgf_engine.masks.user_masks import read_user_masks

    scene = small_scene(folder)
    given = read_user_masks(folder, scene)
    nothing = np.zeros((12, 16), np.uint8)
    use_masks(replace(all_inside(scene), labels=tuple(nothing if m is None else m for m in given)), scene, folder)


def _prepare_photos(folder: Path) -> None:
    rng = np.random.default_rng(0)
    photo = cv2.resize(rng.integers(0, 255, (6, 8, 3)).astype(np.uint8), (32, 24))
    for name in ("a.jpg", "a.png", "a.tif", "a.webp", "a.bmp"):
        cv2.imwrite(str(folder / name), photo)


def _read_photos(folder: Path) -> Any:
    from mgf_engine.files.images import read_info, read_rgb

    for path in sorted(folder.iterdir()):
        try:
            info = read_info(path)
            if info.width * info.height < 1 << 20:
                read_rgb(path)
        except BadInput as error:
            check_sentence(error)


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
    **JOB_TARGETS,
}  # fmt: skip
