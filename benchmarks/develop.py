# SPDX-License-Identifier: GPL-3.0-or-later
"""Rendered pictures become photos as a real camera takes them: lens, vignetting, drift, clipping, blur, noise.

A picture is rendered through a pinhole that looks a little wider (:func:`render_frame`) and is bent into the photo
afterwards, so the lens is exactly COLMAP's model OPENCV and truth per pixel follows through the same map.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.catalogue import SceneSpec
from mgf_engine.errors import BadInput

Picture = NDArray[np.uint8]
Lens = tuple[float, float, float, float]  # k1, k2, p1, p2
_ROUNDS = 40  # more than any sensible lens needs to 1e-6 of a pixel


class Frame(NamedTuple):
    """A pinhole picture in COLMAP's pixel convention (the first pixel's centre is at 0.5)."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float


def photo_frame(spec: SceneSpec) -> Frame:
    """Return the photo's camera less its lens; the principal point is a little off the middle, as in life."""
    fx = float(spec.width / 2 / np.tan(np.radians(spec.field_of_view) / 2))
    return Frame(spec.width, spec.height, fx, fx, spec.width / 2 + 1.25, spec.height / 2 - 0.75)


def render_frame(spec: SceneSpec) -> Frame:
    """Make the pinhole camera to render: the photo's own without a lens, else as much wider as its corners need."""
    frame = photo_frame(spec)
    if not any(spec.lens):
        return frame
    edge = np.linspace(0, 1, 50)
    rim = [(u * frame.width, v * frame.height) for s in edge for u, v in ((s, 0.0), (s, 1.0), (0.0, s), (1.0, s))]
    straight = _straighten(spec, np.array(rim))
    margin = int(np.ceil(max(-straight.min(), (straight - [frame.width, frame.height]).max(), 0.0))) + 2
    return Frame(
        frame.width + 2 * margin, frame.height + 2 * margin, frame.fx, frame.fy, frame.cx + margin, frame.cy + margin
    )


def _straighten(spec: SceneSpec, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
    """Where the pinhole of :func:`photo_frame` sees what the lens puts at pixels [N, 2], by fixed point iteration."""
    f = photo_frame(spec)
    focal, middle = np.array([f.fx, f.fy]), np.array([f.cx, f.cy])
    bent = (pixels - middle) / focal
    straight = bent.copy()
    for _ in range(_ROUNDS):
        straight += bent - distort(spec, straight)
    return np.asarray(straight * focal + middle)


def distort(spec: SceneSpec, rays: NDArray[np.float64]) -> NDArray[np.float64]:
    """Convert normalised image points [N, 2] of a pinhole to where the lens puts them (COLMAP's OPENCV)."""
    k1, k2, p1, p2 = spec.lens
    x, y = rays.T
    r = x * x + y * y
    radial = 1 + k1 * r + k2 * r * r
    return np.stack(
        [x * radial + 2 * p1 * x * y + p2 * (r + 2 * x * x), y * radial + 2 * p2 * x * y + p1 * (r + 2 * y * y)], axis=1
    )


def pixel_rays(spec: SceneSpec) -> NDArray[np.float64]:
    """Rays through the centres of a photo's pixels, lens and all, in the camera's frame with z = 1: [H, W, 3]."""
    f = photo_frame(spec)
    v, u = np.mgrid[0 : f.height, 0 : f.width] + 0.5
    at = _straighten(spec, np.stack([u.ravel(), v.ravel()], axis=1)) if any(spec.lens) else np.stack([u, v], axis=-1)
    rays = (at.reshape(f.height, f.width, 2) - [f.cx, f.cy]) / [f.fx, f.fy]
    return np.concatenate([rays, np.ones((f.height, f.width, 1))], axis=2)


def bend(spec: SceneSpec, picture: Picture, labels: bool = False) -> Picture:
    """Return a picture of :func:`render_frame` as the lens shows it in :func:`photo_frame`.

    Args:
        labels: take the nearest pixel's value instead of mixing neighbours.
    """
    if not any(spec.lens):
        return picture
    photo, wide = photo_frame(spec), render_frame(spec)
    v, u = np.mgrid[0 : photo.height, 0 : photo.width] + 0.5
    shift = np.array([wide.cx - photo.cx, wide.cy - photo.cy]) - 0.5
    at = _straighten(spec, np.stack([u.ravel(), v.ravel()], axis=1)) + shift
    x, y = (at[:, i].reshape(u.shape).astype(np.float32) for i in (0, 1))
    how = cv2.INTER_NEAREST if labels else cv2.INTER_LANCZOS4
    return np.asarray(cv2.remap(picture, x, y, how, borderMode=cv2.BORDER_REPLICATE), dtype=np.uint8)


def develop(spec: SceneSpec, rendered: Picture, number: int) -> Picture:
    """Make one photo of its rendered picture (BGR): what lens, light and sensor do, in this order."""
    rng = np.random.default_rng([spec.seed, 1, number])
    picture = np.asarray(bend(spec, rendered), dtype=np.float64)
    gain = _gains(spec, picture.shape[:2], number)
    if gain is not None:
        picture = _to_grey(np.clip(_to_light(picture) * gain, 0.0, 1.0))
    if spec.motion_blur > 0:
        picture = _blur(picture, spec.motion_blur * rng.rayleigh(0.8), rng.uniform(0, np.pi))
    noisy = picture + rng.normal(0, spec.noise, picture.shape) if spec.noise > 0 else picture
    return np.asarray(np.clip(np.round(noisy), 0, 255), dtype=np.uint8)


def _gains(spec: SceneSpec, shape: tuple[int, ...], number: int) -> NDArray[np.float64] | None:
    """What each pixel's light is multiplied with, float64 [H, W, 3] in BGR; None where nothing is to be done."""
    if not (spec.vignetting or spec.white_balance or spec.exposure_drift or spec.highlights):
        return None
    rng = np.random.default_rng([spec.seed, 3])  # one flight, one drift
    phases = rng.uniform(0, 2 * np.pi, 3)
    turn = 2 * np.pi * number / max(spec.photos, 1)
    waves = np.sin(turn * np.array([1.0, 2.0, 3.0]) + phases)
    stops = spec.highlights + spec.exposure_drift * waves[0] + spec.white_balance * np.array([waves[1], 0.0, waves[2]])
    height, width = shape[:2]
    v, u = np.mgrid[0:height, 0:width] + 0.5
    from_middle = ((u - width / 2) ** 2 + (v - height / 2) ** 2) / ((width / 2) ** 2 + (height / 2) ** 2)
    return np.asarray(2.0 ** (stops - spec.vignetting * from_middle[..., None]))


def _to_light(grey: NDArray[np.float64]) -> NDArray[np.float64]:
    """sRGB values 0..255 -> linear light 0..1."""
    x = grey / 255.0
    return np.asarray(np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4))


def _to_grey(light: NDArray[np.float64]) -> NDArray[np.float64]:
    """Linear light 0..1 -> sRGB values 0..255."""
    return np.asarray(255.0 * np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055))


def _blur(picture: NDArray[np.float64], length: float, angle: float) -> NDArray[np.float64]:
    """Blur along a line of some pixels, in subpixel steps."""
    size = 2 * int(np.ceil(length / 2)) + 3
    kernel = np.zeros((size, size), np.float32)
    for step in np.linspace(-0.5, 0.5, 33):
        x, y = size // 2 + step * length * np.cos(angle), size // 2 + step * length * np.sin(angle)
        left, top = int(np.floor(x)), int(np.floor(y))
        for row, column, weight in (
            (top, left, (1 - x + left) * (1 - y + top)), (top, left + 1, (x - left) * (1 - y + top)),
            (top + 1, left, (1 - x + left) * (y - top)), (top + 1, left + 1, (x - left) * (y - top)),
        ):  # fmt: skip
            kernel[row, column] += weight
    return np.asarray(cv2.filter2D(picture, -1, kernel / kernel.sum(), borderType=cv2.BORDER_REFLECT))


def write_photo(path: Path, photo: Picture, quality: int) -> None:
    """A JPEG file.

    Raises:
        BadInput: it cannot be written.
    """
    if not cv2.imwrite(str(path), photo, [cv2.IMWRITE_JPEG_QUALITY, quality]):
        raise BadInput(f"Cannot write the photo '{path}'; check the disk and the folder's rights.")
