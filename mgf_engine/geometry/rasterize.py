# SPDX-License-Identifier: GPL-3.0-or-later
"""Render a mesh from a camera (z-buffer): depth, face ids and a shaded image.

A z-buffer in C (``native/csrc/mesh/zbuffer.c``); a million faces at 750x500 take a fraction of a second.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.geometry.normals import face_cross_products
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.scene import View
from mgf_engine.native.library import own_threads, parallel
from mgf_engine.raster.camera import pose_and_intrinsics

SIDE = (-0.86, -0.40, -0.32)  # where the light is that shows relief, camera axes: left of the camera and above it
NEAR = 1e-3  # of the normalised frame: faces with a vertex nearer than this are not drawn


@dataclass(frozen=True)
class MeshBuffers:
    """What a camera sees of a mesh.

    Attributes:
        depth: float32 [H, W], along the optical axis; 0 where nothing is seen.
        face: int32 [H, W], index of the face; -1 where nothing is seen.
    """

    depth: NDArray[np.float32]
    face: NDArray[np.int32]


def corners(points: NDArray[np.float64], view: View) -> NDArray[np.float64]:
    """Project points [N, 3] (normalised frame), [N, 3]: u and v in pixels, 1 / depth; all 0 if not in front."""
    result = np.empty((len(points), 3))
    points = np.ascontiguousarray(points, dtype=np.float64)
    parallel("mgf_project_vertices", len(points), points, *pose_and_intrinsics(view), NEAR, result)
    return result


def render_mesh(mesh: Mesh, view: View, at: NDArray[np.float64] | None = None) -> MeshBuffers:
    """Render depth and faces of ``mesh`` (normalised frame) from ``view``.

    Args:
        at: :func:`corners` of the mesh's vertices, where they are known already.
    """
    height, width = view.height, view.width
    at = corners(mesh.vertices, view) if at is None else at
    inverse, face = _zbuffer(at, mesh.faces, height, width)
    return MeshBuffers(np.divide(1.0, inverse, out=np.zeros_like(inverse), where=face >= 0), face)


def seen_faces(faces: NDArray[np.int32], view: View, at: NDArray[np.float64]) -> NDArray[np.int32]:
    """Find the face [F, 3] at each pixel, as in :func:`render_mesh`; ``at``: :func:`corners` of the vertices."""
    return _zbuffer(at, faces, view.height, view.width)[1]


def render_parallel(at: NDArray[np.float64], faces: NDArray[np.int32], height: int, width: int) -> MeshBuffers:
    """Render faces [F, 3] along parallel rays.

    Args:
        at: of each vertex [N, 3]: column and row in pixels, and how near it is (larger is nearer, any unit).
        faces: vertices of each, [F, 3].
        height: of the picture, pixels.
        width: of the picture, pixels.

    Returns:
        The face at each pixel, and as ``depth`` how near it is; 0 and -1 where there is none.
    """
    least = float(at[:, 2].min()) if len(at) else 0.0
    reach = max(float(np.ptp(at[:, 2])), 1e-300) if len(at) else 1.0
    # The z-buffer keeps the largest of what is linear over a triangle's image and above 0: 1 / depth, or nearness.
    near, face = _zbuffer(np.column_stack([at[:, :2], (at[:, 2] - least) / reach + 1.0]), faces, height, width)
    return MeshBuffers(
        np.where(face >= 0, (near - np.float32(1)) * np.float32(reach) + np.float32(least), np.float32(0)), face
    )


def draw_triangles(at: NDArray[np.float64], height: int, width: int) -> NDArray[np.int32]:
    """Find which triangle of [F, 3, 2] (pixels, none over another) covers each pixel's centre, -1 for none, [H, W]."""
    flat = np.concatenate([at.reshape(-1, 2), np.ones((3 * len(at), 1))], 1)
    return _zbuffer(flat, np.arange(3 * len(at), dtype=np.int32).reshape(-1, 3), height, width)[1]


def _zbuffer(
    at: NDArray[np.float64], faces: NDArray[np.int32], height: int, width: int
) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Draw 1 / depth and face at each pixel, 0 and -1 where there is none, [H, W] each; ``at`` as :func:`corners`
    gives."""
    inverse, face = np.zeros((height, width), np.float32), np.full((height, width), -1, np.int32)
    if len(faces):
        faces = np.ascontiguousarray(faces, dtype=np.int32)
        bands = 1 if own_threads() == 1 else 2 * own_threads()
        band = -(-height // bands)
        parallel("mgf_zbuffer", at, faces, len(faces), height, width, band, inverse, face, pieces=bands)
    return inverse, face


def face_normals(mesh: Mesh) -> NDArray[np.float64]:
    """Return outward unit normals [F, 3]; zero for faces without area."""
    normals = face_cross_products(mesh.vertices, mesh.faces)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return normals / np.where(length > 0, length, 1.0)


_GREY = 150.0  # of faces seen from behind, grey levels


def shaded(
    mesh: Mesh,
    view: View,
    oversample: int = 2,
    *,
    color: bool = False,
    from_side: bool = False,
    grey_behind: bool = False,
) -> NDArray[np.uint8]:
    """Return a picture of the mesh, RGB uint8 [H, W, 3] on white.

    Args:
        mesh: normalised frame.
        view: camera.
        color: with the vertex colours instead of clay; faces seen from behind are reddish either way.
        oversample: samples per pixel in each direction.
        from_side: lit from the upper left, so that pits in a wall show; else from the camera.
        grey_behind: faces seen from behind are grey, where reddish could be taken for a colour that means something.
    """
    if not len(mesh.faces):
        return np.full((view.height, view.width, 3), 255, np.uint8)
    fine = scaled_view(view, oversample)
    face = render_mesh(mesh, fine).face
    seen, index = face >= 0, np.maximum(face, 0)
    normals = (face_normals(mesh) @ fine.rotation.T).astype(np.float32)
    u, v = (rays.astype(np.float32) for rays in fine.pixel_rays())
    v = v[:, None]
    x, y, z = (normals[:, k].take(index) for k in range(3))  # unlike indexing, take lets other threads work meanwhile
    facing = -(x * u + y * v + z) / np.sqrt(u * u + v * v + 1)
    light = _from_side(x, y, z, facing) if from_side else 0.35 + 0.65 * np.abs(facing)
    light = 0.6 + 0.4 * light if color else light
    base = mesh.colors[mesh.faces].mean(1).astype(np.float32) if color else None
    picture = np.empty((*face.shape, 3), np.float32)
    for k, behind in enumerate((1.0, 0.55, 0.5)):
        own = np.float32(225.0) if base is None else base[:, k].take(index)
        away = np.float32(_GREY) if grey_behind else own * np.float32(behind)
        picture[..., k] = np.where(seen, np.minimum(light, 1) * np.where(facing >= 0, own, away), 255)
    return cv2.resize(picture, (view.width, view.height), interpolation=cv2.INTER_AREA).round().astype(np.uint8)


def _from_side(
    x: NDArray[np.float32], y: NDArray[np.float32], z: NDArray[np.float32], facing: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Return brightness in 0..1 of normals in the camera's frame by :data:`SIDE` and, weaker, by its mirror on the
    right."""
    outward = np.sign(facing)
    across = outward * x * np.float32(SIDE[0])
    rest = outward * (y * np.float32(SIDE[1]) + z * np.float32(SIDE[2]))
    return np.asarray(0.15 + 0.85 * np.maximum(rest + across, 0) + 0.55 * np.maximum(rest - across, 0), np.float32)


def scaled_view(view: View, factor: float) -> View:
    """Return the same camera with pictures ``factor`` times as large."""
    return view.resized(round(view.width * factor), round(view.height * factor))
