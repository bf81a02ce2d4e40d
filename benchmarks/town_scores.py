# SPDX-License-Identifier: GPL-3.0-or-later
"""How good a town is: meshes against the true houses, and automatic clicks against clicks made from true masks.

``python -m benchmarks.town_scores clicks SCENE TOWN FOLDER`` writes clicks as a person would set them for ``mgf town
--clicks FOLDER``; ``python -m benchmarks.town_scores score SCENE TOWN`` prints a table.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.prompts import inside_points, spread_photos
from benchmarks.scenes import read_png
from mgf_engine.evaluation.geometry import ComparisonOptions, score_surface
from mgf_engine.evaluation.model_cameras import cameras_of
from mgf_engine.evaluation.surfaces import read_surface
from mgf_engine.files.atomic import write_json
from mgf_engine.scene.colmap import find_model, read_model
from mgf_engine.scene.normalise import rotation_of

_LEAST = 0.01  # of a photo: nobody clicks a building that fills less


def make_clicks(scene: Path, town: Path, folder: Path) -> None:
    """Clicks from true masks on a fifth of the photos that the town gives each building."""
    for building in sorted((town / "buildings").iterdir()):
        masks = scene / "buildings" / building.name / "masks"
        model = find_model(building / "scene") if (building / "scene").is_dir() else None
        if model is None or not masks.is_dir():
            continue
        names, poses, seen = [], [], []
        for image in read_model(model).images:
            mask = _mask(masks, image.name)
            if mask.mean() >= _LEAST:
                rotation = rotation_of(image.quaternion)
                names.append(image.name)
                poses.append([*(-rotation.T @ image.translation), *rotation[2]])
                seen.append(mask)
        chosen = spread_photos(np.array(poses), max(3, -(-len(names) // 5)))
        clicks = {names[i]: {"positive": inside_points(seen[i], 3), "negative": inside_points(_beside(seen[i]), 2)}
                  for i in chosen}  # fmt: skip
        write_json(folder / f"{building.name}.json", clicks)


def _mask(folder: Path, photo: str) -> NDArray[np.bool_]:
    return np.asarray(read_png(folder / (Path(photo).stem + ".png")) > 127)


def _beside(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    return np.asarray(cv2.dilate(mask.astype(np.uint8), np.ones((5, 5), np.uint8)) == 0)


def scores(scene: Path, town: Path, thresholds: tuple[float, ...] = (0.1, 0.2)) -> list[dict[str, Any]]:
    """Found, missed and false buildings, F1 and CPU seconds of each."""
    from mgf_engine.town.result import read_rows

    rows = []
    truth = json.loads((scene / "town.json").read_text(encoding="utf-8"))["houses"]
    found = {row["id"]: row for row in read_rows(town, running=False)}
    for name in dict.fromkeys([*truth, *found]):
        row = found.get(name)
        if row is None or row["job"] != "done":
            outcome = "missed" if name in truth else "rightly left out"
            rows.append({"id": name, "outcome": outcome})
            continue
        if name not in truth:
            rows.append({"id": name, "outcome": "false"})
            continue
        job = town / "buildings" / name / "job"
        true = read_surface(scene / "buildings" / name / "truth.ply")
        masks = scene / "buildings" / name / "masks"
        cameras = cameras_of(scene / "sparse/0", partial(_mask, masks))
        result = score_surface(
            read_surface(job / "mesh.ply"), true, list(thresholds), ComparisonOptions(200_000, cameras)
        )
        rows.append({
            "id": name, "outcome": "found", "f1": result.f1, "accuracy": result.accuracy,
            "completeness": result.completeness, "cpu": row["done"]["cpu_seconds"], "photos": len(row["photos"]),
            "confidence": row["done"]["confidence"],
        })  # fmt: skip
    return rows


def main(argv: Sequence[str] | None = None) -> int:
    """Run one of the two commands above."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.town_scores", description=(__doc__ or "").split("\n")[0]
    )
    commands = parser.add_subparsers(dest="command", required=True)
    for name, about in (("clicks", "write clicks from true masks"), ("score", "print a table of scores")):
        command = commands.add_parser(name, help=about, description=about)
        command.add_argument("scene", type=Path, help="folder that 'python -m benchmarks.town' made")
        command.add_argument("town", type=Path, help="folder that 'mgf town' made")
        if name == "clicks":
            command.add_argument("folder", type=Path, help="where the clicks go, for 'mgf town --clicks'")
    args = parser.parse_args(argv)
    if args.command == "clicks":
        make_clicks(args.scene, args.town, args.folder)
        return 0
    print(
        f"{'building':<16}{'outcome':<18}{'F1 10 cm':>9}{'20 cm':>7}{'acc.':>7}{'compl.':>7}{'CPU s':>7}{'photos':>7}"
    )
    for row in scores(args.scene, args.town):
        text = f"{row['id']:<16}{row['outcome']:<18}"
        if row["outcome"] == "found":
            a, b = row["f1"]
            text += f"{a:>9.1f}{b:>7.1f}{row['accuracy'][1]:>7.1f}{row['completeness'][1]:>7.1f}"
            text += f"{row['cpu']:>7.0f}{row['photos']:>7}"
        print(text)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
