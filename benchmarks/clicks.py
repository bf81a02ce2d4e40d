# SPDX-License-Identifier: GPL-3.0-or-later
"""Kinds of clicks to test masks with, made from true masks: on many photos and few, good and bad ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pycolmap
from numpy.typing import NDArray

from benchmarks.prompts import inside_points, spread_photos
from mgf_engine.errors import BadInput
from mgf_engine.files.atomic import write_json
from mgf_engine.model.masks import BACKGROUND, BUILDING
from mgf_engine.scene.colmap import find_model

Entry = dict[str, list[list[float]]]
Clicks = dict[str, Entry]
#: px on photos of 480 px: what 20 px are on a photo of 1000 px.
OFF = 10.0


@dataclass(frozen=True)
class Truth:
    """Photos of a scene, their poses [N, 6] (camera centre, viewing direction), and true masks."""

    names: list[str]
    poses: NDArray[np.float64]
    masks: list[NDArray[np.uint8]]


def make_clicks(folder: Path, variant: str, path: Path) -> None:
    """Write the clicks of a kind for the scene in ``folder`` to ``path``."""
    truth = read_truth(folder)
    write_json(path, VARIANTS[variant](truth, np.random.default_rng(7)))


def read_truth(folder: Path) -> Truth:
    """Read names, poses and true masks of the photos in the model that the engine takes of a synthetic scene."""
    model = pycolmap.Reconstruction(folder / "sparse_truth")
    loaded = find_model(folder) or folder / "sparse/0"
    placed = {str(i.name) for i in pycolmap.Reconstruction(loaded).images.values()}
    images = sorted((i for i in model.images.values() if str(i.name) in placed), key=lambda i: str(i.name))
    poses = [[*i.projection_center(), *i.cam_from_world().rotation.matrix()[2]] for i in images]
    masks = []
    for image in images:
        mask = cv2.imread(str(folder / "masks" / (Path(image.name).stem + ".png")), cv2.IMREAD_UNCHANGED)
        if mask is None:
            raise BadInput(f"The mask of '{image.name}' in '{folder}' is missing; delete the folder and make it again.")
        masks.append(np.asarray(mask, np.uint8))
    return Truth([str(i.name) for i in images], np.array(poses), masks)


def good(truth: Truth, count: int, positives: int = 3, negatives: int = 2) -> Clicks:
    """Return clicks well inside, on ``count`` spread photos."""
    return {
        truth.names[i]: {
            "positive": inside_points(truth.masks[i] == BUILDING, positives),
            "negative": inside_points(truth.masks[i] == BACKGROUND, negatives),
        }
        for i in spread_photos(truth.poses, count)
    }


def _fifth(truth: Truth) -> int:
    return max(3, -(-len(truth.names) // 5))


def _tenth(truth: Truth) -> int:
    return max(1, -(-len(truth.names) // 10))


def _off(truth: Truth, rng: np.random.Generator) -> Clicks:
    clicks = good(truth, _fifth(truth))
    for name, entry in clicks.items():
        h, w = truth.masks[truth.names.index(name)].shape
        for kind, points in entry.items():
            turn = rng.uniform(0, 2 * np.pi, len(points))
            moved = np.array(points).reshape(-1, 2) + OFF * np.stack([np.cos(turn), np.sin(turn)], 1)
            entry[kind] = np.clip(moved, 0.5, (w - 0.5, h - 0.5)).tolist()
    return clicks


def _one_wrong_in_five(truth: Truth, rng: np.random.Generator) -> Clicks:
    """Every fifth click says the opposite of the truth."""
    clicks = good(truth, _fifth(truth))
    spots = [(name, kind, k) for name, e in clicks.items() for kind in e for k in range(len(e[kind]))]
    wrong = rng.permutation(len(spots))[: round(len(spots) / 5)]
    swapped: dict[str, Entry] = {name: {"positive": [], "negative": []} for name in clicks}
    for number, (name, kind, k) in enumerate(spots):
        other = {"positive": "negative", "negative": "positive"}[kind]
        swapped[name][other if number in wrong else kind].append(clicks[name][kind][k])
    return swapped


def _other_building(truth: Truth, rng: np.random.Generator) -> Clicks:
    """One photo is clicked the other way round: on what stands beside the building."""
    clicks = good(truth, _fifth(truth))
    name = sorted(clicks)[len(clicks) // 2]
    mask = truth.masks[truth.names.index(name)]
    beside = (mask == BACKGROUND) & (cv2.dilate((mask == BUILDING).astype(np.uint8), np.ones((3, 3), np.uint8)) == 0)
    clicks[name] = {"positive": inside_points(beside, 3), "negative": inside_points(mask == BUILDING, 2)}
    return clicks


Maker = Callable[[Truth, np.random.Generator], Clicks]
VARIANTS: dict[str, Maker] = {
    "a fifth": lambda t, r: good(t, _fifth(t)),
    "a fifth, 2+1 clicks": lambda t, r: good(t, _fifth(t), 2, 1),
    "1 photo": lambda t, r: good(t, 1),
    "2 photos": lambda t, r: good(t, 2),
    "3 photos": lambda t, r: good(t, 3),
    "a tenth": lambda t, r: good(t, _tenth(t)),
    "10 px off": _off,
    "one click in five wrong": _one_wrong_in_five,
    "one photo elsewhere": _other_building,
}
