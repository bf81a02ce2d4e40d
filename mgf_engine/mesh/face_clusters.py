# SPDX-License-Identifier: GPL-3.0-or-later
"""Group faces into spatial clusters, to find quickly which of them can be visible at some pixels of a view."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.geometry.rasterize import corners
from mgf_engine.model.scene import View

CLUSTER_SIZE = 256  # faces in a cluster
_ENDS = np.indices((2, 2, 2)).reshape(3, 8).T  # which end of a box each of its corners lies at, along each axis


@dataclass(frozen=True)
class FaceClusters:
    """Faces that follow each other in a mesh, and so lie close together (:mod:`mgf_engine.geometry.morton`).

    Attributes:
        faces: int32 [B, CLUSTER_SIZE, 3]; those of the last cluster may repeat its last.
        boxes: float64 [8 B, 3], corners of the boxes around the clusters.
    """

    faces: NDArray[np.int32]
    boxes: NDArray[np.float64]

    @classmethod
    def of(cls, vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> FaceClusters:
        """Make the clusters of ``faces`` [F, 3], at least one, between ``vertices`` [N, 3]."""
        count = -(-len(faces) // CLUSTER_SIZE)
        whole = np.pad(faces, ((0, count * CLUSTER_SIZE - len(faces)), (0, 0)), "edge")
        points = vertices[whole].reshape(count, 3 * CLUSTER_SIZE, 3)
        ends = np.stack([points.min(1), points.max(1)], 1)  # [B, 2, 3]
        return cls(whole.reshape(count, CLUSTER_SIZE, 3), ends[:, _ENDS, np.arange(3)].reshape(-1, 3))

    def touching(self, view: View, wanted: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Return the clusters that may show at a pixel that is ``wanted``, [H, W]; ascending."""
        at = corners(self.boxes, view).reshape(-1, 8, 3)
        front = at[..., 2] > 0
        whole, size = np.reshape(front.all(1), (-1, 1)), np.array([view.width, view.height])
        low = np.where(whole, at[..., :2].min(1) - 1, 0)  # a box around the camera may show anywhere
        high = np.where(whole, at[..., :2].max(1) + 1, size)
        x0, y0 = np.clip(np.floor(low), 0, size).astype(np.int64).T
        x1, y1 = np.clip(np.ceil(high), 0, size).astype(np.int64).T
        sums = cv2.integral(wanted.astype(np.uint8))  # of all pixels above and left
        number = np.asarray(sums[y1, x1] - sums[y0, x1] - sums[y1, x0] + sums[y0, x0])
        return np.flatnonzero((number > 0) & front.any(1))
