# SPDX-License-Identifier: GPL-3.0-or-later
"""Draw the picture of a building for the page of its town."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.files.images import write_picture
from mgf_engine.geometry.rasterize import render_mesh, shaded
from mgf_engine.jobs.job import Job
from mgf_engine.jobs.results import load_mesh, load_scene_of
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.scene import View

_WIDTH = 480  # px
_TRIED_SIDE = 160  # px; longest side at which the photos are compared
_CUT_OFF = 5  # weight of a pixel at the frame, where a photo cuts the building off, against one within


def draw_picture(job: Job, path: Path) -> None:
    """Draw the photo that shows most of the building, and the mesh from the same place, side by side."""
    scene, mesh = load_scene_of(job), load_mesh(job)
    mesh = Mesh(scene.to_normalised.apply(mesh.vertices), mesh.faces, mesh.colors)
    best = best_view(mesh, scene.views)
    view = scene.views[best]
    v, u = np.nonzero(render_mesh(mesh, view).face >= 0)
    if not len(u):
        return
    margin = 0.15 * max(np.ptp(u), np.ptp(v)) + 4
    left, top = (max(0, int(a.min() - margin)) for a in (u, v))
    right, bottom = (min(m, int(a.max() + margin)) for a, m in ((u, view.width), (v, view.height)))
    pair = np.hstack([scene.photo(best), shaded(mesh, view, color=True)])
    both = np.hstack([pair[top:bottom, left:right], pair[top:bottom, view.width + left : view.width + right]])
    size = _WIDTH / both.shape[1]
    small = cv2.resize(both, None, fx=size, fy=size, interpolation=cv2.INTER_AREA if size < 1 else cv2.INTER_CUBIC)
    write_picture(path, np.asarray(small, np.uint8))


def best_view(mesh: Mesh, views: Sequence[View]) -> int:
    """Return the number of the view that shows most of a mesh (normalised frame), by its pixels at a small size."""

    def small(view: View) -> View:
        size = _TRIED_SIDE / max(view.width, view.height)
        return view.resized(max(1, round(view.width * size)), max(1, round(view.height * size)))

    return int(np.argmax([_shown_share(render_mesh(mesh, small(view)).face >= 0) for view in views]))


def _shown_share(inside: NDArray[np.bool_]) -> float:
    """Rate how much of the building a photo shows, by its pixels on it [H, W]: those at the frame count against it."""
    within = int(inside[1:-1, 1:-1].sum())
    return (within - _CUT_OFF * (int(inside.sum()) - within)) / inside.size
