# SPDX-License-Identifier: GPL-3.0-or-later
"""From rendered pictures to photos: COLMAP's lens, clipping, drift, blur and noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pycolmap
import pytest

from benchmarks.catalogue import SceneSpec
from benchmarks.develop import bend, develop, distort, photo_frame, pixel_rays, render_frame

PLAIN = SceneSpec(photos=8, width=120, noise=0.0)
LENS = replace(PLAIN, lens=(-0.11, 0.025, 0.0008, -0.0006))


def grey(spec: SceneSpec, value: int) -> np.ndarray:
    frame = render_frame(spec)
    return np.full((frame.height, frame.width, 3), value, np.uint8)


def test_the_lens_is_colmaps_model() -> None:
    frame = photo_frame(LENS)
    camera = pycolmap.Camera(
        model="OPENCV", width=frame.width, height=frame.height, params=[*frame[2:], *LENS.lens], camera_id=1
    )
    rays = np.random.default_rng(0).uniform(-0.5, 0.5, (50, 2))
    mine = distort(LENS, rays) * [frame.fx, frame.fy] + [frame.cx, frame.cy]
    theirs = [camera.img_from_cam(np.array([*ray, 1.0])) for ray in rays]
    assert mine == pytest.approx(np.array(theirs), abs=1e-9)


def test_rays_of_pixels_go_back_through_the_lens() -> None:
    frame, rays = photo_frame(LENS), pixel_rays(LENS)
    assert rays.shape == (frame.height, frame.width, 3)
    pixels = distort(LENS, rays[..., :2].reshape(-1, 2)) * [frame.fx, frame.fy] + [frame.cx, frame.cy]
    v, u = np.mgrid[0 : frame.height, 0 : frame.width] + 0.5
    assert pixels == pytest.approx(np.stack([u.ravel(), v.ravel()], axis=1), abs=1e-6)
    assert pixel_rays(PLAIN)[0, 0] == pytest.approx([(0.5 - frame.cx) / frame.fx, (0.5 - frame.cy) / frame.fy, 1.0])


def test_a_bent_picture_shows_each_pixels_ray() -> None:
    """A picture whose grey is the ray's slope: after bending each pixel has the grey of its own ray."""
    wide = render_frame(LENS)
    slope = (np.arange(wide.width) + 0.5 - wide.cx) / wide.fx
    picture = np.repeat(np.round(120 + 150 * slope)[None, :, None], wide.height, axis=0).astype(np.uint8)
    bent = bend(LENS, np.repeat(picture, 3, axis=2))
    inner = (slice(4, -4), slice(4, -4), 0)
    assert bent[inner] == pytest.approx(120 + 150 * pixel_rays(LENS)[inner], abs=1.1)
    assert bend(PLAIN, picture) is picture


def test_without_faults_a_photo_is_the_picture() -> None:
    picture = np.random.default_rng(0).integers(0, 256, (80, 120, 3)).astype(np.uint8)
    assert np.array_equal(develop(PLAIN, picture, 0), picture)


def test_highlights_clip_and_corners_darken() -> None:
    over = develop(replace(PLAIN, highlights=1.0), grey(PLAIN, 200), 0)
    assert (over == 255).all()
    dark = develop(replace(PLAIN, vignetting=1.0), grey(PLAIN, 200), 0)
    assert dark[0, 0].max() < 155 and dark[40, 60].min() >= 199  # half the light is about 146 of 200


def test_exposure_and_color_drift_over_the_flight() -> None:
    exposed = [develop(replace(PLAIN, exposure_drift=0.5), grey(PLAIN, 128), i)[0, 0] for i in range(8)]
    assert np.ptp([p[0] for p in exposed]) > 30 and all(np.ptp(p) == 0 for p in exposed)
    tinted = [develop(replace(PLAIN, white_balance=0.5), grey(PLAIN, 128), i)[0, 0] for i in range(8)]
    assert np.ptp([int(p[0]) - int(p[2]) for p in tinted]) > 30 and len({int(p[1]) for p in tinted}) == 1


def test_motion_blur_and_noise_keep_the_mean() -> None:
    picture = grey(PLAIN, 60)
    picture[:, 60:] = 180
    blurred = [develop(replace(PLAIN, motion_blur=2.0), picture, i) for i in range(4)]
    assert all(p.mean() == pytest.approx(120, abs=2) for p in blurred)
    assert any(len(np.unique(p)) > 2 for p in blurred)
    noisy = develop(replace(PLAIN, noise=3.0), grey(PLAIN, 120), 0)
    assert noisy.std() == pytest.approx(3.0, abs=0.2) and noisy.mean() == pytest.approx(120, abs=0.2)
