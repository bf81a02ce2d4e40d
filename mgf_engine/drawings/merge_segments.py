# SPDX-License-Identifier: GPL-3.0-or-later
"""Merge straight segments of a drawing that lie on one line."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mgf_engine.drawings.straighten import StraightenOptions

Array = NDArray[np.float64]


def merge_segments(
    segments: list[tuple[Array, Array]], pixel: float, options: StraightenOptions = StraightenOptions()
) -> list[tuple[Array, Array]]:
    """Merge segments on one line that touch or overlap.

    Args:
        segments: start and end of each, [2].
        pixel: a ground pixel, which a gap may have.
        options: largest angle and distance of segments on one line.
    """
    merged = [s for s in segments if np.hypot(*(s[1] - s[0])) > 1e-9]
    changed = True
    while changed:
        changed, merged = _merged_once(merged, pixel, options)
    return merged


def _merged_once(
    segments: list[tuple[Array, Array]], pixel: float, options: StraightenOptions
) -> tuple[bool, list[tuple[Array, Array]]]:
    """Merge each segment, longest first, with those on its line; also tell whether any were merged."""
    segments = sorted(segments, key=lambda s: -float(np.hypot(*(s[1] - s[0]))))
    taken, result, changed = np.zeros(len(segments), bool), list[tuple[Array, Array]](), False
    if not segments:
        return False, []
    starts, ends = (np.array([s[k] for s in segments]) for k in range(2))
    spans = ends - starts
    directions = spans / np.linalg.norm(spans, axis=1, keepdims=True)
    for k in range(len(segments)):
        if taken[k]:
            continue
        taken[k] = True
        low, high = 0.0, float(np.linalg.norm(spans[k]))
        along, across = directions[k], np.array([-directions[k][1], directions[k][0]])
        off = np.maximum(np.abs((starts - starts[k]) @ across), np.abs((ends - starts[k]) @ across))
        a, b = (starts - starts[k]) @ along, (ends - starts[k]) @ along
        alike = (
            ~taken
            & (np.abs(directions @ along) > np.cos(np.radians(options.same_angle)))
            & (off < options.same_distance * pixel)
        )
        for other in np.flatnonzero(alike):
            least, most = min(a[other], b[other]), max(a[other], b[other])
            if least <= high + pixel and most >= low - pixel:
                low, high, taken[other], changed = min(low, least), max(high, most), True, True
        result.append((starts[k] + low * along, starts[k] + high * along))
    return changed, result
