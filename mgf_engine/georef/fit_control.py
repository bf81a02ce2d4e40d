# SPDX-License-Identifier: GPL-3.0-or-later
"""Fit the similarity that aligns a scene with its control points."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mgf_engine.errors import BadInput
from mgf_engine.georef.control_points import CONTROL, ControlPoint
from mgf_engine.georef.options import ControlPointOptions
from mgf_engine.georef.similarity import LINE, find_inliers, refine_similarity, straightness, transform_points, umeyama
from mgf_engine.georef.triangulate import TriangulatedPoint
from mgf_engine.model.scene import Scene

Array = NDArray[np.float64]
_UPSIDE = 0.5  # cosine between up by the points and by the cameras below which heights must be wrong


@dataclass(frozen=True)
class ControlRow:
    """A point of the user's file and what the scene makes of it.

    Attributes:
        point: as given.
        residual: scene less file, metres east, north, up; NaN where it could not be placed.
        pixels: root mean square distance of its marks to its projection, pixels of the photos as taken.
        photos: number of photos it is marked in.
        used: it took part in the fit; check points never do.
        note: what is wrong with it, else empty.
    """

    point: ControlPoint
    residual: tuple[float, float, float]
    pixels: float
    photos: int
    used: bool
    note: str = ""

    @property
    def distance(self) -> float:
        """Length of the residual, metres."""
        return float(np.linalg.norm(self.residual))


@dataclass(frozen=True)
class ControlFit:
    """The scene aligned to control points: similarity [4, 4] (normalised frame -> world less ``offset``), and rows."""

    matrix: Array
    offset: Array
    rows: tuple[ControlRow, ...]

    def rms(self, role: str) -> Array | None:
        """Compute the root mean square residual of the points of a role, [3]; control points that were left out do not
        count."""
        found = [r.residual for r in self.rows if r.point.role == role and np.isfinite(r.residual[0])]
        used = [r.residual for r in self.rows if r.used] if role == CONTROL else found
        return np.sqrt(np.square(used).mean(0)) if used else None


def fit_control(
    scene: Scene,
    points: Sequence[ControlPoint],
    placed: Mapping[str, TriangulatedPoint],
    failed: Mapping[str, str],
    up: Array | None,
    options: ControlPointOptions = ControlPointOptions(),
) -> ControlFit:
    """Fit the similarity from the scene to its control points.

    Args:
        scene: cameras of the photos.
        points: control and check points.
        placed: marked points in the normalised frame, by name.
        failed: why others could not be placed, by name.
        up: approximate direction up [3], normalised frame; None if unknown.
        options: accuracies and limits.

    Raises:
        BadInput: too few points, points on a line, or points that do not fit; with the guess what is wrong.
    """
    own = [p for p in points if p.role == CONTROL and p.name in placed]
    if len(own) < 3:
        if len(points) >= 3 and not any(p.role == CONTROL for p in points):
            raise BadInput(f"All {len(points)} points are check points; at least three have to be control points.")
        reason = next((f" ('{p.name}': {failed[p.name]})" for p in points if p.name in failed), "")
        raise BadInput(
            f"Only {len(own)} control points can be placed{reason}; at least three are needed, each marked in two "
            "photos from different places."
        )
    source = np.array([placed[p.name].position for p in own])
    positions = np.array([p.position for p in own])
    offset = np.round(positions.mean(0)) * (1, 1, 0)
    target = positions - offset
    if straightness(target) < LINE or straightness(source) < LINE:
        raise BadInput("The control points lie on a line; add one beside it, else the scene can turn about them.")
    sd = np.array([p.accuracy for p in own])
    matrix, good = _fit(source, target, sd, options)
    swapped = not good.all() and _fit(source, target[:, [1, 0, 2]], sd, options)[1].sum() > good.sum()
    if swapped or 2 * good.sum() <= len(own) or _upside_down(matrix, up):
        raise BadInput(_misfit_text(source, target, sd, own, up, options))
    marks = [mark_error(scene, placed[p.name], max(options.mark_accuracy, placed[p.name].rms)) for p in own]
    pixel = np.array(marks)[:, None] * np.cbrt(np.linalg.det(matrix[:3, :3]))
    matrix = refine_similarity(matrix, source[good], target[good], np.hypot(sd, pixel)[good])
    used = {p.name for p, ok in zip(own, good, strict=True) if ok}
    return ControlFit(matrix, offset, control_rows(points, placed, failed, matrix, offset, used))


def control_rows(
    points: Sequence[ControlPoint],
    placed: Mapping[str, TriangulatedPoint],
    failed: Mapping[str, str],
    matrix: Array,
    offset: Array,
    used: set[str],
) -> tuple[ControlRow, ...]:
    """Return a row for each point, in the order of the file; ``used``: names of those that took part in the fit.

    Args:
        points: in the order of the file.
        placed: marked points in the normalised frame, by name.
        failed: why others could not be placed, by name.
        matrix: similarity [4, 4], normalised frame -> world less ``offset``.
        offset: [3], metres.
        used: names of the points that took part in the fit.
    """
    rows = []
    for p in points:
        found = placed.get(p.name)
        if found is None:
            note = failed.get(p.name, "not marked in any photo")
            rows.append(ControlRow(p, (np.nan, np.nan, np.nan), np.nan, 0, False, note))
            continue
        x, y, z = (transform_points(matrix, found.position) + offset - p.position).tolist()
        note = ""
        if p.role == CONTROL and p.name not in used:
            at = transform_points(matrix, found.position) + offset
            note = "does not fit the others, left out" + _place_of_another(p, at, points)
        photos = len({mark.view for mark in found.marks})
        rows.append(ControlRow(p, (x, y, z), found.rms, photos, p.name in used, note))
    return tuple(rows)


def _place_of_another(own: ControlPoint, at: Array, points: Sequence[ControlPoint]) -> str:
    """Say which point of the file lies where a point that does not fit was marked, as far from its own place as one
    is from the other; empty where none does."""
    away = [float(np.linalg.norm(at - p.position)) for p in points]
    nearest = points[int(np.argmin(away))]
    between = float(np.linalg.norm(np.subtract(own.position, nearest.position)))
    return f"; its marks lie on '{nearest.name}'" if min(away) < 0.1 * between else ""


def _fit(source: Array, target: Array, sd: Array, options: ControlPointOptions) -> tuple[Array, NDArray[np.bool_]]:
    """Return the similarity, and which points it explains, bool [N]; all False where it explains fewer than three."""
    extent = float(np.linalg.norm(np.ptp(target, axis=0)))
    tolerance = np.maximum(options.outlier * np.sqrt((sd**2).sum(1)), options.tolerated * extent)
    good = find_inliers(source, target, tolerance)
    if good.sum() < 3 or straightness(target[good]) < LINE:
        return umeyama(source, target), np.zeros(len(source), bool)
    return umeyama(source[good], target[good]), good


def _upside_down(matrix: Array, up: Array | None) -> bool:
    turned = matrix[:3, :3] @ up if up is not None else np.array([0.0, 0.0, 1.0])
    return bool(turned[2] < _UPSIDE * np.linalg.norm(turned))


def _misfit_text(
    source: Array,
    target: Array,
    sd: Array,
    points: Sequence[ControlPoint],
    up: Array | None,
    options: ControlPointOptions,
) -> str:
    """Return a sentence on why points do not fit: swapped axes, heights, or marks and names."""
    matrix, fits = _fit(source, target, sd, options)
    mirrored, swapped = _fit(source, target[:, [1, 0, 2]], sd, options)
    if 2 * swapped.sum() > len(points) and swapped.sum() >= fits.sum() and not _upside_down(mirrored, up):
        return "East and north of the control points seem swapped; exchange the two columns."
    if 2 * fits.sum() > len(points) and _upside_down(matrix, up):
        return (
            "By the control points the building would lie on its side or stand on its head; check the signs of their "
            "heights, and that east, north and height stand in their columns."
        )
    matrix = umeyama(source, target)
    away = np.linalg.norm(transform_points(matrix, source) - target, axis=1)
    worst = points[int(np.argmax(away))].name
    extent = float(np.linalg.norm(np.ptp(target, axis=0)))
    return (
        f"The control points do not fit their marks: off by {np.sqrt((away**2).mean()):.2f} m over {extent:.1f} m, "
        f"'{worst}' most; check its coordinates, its name in both files, and that its marks are on the right photos."
    )


def mark_error(scene: Scene, placed: TriangulatedPoint, sd: float) -> float:
    """Estimate the error of a point, normalised units, from errors of its marks of ``sd`` px of the photos as taken."""
    kept = [mark.view for mark, ok in zip(placed.marks, placed.good, strict=True) if ok]
    views = [scene.views[index] for index in kept]
    pixel = [np.linalg.norm(placed.position - v.centre) / v.fx * v.width / v.original_width for v in views]
    return float(sd * np.mean(pixel) / np.sqrt(len(views)))
