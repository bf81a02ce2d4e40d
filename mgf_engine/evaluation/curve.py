# SPDX-License-Identifier: GPL-3.0-or-later
"""The training curve as an SVG that takes the page's text colour, so that it reads on light and dark pages."""

from __future__ import annotations

import io
import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

_INK = "#010203"  # replaced by the page's text colour
_BLUE, _ORANGE = "#3b82f6", "#f59e0b"


def curve_svg(curve: list[dict[str, Any]]) -> str:
    """Draw PSNR inside the mask on training views and the number of Gaussians, over the iterations.

    Args:
        curve: entries with ``iteration``, ``psnr`` and ``gaussians``.

    Returns:
        An ``<svg>`` element, or "" when there are fewer than two entries.
    """
    if len(curve) < 2:
        return ""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    iteration = np.array([entry["iteration"] for entry in curve], np.float64)
    psnr = np.array([entry["psnr"] for entry in curve], np.float64)
    gaussians = np.array([entry["gaussians"] for entry in curve], np.float64)
    style: dict[Any, Any] = {
        "svg.fonttype": "none", "svg.hashsalt": "mgf", "font.family": "sans-serif", "font.size": 10, "text.color": _INK,
        "axes.edgecolor": _INK, "axes.labelcolor": _INK, "xtick.color": _INK, "ytick.color": _INK,
        "axes.linewidth": 0.6,
    }  # fmt: skip
    with rc_context(style):
        figure = Figure(figsize=(12.5, 3.6), layout="constrained")
        left = figure.add_subplot()
        left.plot(iteration, psnr, color=_BLUE, alpha=0.25, linewidth=0.8)
        left.plot(iteration, smoothed(psnr), color=_BLUE, linewidth=2)
        left.set_xlabel("iteration")
        left.set_ylabel("PSNR (dB), training views", color=_BLUE)
        left.grid(True, color=_INK, alpha=0.12, linewidth=0.6)
        right = left.twinx()
        right.plot(iteration, gaussians / 1000, color=_ORANGE, linewidth=2)
        right.set_ylabel("Gaussians (thousands)", color=_ORANGE)
        right.set_ylim(bottom=0)
        for axes in (left, right):
            axes.spines["top"].set_visible(False)
            axes.margins(x=0.01)
        text = io.StringIO()
        figure.savefig(text, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    svg = text.getvalue()
    svg = svg[svg.index("<svg") :].replace(_INK, "currentColor")
    return re.sub(
        r'<svg ([^>]*?)width="[^"]*" height="[^"]*"|<svg height="[^"]*"', r'<svg \1 class="plot"', svg, count=1
    )


def smoothed(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a centred moving mean over a twentieth of the run; one photo's PSNR says little about the field."""
    half = max(1, len(values) // 40)
    padded = np.pad(values, half, mode="edge")
    return np.convolve(padded, np.full(2 * half + 1, 1 / (2 * half + 1)), mode="valid")
