# SPDX-License-Identifier: GPL-3.0-or-later
"""Noise and blur are measured rightly, whole sets of poor photos are spoken of, single blurred ones are found."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.perturb import perturb
from benchmarks.perturb_photos import line_kernel
from benchmarks.synthetic.colmap_scene import Messages
from benchmarks.synthetic.house_scene import house_scene
from mgf_engine.options.config import make_config
from mgf_engine.scene.load import load_scene
from mgf_engine.scene.quality import Quality, blurred_views, noise_of, poor_photos, sharpness_of


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return house_scene(tmp_path_factory)


def warnings_of(source: Path, tmp_path: Path, name: str, level: float) -> tuple[list[str], tuple[str, ...]]:
    folder = perturb(source, tmp_path / "copy", name, level)
    messages = Messages()
    scene = load_scene(folder, tmp_path / "job/scene", make_config({}), messages.reporter)
    return messages.warnings, scene.left_out


def leaves() -> np.ndarray:
    """Sharp rectangles of all sizes, one over the other, as edges lie in photos; grey [120, 160]."""
    rng = np.random.default_rng(3)
    picture = np.full((120, 160), 128.0, np.float32)
    for x, y, wide, high, grey in zip(*rng.uniform(0, 1, (5, 900)), strict=True):
        left, top = int(x * 170) - 10, int(y * 130) - 10
        corner = (left + int(3 / (wide + 0.1)), top + int(3 / (high + 0.1)))
        cv2.rectangle(picture, (left, top), corner, 20 + 210 * grey, -1)
    return picture


def wall() -> np.ndarray:
    """Bricks before a plain sky, grey [120, 160]."""
    picture = np.full((120, 160), 200.0, np.float32)
    picture[40:] = 120.0
    picture[40::8] = picture[40:, ::12] = 70.0
    return picture


POINTS = np.stack(np.meshgrid(np.arange(10, 150, 6.0), np.arange(45, 115, 6.0)), -1).reshape(-1, 2)


@pytest.mark.parametrize("sigma", [2.0, 12.0, 30.0])
def test_noise_is_measured_in_grey_values(sigma: float) -> None:
    picture = wall() + np.random.default_rng(1).normal(0, sigma, (120, 160)).astype(np.float32)
    assert noise_of(picture) == pytest.approx(sigma, rel=0.3)
    assert noise_of(wall()) < 0.1


def test_a_clipped_photo_has_no_noise_to_measure() -> None:
    assert np.isnan(noise_of(np.full((64, 64), 255.0, np.float32)))


@pytest.mark.parametrize("angle", [0.0, 0.6, 1.2, 2.2])
def test_a_smear_in_any_direction_is_blur(angle: float) -> None:
    picture = leaves()
    smeared = cv2.filter2D(picture, -1, line_kernel(8.0, angle))
    assert sharpness_of(picture, POINTS) > 0.8
    assert sharpness_of(smeared, POINTS) < 0.5
    assert np.isnan(sharpness_of(picture, np.zeros((0, 2))))


@pytest.mark.parametrize(("name", "level", "word"), [("noise", 50, "noisy"), ("blur", 12, "blurred")])
def test_poor_photos_are_spoken_of(source: Path, tmp_path: Path, name: str, level: float, word: str) -> None:
    warnings, left_out = warnings_of(source, tmp_path, name, level)
    assert any(text.startswith(f"The photos are {word}") for text in warnings)
    assert left_out == ()


@pytest.mark.parametrize(("count", "out"), [(2, True), (9, False)])
def test_blurred_photos_are_named_and_a_few_left_out(source: Path, tmp_path: Path, count: int, out: bool) -> None:
    warnings, left_out = warnings_of(source, tmp_path, "blurred", count)
    changed = sorted(p.name for p in (tmp_path / "copy/images").iterdir() if not p.is_symlink())
    (text,) = (w for w in warnings if "less sharp than the others" in w)
    assert text.startswith(f"{count} of ")
    assert all(name in text for name in changed[:3])
    assert left_out == (tuple(changed) if out else ())


def test_blur_is_told_from_the_other_photos() -> None:
    sharpness = np.array([1.0, 0.9, 0.35, 1.1, 0.95, np.nan, 0.8])
    noise = np.ones(7)
    assert blurred_views(Quality(noise, sharpness)) == [2]
    assert poor_photos(Quality(noise, sharpness)) == []
    assert blurred_views(Quality(noise, sharpness * 0.5)) == [2]  # 0.18 among 0.5
    assert poor_photos(Quality(noise, sharpness * 0.4)) != []
    unknown = np.full(7, np.nan)
    assert poor_photos(Quality(unknown, unknown)) == blurred_views(Quality(unknown, unknown)) == []
