# SPDX-License-Identifier: GPL-3.0-or-later
"""Render a mesh with its texture, for comparison with photos."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mgf_engine.geometry.rasterize import corners, render_mesh
from mgf_engine.model.mesh import Mesh, Texture
from mgf_engine.model.pixels import sample_pixels
from mgf_engine.model.scene import View
from mgf_engine.texture.bake import barycentric


def draw_textured(mesh: Mesh, texture: Texture, view: View) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Draw the mesh (normalised frame) from a view, unlit on white, RGB uint8 [H, W, 3], and where it is seen,
    [H, W]."""
    face = render_mesh(mesh, view).face
    rows, columns = np.nonzero(face >= 0)
    owner = face[rows, columns]
    at = corners(mesh.vertices, view)[mesh.faces[owner]]
    weight = barycentric(at[..., :2], np.stack([columns, rows], 1) + 0.5) * at[..., 2]  # 1 / depth: perspective
    weight /= weight.sum(1, keepdims=True)
    u, v = (texture.uv[owner] * weight[..., None]).sum(1).T
    height, width = texture.image.shape[:2]
    picture = np.full((*face.shape, 3), 255, np.uint8)
    picture[rows, columns] = sample_pixels(texture.image, np.stack([u * width, (1 - v) * height], 1))
    return picture, face >= 0
