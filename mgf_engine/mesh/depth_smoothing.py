# SPDX-License-Identifier: GPL-3.0-or-later
"""Second-order smoothing of depth maps, weighted by the precision of each matched depth.

The inverse depth of a plane is linear in pixel coordinates, so its second differences vanish on planes of any
orientation. They are minimised under a robust norm that keeps creases (second-order prior as in Woodford et al. 2009,
by iteratively reweighted least squares); the data term of a pixel is weighted by the curvature of its correlation peak.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mgf_engine.mesh.photometric import Matched
from mgf_engine.native.library import call
from mgf_engine.options.algorithms import parameter
from mgf_engine.options.config import job_option

MARGIN = 2, 16  # padding of each plane in rows and columns, as csrc/stereo/smooth_depth.c expects it
LANES = 16  # row length is a multiple of this

Array = NDArray[np.float32]


@dataclass(frozen=True)
class SmoothingOptions:
    """Options of the smoothing of depth maps; px are pixels of parallax in the neighbour that sees the most of it."""

    #: Weight of squared second differences beside a depth of precision 1; 0 leaves depths as matched.
    strength: float = job_option("depth_smoothing")
    crease: float = parameter(
        0.15, "Second difference from which it counts as a crease rather than noise", "px", low=1e-6
    )
    jump: float = parameter(2.0, "Second difference from which pixels show separate surfaces", "px")
    unmatched: float = parameter(
        0.05, "Precision of depths without a match, as a share of the median of matched depths", low=1e-6
    )
    rounds: int = parameter(3, "Number of rounds of reweighting")
    steps: int = parameter(12, "Number of conjugate-gradient steps in each round")


def smooth_depth(start: Array, matched: Matched, options: SmoothingOptions = SmoothingOptions()) -> Array:
    """Smooth a matched depth map; imprecise depths move most.

    Args:
        start: depth before matching, for finding depth jumps, 0 for no surface, float32 [H, W].
        matched: depth with its precision.
        options: of the smoothing.

    Returns:
        Depths, float32 [H, W]; unchanged without a surface, and if no pixel has a match.
    """
    shown = (start > 0) & (matched.parallax > 0)
    known = matched.precision[shown & (matched.precision > 0)]
    if not len(known):
        return matched.depth
    box = _box(shown)
    inside, scale = shown[box], float(np.median(matched.parallax[shown] / start[shown]))
    target = _inverse(np.where(inside, scale * matched.depth[box], 0))
    first = _inverse(np.where(inside, scale * start[box], 0))
    least = options.unmatched * float(np.median(known))
    weight = np.where(inside, np.maximum(matched.precision[box], least), 0)
    joined = _on_one_surface(inside, first, options.jump, 0), _on_one_surface(inside, first, options.jump, 1)
    found = smooth_map(weight, target, joined, options.strength, options.crease, options.rounds, options.steps)
    # Conjugate gradients stop before convergence: limit the change to the jump that separates surfaces.
    found = np.clip(found, target - options.jump, target + options.jump)
    result = matched.depth.copy()
    result[box] = np.where(inside & (found > 0), _inverse(scale * found), result[box])
    return result


def smooth_map(
    weight: Array,
    target: Array,
    joined: tuple[NDArray[np.bool_], NDArray[np.bool_]],
    strength: float,
    crease: float,
    rounds: int,
    steps: int,
) -> Array:
    """Smooth a map in float32, as :func:`mgf_engine.mesh.reference_depth_smoothing.smooth_map` does in float64.

    Args:
        weight: weight of the data term, [H, W]; 0 for pixels without a value.
        target: values of the data term, [H, W].
        joined: whether three pixels in a column [H-2, W], and in a row [H, W-2], belong to one surface.
        strength: weight of the squared second differences.
        crease: second difference from which on it is weighted less.
        rounds: number of rounds of reweighting.
        steps: number of conjugate-gradient steps in each round.
    """
    height, width = target.shape
    stride = 2 * MARGIN[1] + -(-width // LANES) * LANES
    planes = np.zeros((11, height + 2 * MARGIN[0], stride), np.float32)
    inner = planes[:, MARGIN[0] : MARGIN[0] + height, MARGIN[1] : MARGIN[1] + width]
    inner[0], inner[1], inner[4] = weight, target, target
    inner[2, 1:-1], inner[3, :, 1:-1] = joined
    call(
        "mgf_smooth_depth", height, width, stride, *planes[:4], float(strength), float(crease), rounds, steps,
        planes[4], planes[5:],
    )  # fmt: skip
    return inner[4]


def _inverse(values: Array) -> Array:
    """Return 1 / x where x > 0, else 0, float32."""
    return np.divide(1, values, out=np.zeros(values.shape, np.float32), where=values > 0)


def _on_one_surface(inside: NDArray[np.bool_], inverse: Array, jump: float, axis: int) -> NDArray[np.bool_]:
    """Tell whether three pixels in a column (axis 0) or row (axis 1) belong to one surface; shorter by two there."""
    i, v = (inside, inverse) if axis == 0 else (inside.T, inverse.T)
    joined = i[:-2] & i[1:-1] & i[2:] & (np.abs(v[:-2] - 2 * v[1:-1] + v[2:]) < jump)
    return joined if axis == 0 else joined.T


def _box(shown: NDArray[np.bool_]) -> tuple[slice, slice]:
    rows, columns = np.flatnonzero(shown.any(1)), np.flatnonzero(shown.any(0))
    return slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
