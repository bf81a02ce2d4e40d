# SPDX-License-Identifier: GPL-3.0-or-later
"""Cameras that disagree with the sparse points are adjusted, before any photo is undistorted.

A COLMAP model that was edited, exported half done or given another lens contradicts itself: its points do not project
to where its photos saw them. What the photos saw is still there, so poses, focal lengths and points are found anew
and laid onto the old camera centres. A model that agrees with itself is never touched, nor one that adjusting hardly
improves.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pycolmap
from numpy.typing import NDArray

from mgf_engine.messages import Reporter, log
from mgf_engine.scene.bundle import Bundle, adjust, errors, triangulate
from mgf_engine.scene.cameras import lens_camera, lens_rays
from mgf_engine.scene.model import Lens
from mgf_engine.scene.normalise import rotation_of
from mgf_engine.scene.sparse import SparseCamera, SparseModel

Array = NDArray[np.float64]
#: Median error, working pixels, from which adjusting is tried; sound models stay below 0.35.
DISAGREEING = 0.4
#: What may be left of it at most: a model that was adjusted before cannot lose as much.
BETTER = 0.6
#: A point is stray when its observations lie this far off, working pixels, beyond what is usual in the scene.
STRAY, USUAL = 4.0, 3.0
MOST_VIEWS = 600  # whose poses are solved for at once
#: Points that take part, and how many of them each view should see.
MOST_POINTS, FEWEST_PER_VIEW = 3000, 60
_ALIGNMENTS = 20


def agreeing(model: SparseModel, resolution: int, reporter: Reporter) -> SparseModel:
    """The model itself, or adjusted where its cameras and points disagree; a warning says so.

    Args:
        resolution: longest side of the working photos; errors are measured in their pixels.
    """
    if not all(lens_camera(_lens(camera)).verify_params() for camera in model.cameras.values()):
        return model  # refused where the photos are planned
    try:
        with np.errstate(all="ignore"):
            before, after, adjusted = _adjusted(model, resolution)
    except (np.linalg.LinAlgError, ValueError) as error:  # numbers beyond reason: the model stays as it is
        log.info("scene: cameras could not be adjusted (%s)", error)
        return model
    if adjusted is model:
        return model
    change = max(abs(new.params[0] / model.cameras[i].params[0] - 1) for i, new in adjusted.cameras.items())
    reporter.warning(
        f"Cameras and points of the COLMAP model disagreed by {before:.1f} pixels of the working photos and were "
        f"adjusted; {after:.1f} are left, and focal lengths changed by up to {change:.0%}. COLMAP's own bundle "
        "adjuster with the right lens would be surer."
    )
    return adjusted


def _adjusted(model: SparseModel, resolution: int) -> tuple[float, float, SparseModel]:
    """Disagreement before and after, working pixels, and the better model: the same one where it is not much better."""
    start = bundle_of(model, resolution)
    before, sound = _disagreement(start)
    if before <= DISAGREEING or not 3 <= len(model.images) <= MOST_VIEWS:
        return before, before, model
    chosen, result = _taking_part(start, sound), model
    used = np.unique(start.point[chosen])
    for _ in range(2):  # rays through a bent lens depend on its focal length: once more with the new one
        result = _onto(_with(result, triangulate(adjust(bundle_of(result, resolution), chosen))), model, used)
    after, _ = _disagreement(bundle_of(result, resolution))
    finite = (
        all(np.isfinite(image.translation).all() for image in result.images) and np.isfinite(result.points.xyz).all()
    )
    return (before, after, result) if finite and after < BETTER * before else (before, before, model)


def far_points(distances: Array, start: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Points that most of their photos see elsewhere, bool [P]. Holds while a sixth of them are sound.

    Args:
        distances: of each observation from its point's projection, working pixels, [T].
        start: observations of point i are ``start[i]:start[i + 1]``.
    """
    if not len(distances):
        return np.zeros(len(start) - 1, bool)
    limit = STRAY + USUAL * float(np.percentile(distances, 10))
    far = np.concatenate([[0], np.cumsum(distances > limit)])
    return np.asarray(far[start[1:]] - far[start[:-1]] > 0.5 * np.diff(start))


def bundle_of(model: SparseModel, resolution: int) -> Bundle:
    """The model as the adjustment wants it, centred on the cameras (coordinates may be a map's)."""
    rotations = np.array([rotation_of(image.quaternion) for image in model.images])
    translations = np.array([image.translation for image in model.images])
    points, lenses = model.points, list(model.cameras)
    slot = {image.id: i for i, image in enumerate(model.images)}
    view = np.array([slot[i] for i in points.image_ids.tolist()], np.int64)
    lens = np.array([lenses.index(image.camera_id) for image in model.images], np.int64)
    rays = np.full((len(view), 2), np.nan)
    for index, image in enumerate(model.images):
        mine = np.flatnonzero(view == index)
        camera = model.cameras[image.camera_id]
        rays[mine] = lens_rays(_lens(camera), image.keypoints[points.keypoint[mine]])
    pixels = np.array([_pixels(model.cameras[i], resolution) for i in lenses])
    raw = Bundle(
        rotations, translations, points.xyz, np.zeros(len(lenses)), lens, view,
        np.repeat(np.arange(len(points.ids)), np.diff(points.start)), rays, pixels[lens[view]],
    )  # fmt: skip
    middle = raw.centres.mean(0)
    return replace(raw, translations=translations + rotations @ middle, points=points.xyz - middle)


def _disagreement(bundle: Bundle) -> tuple[float, NDArray[np.bool_]]:
    """Median error of the observations of points that are not stray, working pixels; and which those are, bool [T]."""
    distances = errors(bundle)
    start = np.searchsorted(bundle.point, np.arange(len(bundle.points) + 1))
    sound = ~far_points(distances, start)[bundle.point] & np.isfinite(distances)
    return (float(np.median(distances[sound])) if sound.any() else 0.0), sound


def _taking_part(bundle: Bundle, sound: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Observations of points enough to settle the cameras: those that most photos see, and some for every photo."""
    seen = np.bincount(bundle.point[sound], minlength=len(bundle.points))
    order = np.argsort(-seen, kind="stable")
    taken = np.zeros(len(bundle.points), bool)
    taken[order[:MOST_POINTS]] = True
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    for index in range(len(bundle.rotations)):
        own = bundle.point[sound & (bundle.view == index)]
        taken[own[np.argsort(rank[own], kind="stable")[:FEWEST_PER_VIEW]]] = True
    return np.flatnonzero(sound & (taken & (seen >= 2))[bundle.point])


def _with(model: SparseModel, bundle: Bundle) -> SparseModel:
    """The model with the bundle's poses, points and focal lengths, in the bundle's frame."""
    quaternions = [np.roll(pycolmap.Rotation3d(turn).quat, 1) for turn in bundle.rotations]  # COLMAP gives x, y, z, w
    images = tuple(
        replace(image, quaternion=q, translation=t)
        for image, q, t in zip(model.images, quaternions, bundle.translations, strict=True)
    )
    zooms = dict(zip(model.cameras, np.exp(bundle.focal).tolist(), strict=True))
    cameras = {i: _zoomed(camera, zooms[i]) for i, camera in model.cameras.items()}
    return replace(model, cameras=cameras, images=images, points=replace(model.points, xyz=bundle.points))


def _zoomed(camera: SparseCamera, factor: float) -> SparseCamera:
    params = np.array(camera.params)
    params[list(lens_camera(_lens(camera)).focal_length_idxs())] *= factor
    return replace(camera, params=tuple(params.tolist()))


def _onto(model: SparseModel, old: SparseModel, used: NDArray[np.int64]) -> SparseModel:
    """The model moved, turned and scaled so that most cameras and points ``used`` lie where they lay."""
    source, target = (np.concatenate([_centres(m), m.points.xyz[used]]) for m in (model, old))
    weight = np.ones(len(source))
    for _ in range(_ALIGNMENTS):
        scale, rotation, offset = similarity(source, target, weight)
        away = np.linalg.norm(scale * source @ rotation.T + offset - target, axis=1)
        weight = 1.0 / np.maximum(away, max(1e-3 * float(np.median(away)), 1e-12))
    images = []
    for image in model.images:
        turn = rotation_of(image.quaternion) @ rotation.T
        quaternion = np.roll(pycolmap.Rotation3d(turn).quat, 1)
        images.append(replace(image, quaternion=quaternion, translation=scale * image.translation - turn @ offset))
    xyz = scale * model.points.xyz @ rotation.T + offset
    return replace(model, images=tuple(images), points=replace(model.points, xyz=xyz))


def similarity(source: Array, target: Array, weight: Array) -> tuple[float, Array, Array]:
    """Scale, rotation and offset that take points [N, 3] nearest to others, weights [N] (Umeyama 1991)."""
    share = weight[:, None] / weight.sum()
    from_middle, to_middle = (share * source).sum(0), (share * target).sum(0)
    a, b = source - from_middle, target - to_middle
    u, d, vt = np.linalg.svd((share * b).T @ a)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation = np.asarray((u * sign) @ vt)
    scale = float((d * sign).sum() / max(float((share * a**2).sum()), 1e-300))
    return scale, rotation, to_middle - scale * rotation @ from_middle


def _centres(model: SparseModel) -> Array:
    return np.array([-rotation_of(image.quaternion).T @ image.translation for image in model.images])


def _lens(camera: SparseCamera) -> Lens:
    return Lens(camera.model, camera.width, camera.height, camera.params)


def _pixels(camera: SparseCamera, resolution: int) -> float:
    """Working pixels per unit of a ray."""
    focal = float(np.mean([camera.params[i] for i in lens_camera(_lens(camera)).focal_length_idxs()]))
    return focal * min(1.0, resolution / max(camera.width, camera.height))
