# SPDX-License-Identifier: GPL-3.0-or-later
"""Place a scene in Blender's world: by an offset kept in float64 and an upright pose.

Objects hold ``scene - offset``, so that float32 does not round coordinates far from the origin; the empty above
them carries the similarity that turns the scene upright (and, later, the scale the user measured).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

#: Coordinates further from the origin than this many scene radii are moved (float32 would cost > 1e-5 of the scene).
_FAR = 50.0
#: Weight of the mean up direction against level horizons; matters only where all photos look the same way.
_LEVEL_SOFTNESS = 0.02


@dataclass(frozen=True)
class SceneFrame:
    """Placement of a scene in the world.

    Attributes:
        offset: float64 [3], taken off all scene coordinates.
        rotation: float64 [3, 3], scene -> upright world (z up).
        translation: float64 [3], after the rotation.
        radius: size of the scene, in its own units.
    """

    offset: np.ndarray
    rotation: np.ndarray
    translation: np.ndarray
    radius: float

    def matrix(self) -> np.ndarray:
        """Return the empty's world matrix [4, 4], from offset scene coordinates."""
        result = np.eye(4)
        result[:3, :3], result[:3, 3] = self.rotation, self.translation
        return result


def make_frame(xyz: np.ndarray, rotations: np.ndarray, centres: np.ndarray, upright: bool = True) -> SceneFrame:
    """Return the frame of a scene: upright by its cameras, middle of the points over the origin, ground at z = 0.

    Args:
        xyz: sparse points [P, 3], scene frame (may be empty).
        rotations: world -> camera [V, 3, 3].
        centres: camera centres [V, 3].
        upright: False keeps the scene's own axes and origin.
    """
    cloud = xyz if len(xyz) >= 10 else np.concatenate([xyz, centres])
    middle = np.median(cloud, axis=0)
    distance = np.linalg.norm(np.concatenate([cloud, centres]) - middle, axis=1)
    radius = float(max(np.percentile(distance, 95), 1e-6))
    far = np.linalg.norm(middle) > _FAR * radius
    offset = np.round(middle) if far else np.zeros(3)
    if not upright:
        return SceneFrame(offset, np.eye(3), np.zeros(3), radius)
    rotation = rotation_to_z(up_direction(rotations))
    turned = (cloud - offset) @ rotation.T
    ground = np.array([*np.median(turned[:, :2], axis=0), np.percentile(turned[:, 2], 2)])
    return SceneFrame(offset, rotation, -ground, radius)


def turn_as_held(rotation: np.ndarray, orientation: int) -> np.ndarray:
    """Turn a camera [3, 3] about its axis so that its y points down in the photo as people look at it.

    Args:
        rotation: world -> camera.
        orientation: EXIF orientation that the camera's photo lacks, 1 for none.
    """
    x, y, z = rotation
    axes = {3: (-x, -y), 4: (-x, -y), 5: (-y, x), 6: (-y, x), 7: (y, -x), 8: (y, -x)}.get(orientation, (x, y))
    return np.stack([*axes, z])


def up_direction(rotations: np.ndarray) -> np.ndarray:
    """Return the upward unit vector [3] that keeps the horizons of all cameras level.

    Photographers hold cameras level: each camera's x axis lies in the ground plane. With A the mean of x x^T and
    m the mean of -y, up solves (A + softness I) u = m. Cameras are as :func:`turn_as_held` gives them.
    """
    right, up = rotations[:, 0], -rotations[:, 1]
    level = (right[:, :, None] * right[:, None, :]).mean(axis=0)
    solution = np.linalg.solve(level + _LEVEL_SOFTNESS * np.eye(3), up.mean(axis=0))
    length = np.linalg.norm(solution)
    return solution / length if length > 1e-9 else np.array([0.0, 0.0, 1.0])


def rotation_to_z(up: np.ndarray) -> np.ndarray:
    """Return the smallest rotation [3, 3] that takes the unit vector ``up`` to +z (Rodrigues)."""
    axis, cosine = np.cross(up, (0.0, 0.0, 1.0)), float(up[2])
    if cosine < -1 + 1e-9:
        return np.diag([1.0, -1.0, -1.0])
    k = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + k + k @ k / (1 + cosine)
