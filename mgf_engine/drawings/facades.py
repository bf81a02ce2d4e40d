# SPDX-License-Identifier: GPL-3.0-or-later
"""Find the facades of a building: the main directions of its wall area, each with its largest plane."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mgf_engine.drawings.model import LEANING, Array, DrawingFrame, Facade, Survey
from mgf_engine.errors import BadInput
from mgf_engine.options.algorithms import parameter

COMPASS = ("north", "north-east", "east", "south-east", "south", "south-west", "west", "north-west")


@dataclass(frozen=True)
class FacadeOptions:
    """Options of the search for facades."""

    bins: int = parameter(720, "Number of bins of the histogram of wall directions", low=8)
    blur: float = parameter(4.0, "Standard deviation of the blur of that histogram", "degrees", low=0.01)
    same_direction: float = parameter(
        10.0, "Largest angle between the walls of one facade and its direction", "degrees", high=90
    )
    other_direction: float = parameter(25.0, "Smallest angle between two facades", "degrees", high=180)
    least_area: float = parameter(0.12, "Minimum wall area of a facade, as a share of the largest facade's", high=1)
    least_share: float = parameter(
        0.045, "Minimum area of a facade's plane, as a share of the rectangle around the building as seen from there",
        high=1,
    )  # fmt: skip
    plane_distance: float = parameter(
        3.0, "Largest distance of a face from the plane of its facade, in pixels of the photos", "ground px"
    )
    most: int = parameter(12, "Maximum number of facades", low=1)


def find_facades(survey: Survey, options: FacadeOptions = FacadeOptions()) -> list[Facade]:
    """Find the facades, in order around the building: from north over east, or from the largest where north is unknown.

    Raises:
        BadInput: no wall faces any direction more than others.
    """
    wall = np.flatnonzero(np.abs(survey.normals[:, 2]) < LEANING)
    normals, areas = survey.normals[wall], survey.areas[wall]
    azimuth = np.degrees(np.arctan2(normals[:, 0], normals[:, 1])) % 360
    left, found = np.ones(len(wall), bool), list[tuple[float, NDArray[np.int64]]]()
    largest = 0.0
    while left.any() and len(found) < options.most:
        peak = _peak(azimuth[left], areas[left], options)
        peak, near = _refined(peak, azimuth, areas, options)
        near &= left
        area = float(areas[near].sum())
        largest = max(largest, area)
        if area < options.least_area * largest or not near.any():
            break
        if not any(abs(_angle_between(peak, other)) < options.other_direction for other, _ in found):
            found.append((peak, wall[near]))
        left &= np.abs(_angle_between(azimuth, peak)) > options.other_direction
    if not found or largest < 0.02 * survey.areas.sum():
        raise BadInput(
            "The mesh has no vertical plane that could be a facade; name one with three of its points: "
            '--facade "x,y,z x,y,z x,y,z".'
        )
    facades = [_facade(survey, direction, faces, options) for direction, faces in found]
    largest_plane = max(float(survey.areas[facade.wall].sum()) for facade in facades)
    facades = [facade for facade in facades if _is_side(survey, facade, largest_plane, options)]
    return _named(facades, survey.georeference.north_known)


def _is_side(survey: Survey, facade: Facade, largest: float, options: FacadeOptions) -> bool:
    """Tell whether a facade is drawn: the one with the largest plane, or one whose plane fills enough of its elevation.

    Narrow faces of turrets, buttresses and frayed corners add up to a direction, but none of them is a wall to draw.

    Args:
        survey: mesh in the local frame.
        facade: a direction and its largest plane.
        largest: area of the largest plane of all facades.
        options: least share of the elevation.
    """
    area = float(survey.areas[facade.wall].sum())
    return area >= largest or area >= options.least_share * float(np.prod(facade.frame.size))


def facade_through(survey: Survey, points: Array, name: str, options: FacadeOptions = FacadeOptions()) -> Facade:
    """Return the facade through three points [3, 3] of the scene frame.

    Args:
        survey: mesh in the local frame, and what is known of it.
        points: [3, 3], scene frame.
        name: of the facade.
        options: how level or steep it may be.

    Raises:
        BadInput: the points lie on a line, on a level plane, or on one beside the building.
    """
    at = survey.local(points)
    normal = np.cross(at[1] - at[0], at[2] - at[0])
    spread = max(float(np.linalg.norm(at - at.mean(0), axis=1).max()), 1e-300)
    if np.linalg.norm(normal) < 1e-3 * spread**2:
        raise BadInput("The three points of --facade lie on a line; give three corners of the facade.")
    normal /= np.linalg.norm(normal)
    if abs(normal[2]) > 0.5:
        raise BadInput("The three points of --facade lie on a level plane; give three corners of a wall.")
    cameras = survey.local(survey.scene.to_normalised.invert(np.stack([v.centre for v in survey.scene.views])))
    outward = np.sign(np.median((cameras - at.mean(0)) @ normal)) or 1.0
    normal = normal * outward
    direction = float(np.degrees(np.arctan2(normal[0], normal[1])) % 360)
    facing = np.flatnonzero(survey.normals @ normal > np.cos(np.radians(options.same_direction)))
    away = (survey.centres[facing] - at.mean(0)) @ normal
    before = (survey.mesh.vertices - at.mean(0)) @ normal
    if before.min() > 0 or before.max() < 0:
        raise BadInput(
            f"The plane through the three points of --facade misses the building by {np.abs(before).min():.2f}; give "
            "corners of a wall in the coordinates of mesh.ply."
        )
    wall = facing[np.abs(away) < options.plane_distance * survey.pixel]
    frame = _frame(survey, direction, float(_level(direction) @ at.mean(0)), name)
    return Facade(frame, direction, wall, float(np.degrees(np.arcsin(-normal[2]))))


def plan_frame(survey: Survey, facades: list[Facade]) -> DrawingFrame:
    """Return the level frame seen from above: x is east where north is known, else along the first facade."""
    x = np.array([1.0, 0.0, 0.0])
    if not survey.georeference.north_known and facades:
        x = facades[0].frame.x
    y = np.cross([0.0, 0.0, 1.0], x)
    return _with_extent(survey, DrawingFrame("plan", np.zeros(3), x, y, np.zeros(2), np.zeros(2)))


def _angle_between(one: NDArray[np.float64] | float, other: float) -> NDArray[np.float64]:
    """Compute signed angles between directions in degrees, -180..180."""
    return np.asarray((np.asarray(one) - other + 180) % 360 - 180)


def _peak(azimuth: Array, areas: Array, options: FacadeOptions) -> float:
    """Return the direction with most wall area, in degrees; the last of equal ones."""
    count = np.bincount((azimuth * options.bins / 360).astype(int) % options.bins, areas, options.bins)
    step = np.minimum(np.arange(options.bins), options.bins - np.arange(options.bins)) * 360 / options.bins
    blurred = np.fft.irfft(np.fft.rfft(count) * np.fft.rfft(np.exp(-0.5 * (step / options.blur) ** 2)), options.bins)
    equal = np.flatnonzero(blurred >= blurred.max() * (1 - 1e-9))  # rounding differs by processor and must not choose
    return (float(equal[-1]) + 0.5) * 360 / options.bins


def _refined(peak: float, azimuth: Array, areas: Array, options: FacadeOptions) -> tuple[float, NDArray[np.bool_]]:
    """Return the direction around a peak that the walls there agree on, and which faces have it."""
    for reach in (options.same_direction, options.same_direction / 2, options.same_direction / 4):
        off = _angle_between(azimuth, peak)
        weight = areas * np.maximum(1 - (off / reach) ** 2, 0) ** 2
        if weight.sum() > 0:
            peak = float(peak + weight @ off / weight.sum()) % 360
    return peak, np.abs(_angle_between(azimuth, peak)) < options.same_direction


def _level(direction: float) -> Array:
    angle = np.radians(direction)
    return np.array([np.sin(angle), np.cos(angle), 0.0])


def _facade(survey: Survey, direction: float, faces: NDArray[np.int64], options: FacadeOptions) -> Facade:
    """Return the facade of a direction, through the plane with most of the faces' area."""
    normal = _level(direction)
    away, areas = survey.centres[faces] @ normal, survey.areas[faces]
    step = options.plane_distance * survey.pixel
    order = np.argsort(away)
    total = np.concatenate([[0.0], np.cumsum(areas[order])])
    until = np.searchsorted(away[order], away[order] + 2 * step)
    first = int((total[until] - total[:-1]).argmax())
    wall = faces[order[first : until[first]]]
    middle, lean = _fit(survey, wall)
    direction = float(np.degrees(np.arctan2(lean[0], lean[1])) % 360)
    frame = _frame(survey, direction, float(_level(direction) @ middle), "")
    return Facade(frame, direction, wall, float(np.degrees(np.arcsin(np.clip(-lean[2], -1, 1)))))


def _fit(survey: Survey, faces: NDArray[np.int64]) -> tuple[Array, Array]:
    """Fit the plane of least squares through faces, by area: middle and outward normal."""
    weight, at = survey.areas[faces], survey.centres[faces]
    middle = weight @ at / weight.sum()
    mean = weight @ survey.normals[faces]
    corners = survey.mesh.vertices[survey.mesh.faces[faces]].reshape(-1, 3) - middle
    each = np.repeat(weight, 3)
    values, vectors = np.linalg.eigh((corners * each[:, None]).T @ corners)
    normal = vectors[:, 0] if values[1] > 1e-9 * values[2] else mean / np.linalg.norm(mean)
    return middle, normal * np.sign(normal @ mean or 1.0)


def _frame(survey: Survey, direction: float, offset: float, name: str) -> DrawingFrame:
    """Return the vertical frame ``normal @ x = offset`` around the whole building; x begins at its left end."""
    normal, up = _level(direction), np.array([0.0, 0.0, 1.0])
    x = np.cross(up, normal)
    left = float((survey.mesh.vertices @ x).min())
    return _with_extent(survey, DrawingFrame(name, normal * offset + x * left, x, up, np.zeros(2), np.zeros(2)))


def _with_extent(survey: Survey, frame: DrawingFrame) -> DrawingFrame:
    at = frame.to_drawing(survey.mesh.vertices)[:, :2]
    return DrawingFrame(frame.name, frame.origin, frame.x, frame.y, at.min(0), at.max(0))


def _named(facades: list[Facade], compass: bool) -> list[Facade]:
    """Return the facades with names, in order around the building."""
    start = 0.0 if compass else facades[0].direction
    ordered = sorted(facades, key=lambda f: (f.direction - start + 22.5 * compass) % 360)
    names, taken = list[str](), dict[str, int]()
    for k, facade in enumerate(ordered):
        name = COMPASS[int((facade.direction + 22.5) // 45) % 8] if compass else chr(ord("A") + k)
        taken[name] = taken.get(name, 0) + 1
        names.append(name if taken[name] == 1 else f"{name}-{taken[name]}")
    return [
        replace(facade, frame=replace(facade.frame, name=name)) for name, facade in zip(names, ordered, strict=True)
    ]
