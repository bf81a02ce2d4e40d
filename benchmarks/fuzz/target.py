# SPDX-License-Identifier: GPL-3.0-or-later
"""What a target of the fuzzer is, and what its readers share: a small scene, and checks of how a reader fails."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from mgf_engine.errors import BadInput
from mgf_engine.model.gaussians import Gaussians
from mgf_engine.model.scene import Scene, Similarity, View

#: A tetrahedron.
VERTICES = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]], np.int32)


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


def check_contained(folder: Path, allowed: set[str]) -> None:
    """Raise when a reader wrote beside the folders it was given."""
    extra = {p.name for p in folder.iterdir()} - allowed
    if extra:
        raise AssertionError(f"written outside the job: {sorted(extra)}")


def write_photos(scene: Scene) -> None:
    (scene.folder / "images").mkdir()
    for view in scene.views:
        cv2.imwrite(str(scene.folder / view.file), np.full((12, 16, 3), 90, np.uint8))


def ignore_bad_input(reader: Callable[[Path], Any], path: Path) -> None:
    try:
        reader(path)
    except BadInput as error:
        check_sentence(error)


def check_sentence(error: BadInput) -> None:
    """One line that ends like a sentence."""
    text = str(error)
    if not text or "\n" in text or not text.endswith("."):
        raise AssertionError(f"not one sentence: {text!r}")


def small_field() -> Gaussians:
    import torch

    from mgf_engine.field.initialise import initial_field

    points = np.random.default_rng(0).normal(size=(6, 3))
    torch.manual_seed(0)
    return initial_field(points, np.full((6, 3), 90, np.uint8), np.tile([[0.0, 0, -5]], (6, 1)))
