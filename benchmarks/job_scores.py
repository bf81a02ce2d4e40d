# SPDX-License-Identifier: GPL-3.0-or-later
"""Scores of a job's masks and renders against the scene's true masks.

A report measures inside the job's own masks, as users have no others. Variants with other masks, or with none, are
only compared fairly inside the same ones.
"""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.evaluation.geometry import mask_iou
from mgf_engine.evaluation.images import Scores, mean_scores, score
from mgf_engine.evaluation.lpips import Lpips, find_lpips
from mgf_engine.model.masks import BACKGROUND, IGNORE, building


def held_out_scores(job: Path, scene: Path) -> Scores:
    """Compute the mean scores of the held-out renders inside the true masks; all None for a job that held out nothing.

    Args:
        job: a finished job with its renders; scene: folder with ``masks``.
    """
    views = json.loads((job / "deliver.json").read_text(encoding="utf-8"))["views"]
    lpips = find_lpips()
    return mean_scores([_score(job, scene, view, lpips) for view in views if view["held_out"] and view["render"]])


def _score(job: Path, scene: Path, view: dict[str, str], lpips: Lpips | None) -> Scores:
    photo = _read(job / view["file"])[..., 2::-1]
    render = _read(job / view["render"])
    # Renders are stored with straight alpha; over black they are what training compares with the photo.
    over_black = np.round(render[..., 2::-1] * (render[..., 3:] / 255.0)).astype(np.uint8)
    truth = _read(scene / "masks" / (Path(view["name"]).stem + ".png"))
    truth = np.asarray(cv2.resize(truth, photo.shape[1::-1], interpolation=cv2.INTER_NEAREST), np.uint8)
    return score(np.ascontiguousarray(photo), over_black, building(truth), lpips)


def _read(path: Path) -> NDArray[np.uint8]:
    picture = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if picture is None:
        raise RuntimeError(f"'{path}' cannot be read")
    return np.asarray(picture, np.uint8)


def mean_mask_iou(job: Path, scene: Path) -> float | None:
    """Compute the mean IoU in percent of the job's level-one masks with the true ones, where they are not unknown."""
    values = []
    for path in sorted((scene / "masks").glob("*.png")):
        found = next((p for p in (job / "masks").rglob(f"{path.stem}*.png")), None)
        if found is None:
            continue
        labels, truth = cv2.imread(str(found), cv2.IMREAD_UNCHANGED), cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        if labels is None or truth is None or labels.ndim != 2:
            continue
        truth = cv2.resize(truth, labels.shape[::-1], interpolation=cv2.INTER_NEAREST)
        mine = (labels != BACKGROUND) & (labels != IGNORE)
        values.append(mask_iou(mine, truth != BACKGROUND, truth != IGNORE))
    return float(np.mean(values)) if values else None
