# SPDX-License-Identifier: GPL-3.0-or-later
"""Draw the picture of a building for the page of its town."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.files.images import write_picture
from mgf_engine.geometry.rasterize import render_mesh, shaded
from mgf_engine.jobs.job import Job
from mgf_engine.jobs.results import load_mesh, load_scene_of
from mgf_engine.model.mesh import Mesh

_WIDTH = 480  # px
_RIM = 2  # px along the frame; a photo that shows the building there cuts it off
_CUT_OFF = 5  # weight of such a pixel against one within


def draw_picture(job: Job, path: Path) -> None:
    """Draw the photo that shows most of the building, and the mesh from the same place, side by side."""
    scene, mesh = load_scene_of(job), load_mesh(job)
    mesh = Mesh(scene.to_normalised.apply(mesh.vertices), mesh.faces, mesh.colors)
    seen = [render_mesh(mesh, view).face >= 0 for view in scene.views]
    best = int(np.argmax([_shown(inside) for inside in seen]))
    v, u = np.nonzero(seen[best])
    view = scene.views[best]
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


def _shown(inside: NDArray[np.bool_]) -> int:
    """Rate how much of the building a photo shows, by its pixels on it [H, W]: those at the frame count against it."""
    within = int(inside[_RIM:-_RIM, _RIM:-_RIM].sum())
    return within - _CUT_OFF * (int(inside.sum()) - within)
