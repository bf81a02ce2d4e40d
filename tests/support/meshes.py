# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes made of others, and one of nothing."""

from __future__ import annotations

import numpy as np

from mgf_engine.model.mesh import Mesh


def merged(*meshes: Mesh) -> Mesh:
    starts = np.cumsum([0, *(len(m.vertices) for m in meshes[:-1])])
    faces = [m.faces + s for m, s in zip(meshes, starts, strict=True)]
    return Mesh(
        np.concatenate([m.vertices for m in meshes]),
        np.concatenate(faces).astype(np.int32),
        np.concatenate([m.colors for m in meshes]),
    )


def empty() -> Mesh:
    return Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32), np.zeros((0, 3), np.uint8))
