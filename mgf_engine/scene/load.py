# SPDX-License-Identifier: GPL-3.0-or-later
"""Run the scene stage: from the user's folder to the job's ``scene`` folder."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mgf_engine.errors import BadInput, is_full_disk
from mgf_engine.files.atomic import atomic_folder, sweep
from mgf_engine.files.images import UnreadablePhoto, read_infos
from mgf_engine.messages import Reporter
from mgf_engine.model.photo_cache import PHOTOS
from mgf_engine.model.scene import Scene, View
from mgf_engine.options.config import Config
from mgf_engine.scene.adjust import AdjustOptions, adjust_if_inconsistent
from mgf_engine.scene.colmap import find_model, find_photos, list_photos, read_model
from mgf_engine.scene.exposure import ExposureOptions, even_exposure
from mgf_engine.scene.names import named_like
from mgf_engine.scene.normalise import normalise, normalise_pose, rotation_of
from mgf_engine.scene.photos import Photo, make_photos, plan_photos
from mgf_engine.scene.roots import camera_poses, choose_held_out, choose_roots, sample_views
from mgf_engine.scene.sfm import SfmOptions, run_sfm
from mgf_engine.scene.sparse import SparseModel
from mgf_engine.scene.store import FILE, save_scene
from mgf_engine.scene.unreadable import check_readable, find_unreadable, warn_of_unreadable
from mgf_engine.scene.validation import ValidationOptions, drop_views, filter_outliers
from mgf_engine.system.machine import cores

log = logging.getLogger("mgf")

#: A model, the scene of it, what makes a scene of another model, options, reporter -> the model with other cameras.
Adjust = Callable[[SparseModel, Scene, Callable[[SparseModel], Scene], Config, Reporter], SparseModel]
_SFM_SHARE = 0.9


def load_scene(
    source: Path,
    folder: Path,
    config: Config,
    reporter: Reporter,
    clicked: Sequence[str] = (),
    adjust: Adjust | None = None,
) -> Scene:
    """Read the user's scene and write the job's ``scene`` folder.

    Args:
        source: a COLMAP scene (any usual layout), the model's folder itself, or a folder of photos alone.
        folder: the job's ``scene`` folder; made if needed. It holds a readable scene only when this returns.
        config: options; those of the section ``scene`` and ``threads`` are used.
        reporter: for progress, warnings and the request to cancel.
        clicked: photos as the user's clicks name them; they are used also where ``max_photos`` leaves others out.
        adjust: moves the cameras to what else is known of the place, before any photo is undistorted.

    Raises:
        BadInput: anything about the model or the photos that cannot be used; nothing half-written stays.
        OSError: the disk is full.
    """
    source, folder = source.resolve(), folder.resolve()
    if not source.is_dir():
        raise BadInput(f"The scene '{source}' is not a folder; give a COLMAP scene or a folder of photos.")
    made = not folder.exists()
    try:
        (folder / FILE).unlink(missing_ok=True)
        sweep(folder)
        with atomic_folder(folder / "images") as working:
            scene = _load(source, folder, working, config, reporter, clicked, adjust)
        PHOTOS.clear()  # their files were renamed
        save_scene(scene)
        return scene
    except OSError as error:
        if is_full_disk(error):
            raise
        reason = error.strerror or str(error)
        raise BadInput(
            f"Cannot read the scene or write to '{folder}' ({reason}); check the disk and the permissions."
        ) from error
    finally:
        if made and folder.is_dir() and not any(folder.iterdir()):
            folder.rmdir()


@dataclass(frozen=True)
class _Found:
    """A model and its photos.

    Attributes:
        paths: of the photos, in the order of the model's images.
        unreadable: photos that structure from motion could not read, by name.
        unplaced: names of the photos that it could not register.
        done: share of the stage that finding it took.
    """

    model: SparseModel
    paths: list[Path]
    unreadable: dict[str, UnreadablePhoto] = field(default_factory=dict)
    unplaced: tuple[str, ...] = ()
    done: float = 0.0


def _load(
    source: Path,
    folder: Path,
    working: Path,
    config: Config,
    reporter: Reporter,
    clicked: Sequence[str],
    adjust: Adjust | None,
) -> Scene:
    """Find the model, place its cameras, write the photos that are used, and check them."""
    reporter.progress(0.0)
    found = _find(source, folder, config, reporter)
    scene, photos = _place(found, folder, config, reporter, adjust)
    wanted = _choose_views(scene, config.max_photos, clicked)
    used = _write_photos(found, [photos[i] for i in wanted], working, config, reporter)
    if len(used) < len(photos):
        log.info("scene: %d of %d photos are used", len(used), len(photos))
        kept = {wanted[i] for i in used}
        scene = drop_views(scene, [i for i in range(len(photos)) if i not in kept], config.holdout_every)
    scene = _check(scene, working, config, reporter)
    return replace(scene, left_out=(*scene.left_out, *found.unreadable, *found.unplaced))


def _find(source: Path, folder: Path, config: Config, reporter: Reporter) -> _Found:
    """Read the user's model, adjusted where it is inconsistent; or one by structure from motion where there is none."""
    job = folder.parent
    exclude = folder if source == job or job in source.parents else job
    model_folder = find_model(source, exclude)
    if model_folder is None:
        return _reconstruct(source, exclude, folder / "sfm", config, reporter)
    model = read_model(model_folder)
    model = adjust_if_inconsistent(model, config.resolution, reporter, config.algorithm(AdjustOptions))
    return _Found(model, find_photos([image.name for image in model.images], model_folder, source, exclude))


def _reconstruct(source: Path, exclude: Path, folder: Path, config: Config, reporter: Reporter) -> _Found:
    """Make a model of a folder of photos by structure from motion; warns of photos that it could not register."""
    root, names = list_photos(source, exclude)
    headers = dict(zip(names, read_infos([root / name for name in names]), strict=True))
    infos = {name: info for name, info in headers.items() if not isinstance(info, UnreadablePhoto)}
    unreadable = {name: error for name, error in headers.items() if isinstance(error, UnreadablePhoto)}
    check_readable(unreadable, len(names), config.algorithm(ValidationOptions).most_unreadable)
    options = config.algorithm(SfmOptions)
    model = read_model(run_sfm(root, infos, folder, options, reporter, lambda f: f * _SFM_SHARE))
    unplaced = sorted(infos.keys() - {image.name for image in model.images})
    unreadable |= find_unreadable(root, unplaced)  # COLMAP does not say why it passes over a photo
    unplaced = [name for name in unplaced if name not in unreadable]
    if unplaced:
        reporter.warning(
            f"{len(unplaced)} of {len(names)} photos could not be registered and are left out; photos taken "
            "closer together, with more overlap, would help."
        )
    return _Found(model, [root / image.name for image in model.images], unreadable, tuple(unplaced), _SFM_SHARE)


def _write_photos(found: _Found, photos: list[Photo], working: Path, config: Config, reporter: Reporter) -> list[int]:
    """Write the working photos; warns of those that cannot be read, and returns the indices of the others."""
    count = len(photos) + len(found.unreadable)

    def progress(fraction: float) -> None:
        reporter.progress(found.done + (1.0 - found.done) * fraction, photos=len(photos))

    lost = make_photos(photos, working, config.threads, progress)
    unreadable = found.unreadable | {photos[i].name: error for i, error in lost.items()}
    check_readable(unreadable, count, config.algorithm(ValidationOptions).most_unreadable)
    warn_of_unreadable(unreadable, count, reporter)
    return [i for i in range(len(photos)) if i not in lost]


def _place(
    found: _Found, folder: Path, config: Config, reporter: Reporter, adjust: Adjust | None
) -> tuple[Scene, list[Photo]]:
    """Make the scene of a model, after ``adjust`` moved its cameras, and its photos as they will be undistorted."""

    def build(model: SparseModel, reporter: Reporter) -> tuple[Scene, list[Photo]]:
        photos = plan_photos(model, found.paths, config.resolution, reporter)
        return build_scene(model, photos, folder, config), photos

    scene, photos = build(found.model, reporter)
    if adjust is None:
        return scene, photos
    quiet = Reporter()  # the first planning has warned of all there is
    return build(adjust(found.model, scene, lambda model: build(model, quiet)[0], config, reporter), quiet)


def _check(scene: Scene, working: Path, config: Config, reporter: Reporter) -> Scene:
    """Remove outliers, and bring the working photos to one exposure."""
    threads = config.threads or cores()
    checks = config.algorithm(ValidationOptions)
    scene = filter_outliers(scene, working, config.holdout_every, reporter, threads, checks)
    if not config.even_exposure:
        return scene
    gains = even_exposure(scene, working, threads, config.algorithm(ExposureOptions))
    log.info("scene: photos brought to one exposure, factors %.2f to %.2f", gains.min(), gains.max())
    views = (replace(v, gain=(r, g, b)) for v, (r, g, b) in zip(scene.views, gains.tolist(), strict=True))
    return replace(scene, views=tuple(views))


def _choose_views(scene: Scene, limit: int, clicked: Sequence[str]) -> list[int]:
    """Choose at most ``limit`` views (0: all), those with clicks and then those farthest from them."""
    count = len(scene.views)
    if limit == 0 or limit >= count:
        return list(range(count))
    names = [view.name for view in scene.views]
    wanted = {index for name in clicked for index in named_like(name, names)}
    return sorted(sample_views(*camera_poses(scene.views, scene.track_view), limit, wanted))


def build_scene(model: SparseModel, photos: list[Photo], folder: Path, config: Config) -> Scene:
    """Make cameras, points and tracks in the normalised frame at working resolution.

    Args:
        model: the user's cameras and points.
        photos: planned, in the order of the model's images.
        folder: of the job's scene.
        config: share of photos held out.
    """
    rotations = [rotation_of(image.quaternion) for image in model.images]
    centres = np.array([-r.T @ image.translation for r, image in zip(rotations, model.images, strict=True)])
    points = model.points
    to_normalised = normalise(points.xyz, np.diff(points.start), centres)
    views = tuple(
        _view(photo, *normalise_pose(rotation, image.translation, to_normalised))
        for image, photo, rotation in zip(model.images, photos, rotations, strict=True)
    )
    start, track_view, track_uv = _tracks(model, photos)
    roots = choose_roots(*camera_poses(views, track_view))
    return Scene(
        views=views, points=to_normalised.apply(points.xyz), colors=points.rgb,
        errors=np.maximum(np.nan_to_num(points.errors, nan=0.0, posinf=0.0), 0.0).astype(np.float32),
        track_start=start, track_view=track_view, track_uv=track_uv, to_normalised=to_normalised, roots=roots,
        held_out=choose_held_out(len(views), roots, config.holdout_every), folder=folder,
    )  # fmt: skip


def _view(photo: Photo, rotation: NDArray[np.float64], translation: NDArray[np.float64]) -> View:
    camera = photo.camera
    return View(
        name=photo.name.replace("\\", "/"), file=f"images/{photo.file}", width=camera.width, height=camera.height,
        fx=camera.fx, fy=camera.fy, cx=camera.cx, cy=camera.cy, rotation=rotation, translation=translation,
        original_width=photo.width, original_height=photo.height, lens=camera.lens,
        photo=str(photo.path), orientation=photo.orientation, held=photo.held,
        gravity=photo.gravity,
    )  # fmt: skip


def _tracks(
    model: SparseModel, photos: list[Photo]
) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.float32]]:
    """Convert observations to working pixels, those outside the working photos left out (CSR arrays)."""
    points, track_view = model.points, model.track_view
    uv = np.full((len(track_view), 2), np.nan)
    for index, (image, photo) in enumerate(zip(model.images, photos, strict=True)):
        mine = model.observations(index)
        observed = image.keypoints[points.keypoint[mine]]
        uv[mine] = photo.camera.keypoints(observed, model.cameras[image.camera_id])
    limit = np.array([(p.camera.width, p.camera.height) for p in photos], np.float64)
    uv32 = uv.astype(np.float32)
    inside = ((uv32 >= 0) & (uv32 < limit[track_view])).all(1)
    kept = np.concatenate([[0], np.cumsum(inside)])
    return kept[points.start].astype(np.int64), track_view[inside], uv32[inside]
