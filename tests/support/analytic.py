# SPDX-License-Identifier: GPL-3.0-or-later
"""Fields whose surface is known: spheres and boxes paved with flat Gaussians, seen by a ring of cameras."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import torch
import trimesh

from mgf_engine.geometry.rasterize import render_mesh
from mgf_engine.model.gaussians import Gaussians
from mgf_engine.model.masks import MaskSet
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.scene import Scene, Similarity, View

WIDTH, HEIGHT, FOCAL = 160, 128, 180.0


def camera(position, target=(0.0, 0.0, 0.0), width=WIDTH, height=HEIGHT, focal=FOCAL, name="a.png") -> View:
    position, target = np.asarray(position, float), np.asarray(target, float)
    forward = (target - position) / np.linalg.norm(target - position)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    intrinsics = (focal, focal, width / 2, height / 2)
    return View(name, name, width, height, *intrinsics, rotation, -rotation @ position, width, height)


def ring(count=16, radius=4.0, elevations=(0.1, 0.7, -0.9, 1.2)) -> list[View]:
    views = []
    for i in range(count):
        around, up = 2 * np.pi * i / count, elevations[i % len(elevations)]
        place = radius * np.array([np.cos(around) * np.cos(up), np.sin(around) * np.cos(up), np.sin(up)])
        views.append(camera(place, name=f"{i:03d}.png"))
    return views


def _turning_z_to(normals: np.ndarray) -> np.ndarray:
    """Quaternions [N, 4] (w, x, y, z) that turn the z axis to the normals."""
    axis = np.cross(np.broadcast_to((0.0, 0.0, 1.0), normals.shape), normals)
    quaternion = np.column_stack([1 + normals[:, 2], axis])
    quaternion[1 + normals[:, 2] < 1e-9] = (0, 1, 0, 0)
    return quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)


def discs(points, normals, size, opacity=0.95, thickness=0.1) -> Gaussians:
    """Flat Gaussians on a surface; ``size``: standard deviation along it, ``thickness``: across, as a share of size."""
    count = len(points)
    scales = np.log([[size, size, size * thickness]]).repeat(count, 0)
    as_tensor = lambda a: torch.tensor(np.asarray(a), dtype=torch.float32)  # noqa: E731
    return Gaussians(
        as_tensor(points), as_tensor(scales), as_tensor(_turning_z_to(np.asarray(normals, float))),
        torch.full((count,), float(np.log(opacity / (1 - opacity)))), torch.zeros(count, 16, 3),
        torch.full((count,), 1e-4),
    )  # fmt: skip


def joined(*fields: Gaussians) -> Gaussians:
    """Gaussians of several fields as one."""
    return Gaussians(*(torch.cat([getattr(f, n) for f in fields]) for n in Gaussians.__dataclass_fields__))


def sphere(count=1200, radius=1.0) -> Gaussians:
    i = np.arange(count) + 0.5
    polar, around = np.arccos(1 - 2 * i / count), np.pi * (1 + 5**0.5) * i
    normals = np.column_stack([np.cos(around) * np.sin(polar), np.sin(around) * np.sin(polar), np.cos(polar)])
    return discs(normals * radius, normals, radius * np.sqrt(4 * np.pi / count))


def box(spacing=0.1, half=(1.0, 0.7, 0.5)) -> Gaussians:
    half = np.array(half)
    points, normals = [], []
    for axis in range(3):
        others = [a for a in range(3) if a != axis]
        lines = [np.linspace(-half[a], half[a], int(2 * half[a] / spacing) + 1)[:-1] + spacing / 2 for a in others]
        u, v = np.meshgrid(*lines)
        for sign in (-1.0, 1.0):
            face, normal = np.zeros((u.size, 3)), np.zeros((u.size, 3))
            face[:, others[0]], face[:, others[1]], face[:, axis] = u.ravel(), v.ravel(), sign * half[axis]
            normal[:, axis] = sign
            points.append(face)
            normals.append(normal)
    return discs(np.concatenate(points), np.concatenate(normals), spacing)


def mesh_of(shape: trimesh.Trimesh) -> Mesh:
    colors = np.full((len(shape.vertices), 3), 200, np.uint8)
    return Mesh(np.array(shape.vertices, float), np.array(shape.faces, np.int32), colors)


def ball(radius=1.0, subdivisions=4) -> Mesh:
    return mesh_of(trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius))


def cuboid(half=(1.0, 0.7, 0.5)) -> Mesh:
    return mesh_of(trimesh.creation.box(2 * np.array(half)))


def as_trimesh(mesh: Mesh) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


class PaintedScene(Scene):
    """A scene whose photos need no files: every pixel is one colour."""

    def photo(self, index: int) -> np.ndarray:
        view = self.views[index]
        return np.full((view.height, view.width, 3), (200, 120, 40), np.uint8)


def scene_of(views: list[View], truth: Mesh, grow: int = 1) -> tuple[PaintedScene, MaskSet]:
    """A scene of these views with the silhouettes of ``truth`` as masks."""
    kernel = np.ones((2 * grow + 1, 2 * grow + 1), np.uint8)
    labels = [cv2.dilate((render_mesh(truth, v).face >= 0).astype(np.uint8), kernel) for v in views]
    scene = PaintedScene(
        tuple(views), np.zeros((0, 3)), np.zeros((0, 3), np.uint8), np.zeros(0, np.float32), np.zeros(1, np.int64),
        np.zeros(0, np.int32), np.zeros((0, 2), np.float32), Similarity(1.0, np.eye(3), np.zeros(3)),
        tuple(range(len(views))), (), Path(),
    )  # fmt: skip
    count = len(views)
    masks = MaskSet(tuple(labels), np.ones(count, bool), np.ones(count, np.float32), np.zeros(0, bool))
    return scene, masks
