# SPDX-License-Identifier: GPL-3.0-or-later
"""Worse photos: noise, exposure, blur, shadows that move, and photos of another place under the right names."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.perturb_copy import REFERENCE_WIDTH, SceneCopy
from mgf_engine.errors import BadInput

#: Photos store roughly this power of the light.
GAMMA = 2.2


def add_noise(copy: SceneCopy, sigma: float) -> None:
    """A dark sensor turned up: noise of ``sigma`` grey values at mid grey, growing with the root of the light."""
    for name in copy.names:
        photo = copy.photo(name).astype(float)
        spread = sigma * np.sqrt((photo + 16.0) / 144.0)
        copy.write_photo(name, photo + spread * copy.rng.normal(size=photo.shape))


def change_exposure(copy: SceneCopy, stops: float) -> None:
    """Every photo brighter or darker by up to ``stops``, uniform; what leaves the range is clipped."""
    for name in copy.names:
        gain = 2.0 ** copy.rng.uniform(-stops, stops)
        copy.write_photo(name, copy.photo(name) * gain ** (1.0 / GAMMA))


def change_balance(copy: SceneCopy, stops: float) -> None:
    """Every photo's red and blue off by up to ``stops``, each its own way; green stays."""
    for name in copy.names:
        gains = 2.0 ** np.array([copy.rng.uniform(-stops, stops), 0.0, copy.rng.uniform(-stops, stops)])
        copy.write_photo(name, copy.photo(name) * gains ** (1.0 / GAMMA))


def blur(copy: SceneCopy, length: float) -> None:
    """Every photo smeared along a direction of its own, ``length`` pixels of a photo 480 wide."""
    pixels = copy.pixels(length)
    for name in copy.names:
        kernel = line_kernel(pixels, copy.rng.uniform(0, math.pi))
        copy.write_photo(name, cv2.filter2D(copy.photo(name), -1, kernel, borderType=cv2.BORDER_REPLICATE))


def blur_some(copy: SceneCopy, count: float) -> None:
    """``count`` photos smeared over 24 pixels of a photo 480 wide, each in a direction of its own; the rest stays."""
    names = copy.names
    for index in copy.rng.permutation(len(names))[: int(count)]:
        kernel = line_kernel(copy.pixels(24.0), copy.rng.uniform(0, math.pi))
        smeared = cv2.filter2D(copy.photo(names[index]), -1, kernel, borderType=cv2.BORDER_REPLICATE)
        copy.write_photo(names[index], smeared)


def line_kernel(length: float, angle: float) -> NDArray[np.float32]:
    """Return a line of the given length (pixels) and direction through the middle of a square kernel; its sum is 1."""
    half = math.ceil(length / 2) + 1
    y, x = np.mgrid[-half : half + 1, -half : half + 1].astype(float)
    along, across = x * math.cos(angle) + y * math.sin(angle), -x * math.sin(angle) + y * math.cos(angle)
    inside = np.clip(length / 2 + 0.5 - np.abs(along), 0, 1) * np.clip(1 - np.abs(across), 0, 1)
    return (inside / inside.sum()).astype(np.float32)


def cast_shadows(copy: SceneCopy, darkness: float) -> None:
    """In every photo a band in another place loses ``darkness`` of its stored light, with soft edges."""
    for name in copy.names:
        photo = copy.photo(name).astype(float)
        height, width = photo.shape[:2]
        angle, place = copy.rng.uniform(0, math.pi), copy.rng.uniform(-0.25, 0.25) * width
        y, x = np.mgrid[:height, :width].astype(float)
        across = (x - width / 2) * math.cos(angle) + (y - height / 2) * math.sin(angle) - place
        soft = 6.0 * width / REFERENCE_WIDTH
        shadow = np.clip((0.15 * width - np.abs(across)) / soft, 0, 1)
        copy.write_photo(name, photo * (1.0 - darkness * shadow[..., None]))


def swap_foreign(copy: SceneCopy, count: float) -> None:
    """``count`` photos show another place: those of the other scene, or of this one upside down in false colours."""
    names = copy.names
    chosen = copy.rng.permutation(len(names))[: int(count)]
    others = sorted((copy.other / "images").iterdir()) if copy.other else []
    if copy.other and not others:
        raise BadInput(f"The other scene '{copy.other}' has no photos.")
    for number, index in enumerate(chosen):
        own = copy.photo(names[index])
        if others:
            picture = cv2.imread(str(others[number % len(others)]), cv2.IMREAD_COLOR)
            if picture is None:
                raise BadInput(f"The photo '{others[number % len(others)]}' cannot be read.")
            foreign = cv2.resize(picture, own.shape[1::-1], interpolation=cv2.INTER_AREA)
        else:
            foreign = copy.photo(names[(index + len(names) // 2) % len(names)])[::-1, ::-1, ::-1]
        copy.write_photo(names[index], foreign)
