# SPDX-License-Identifier: GPL-3.0-or-later
"""Given masks with holes, cut off or too wide are found by the points; what they wrongly leave out becomes unknown."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from benchmarks.perturb import perturb
from benchmarks.synthetic.colmap_scene import Messages
from benchmarks.synthetic.house_scene import house_scene
from mgf_engine.masks.build import build_masks
from mgf_engine.masks.user_masks import read_user_masks
from mgf_engine.masks.validation.mask_coverage import MaskCoverage, describe_misfits, mark_ignored, measure_coverage
from mgf_engine.model.masks import IGNORE, building
from mgf_engine.model.scene import Scene
from mgf_engine.options.config import make_config
from mgf_engine.scene.load import load_scene


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return house_scene(tmp_path_factory)


@pytest.fixture(scope="module")
def scene(source: Path, tmp_path_factory: pytest.TempPathFactory) -> Scene:
    plain = perturb(source, tmp_path_factory.mktemp("plain") / "copy", "masks_holes", 0)
    return load_scene(plain, tmp_path_factory.mktemp("job") / "scene", make_config({}), Messages().reporter)


def masks_of(source: Path, tmp_path: Path, scene: Scene, name: str, level: float) -> list[np.ndarray]:
    folder = perturb(source, tmp_path / name, name, level)
    labels = read_user_masks(folder / "masks", scene)
    assert all(mask is not None for mask in labels)
    return labels


def test_sound_masks_are_left_as_they_are(source: Path, tmp_path: Path, scene: Scene) -> None:
    labels = masks_of(source, tmp_path, scene, "masks_holes", 0)
    fit = measure_coverage(scene, labels, np.ones(len(labels), bool))
    assert fit.on_building.sum() > 500 and fit.beside.sum() > 500
    assert describe_misfits(scene, fit) == []
    assert all((a == b).all() for a, b in zip(mark_ignored(scene, labels, fit), labels, strict=True))


@pytest.mark.parametrize(
    ("name", "level", "words"),
    [
        ("masks_eroded", 25, "cut off parts of the building"),
        ("masks_holes", 0.2, "fill their holes"),
        ("masks_dilated", 25, "include more than the building"),
    ],
)
def test_masks_that_do_not_fit_are_spoken_of(
    source: Path, tmp_path: Path, scene: Scene, name: str, level: float, words: str
) -> None:
    folder = perturb(source, tmp_path / "copy", name, level)
    messages = Messages()
    build_masks(scene, None, folder / "masks", tmp_path / "masks", make_config({}), messages.reporter)
    (text,) = (w for w in messages.warnings if w.startswith("The given masks"))
    assert words in text
    assert scene.views[0].name[-4:] in text  # photos are named


def test_holes_become_unknown_and_nothing_else(source: Path, tmp_path: Path, scene: Scene) -> None:
    true = masks_of(source, tmp_path, scene, "masks_holes", 0)
    holed = masks_of(source, tmp_path / "holed", scene, "masks_holes", 0.2)
    mended = mark_ignored(scene, holed, measure_coverage(scene, holed, np.ones(len(holed), bool)))
    inside = [building(mask) for mask in true]
    before = sum(int((mask[on] == 0).sum()) for mask, on in zip(holed, inside, strict=True))
    after = sum(int((mask[on] == 0).sum()) for mask, on in zip(mended, inside, strict=True))
    beside = sum(int((mask[~on] == IGNORE).sum()) for mask, on in zip(mended, inside, strict=True))
    assert after < 0.4 * before
    assert beside < 0.1 * before
    for now, was in zip(mended, holed, strict=True):
        assert ((now == was) | ((now == IGNORE) & (was == 0))).all()


def test_an_opening_that_shows_the_surroundings_stays(source: Path, tmp_path: Path, scene: Scene) -> None:
    """One photo's mask has a hole; where a point of the ground is seen in it, it stays background."""
    labels = masks_of(source, tmp_path, scene, "masks_holes", 0)
    fit = measure_coverage(scene, labels, np.ones(len(labels), bool))
    row = int(np.flatnonzero(fit.beside & (fit.margin < -12))[0])
    view, (x, y) = int(scene.track_view[row]), np.floor(scene.track_uv[row]).astype(int).tolist()
    ring = np.zeros_like(labels[view])
    cv2.circle(ring, (x, y), 11, 1, -1)
    cv2.circle(ring, (x, y), 8, 0, -1)
    changed = list(labels)
    changed[view] = np.maximum(labels[view], ring)
    again = measure_coverage(scene, changed, np.ones(len(labels), bool))
    assert mark_ignored(scene, changed, again)[view][y, x] == 0


@pytest.mark.parametrize(("ground", "left"), [(False, IGNORE), (True, 0)])
def test_a_hole_that_shows_building_and_ground_is_not_ignored_as_a_whole(ground: bool, left: int) -> None:
    label = np.ones((40, 40), np.uint8)
    label[8:32, 8:32] = 0
    scene: Any = SimpleNamespace(
        track_view=np.zeros(2, int),
        track_uv=np.array([[12.5, 12.5], [27.5, 27.5]]),
        observations=lambda _: np.arange(2),
    )
    fit = MaskCoverage(np.array([-5.0, -5.0]), np.array([True, False]), np.array([False, ground]))
    (result,) = mark_ignored(scene, [label], fit)
    assert result[12, 12] == IGNORE  # around what its mask leaves out
    assert result[12, 12 + 6] == IGNORE and result[12, 12 + 8] == left  # 2 px beyond its distance to the outline, 5 px
    assert result[12, 28] == left  # far from it, in the same hole
    assert (result[label == 1] == 1).all()
