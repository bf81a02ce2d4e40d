# SPDX-License-Identifier: GPL-3.0-or-later
"""Convert a sparse model to a pycolmap reconstruction: bundle adjustment, triangulation, reprojection errors.

Everything is measured in pixels of the working photos, whose longest side is the ``resolution``.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pycolmap
from numpy.typing import NDArray

from mgf_engine.scene.sparse import SparseCamera, SparseModel

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


def projection_errors(model: SparseModel, resolution: int) -> Array:
    """Compute the reprojection error of each observation, working pixels, [T]; inf behind a camera."""
    points, owner = model.points, model.points.track_point
    distances = np.full(len(owner), np.inf)
    for index, image in enumerate(model.images):
        mine = model.observations(index)
        camera = model.cameras[image.camera_id]
        local = pose(model, index) * points.xyz[owner[mine]]
        uv = np.asarray(colmap_camera(camera).img_from_cam(local)).reshape(-1, 2)
        away = np.linalg.norm(uv - image.keypoints[points.keypoint[mine]], axis=1)
        distances[mine] = np.where(np.isfinite(away), away * working_scale(camera, resolution), np.inf)
    return distances


class Bundle:
    """Some observations of a model as COLMAP's reconstruction, in working pixels, with numbers of its own from 1."""

    def __init__(self, model: SparseModel, resolution: int, observations: Indices) -> None:
        self.model, self.resolution = model, resolution
        self.scales = [working_scale(camera, resolution) for camera in model.cameras.values()]
        self.reconstruction = pycolmap.Reconstruction()
        for number, (camera, scale) in enumerate(zip(model.cameras.values(), self.scales, strict=True), start=1):
            self.reconstruction.add_camera_with_trivial_rig(colmap_camera(camera, scale, number))
        #: Numbers of the model's points that the observations are of.
        self.used = np.unique(model.points.track_point[observations])
        place = self._add_images(observations)
        self._add_points(observations, place)

    def _add_images(self, observations: Indices) -> Indices:
        """Add every photo with its share of the observations; returns where each stands in its photo's list."""
        numbers = {camera_id: number for number, camera_id in enumerate(self.model.cameras, start=1)}
        taken = np.zeros(len(self.model.points.image_ids), bool)
        taken[observations] = True
        place = np.zeros(len(taken), np.int64)
        for index, image in enumerate(self.model.images):
            mine = self.model.observations(index)
            mine = mine[taken[mine]]
            place[mine] = np.arange(len(mine))
            camera = numbers[image.camera_id]
            keypoints = image.keypoints[self.model.points.keypoint[mine]] * self.scales[camera - 1]
            self.reconstruction.add_image_with_trivial_frame(
                pycolmap.Image(name=str(index), keypoints=keypoints, camera_id=camera, image_id=index + 1),
                pose(self.model, index),
            )
        return place

    def _add_points(self, observations: Indices, place: Indices) -> None:
        """Add the points used with their tracks; ``place``: position of each observation in its photo's list, [T]."""
        points = self.model.points
        slots = {image.id: number for number, image in enumerate(self.model.images, start=1)}
        owner = points.track_point[observations]
        bounds = np.searchsorted(owner, [*self.used, np.inf])
        numbers = []
        for xyz, first, last in zip(points.xyz[self.used], bounds[:-1], bounds[1:], strict=True):
            mine = observations[first:last]
            track = [
                pycolmap.TrackElement(slots[image], at)
                for image, at in zip(points.image_ids[mine].tolist(), place[mine].tolist(), strict=True)
            ]
            numbers.append(self.reconstruction.add_point3D(xyz, pycolmap.Track(track)))
        self.numbers = np.array(numbers, np.int64)

    def triangulate(self) -> None:
        """Place every point by its observations alone; one whose rays do not meet stays."""
        options = pycolmap.EstimateTriangulationOptions()
        options.ransac.random_seed = 0
        images = self.reconstruction.images
        poses = {number: image.cam_from_world() for number, image in images.items()}
        keypoints = {number: [p.xy for p in image.points2D] for number, image in images.items()}
        cameras = {number: image.camera for number, image in images.items()}
        for number in self.numbers.tolist():
            point = self.reconstruction.point3D(number)
            seen = [(element.image_id, element.point2D_idx) for element in point.track.elements]
            found = pycolmap.estimate_triangulation(
                np.array([keypoints[image][at] for image, at in seen]), [poses[image] for image, _ in seen],
                [cameras[image] for image, _ in seen], options,
            )  # fmt: skip
            if found is not None and np.isfinite(found["xyz"]).all():
                point.xyz = found["xyz"]

    def solve(self, config: pycolmap.BundleAdjustmentConfig, scale: float) -> None:
        """Run COLMAP's bundle adjustment of what ``config`` names, with Cauchy's loss of ``scale`` working pixels."""
        self.adjuster(config, scale).solve()

    def adjuster(self, config: pycolmap.BundleAdjustmentConfig, scale: float) -> Any:
        """Return COLMAP's bundle adjuster for that, with Ceres' problem in its ``problem``, not solved yet."""
        options = pycolmap.BundleAdjustmentOptions()
        options.refine_extra_params, options.print_summary = False, False
        options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
        options.ceres.loss_function_scale = scale
        options.ceres.solver_options.num_threads = 1
        return pycolmap.create_default_ceres_bundle_adjuster(options, config, self.reconstruction)

    def points(self) -> Array:
        """Return the points used, [len(used), 3]."""
        return np.array([self.reconstruction.point3D(n).xyz for n in self.numbers.tolist()]).reshape(-1, 3)

    def adjusted(self) -> SparseModel:
        """Return the model with the poses, focal lengths and points as they are now."""
        images = []
        for number, image in enumerate(self.model.images, start=1):
            now = self.reconstruction.image(number).cam_from_world()
            images.append(replace(image, quaternion=np.roll(now.rotation.quat, 1), translation=now.translation))
        cameras = {}
        for number, camera in enumerate(self.model.cameras.values(), start=1):
            found, params = self.reconstruction.camera(number), np.array(camera.params)
            focal = list(found.focal_length_idxs())
            params[focal] = np.array(found.params)[focal] / self.scales[number - 1]
            cameras[camera.id] = replace(camera, params=tuple(params.tolist()))
        xyz = self.model.points.xyz.copy()
        xyz[self.used] = self.points()
        return replace(self.model, cameras=cameras, images=tuple(images), points=replace(self.model.points, xyz=xyz))


def pose(model: SparseModel, index: int) -> pycolmap.Rigid3d:
    """Return the camera from world of a photo."""
    image = model.images[index]
    x = image.quaternion / np.linalg.norm(image.quaternion)
    return pycolmap.Rigid3d(pycolmap.Rotation3d(np.roll(x, -1)), image.translation)  # COLMAP takes x, y, z, w


def colmap_camera(camera: SparseCamera, scale: float = 1.0, number: int = 1) -> pycolmap.Camera:
    """Return COLMAP's camera, for photos ``scale`` times as large."""
    made = pycolmap.Camera(
        model=camera.model, width=camera.width, height=camera.height, params=list(camera.params), camera_id=number
    )
    params = np.array(made.params)
    params[[*made.focal_length_idxs(), *made.principal_point_idxs()]] *= scale
    made.params = params.tolist()
    return made


def working_scale(camera: SparseCamera, resolution: int) -> float:
    """Return working pixels per pixel of the camera."""
    return min(1.0, resolution / max(camera.width, camera.height))


def centres(model: SparseModel) -> Array:
    """Return camera centres, [V, 3]."""
    return np.array([pose(model, i).inverse().translation for i in range(len(model.images))])


def transform_model(model: SparseModel, by: pycolmap.Sim3d) -> SparseModel:
    """Return the model in other coordinates."""
    images = []
    for index, image in enumerate(model.images):
        there = by.transform_camera_world(pose(model, index))
        images.append(replace(image, quaternion=np.roll(there.rotation.quat, 1), translation=there.translation))
    return replace(model, images=tuple(images), points=replace(model.points, xyz=by * model.points.xyz))
