# SPDX-License-Identifier: GPL-3.0-or-later
"""Memory of the texture stage with many large photos: ``python -m benchmarks.stability_texture``.

The painted house with a fine mesh, in 500 photos of 24 megapixels (6000 x 4000) with flat content, all of them
hard links to one file, and each with a mask of its own that shows a stripe of the house, so that nearly every photo has
to be opened and paints something. Prints the number of photos, those that painted, CPU seconds, and the memory before
and at its peak. ``--width 3000`` gives photos of 6 megapixels and takes less than half the time.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
from dataclasses import replace
from pathlib import Path
from unittest import mock

import cv2
import numpy as np
import psutil
import trimesh

from benchmarks.synthetic.house import house_mesh, ring_view
from mgf_engine.model.masks import BUILDING, MaskSet
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.scene import Scene, Similarity, View
from mgf_engine.native.library import set_threads
from mgf_engine.system.machine import cpu_seconds
from mgf_engine.system.memory import MemoryMonitor
from mgf_engine.texture import painting
from mgf_engine.texture.texture_pipeline import make_texture

WIDTH, WORKING = 6000, (750, 500)
STRIPES = 24


def many_photos(folder: Path, count: int, width: int = WIDTH) -> Scene:
    """A scene of so many photos, 3:2, around the house; normalised frame and scene frame are one."""
    (folder / "images").mkdir()
    photo, small = folder / "photo.jpg", folder / "photo.png"
    cv2.imwrite(str(photo), np.full((width * 2 // 3, width, 3), (70, 90, 160), np.uint8))
    cv2.imwrite(str(small), np.full((WORKING[1], WORKING[0], 3), (70, 90, 160), np.uint8))
    views = [_view(folder, k, count, width) for k in range(count)]
    for view in views:
        os.link(photo, view.photo)
        os.link(small, folder / view.file)
    nothing = np.zeros(0, np.int32)
    return Scene(
        views=tuple(views), points=np.zeros((0, 3)), colors=np.zeros((0, 3), np.uint8), errors=np.zeros(0, np.float32),
        track_start=np.zeros(1, np.int64), track_view=nothing, track_uv=np.zeros((0, 2), np.float32),
        to_normalised=Similarity(1.0, np.eye(3), np.zeros(3)), roots=(), held_out=(), folder=folder,
    )  # fmt: skip


def _view(folder: Path, index: int, count: int, original_width: int) -> View:
    view = ring_view(index, count)
    factor = WORKING[0] / view.width
    return replace(
        view, file=f"images/{index:04d}.png", photo=str(folder / f"{index:04d}.jpg"), width=WORKING[0],
        height=WORKING[1], fx=view.fx * factor, fy=view.fy * factor, cx=WORKING[0] / 2, cy=WORKING[1] / 2,
        original_width=original_width, original_height=original_width * 2 // 3,
    )  # fmt: skip


def striped_masks(count: int) -> MaskSet:
    """Of each photo one upright stripe."""
    labels = np.zeros((count, WORKING[1], WORKING[0]), np.uint8)
    edges = np.linspace(0.2 * WORKING[0], 0.8 * WORKING[0], STRIPES + 1).astype(int)
    for k in range(count):
        stripe = k * 7 % STRIPES
        labels[k, :, edges[stripe] : edges[stripe + 1]] = BUILDING
    return MaskSet(tuple(labels), np.ones(count, bool), np.ones(count, np.float32), np.zeros(0, bool))


def fine_house(rounds: int) -> Mesh:
    """The house with every face cut into four, again and again; 14 faces become 14 * 4^rounds."""
    house = house_mesh()
    mesh = trimesh.Trimesh(house.vertices, house.faces, process=False)
    for _ in range(rounds):
        mesh = mesh.subdivide()
    return Mesh(
        np.asarray(mesh.vertices), np.asarray(mesh.faces, np.int32), np.full(mesh.vertices.shape, 120, np.uint8)
    )


def measure(photos: int, width: int, rounds: int, side: int, threads: int) -> dict[str, float]:
    """Paint the house from so many photos of so many columns."""
    set_threads(threads)
    with tempfile.TemporaryDirectory() as name:
        scene, masks, mesh = many_photos(Path(name), photos, width), striped_masks(photos), fine_house(rounds)
        before, memory_before = cpu_seconds(), psutil.Process().memory_info().rss
        opening = mock.patch.object(painting, "original_photo", wraps=painting.original_photo)
        with opening as opened, MemoryMonitor() as memory:
            texture = make_texture(mesh, scene, masks, side, print)
    assert texture.image.shape[2] == 3 and texture.image.std() > 0
    return {
        "photos": photos, "painted": opened.call_count, "faces": len(mesh.faces), "side": texture.image.shape[1],
        "cpu_seconds": round(cpu_seconds() - before, 1), "before": memory_before, "peak": memory.peak,
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.stability_texture", description=__doc__)
    parser.add_argument("--photos", type=int, default=500)
    parser.add_argument("--width", type=int, default=WIDTH, help="of each photo, pixels; its height is two thirds")
    parser.add_argument("--rounds", type=int, default=7, help="times each face is cut into four")
    parser.add_argument("--side", type=int, default=4096, help="of the texture, pixels at most")
    parser.add_argument("--threads", type=int, default=8)
    args = parser.parse_args()
    print(json.dumps(measure(args.photos, args.width, args.rounds, args.side, args.threads)))


if __name__ == "__main__":
    main()
