# SPDX-License-Identifier: GPL-3.0-or-later
"""How exactly the mesh, rendered through Blender's cameras, overlays the photos.

    .venv-bpy/bin/python tools/measure_overlay.py --scene SCENE --job JOB [--masks FOLDER] [--photos 8] [--out FOLDER]

Imports scene and job through the add-on, renders the mesh's silhouette through cameras spread over the list, and
measures from each outline pixel of the photo's mask to the nearest outline pixel of the render, and back. A mask is a
PNG of the photo's name: 0 and 255 for background and building, or labels with 255 for what hides the building; without
``--masks`` they are the labels of the job itself. Outlines at the border of the picture and beside what hides the
building do not count. States median and 90th percentile of both ways, in pixels of the render, and the overlap
(intersection over union); ``--out`` keeps the photos with the mesh's outline in red and the mask's in green.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from pathlib import Path

import bpy
import numpy as np
from mathutils.kdtree import KDTree

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from mgf_blender.results.load import import_result
from mgf_blender.scene_import.cameras import PHOTO_KEY, fit_render
from mgf_blender.scene_import.imported_scene import ImportedScene
from mgf_blender.scene_import.load import import_scene


def main() -> int:
    """Measure and print; returns the exit code."""
    args = _parser().parse_args()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    imported = import_scene(scene, args.scene).imported
    imported = import_result(scene, args.job, imported).imported
    own = args.masks is None
    masks = {path.stem: path for path in (args.job / "masks" / "labels" if own else args.masks).rglob("*.png")}
    cameras = [c for c in imported.objects("Cameras") if Path(c[PHOTO_KEY]).stem in masks]
    if not cameras or not imported.objects("Mesh"):
        print("Error: No mask belongs to a photo of the scene, or the job has no mesh.", file=sys.stderr)
        return 2
    there, back, shares = [], [], []
    for camera in cameras[:: max(1, len(cameras) // args.photos)][: args.photos]:
        render = silhouette(scene, imported, camera)
        mask, hidden = (_resized(m, render.shape) for m in read_mask(masks[Path(camera[PHOTO_KEY]).stem], own))
        seen = ~hidden
        if not (mask.any() and (render & seen).any()):
            print(f"{camera[PHOTO_KEY]}: left out, the building is not in it")
            continue
        there.append(outline_distances(mask, render, hidden))
        back.append(outline_distances(render, mask, hidden))
        shares.append((mask & render & seen).sum() / max(1, ((mask | render) & seen).sum()))
        print(f"{camera[PHOTO_KEY]}: {_told(there[-1:], back[-1:])}, overlap {shares[-1]:.1%}", flush=True)
        if args.out is not None:
            _draw(camera, mask, render, args.out)
    if not shares:
        print("Error: The building is in none of the photos.", file=sys.stderr)
        return 2
    size = " x ".join(map(str, render.shape[::-1]))
    print(f"all {len(shares)} photos, renders of {size}: {_told(there, back)}, overlap {np.mean(shares):.1%}")
    return 0


def _told(there: list[np.ndarray], back: list[np.ndarray]) -> str:
    """Median and 90th percentile of both ways; a way without any outline that counts has none."""
    words = []
    for name, found in (("mask to mesh", np.concatenate(there)), ("mesh to mask", np.concatenate(back))):
        figures = (
            f"median {np.median(found):.2f} px, 90 % within {np.percentile(found, 90):.2f} px" if len(found) else "-"
        )
        words.append(f"{name} {figures}")
    return ", ".join(words)


def silhouette(scene: bpy.types.Scene, imported: ImportedScene, camera: bpy.types.Object) -> np.ndarray:
    """Where the mesh covers the picture of a camera, bool [H, W], first row at the top."""
    shown = {o: o.hide_render for o in scene.objects}
    scene.camera = camera
    fit_render(scene, camera)
    for obj in scene.objects:
        obj.hide_render = obj not in imported.objects("Mesh")
    render = scene.render
    render.engine, render.film_transparent, render.use_persistent_data = "CYCLES", True, True
    scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.max_bounces = 1, False, 0
    scene.cycles.pixel_filter_type, render.image_settings.file_format = "BOX", "PNG"
    scene.cycles.filter_width = 0.01  # one ray through the middle of each pixel
    render.image_settings.color_mode = "RGBA"
    with tempfile.TemporaryDirectory() as folder:
        render.filepath = str(Path(folder) / "alpha.png")
        bpy.ops.render.render(write_still=True)
        covered = read_pixels(Path(render.filepath))[..., 3] > 0.5
    for obj, hidden in shown.items():
        obj.hide_render = hidden
    return covered


def outline(mask: np.ndarray) -> np.ndarray:
    """Pixels of a mask that touch one outside it, not at the border of the picture; [N, 2] row, column."""
    inner = mask.copy()
    inner[1:-1, 1:-1] = (
        mask[1:-1, 1:-1] & mask[:-2, 1:-1] & mask[2:, 1:-1] & mask[1:-1, :-2] & mask[1:-1, 2:]
    )  # fmt: skip
    found = np.argwhere(mask & ~inner)
    high, wide = mask.shape
    margin = 2
    kept = (found > margin - 1).all(axis=1) & (found[:, 0] < high - margin) & (found[:, 1] < wide - margin)
    return found[kept]


def outline_distances(mask: np.ndarray, render: np.ndarray, hidden: np.ndarray | None = None) -> np.ndarray:
    """From each outline pixel of ``mask`` to the nearest one of ``render``, in pixels [N]; infinite if it has none.

    Args:
        hidden: bool [H, W], where something stands before the building; outlines within 2 pixels of it do not count.
    """
    aims, places = outline(render), outline(mask)
    if hidden is not None:
        near = hidden.copy()
        for _ in range(2):
            near[1:] |= near[:-1].copy()
            near[:-1] |= near[1:].copy()
            near[:, 1:] |= near[:, :-1].copy()
            near[:, :-1] |= near[:, 1:].copy()
        places = places[~near[places[:, 0], places[:, 1]]]
    imported = KDTree(len(aims))
    for i, (row, column) in enumerate(aims.tolist()):
        imported.insert((row, column, 0.0), i)
    imported.balance()
    if not len(aims):
        return np.full(len(places), np.inf)
    return np.array([imported.find((row, column, 0.0))[2] for row, column in places.tolist()])


def read_mask(path: Path, labels_only: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Building, and what hides it, bool [H, W] each; ``labels_only`` takes 255 for what hides it in any case."""
    labels = np.rint(read_pixels(path)[..., 0] * 255).astype(np.uint8)
    if not labels_only and set(np.unique(labels).tolist()) <= {0, 255}:
        return labels == 255, np.zeros(labels.shape, bool)
    return (labels > 0) & (labels < 255), labels == 255


def read_pixels(path: Path) -> np.ndarray:
    """float32 [H, W, 4], first row at the top."""
    image = bpy.data.images.load(str(path))
    image.colorspace_settings.name = "Non-Color"
    width, height = image.size
    flat = np.empty(width * height * image.channels, np.float32)
    image.pixels.foreach_get(flat)
    bpy.data.images.remove(image)
    return flat.reshape(height, width, -1)[::-1]


def _resized(mask: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    rows = ((np.arange(shape[0]) + 0.5) * mask.shape[0] / shape[0]).astype(int)
    columns = ((np.arange(shape[1]) + 0.5) * mask.shape[1] / shape[1]).astype(int)
    return mask[rows][:, columns]


def _draw(camera: bpy.types.Object, mask: np.ndarray, render: np.ndarray, folder: Path) -> None:
    photo = next(s.image for s in camera.data.background_images if s.image is not None and s.image.size[0])
    width, height = photo.size
    flat = np.empty(width * height * photo.channels, np.float32)
    photo.pixels.foreach_get(flat)
    picture = np.ones((height, width, 4), np.float32)
    picture[..., :3] = flat.reshape(height, width, -1)[::-1, :, :3]
    for places, color in ((outline(mask), (0.1, 1.0, 0.2)), (outline(render), (1.0, 0.1, 0.1))):
        scaled = (places * (height / mask.shape[0], width / mask.shape[1])).astype(int)
        picture[scaled[:, 0], scaled[:, 1], :3] = color
    image = bpy.data.images.new("overlay", width, height)
    image.pixels.foreach_set(np.ascontiguousarray(picture[::-1]).ravel())
    folder.mkdir(parents=True, exist_ok=True)
    image.filepath_raw, image.file_format = str(folder / f"{Path(camera[PHOTO_KEY]).stem}.png"), "PNG"
    image.save()
    bpy.data.images.remove(image)


def _parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(description="Measure how exactly the mesh overlays the photos.")
    p.add_argument("--scene", type=Path, required=True, help="COLMAP scene with its photos")
    p.add_argument("--job", type=Path, required=True, help="finished job folder")
    p.add_argument("--masks", type=Path, help="folder of masks, one PNG per photo (default: the job's own labels)")
    p.add_argument("--photos", type=int, default=8, help="how many photos")
    p.add_argument("--out", type=Path, help="folder for pictures of the outlines")
    return p


if __name__ == "__main__":
    code = main()
    sys.stdout.flush()
    os._exit(code)  # some versions of the bpy module crash or hang while the interpreter ends
