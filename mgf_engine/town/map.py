# SPDX-License-Identifier: GPL-3.0-or-later
"""Draw an overview map: points by height, footprints by state, cameras."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import shapely
from numpy.typing import NDArray

from mgf_engine.files.atomic import atomic_path
from mgf_engine.model.scene import Scene
from mgf_engine.town.hulls import BY_HAND, DOUBTFUL, GONE, READY, UNMAPPED, UNSEEN
from mgf_engine.town.place import PlacedFootprints, local_points

#: Colour of each state, also of the page.
COLORS = {READY: "#2b8a3e", BY_HAND: "#1864ab", DOUBTFUL: "#e67700", GONE: "#c92a2a", UNSEEN: "#868e96",
          UNMAPPED: "#ae3ec9"}  # fmt: skip
_MOST_POINTS = 60_000


def draw_map(
    path: Path, scene: Scene, placed: PlacedFootprints, outlines: list[tuple[str, str, shapely.Geometry]]
) -> None:
    """Write the map of a scene as PNG.

    Args:
        path: of the PNG.
        scene: cameras and sparse points.
        placed: the footprints, and scene frame to local frame.
        outlines: name, state and shapely polygon (local frame) of each building.
    """
    from matplotlib.figure import Figure

    points = local_points(scene, placed.georeference)
    points = points[:: max(1, len(points) // _MOST_POINTS)]
    low, high = np.percentile(points, (1, 99), axis=0)
    figure = Figure(figsize=(9, 7), layout="constrained")
    axes = figure.subplots()
    shown = axes.scatter(points[:, 0], points[:, 1], s=1.5, c=np.clip(points[:, 2], low[2], high[2]), cmap="Greys",
                         vmin=low[2] - 0.5 * (high[2] - low[2]), zorder=1)  # fmt: skip
    figure.colorbar(shown, ax=axes, shrink=0.6, label=f"height of sparse points, {placed.georeference.unit_name}")
    for name, state, polygon in outlines:
        for part in getattr(polygon, "geoms", [polygon]):
            ring = np.array(part.exterior.coords)
            axes.fill(ring[:, 0], ring[:, 1], facecolor=COLORS[state] + "40", edgecolor=COLORS[state], lw=1.6, zorder=3)
        spot = polygon.representative_point()
        if len(outlines) <= 200:
            box = {"boxstyle": "round,pad=0.2", "fc": "white", "ec": "none", "alpha": 0.8}
            axes.annotate(name, (spot.x, spot.y), ha="center", va="center", fontsize=7, zorder=4, bbox=box,
                          rotation=90 if _is_tall(polygon) else 0)  # fmt: skip
    centres: NDArray[np.float64] = placed.georeference.local(
        scene.to_normalised.invert(np.array([view.centre for view in scene.views]))
    )
    axes.plot(centres[:, 0], centres[:, 1], "^", ms=4, color="#7048e8", zorder=2, label="photos")
    for state, color in COLORS.items():
        count = sum(s == state for _, s, _ in outlines)
        if count:
            axes.plot([], [], "s", color=color, label=f"{state}: {count}")
    margin = 0.12 * (high - low)[:2].max()
    axes.set_xlim(low[0] - margin, high[0] + margin)
    axes.set_ylim(low[1] - margin, high[1] + margin)
    axes.set_aspect("equal")
    axes.set_xlabel(f"east, {placed.georeference.unit_name}")
    axes.set_ylabel(f"north, {placed.georeference.unit_name}")
    axes.legend(loc="upper right", fontsize=8)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=120, bbox_inches="tight")


def _is_tall(polygon: shapely.Geometry) -> bool:
    """Tell whether a name has more room from south to north: houses of a row stand side by side."""
    west, south, east, north = polygon.bounds
    return bool(north - south > 1.1 * (east - west))
