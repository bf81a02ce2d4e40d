# SPDX-License-Identifier: GPL-3.0-or-later
"""COLMAP models of a synthetic scene from real features: structure from motion put onto the true frame, and
true cameras with triangulated points."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pycolmap
from numpy.typing import NDArray

from benchmarks.camera_path import Shot
from benchmarks.develop import Frame, Lens
from mgf_engine.errors import BadInput

_NO_LENS: Lens = (0.0, 0.0, 0.0, 0.0)
_ROUNDS = 50  # of reweighting
_FILTER = 2.0  # px of a point's error; half of COLMAP's own, for small photos
_FEWEST = 3  # photos of a model
_TIED = 1e-4  # metres; closer than this counts as exact

# COLMAP tells of every photo what it does; only what goes wrong is of interest.
pycolmap.logging.minloglevel = int(pycolmap.logging.WARNING)


def match_features(folder: Path, camera: Frame, lens: Lens = _NO_LENS) -> Path:
    """SIFT features of ``folder/images`` matched exhaustively; returns the database.

    The camera in it is what a photo's EXIF could tell: the focal length, and with a lens nothing of its distortion.
    """
    database = folder / "work/features.db"
    if database.exists():
        return database
    partial = database.with_suffix(".partial.db")
    partial.unlink(missing_ok=True)
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = "OPENCV" if any(lens) else "PINHOLE"
    reader.camera_params = ",".join(str(v) for v in (*camera[2:], *(_NO_LENS if any(lens) else ())))
    extraction = pycolmap.FeatureExtractionOptions()
    extraction.use_gpu, extraction.num_threads = False, 2
    extraction.sift.max_num_features, extraction.sift.peak_threshold = 6000, 0.004
    extraction.sift.estimate_affine_shape = extraction.sift.domain_size_pooling = True  # wide baselines
    matching = pycolmap.FeatureMatchingOptions()
    matching.use_gpu, matching.num_threads = False, 2
    pycolmap.extract_features(
        partial, folder / "images", camera_mode=pycolmap.CameraMode.SINGLE, reader_options=reader,
        extraction_options=extraction, device=pycolmap.Device.cpu,
    )  # fmt: skip
    pycolmap.match_exhaustive(partial, matching_options=matching, device=pycolmap.Device.cpu)
    partial.replace(database)
    return database


def truth_model(
    folder: Path, shots: list[Shot], camera: Frame, shift: NDArray[np.float64], lens: Lens = _NO_LENS
) -> pycolmap.Reconstruction:
    """Return ``sparse_truth``: the true cameras with points triangulated from the real features.

    Args:
        shift: [N, 3] error put on the camera centres, metres.
    """
    database = match_features(folder, camera, lens)
    model = pycolmap.Reconstruction()
    with pycolmap.Database.open(database) as db:
        images = {image.name: image for image in db.read_all_images()}
        true = db.read_all_cameras()[0]
    true.params = [*camera[2:], *(lens if any(lens) else ())]
    model.add_camera_with_trivial_rig(true)
    for shot, error in zip(shots, shift, strict=True):
        image = images[shot.name]
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(shot.rotation), shot.translation - shot.rotation @ error)
        model.add_image_with_trivial_frame(image, pose)
    options = pycolmap.IncrementalPipelineOptions()
    options.ba_refine_focal_length = options.ba_refine_extra_params = False
    options.triangulation.min_angle = 2.0
    out = folder / "work/truth_model"
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    done = pycolmap.triangulate_points(model, database, folder / "images", out, options=options)
    _publish(done, folder / "sparse_truth")
    return done


class NoModel(BadInput):
    """Structure from motion could not place the photos: where a method may fail, that is a result."""


def sfm_model(
    folder: Path, shots: list[Shot], camera: Frame, lens: Lens = _NO_LENS, refine_focal: bool = True
) -> pycolmap.Reconstruction:
    """``sparse/0``: structure from motion from the photos alone, then the similarity onto the true camera centres.

    Args:
        refine_focal: False keeps the focal length that is known: photos that all look straight down do not tell it
            from the height they were taken at.

    Raises:
        NoModel: no three photos could be placed together.
    """
    database = match_features(folder, camera, lens)
    options = pycolmap.IncrementalPipelineOptions()
    options.ba_refine_principal_point = False
    options.ba_refine_focal_length = refine_focal
    options.num_threads = 2
    database = _with_one_focal_length(database, camera, lens)
    if any(lens):
        options.mapper.filter_max_reproj_error = _FILTER
    out = folder / "work/sfm"
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    models = pycolmap.incremental_mapping(database, folder / "images", out, options=options)
    best = max(models.values(), key=lambda m: m.num_reg_images(), default=None)
    if best is None or best.num_reg_images() < _FEWEST:  # two centres do not even tell which way is up
        raise NoModel("Structure from motion found no model in the rendered photos; render more or larger ones.")
    centres = {s.name: -s.rotation.T @ s.translation for s in shots}
    names = [image.name for image in best.images.values() if image.has_pose]
    found = np.array([image.projection_center() for image in best.images.values() if image.has_pose])
    best.transform(_similarity(found, np.array([centres[n] for n in names])))
    (folder / "sparse").mkdir(exist_ok=True)
    _publish(best, folder / "sparse/0")
    return best


def _with_one_focal_length(database: Path, camera: Frame, lens: Lens) -> Path:
    """A copy of the features whose camera has one focal length, with a lens also k1 and k2.

    With few points more parameters wander. A second focal length does so even with many: photos on one ring hardly
    tell a building that is too low from a focal length that is too short across the horizon.
    """
    copy = database.with_name("one_focal_length.db")
    shutil.copy(database, copy)
    model, beyond = ("RADIAL", [0.0, 0.0]) if any(lens) else ("SIMPLE_PINHOLE", [])
    with pycolmap.Database.open(copy) as db:
        known = db.read_all_cameras()[0]
        single = pycolmap.Camera(
            model=model, width=known.width, height=known.height, params=[camera.fx, camera.cx, camera.cy, *beyond],
            camera_id=known.camera_id,
        )  # fmt: skip
        single.has_prior_focal_length = known.has_prior_focal_length
        db.update_camera(single)
    return copy


def _similarity(source: NDArray[np.float64], target: NDArray[np.float64]) -> pycolmap.Sim3d:
    """The similarity source -> target with the smallest sum of distances; points [N, 3].

    Not of their squares: a photo that is placed a metre wrong would pull the whole model, and the mesh would be
    measured where it is not. Least squares (Umeyama 1991), each point's weight the inverse of its distance (Weiszfeld
    1937).
    """
    weight = np.ones(len(source))
    for _ in range(_ROUNDS):
        scale, rotation, shift = _weighted_similarity(source, target, weight / weight.sum())
        distance = np.linalg.norm(scale * source @ rotation.T + shift - target, axis=1)
        weight = 1 / np.maximum(distance, _TIED)
    return pycolmap.Sim3d(scale, pycolmap.Rotation3d(rotation), shift)


def _weighted_similarity(
    source: NDArray[np.float64], target: NDArray[np.float64], weight: NDArray[np.float64]
) -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
    """Scale, rotation and shift of the least squares; the weights [N] sum to 1."""
    from_middle, to_middle = weight @ source, weight @ target
    a, b = source - from_middle, target - to_middle
    u, d, vt = np.linalg.svd((weight[:, None] * b).T @ a)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation = (u * sign) @ vt
    scale = float((d * sign).sum() / (weight @ (a**2).sum(1)))
    return scale, rotation, to_middle - scale * rotation @ from_middle


def _publish(model: pycolmap.Reconstruction, target: Path) -> None:
    partial = target.with_name(target.name + ".partial")
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    model.write(partial)
    shutil.rmtree(target, ignore_errors=True)
    partial.replace(target)
