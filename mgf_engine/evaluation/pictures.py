# SPDX-License-Identifier: GPL-3.0-or-later
"""Images for the report: masks over photos, normals, error maps of renders, and the mesh from all sides."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.masks.contact_sheet import OCCLUDER, OUTLINE
from mgf_engine.model.masks import BACKGROUND, BUILDING, FIRST_ELEMENT, IGNORE
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.scene import Scene, View
from mgf_engine.native.parallel import parallel_map
from mgf_engine.scene.gravity import up_from_cameras

#: Absolute colour error (0..1, mean of the channels) that is drawn in the brightest colour.
ERROR_LIMIT = 0.25
_FILLED = 0.94  # share of a picture's width or height that the mesh may take
#: Outline and occluders, in the colours of the contact sheet (:mod:`mgf_engine.masks.contact_sheet`).
_BUILDING_TINT = OUTLINE[::-1]
_UNKNOWN_TINT = OCCLUDER[::-1]


def _look_of_labels() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return, of each label, which share of the photo's colour an overlay keeps [256, 1], and what it adds [256, 3]."""
    kept, added = np.ones((256, 1)), np.zeros((256, 3))
    kept[BACKGROUND] = 0.3
    kept[IGNORE], added[IGNORE] = 0.4, 0.6 * np.array(_UNKNOWN_TINT)
    elements = np.arange(FIRST_ELEMENT, IGNORE)
    hue = elements * 67 % 180  # neighbours in number are far apart in hue
    colors = np.stack([hue, np.full_like(hue, 200), np.full_like(hue, 255)], 1).astype(np.uint8)
    tint = cv2.cvtColor(colors[None], cv2.COLOR_HSV2RGB)[0]
    kept[elements], added[elements] = 0.55, 0.45 * tint
    return kept, added


_KEPT, _ADDED = _look_of_labels()


def mask_overlay(photo: NDArray[np.uint8], labels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Draw the photo with the building outlined, elements tinted, the surroundings dimmed and ignored pixels ochre."""
    picture = _KEPT[labels] * photo + _ADDED[labels]
    inside = ((labels >= BUILDING) & (labels != IGNORE)).astype(np.uint8)
    width = max(3, round(max(labels.shape) / 250) | 1)
    outline = cv2.morphologyEx(inside, cv2.MORPH_GRADIENT, np.ones((width, width), np.uint8)) > 0
    picture[outline] = _BUILDING_TINT
    return picture.clip(0, 255).astype(np.uint8)


def normal_picture(normals: NDArray[np.floating], alpha: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Return normals [h, w, 3] as colours: red to the right, green up, blue towards the camera; white where alpha is 0.

    Args:
        normals: in the camera's frame (x right, y down, z forward), of any length.
        alpha: [h, w] in 0..1.
    """
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    unit = np.where(length > 1e-6, normals / np.maximum(length, 1e-6), 0.0)
    colors = 127.5 + 127.5 * unit * (1.0, -1.0, -1.0)
    cover = np.clip(alpha, 0.0, 1.0)[..., None]
    return (cover * colors + (1.0 - cover) * 255.0).clip(0, 255).astype(np.uint8)


def error_picture(photo: NDArray[np.uint8], render: NDArray[np.uint8], mask: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Draw the absolute colour error inside the mask, dark (none) to yellow (:data:`ERROR_LIMIT` or more)."""
    error = np.abs(photo.astype(np.float64) - render).mean(-1) / 255.0 / ERROR_LIMIT
    colors = cv2.applyColorMap((error.clip(0, 1) * 255).astype(np.uint8), cv2.COLORMAP_INFERNO)
    return np.where(mask[..., None], cv2.cvtColor(colors, cv2.COLOR_BGR2RGB), 40).astype(np.uint8)


def on_white(render: NDArray[np.uint8], mask: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Return the render inside the mask, white outside."""
    return np.where(mask[..., None], render, 255).astype(np.uint8)


def turntable(
    mesh: Mesh,
    scene: Scene,
    count: int = 8,
    size: tuple[int, int] = (480, 360),
    *,
    relief: bool = False,
    grey_behind: bool = False,
) -> list[NDArray[np.uint8]]:
    """Return the mesh (normalised frame) from ``count`` sides; up is where the photographers' cameras say it is.

    Args:
        mesh: normalised frame.
        scene: its cameras tell where up is.
        count: number of pictures.
        size: width and height of each, pixels.
        relief: without colours and lit from the side, so that pits show.
        grey_behind: faces seen from behind are grey, not reddish.

    Returns:
        RGB uint8 [height, width, 3] each; nothing for a mesh without faces.
    """
    from mgf_engine.geometry.rasterize import shaded

    if not len(mesh.faces):
        return []
    views = turntable_views(mesh, scene, count, size)

    def draw(view: View) -> NDArray[np.uint8]:
        return shaded(mesh, view, color=not relief, from_side=relief, grey_behind=grey_behind)

    return list(parallel_map(draw, views))


def turntable_views(mesh: Mesh, scene: Scene, count: int, size: tuple[int, int]) -> list[View]:
    """Place cameras on a circle around the mesh, 25 degrees above it, the first one on the photographers' side.

    Args:
        mesh: normalised frame.
        scene: its cameras tell where up is, and from which side photos were taken.
        count: number of cameras.
        size: width and height of their pictures, pixels.
    """
    up = up_from_cameras(scene.views)
    centre, radius = _ball(mesh)
    towards = np.mean([view.centre for view in scene.views], axis=0) - centre
    side = towards - up * (towards @ up)
    if np.linalg.norm(side) < 1e-3 * radius:  # photographed from all around: any side may come first
        side = scene.views[0].centre - centre
    return _filling(circle_views(mesh, up, side, count, size), mesh)


def _filling(views: list[View], mesh: Mesh) -> list[View]:
    """Enlarge the pictures, all alike, until the mesh fills them: a long facade is small in the ball around it."""
    low, high = _box(mesh)
    inside = mesh.vertices[((mesh.vertices >= low) & (mesh.vertices <= high)).all(1)]
    reach = max(
        float((abs(view.project(inside)[0] - (view.cx, view.cy)) / (view.width / 2, view.height / 2)).max())
        for view in views
    )
    factor = _FILLED / max(reach, 1e-6)
    return [replace(view, fx=factor * view.fx, fy=factor * view.fy) for view in views]


def circle_views(
    mesh: Mesh, up: NDArray[np.float64], side: NDArray[np.float64], count: int, size: tuple[int, int]
) -> list[View]:
    """Place cameras on a circle around the mesh, 25 degrees above it.

    Args:
        mesh: normalised frame.
        up: unit direction.
        side: where the first camera stands, seen from the mesh; what is along ``up`` of it does not matter.
        count: number of cameras.
        size: width and height of the pictures.
    """
    centre, radius = _ball(mesh)
    side = side - up * (side @ up)
    if np.linalg.norm(side) < 1e-9:
        side = np.cross(up, [0.3, 0.5, 0.8])
    side = side / np.linalg.norm(side)
    other = np.cross(up, side)
    angles = np.arange(count) * 2 * np.pi / count
    return [_looking_at(centre, side * np.cos(a) + other * np.sin(a), up, radius, size) for a in angles]


def _ball(mesh: Mesh) -> tuple[NDArray[np.float64], float]:
    """Return the centre [3] and radius of a ball around :func:`_box`."""
    low, high = _box(mesh)
    return (low + high) / 2, max(float(np.linalg.norm(high - low)) / 2, 1e-6)


def _box(mesh: Mesh) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the corners of a box around the mesh, spires of few vertices in it, and what is far off not."""
    low, high = np.percentile(mesh.vertices, [1, 99], axis=0)
    slack = 0.3 * (high - low)
    low, high = np.maximum(mesh.vertices.min(0), low - slack), np.minimum(mesh.vertices.max(0), high + slack)
    return low, high


def _looking_at(
    centre: NDArray[np.float64],
    side: NDArray[np.float64],
    up: NDArray[np.float64],
    radius: float,
    size: tuple[int, int],
) -> View:
    lift = np.radians(25)
    distance = 3.2 * radius
    eye = centre + distance * (np.cos(lift) * side + np.sin(lift) * up)
    forward = (centre - eye) / distance
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    width, height = size
    focal = 0.46 * min(size) * distance / radius
    return View(
        name="turntable", file="", width=width, height=height, fx=focal, fy=focal, cx=width / 2, cy=height / 2,
        rotation=rotation, translation=-rotation @ eye, original_width=width, original_height=height,
    )  # fmt: skip
