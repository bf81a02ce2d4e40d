# SPDX-License-Identifier: GPL-3.0-or-later
"""Measure sensor noise and sharpness of the photos at the sparse points, before the stages begin.

Both are measured on the working photos, so that what counts is left after they were made smaller.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.files.images import read_rgb
from mgf_engine.model.photo_cache import PHOTOS
from mgf_engine.model.scene import Scene
from mgf_engine.native.parallel import parallel_map
from mgf_engine.options.algorithms import parameter

Array = NDArray[np.float64]
_SECOND_DIFFERENCE = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)  # its noise gain is 6
_MARGIN = 5  # px: differences over four pixels stay inside the photo


@dataclass(frozen=True)
class QualityOptions:
    """Options of the quality of photos."""

    noisy: float = parameter(10.0, "Noise that a warning is given for (sound photos stay below 5)", "grey levels")
    blurred: float = parameter(0.5, "Sharpness below which a photo is blurred (sound photos have 0.65 to 1.6)")
    out_of_line: float = parameter(
        0.6, "Sharpness of a blurred photo, as a share of the median photo's, below which it is left out", high=1
    )
    block: int = parameter(8, "Side of the blocks that noise is measured in", "px", low=2)
    darkest: float = parameter(16.0, "Grey value below which pixels are clipped and have no noise", "grey levels")
    brightest: float = parameter(235.0, "Grey value above which pixels are clipped and have no noise", "grey levels")
    around: int = parameter(9, "Side of the windows around observations that sharpness is measured in", "px", low=1)


@dataclass(frozen=True)
class Quality:
    """Of each view, [V] each; NaN where too little can be seen.

    Attributes:
        noise: standard deviation in grey values of 255, from the calmest tenth of the photo.
        sharpness: about 1 for edges of a pixel, 0.4 for edges of four, towards 0.3 beyond; the least over four
            directions, because motion smears along one only.
    """

    noise: Array
    sharpness: Array


def photo_quality(scene: Scene, folder: Path, threads: int = 1, options: QualityOptions = QualityOptions()) -> Quality:
    """Measure noise and sharpness of the working photos.

    Args:
        scene: its views and their observations.
        folder: of the working photos.
        threads: photos that are worked on at a time.
        options: what noise and sharpness are measured in.
    """

    def measure(index: int) -> tuple[float, float]:
        photo = PHOTOS.get(folder / Path(scene.views[index].file).name, read_rgb)
        green = photo[..., 1].astype(np.float32)
        return noise_of(green, options), sharpness_of(green, scene.track_uv[scene.observations(index)], options)

    found = list(parallel_map(measure, range(len(scene.views)), threads))
    noise, sharpness = np.reshape(found, (-1, 2)).T
    return Quality(noise, sharpness)


def noise_of(grey: NDArray[np.float32], options: QualityOptions = QualityOptions()) -> float:
    """Estimate the standard deviation of the noise in a photo [H, W], grey values of 0..255; NaN where nearly all is
    clipped.

    Second differences across and down cancel smooth shading; for Gaussian noise their mean size is 6 sigma sqrt(2/pi).
    The calmest tenth of all blocks is taken: texture adds to the others.
    """
    size = np.abs(cv2.filter2D(grey, -1, _SECOND_DIFFERENCE))[1:-1, 1:-1]
    usable = ((grey > options.darkest) & (grey < options.brightest)).astype(np.float32)[1:-1, 1:-1]
    values = _block_means(size, options.block)[_block_means(usable, options.block) > 0.9]
    if len(values) < 10:
        return float("nan")
    return float(np.percentile(values, 10) * np.sqrt(np.pi / 2) / 6)


def _block_means(values: NDArray[np.float32], side: int) -> NDArray[np.float32]:
    high, wide = (n // side for n in values.shape)
    blocks = values[: high * side, : wide * side].reshape(high, side, wide, side)
    return np.asarray(blocks.mean((1, 3)), np.float32)


def sharpness_of(
    grey: NDArray[np.float32], uv: NDArray[np.floating], options: QualityOptions = QualityOptions()
) -> float:
    """Measure sharpness around the observations uv [N, 2] of a photo [H, W]; see :class:`Quality`. NaN where nothing
    is.

    Squared differences over one pixel against those over four, per pixel of distance: a sharp edge gives both the
    same sum, an edge wider than four pixels a quarter of it.
    """
    x, y = np.floor(uv).astype(np.int64).T
    near = np.zeros(grey.shape, np.uint8)
    near[np.clip(y, 0, grey.shape[0] - 1), np.clip(x, 0, grey.shape[1] - 1)] = 1
    near = np.asarray(cv2.dilate(near, np.ones((options.around, options.around), np.uint8)), np.uint8)
    inner = near[_MARGIN:-_MARGIN, _MARGIN:-_MARGIN] > 0
    if not inner.any():
        return float("nan")
    return min(_along(grey, step, far, inner) for step, far in (((0, 1), 4), ((1, 0), 4), ((1, 1), 3), ((1, -1), 3)))


def _along(grey: NDArray[np.float32], step: tuple[int, int], far: int, inner: NDArray[np.bool_]) -> float:
    """Return the ratio along one direction, ``step`` in rows and columns."""
    high, wide = grey.shape

    def squares(times: int) -> float:
        y, x = _MARGIN + times * step[0], _MARGIN + times * step[1]
        moved = grey[y : high - 2 * _MARGIN + y, x : wide - 2 * _MARGIN + x]
        return float(((moved - grey[_MARGIN:-_MARGIN, _MARGIN:-_MARGIN])[inner] ** 2).sum())

    return far * squares(1) / max(squares(far), 1e-6)


def blurred_views(quality: Quality, options: QualityOptions = QualityOptions()) -> list[int]:
    """Find blurred photos, much less sharp than the median photo."""
    limit = min(options.blurred, options.out_of_line * _median(quality.sharpness))
    return np.flatnonzero(quality.sharpness < limit).tolist()


def poor_photos(quality: Quality, options: QualityOptions = QualityOptions()) -> list[str]:
    """Return a sentence each, with cause and cure, where the photos as a whole are noisy or blurred."""
    found = []
    noise, sharpness = _median(quality.noise), _median(quality.sharpness)
    if noise > options.noisy:
        found.append(
            f"The photos are noisy ({noise:.0f} of 255 grey values at working resolution); the mesh will be rough "
            "and lose detail. Take them in more light or with a lower ISO."
        )
    if sharpness < options.blurred:
        found.append(
            "The photos are blurred by three pixels or more at working resolution; the mesh will lose detail. Take "
            "them again in focus, with a shorter exposure."
        )
    return found


def _median(values: Array) -> float:
    """Compute the median; NaN, which is neither above nor below anything, where no photo tells."""
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else float("nan")
