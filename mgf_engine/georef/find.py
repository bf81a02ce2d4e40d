# SPDX-License-Identifier: GPL-3.0-or-later
"""Find the georeference of a scene by the best available data: control points, GPS, scale bars, or up alone."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mgf_engine.errors import BadInput
from mgf_engine.georef.control_points import CHECK, CONTROL, ControlPoints, read_control, read_marks
from mgf_engine.georef.crs import AUTO, ProjectedCrs, to_enu
from mgf_engine.georef.fit_control import ControlFit, fit_control
from mgf_engine.georef.fit_gps import MIN_GPS_POSITIONS, GpsFit, fit_gps
from mgf_engine.georef.gps import GpsPosition, read_gps_position
from mgf_engine.georef.model import METRE, SCENE_UNITS, Georeference
from mgf_engine.georef.options import GeoreferenceOptions
from mgf_engine.georef.scale_bars import MeasuredBar, measure_bars, read_bars
from mgf_engine.georef.similarity import Direction, matrix_of
from mgf_engine.georef.triangulate import TriangulatedPoint, place_points
from mgf_engine.georef.validation import check_marks, check_points, wrong_marks
from mgf_engine.model.scene import Scene, Similarity
from mgf_engine.model.up_direction import UpDirection
from mgf_engine.scene.gravity import find_up, turn_up

Array = NDArray[np.float64]
log = logging.getLogger("mgf")
#: Angle between z and up below which a scene keeps its axes: it was made upright before.
_UPRIGHT = np.radians(0.5)


@dataclass(frozen=True)
class GeoreferenceFit:
    """A georeference and what it was found from.

    Attributes:
        control: the fit to control points, or None.
        placed: marked points in the normalised frame, by name.
        bars: the scale bars.
        gps: cameras aligned to their GPS positions, or None; ``gps_views`` are their indices.
        up: up by cameras, tags or walls.
        notes: sentences for the log and the report.
    """

    georeference: Georeference
    up: UpDirection
    control: ControlFit | None = None
    placed: dict[str, TriangulatedPoint] | None = None
    bars: tuple[MeasuredBar, ...] = ()
    gps: GpsFit | None = None
    gps_views: tuple[int, ...] = ()
    notes: tuple[str, ...] = ()


def find_georeference(
    scene: Scene, options: GeoreferenceOptions, warn: Callable[[str], None], up: UpDirection | None = None
) -> GeoreferenceFit:
    """Find the georeference of a scene by control points, GPS, scale bars, or up alone.

    Args:
        scene: cameras and photos.
        options: files and CRS that the user gave, and numbers of the algorithms.
        warn: takes a sentence that the user should read.
        up: direction up, where it was found before by the same options; else it is found here.

    Raises:
        BadInput: what the user gave cannot be used; photos without GPS, or with one that does not fit, are no reason.
    """
    positions = [read_gps_position(Path(v.photo), options.position.accuracy) if v.photo else None for v in scene.views]
    up = find_up(scene, options=options.gravity) if up is None else up
    if options.gps == "off":
        positions = [None] * len(positions)
    known = np.array([[p.latitude, p.longitude, p.height] for p in positions if p is not None]).reshape(-1, 3)
    control, placed, failed = _marked(scene, options, warn)
    projection = _projection(options, control, known)
    if control.points:
        check_points(control.points, projection, known if len(known) >= MIN_GPS_POSITIONS else None)
        fit = _by_control(scene, control, placed, failed, projection, up, options)
    else:
        fit = _without_control(scene, positions, known, projection, up, options, warn)
    if options.scale_bars:
        fit = _with_bars(scene, fit, placed, options)
    for text in fit.notes:
        log.info("georeference: %s", text)
    return fit


def _marked(
    scene: Scene, options: GeoreferenceOptions, warn: Callable[[str], None]
) -> tuple[ControlPoints, dict[str, TriangulatedPoint], dict[str, str]]:
    """Return the user's points, and marked points in the normalised frame."""
    names = [view.name for view in scene.views]
    marks = Path(options.marks) if options.marks else None
    if options.control:
        control = read_control(Path(options.control), marks, names, options.point.accuracy)
    elif marks is not None:
        found, unknown_photos = read_marks(marks, names)
        control = ControlPoints(marks=found, unknown_photos=unknown_photos)
    else:
        control = ControlPoints()
    if control.unknown_photos:
        warn(
            f"Marks in {len(control.unknown_photos)} photos that are not among the job's were passed over (such as "
            f"'{control.unknown_photos[0]}'); check their names."
        )
    if control.unlisted:
        warn(
            f"Marks of {len(control.unlisted)} points that '{options.control}' does not list were passed over (such as "
            f"'{control.unlisted[0]}'); check their names."
        )
    check_marks(scene, control)
    placed, failed = place_points(scene, control.marks, options.mark)
    for text in wrong_marks(scene, control, placed, options.mark):
        warn(text)
    return control, placed, failed


def _projection(options: GeoreferenceOptions, control: ControlPoints, known: Array) -> ProjectedCrs | None:
    text = options.crs or control.crs
    near = np.median(known, axis=0) if len(known) else None
    if text == AUTO and near is None and control.crs:
        text = control.crs
    return ProjectedCrs(text, near) if text else None


def _by_control(
    scene: Scene,
    control: ControlPoints,
    placed: dict[str, TriangulatedPoint],
    failed: dict[str, str],
    projection: ProjectedCrs | None,
    up: UpDirection,
    options: GeoreferenceOptions,
) -> GeoreferenceFit:
    """Georeference a scene by control points.

    Args:
        scene: cameras of the photos.
        control: points and marks.
        placed: marked points in the normalised frame, by name.
        failed: why others could not be placed, by name.
        projection: of the points' coordinates; None if unknown.
        up: direction up in the scene.
        options: accuracies and limits.

    Raises:
        BadInput: the points do not fit.
    """
    fit = fit_control(scene, control.points, placed, failed, up.vector, options.point)
    accuracy = {}
    for role in (CONTROL, CHECK):
        rms = fit.rms(role)
        if rms is not None:
            accuracy.update({f"{role}_{axis}": float(value) for axis, value in zip("xyz", rms, strict=True)})
    heights = "as the control points have them"
    found = Georeference(
        _to_local(fit.matrix, scene.to_normalised), _three(fit.offset), None if projection is None else projection.name,
        METRE, True, True, "control", heights, _origin(projection, fit.offset), accuracy,
    )  # fmt: skip
    return GeoreferenceFit(found, up, fit, placed)


def _without_control(
    scene: Scene,
    positions: list[GpsPosition | None],
    known: Array,
    projection: ProjectedCrs | None,
    up: UpDirection,
    options: GeoreferenceOptions,
    warn: Callable[[str], None],
) -> GeoreferenceFit:
    """Georeference a scene by the GPS of its photos, or make it upright without one.

    Args:
        scene: cameras of the photos.
        positions: GPS of each photo, None without.
        known: latitude, longitude and height of those with GPS, [N, 3].
        projection: that is wanted; None for a local frame.
        up: direction up in the scene.
        options: limits of the fit.
        warn: takes a sentence about GPS that does not fit.

    Raises:
        BadInput: a CRS is wanted, and no GPS tells where the scene is.
    """
    reason = ""
    if len(known):
        fit, offset = _by_gps(scene, positions, known, projection, up, options)
        if isinstance(fit, GpsFit):
            return _gps_fit(scene, positions, fit, offset, projection, up)
        reason = fit
        if len(known) >= MIN_GPS_POSITIONS:
            warn(
                f"The GPS of the photos cannot place the building: {fit}; control points or scale bars (see "
                "docs/georeferencing.md) would."
            )
    if projection is not None:
        none = "--gps off leaves the GPS of the photos aside" if options.gps == "off" else "the photos have no GPS"
        why = reason or none
        raise BadInput(f"Nothing tells where the building is ({why}); {projection.name} needs GPS or control points.")
    return GeoreferenceFit(_upright(scene, up), up)


def _by_gps(
    scene: Scene,
    positions: list[GpsPosition | None],
    known: Array,
    projection: ProjectedCrs | None,
    up: UpDirection,
    options: GeoreferenceOptions,
) -> tuple[GpsFit | str, Array]:
    """Place cameras on their GPS, and return what was taken off easting and northing (with a CRS) or latitude and
    longitude."""
    centres = np.array([v.centre for v, p in zip(scene.views, positions, strict=True) if p is not None])
    middle = np.median(known, axis=0) * (1, 1, 0)
    if projection is None:
        middle = np.round(middle, 6)
        targets, offset = to_enu(known, middle), middle
    else:
        targets = projection.project(known)
        if not projection.covers(targets):
            raise BadInput(
                f"The photos lie outside of what {projection.name} is made for ({projection.area}); give another "
                "--crs, or auto."
            )
        offset = np.round(np.median(targets, axis=0)) * (1, 1, 0)
        targets = targets - offset
    direction = Direction(up.vector, up.sd)
    return fit_gps(centres, targets, [p for p in positions if p is not None], direction, options.position), offset


def _gps_fit(
    scene: Scene,
    positions: list[GpsPosition | None],
    fit: GpsFit,
    offset: Array,
    projection: ProjectedCrs | None,
    up: UpDirection,
) -> GeoreferenceFit:
    """Return the georeference of a fit to the GPS of photos.

    Args:
        scene: of the job.
        positions: GPS of each photo, None without.
        fit: cameras aligned to it.
        offset: origin of the fit's metres: in the projection, or latitude, longitude and height without one.
        projection: None for a local frame.
        up: direction up in the scene.
    """
    views = tuple(i for i, p in enumerate(positions) if p is not None)
    mostly = np.mean([p.ellipsoidal for p in positions if p is not None]) > 0.5
    height_kind = "ellipsoidal (WGS 84)" if mostly else "as the photos' GPS has them, mostly above sea level"
    notes: tuple[str, ...] = ()
    if projection is not None:
        heights, note = projection.heights()
        notes = (note,) if note else ()
        height_kind = heights if projection.vertical and not note else height_kind
    rms = fit.rms
    accuracy = {f"gps_{axis}": float(value) for axis, value in zip("xyz", rms, strict=True)}
    crs, origin, shift = None, _three(offset), (0.0, 0.0, 0.0)
    if projection is not None:
        crs, origin, shift = projection.name, _origin(projection, offset), _three(offset)  # type: ignore[assignment]
    found = Georeference(
        _to_local(fit.matrix, scene.to_normalised), shift, crs, METRE, True, True, "gps", height_kind, origin, accuracy
    )
    return GeoreferenceFit(found, up, gps=fit, gps_views=views, notes=notes)


def _upright(scene: Scene, up: UpDirection, scale: float | None = None) -> Georeference:
    """Georeference with up alone, and the scale where it is given (metres per unit of the normalised frame)."""
    frame = scene.to_normalised
    direction = frame.rotation.T @ up.vector  # in the scene frame
    turn = np.eye(3) if direction[2] > np.cos(_UPRIGHT) else turn_up(direction)
    unit, factor = (SCENE_UNITS, 1.0) if scale is None else (METRE, scale * frame.scale)
    accuracy = {"up_degrees": up.degrees}
    method = "up" if scale is None else "scale_bars"
    return Georeference(
        matrix_of(factor, turn, np.zeros(3)), unit=unit, up_known=True, method=method, accuracy=accuracy
    )


def _with_bars(
    scene: Scene, fit: GeoreferenceFit, placed: dict[str, TriangulatedPoint], options: GeoreferenceOptions
) -> GeoreferenceFit:
    """Take the scale from scale bars where no control points give it; there, only measure the bars."""
    bars, now = read_bars(Path(options.scale_bars), options.bar), fit.georeference
    if fit.control is not None:
        return replace(fit, bars=tuple(measure_bars(bars, placed, now.scale / scene.to_normalised.scale)[1]))
    scale, rows = measure_bars(bars, placed, None, options.bar)
    rms = float(np.sqrt(np.mean([row.error**2 for row in rows])))
    if fit.gps is None:
        found = _upright(scene, fit.up, scale)
    else:  # about the middle of the cameras, which stays where GPS puts it
        middle = np.mean([view.centre for view in scene.views], axis=0)
        place, factor = now.local(scene.to_normalised.invert(middle)), scale * scene.to_normalised.scale / now.scale
        turn = now.to_local[:3, :3] * factor
        matrix = matrix_of(1.0, turn, place - turn @ scene.to_normalised.invert(middle))
        found = replace(now, to_local=matrix)
    found = replace(found, accuracy={**found.accuracy, "scale_bars": rms})
    return replace(fit, georeference=found, bars=tuple(rows), placed=placed)


def _to_local(matrix: Array, to_normalised: Similarity) -> Array:
    """Convert the similarity from the normalised frame into one from the scene frame, both to the local frame."""
    frame = matrix_of(to_normalised.scale, to_normalised.rotation, to_normalised.translation)
    found = matrix @ frame
    found[3] = (0, 0, 0, 1)
    return np.asarray(found)


def _origin(projection: ProjectedCrs | None, offset: Array) -> tuple[float, float, float] | None:
    return None if projection is None else _three(projection.places(offset[None])[0])


def _three(values: Array) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z
