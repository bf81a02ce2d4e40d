# SPDX-License-Identifier: GPL-3.0-or-later
"""Validate a scene: outlier photos, outlier points, inaccurate cameras.

Outlier points and photos of another place are removed; what cannot be repaired becomes a warning with its remedy.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mgf_engine.errors import BadInput
from mgf_engine.messages import Reporter
from mgf_engine.model.scene import Scene
from mgf_engine.options.algorithms import parameter
from mgf_engine.scene.adjust import AdjustOptions, far_points
from mgf_engine.scene.exposure import observed_colors
from mgf_engine.scene.gravity import horizontal_axes, rough_up
from mgf_engine.scene.quality import QualityOptions, blurred_views, photo_quality, poor_photos
from mgf_engine.scene.roots import camera_poses, choose_held_out, choose_roots

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ValidationOptions:
    """Options of the checks of a scene."""

    outlier_consistency: float = parameter(
        0.35, "Correlation with the other photos below which a photo shows another place", low=-1, high=1
    )
    usual_consistency: float = parameter(
        0.7, "Correlation that three quarters of the photos must reach for that", low=-1, high=1
    )
    least_observations: int = parameter(30, "Minimum number of observations of a photo that is validated", low=2)
    most_unreadable: float = parameter(0.5, "Maximum share of the photos that are left out as unreadable", high=1)
    most_outliers: float = parameter(0.45, "Maximum share of the photos that are left out as outliers", high=1)
    most_blurred: float = parameter(0.3, "Maximum share of the photos that are left out as blurred", high=1)
    reprojection_error: float = parameter(0.8, "Median reprojection error that a warning is given for", "px")
    focal_lengths: float = parameter(
        0.02, "Difference between a camera's two focal lengths that is warned of; pixels of cameras are square",
        high=1,
    )  # fmt: skip
    least_photos: int = parameter(5, "Number of photos below which a warning is given")
    largest_angle: float = parameter(25.0, "Angle between neighbouring photos that a warning is given for", "degrees")
    least_points: int = parameter(30, "Number of points that half of the photos see, below which a warning is given")
    least_surround: float = parameter(225.0, "Angle around the building without a warning", "degrees", high=360)
    quality: QualityOptions = QualityOptions()
    #: What adjusting leaves out is what is reported.
    adjust: AdjustOptions = AdjustOptions()


def filter_outliers(
    scene: Scene,
    folder: Path,
    every: int,
    reporter: Reporter,
    threads: int = 1,
    options: ValidationOptions = ValidationOptions(),
) -> Scene:
    """Remove outlier points and photos of another place; warns of them, and of weaknesses that are left.

    Args:
        scene: photos, cameras and sparse points.
        folder: of the working photos under their file names, before exposures are evened.
        every: the option ``holdout_every``.
        reporter: for warnings.
        threads: number of worker threads.
        options: limits of the checks.

    Raises:
        BadInput: fewer than two photos or no points are left.
    """
    stray = find_outlier_points(scene, options.adjust)
    if stray.any():
        share = float(stray.mean())
        scene = keep_points(scene, ~stray)
        if share > 0.05:
            reporter.warning(
                f"{share:.0%} of the sparse points have large reprojection errors and are left out; build the "
                "COLMAP model again for better ones."
            )
    scene = _without_foreign(scene, observed_colors(scene, folder, threads).mean(1), every, reporter, options)
    quality = photo_quality(scene, folder, threads, options.quality)
    scene = _without_blurred(scene, blurred_views(quality, options.quality), every, reporter, options)
    for text in (*poor_photos(quality, options.quality), *diagnose(scene, options)):
        reporter.warning(text)
    return scene


def _without_foreign(
    scene: Scene, brightness: Array, every: int, reporter: Reporter, options: ValidationOptions
) -> Scene:
    """Leave out photos of another place if the others agree well enough to tell; else warn of them.

    Args:
        scene: photos and observations.
        brightness: of each observation, [T].
        every: the option ``holdout_every``.
        reporter: for warnings.
        options: limits of the correlation.
    """
    foreign, consistency = find_outlier_views(brightness, scene, options)
    others = consistency[np.isfinite(consistency)]
    if foreign:
        few = len(foreign) <= options.most_outliers * len(scene.views)
        clear = few and len(others) > 0 and bool(np.percentile(others, 25) >= options.usual_consistency)
    else:
        clear = len(others) < 3 or bool(np.percentile(others, 75) >= options.usual_consistency)
    if not clear:
        reporter.warning(
            "The photos show the same points at very different brightness: moving shadows, clipped exposure or "
            "photos of another place. Remove the photos that differ."
        )
        return scene
    if foreign:
        reporter.warning(
            f"{len(foreign)} of {len(scene.views)} photos do not match the COLMAP model and are left out "
            f"({_names(scene, foreign)}); check whether they show another place."
        )
        return drop_views(scene, foreign, every)
    return scene


def _without_blurred(
    scene: Scene, blurred: list[int], every: int, reporter: Reporter, options: ValidationOptions
) -> Scene:
    """Leave out blurred photos where the others are close enough together without them; else warn of them."""
    if not blurred:
        return scene
    text = f"{len(blurred)} of {len(scene.views)} photos are much less sharp than the others "
    if len(blurred) <= options.most_blurred * len(scene.views):
        smaller = drop_views(scene, blurred, every)
        if triangulation_angle(smaller) <= options.largest_angle:
            reporter.warning(
                f"{text}and are left out ({_names(scene, blurred)}); sharp ones in their place would help."
            )
            return smaller
    reporter.warning(f"{text}({_names(scene, blurred)}): the mesh will lose detail; take them again.")
    return scene


def _names(scene: Scene, views: list[int]) -> str:
    return ", ".join(f"'{scene.views[i].name}'" for i in views[:3]) + (", ..." if len(views) > 3 else "")


def reprojection_errors(scene: Scene) -> Array:
    """Compute the reprojection error of each observation, working pixels, [T]; inf behind a camera."""
    owner = scene.track_point
    errors = np.empty(len(owner))
    for index, view in enumerate(scene.views):
        mine = scene.observations(index)
        uv, depth = view.project(scene.points[owner[mine]])
        errors[mine] = np.where(depth > 0, np.linalg.norm(uv - scene.track_uv[mine], axis=1), np.inf)
    return errors


def find_outlier_points(scene: Scene, options: AdjustOptions = AdjustOptions()) -> NDArray[np.bool_]:
    """Find points that most of their photos see elsewhere, bool [P]."""
    return far_points(reprojection_errors(scene), scene.track_start, options)


def find_outlier_views(
    brightness: Array, scene: Scene, options: ValidationOptions = ValidationOptions()
) -> tuple[list[int], Array]:
    """Find photos whose brightness at their points hardly correlates with that in other photos.

    The worst third is taken out at a time: foreign photos lower the correlation of their neighbours, too. Empty where
    the photos hardly resemble each other at all.

    Args:
        brightness: of each observation, [T].
        scene: its points, and the views that observed each.
        options: limits of the correlation.

    Returns:
        Their numbers, ascending, and :func:`photo_consistency` of the others, [V], NaN for those found.
    """
    found: list[int] = []
    while True:
        alike = photo_consistency(brightness, scene, ~np.isin(scene.track_view, found), options)
        alike[found] = np.nan
        low = np.flatnonzero(alike < options.outlier_consistency)
        if not len(low) or np.isfinite(alike).sum() < 3 or np.nanpercentile(alike, 75) < options.usual_consistency:
            return sorted(found), alike
        found += low[np.argsort(alike[low], kind="stable")][: -(-len(low) // 3)].tolist()


def photo_consistency(
    brightness: Array, scene: Scene, trusted: NDArray[np.bool_], options: ValidationOptions = ValidationOptions()
) -> Array:
    """Correlate each photo's brightness with the mean of the other photos' at its points, [V]; NaN: too few.

    Args:
        brightness, trusted: [T], of each observation, and whether it counts among the others.
        scene: its points, and the views that observed each.
        options: how many points and photos are needed for a correlation.
    """
    owner, points = scene.track_point, len(scene.points)
    count = np.bincount(owner[trusted], minlength=points)
    total = np.bincount(owner[trusted], brightness[trusted], points)
    result = np.full(len(scene.views), np.nan)
    for index in range(len(scene.views)):
        mine = scene.observations(index)
        own, weight = np.unique(owner[mine], return_inverse=True)[1], trusted[mine].astype(np.float64)
        others = count[owner[mine]] - np.bincount(own, weight)[own]
        usable = others > 0.5
        if usable.sum() < options.least_observations:
            continue
        rest = total[owner[mine]] - np.bincount(own, weight * brightness[mine])[own]
        a, b = brightness[mine][usable], rest[usable] / others[usable]
        if a.std() >= 1e-9 and b.std() >= 1e-9:
            result[index] = np.corrcoef(a, b)[0, 1]
    return result


def keep_points(scene: Scene, keep: NDArray[np.bool_]) -> Scene:
    """Return the scene with these points (bool [P]) and their observations.

    Raises:
        BadInput: none is left.
    """
    if not keep.any():
        raise BadInput("No sparse point with a small reprojection error is left; build the COLMAP model again.")
    kept = np.repeat(keep, np.diff(scene.track_start))
    lengths = np.diff(scene.track_start)[keep]
    return replace(
        scene, points=scene.points[keep], colors=scene.colors[keep], errors=scene.errors[keep],
        track_start=np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64), track_view=scene.track_view[kept],
        track_uv=scene.track_uv[kept],
    )  # fmt: skip


def drop_views(scene: Scene, drop: list[int], every: int) -> Scene:
    """Return the scene without these views, and without points that fewer than two of the others see.

    Raises:
        BadInput: fewer than two photos are left, or no point.
    """
    left = [i for i in range(len(scene.views)) if i not in drop]
    if len(left) < 2:
        raise BadInput("Fewer than two photos show the scene of the COLMAP model; use the photos it was made from.")
    slot = np.full(len(scene.views), -1)
    slot[left] = np.arange(len(left))
    kept = slot[scene.track_view] >= 0
    before = np.concatenate([[0], np.cumsum(kept)])
    smaller = replace(
        scene, views=tuple(scene.views[i] for i in left), track_start=before[scene.track_start].astype(np.int64),
        track_view=slot[scene.track_view[kept]].astype(np.int32), track_uv=scene.track_uv[kept],
        left_out=(*scene.left_out, *(scene.views[i].name for i in drop)),
    )  # fmt: skip
    smaller = keep_points(smaller, np.diff(smaller.track_start) >= 2)
    roots = choose_roots(*camera_poses(smaller.views, smaller.track_view))
    return replace(smaller, roots=roots, held_out=choose_held_out(len(left), roots, every))


def diagnose(scene: Scene, options: ValidationOptions = ValidationOptions()) -> list[str]:
    """Return one sentence for everything that will make the mesh worse than it could be: cause and cure."""
    found = []
    errors = reprojection_errors(scene)
    median = float(np.median(errors)) if len(errors) else 0.0
    if median > options.reprojection_error:
        found.append(
            f"The COLMAP model has a reprojection error of {median:.1f} working pixels, and bundle adjustment did "
            "not help; the mesh will be inaccurate. Build the model again with the right camera model."
        )
    unequal = float(np.median([max(v.fx, v.fy) / min(v.fx, v.fy) - 1 for v in scene.views]))
    if unequal > options.focal_lengths:
        found.append(
            f"The cameras' focal lengths in x and y differ by {unequal:.1%}, but pixels of cameras are square: "
            "the mesh will be stretched by as much. Build the COLMAP model again with a camera model of one focal "
            "length, such as SIMPLE_RADIAL."
        )
    spacing = triangulation_angle(scene)
    if spacing > options.largest_angle or len(scene.views) < options.least_photos:
        found.append(
            f"There are only {len(scene.views)} photos, {spacing:.0f} degrees apart seen from the building: "
            "expect holes and depth errors. Photos 5 to 15 degrees apart would help."
        )
    seen = float(np.median(np.bincount(scene.track_view, minlength=len(scene.views))))
    if seen < options.least_points:
        found.append(
            f"Half of the photos see fewer than {seen + 1:.0f} sparse points; masks and mesh will be poor. Build "
            "the COLMAP model again with more features or from sharper photos."
        )
    around = surround_angle(scene)
    if around < options.least_surround:
        found.append(
            f"The photos cover only {around:.0f} degrees around the building; the other sides will be missing or "
            "interpolated."
        )
    return found


def triangulation_angle(scene: Scene) -> float:
    """Compute the median angle between neighbouring cameras, seen from the middle of the points; degrees."""
    away = np.array([view.centre for view in scene.views]) - np.median(scene.points, axis=0)
    towards = away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-12)
    cosine = np.clip(towards @ towards.T, -1.0, 1.0)
    np.fill_diagonal(cosine, -1.0)
    return float(np.degrees(np.median(np.arccos(cosine.max(1)))))


def surround_angle(scene: Scene) -> float:
    """Return the smallest sector around the middle of the points that holds all cameras, seen from above; degrees."""
    away = np.array([view.centre for view in scene.views]) - np.median(scene.points, axis=0)
    first, second = horizontal_axes(rough_up(scene.views).vector)
    angle = np.sort(np.degrees(np.arctan2(away @ second, away @ first)))
    gaps = np.diff(np.concatenate([angle, [angle[0] + 360.0]]))
    return float(360.0 - gaps.max())
