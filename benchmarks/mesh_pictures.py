# SPDX-License-Identifier: GPL-3.0-or-later
"""``python -m benchmarks.mesh_pictures OUT PICTURE --scenes ... --variants ...``: the meshes that a suite has made,
beside a photo: a row per scene, a column per variant, without texture and lit from the side, F1 written below."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.catalogue import scene_spec
from benchmarks.measure import THRESHOLDS, f1_at
from benchmarks.scenes import make_scene
from mgf_engine.errors import BadInput
from mgf_engine.evaluation.model_cameras import cameras_of
from mgf_engine.files.images import write_picture
from mgf_engine.geometry.mesh_files import read_ply
from mgf_engine.geometry.rasterize import shaded

Picture = NDArray[np.uint8]
Row = dict[str, Any]
_LINE, _GAP = 26, 8  # height of the text under a picture, and white between pictures, px


def main(argv: Sequence[str] | None = None) -> int:
    """Write the picture; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path, help="folder of results and jobs, as mgf bench --out makes it")
    parser.add_argument("picture", type=Path)
    parser.add_argument("--scenes", nargs="+", required=True, help="of the catalogue")
    parser.add_argument("--variants", nargs="+", required=True, help="as the tables name them")
    parser.add_argument(
        "--photos", nargs="+", type=int, default=[0], help="number of the photo, of each scene or of all"
    )
    parser.add_argument("--width", type=int, default=440, help="of each picture, px")
    args = parser.parse_args(argv)
    photos = args.photos * len(args.scenes) if len(args.photos) == 1 else args.photos
    try:
        if len(photos) != len(args.scenes):
            raise BadInput("Give one photo number, or as many as scenes.")
        rows = [
            scene_row(
                make_scene(name, scene_spec(name)), number, find_meshes(args.out, name, args.variants), args.width
            )
            for name, number in zip(args.scenes, photos, strict=True)
        ]
        write_picture(args.picture, np.vstack(rows))
    except BadInput as error:
        print(f"Error: {error}", file=sys.stderr)
        return 2
    return 0


def find_meshes(out: Path, scene: str, variants: Sequence[str]) -> dict[str, Path]:
    """Return what to write below each mesh -> the newest mesh of that variant of the scene.

    Raises:
        BadInput: there is none.
    """
    found: dict[str, Path] = {}
    files = sorted((out / "results").glob("*.json"), key=lambda path: path.stat().st_mtime)
    rows = [(json.loads(path.read_text(encoding="utf-8")), out / "jobs" / path.stem / "mesh.ply") for path in files]
    for variant in variants:
        mine = [
            (row, mesh) for row, mesh in rows if (row["scene"], row["variant"]) == (scene, variant) and mesh.exists()
        ]
        if not mine:
            raise BadInput(f"'{out}' holds no mesh of '{variant}' on '{scene}'; run the suite that makes it.")
        row, mesh = mine[-1]
        found[f"{variant}: F1 {_f1(row)}"] = mesh
    return found


def _f1(row: Row) -> str:
    return " / ".join(f"{f1_at(row, t):.1f}" for t in THRESHOLDS)


def scene_row(folder: Path, number: int, meshes: dict[str, Path], width: int) -> Picture:
    """Draw a photo and beside it meshes from its camera.

    Args:
        folder: of the rendered scene.
        number: of the photo, in the order of names.
        meshes: text -> mesh in the true frame.
        width: of each picture, px.

    Raises:
        BadInput: the scene has no such photo.
    """
    names = sorted(path.name for path in (folder / "images").iterdir())
    cameras = cameras_of(folder / "sparse_truth")
    if not 0 <= number < len(cameras):
        raise BadInput(f"'{folder.name}' has no photo {number}, only 0 to {len(cameras) - 1}.")
    view = cameras[number].view
    view = view.resized(width, round(view.height * width / view.width))
    photo = cv2.imread(str(folder / "images" / names[number]), cv2.IMREAD_COLOR)
    if photo is None:
        raise BadInput(f"The photo '{names[number]}' of '{folder}' cannot be read; make the scene again.")
    small = cv2.resize(photo[..., ::-1], (view.width, view.height), interpolation=cv2.INTER_AREA)
    tiles = [_captioned(np.asarray(small, np.uint8), "photo")]
    tiles += [_captioned(shaded(read_ply(path), view, from_side=True), text) for text, path in meshes.items()]
    return np.hstack(tiles)


def _captioned(picture: Picture, text: str) -> Picture:
    """Add white around a picture, and a line of text below it."""
    framed = np.pad(picture, ((0, _LINE), (0, _GAP), (0, 0)), constant_values=255)
    place = (4, picture.shape[0] + _LINE - 9)
    cv2.putText(framed, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.45, (40, 40, 40), 1, cv2.LINE_AA)
    return framed


if __name__ == "__main__":
    sys.exit(main())
