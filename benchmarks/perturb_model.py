# SPDX-License-Identifier: GPL-3.0-or-later
"""Worse COLMAP models: fewer photos, shaken poses, a wrong lens, missing and scattered points, odd frames."""

from __future__ import annotations

import math

import numpy as np
import pycolmap
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from benchmarks.perturb_copy import SceneCopy
from benchmarks.prompts import spread_photos


def keep_photos(copy: SceneCopy, count: float) -> None:
    """``count`` photos, spread over the flight."""
    images = copy.images
    poses = np.array([[*i.projection_center(), *i.cam_from_world().rotation.matrix()[2]] for i in images])
    copy.drop_photos([str(images[i].name) for i in spread_photos(poses, int(count))])


def keep_side(copy: SceneCopy, degrees: float) -> None:
    """Only photos from a sector around the building, centred on where most cameras stand; at least three."""
    images = copy.images
    centres = np.array([i.projection_center() for i in images])
    away = centres - np.median(_points(copy), axis=0)
    angle = np.degrees(np.arctan2(away[:, 1], away[:, 0]))
    apart = np.abs((angle[:, None] - angle[None] + 180) % 360 - 180)
    middle = int((apart <= degrees / 2).sum(1).argmax())
    order = np.argsort(apart[middle])
    count = max(3, int((apart[middle] <= degrees / 2).sum()))
    copy.drop_photos([str(images[i].name) for i in order[:count]])


def shake_poses(copy: SceneCopy, pixels: float) -> None:
    """Every camera turned and moved, each moving the building by about ``pixels`` (root mean square) in the photo.

    Keypoints and points stay: the model no longer agrees with itself, as after a bad adjustment.
    """
    middle = np.median(_points(copy), axis=0)
    for image in copy.images:
        pose, focal = image.cam_from_world(), float(image.camera.mean_focal_length())
        angle = copy.pixels(pixels) / focal / math.sqrt(2)
        distance = float(np.linalg.norm(image.projection_center() - middle))
        turn = Rotation.from_rotvec(copy.rng.normal(0, angle / math.sqrt(2), 3)).as_matrix()
        move = copy.rng.normal(0, angle * distance / math.sqrt(2), 3)
        rotation = turn @ pose.rotation.matrix()
        centre = image.projection_center() + move
        image.frame.set_cam_from_world(
            image.camera_id, pycolmap.Rigid3d(pycolmap.Rotation3d(rotation), -rotation @ centre)
        )
    copy.touch_model()


def wrong_focal(copy: SceneCopy, percent: float) -> None:
    """Every focal length too long by ``percent``; poses and points stay."""
    for camera in copy.model.cameras.values():
        params = np.array(camera.params)
        params[list(camera.focal_length_idxs())] *= 1 + percent / 100
        camera.params = params
    copy.touch_model()


def drop_points(copy: SceneCopy, share: float) -> None:
    """This share of the sparse points gone, with their observations."""
    ids = sorted(copy.model.point3D_ids())
    for point in copy.rng.permutation(ids)[: round(share * len(ids))]:
        copy.model.delete_point3D(int(point))
    copy.touch_model()


def scatter_points(copy: SceneCopy, share: float) -> None:
    """This share of the sparse points anywhere within the box of all; their observations stay."""
    points = _points(copy)
    low, high = np.percentile(points, 2, axis=0), np.percentile(points, 98, axis=0)
    ids = sorted(copy.model.point3D_ids())
    for point in copy.rng.permutation(ids)[: round(share * len(ids))]:
        copy.model.point3D(int(point)).xyz = copy.rng.uniform(low, high)
    copy.touch_model()


def scale(copy: SceneCopy, factor: float) -> None:
    """All coordinates multiplied."""
    copy.model.transform(pycolmap.Sim3d(factor, pycolmap.Rotation3d(), np.zeros(3)))
    copy.scale = factor
    copy.touch_model()


def offset(copy: SceneCopy, metres: float) -> None:
    """All coordinates moved, as in a map's grid: by ``metres`` in x, five times as far in y, little in z."""
    moved = np.array([metres, 5.0 * metres, 1e-4 * metres])
    copy.model.transform(pycolmap.Sim3d(1.0, pycolmap.Rotation3d(), moved))
    copy.offset = moved
    copy.touch_model()


def _points(copy: SceneCopy) -> NDArray[np.float64]:
    return np.array([point.xyz for point in copy.model.points3D.values()])
