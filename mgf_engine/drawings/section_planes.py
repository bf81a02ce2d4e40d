# SPDX-License-Identifier: GPL-3.0-or-later
"""Planes of sections: as the user names them, or a plan and two cross-sections of a building."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from mgf_engine.drawings.facades import plan_frame
from mgf_engine.drawings.model import DrawingFrame, Facade, Survey
from mgf_engine.drawings.section import SectionOptions
from mgf_engine.errors import BadInput


def section_frames(
    survey: Survey,
    facades: Sequence[Facade],
    wanted: Sequence[str],
    ground: float,
    options: SectionOptions = SectionOptions(),
) -> list[DrawingFrame]:
    """Return the planes to cut at.

    Level ones are given as ``z=1.2`` above the ground, upright ones as ``A=3.5`` from a facade's left end, any others
    as ``NAME=x,y,z,nx,ny,nz`` by a point and a normal of the scene frame.

    Without any wanted, a plan and two cross-sections through the middle.

    Args:
        survey: mesh of the job, local frame.
        facades: by whose names upright planes are given.
        wanted: texts of ``--section``.
        ground: height of the ground, local frame.
        options: height of the plan.

    Raises:
        BadInput: a text names no facade, no number, or a plane beside the building; or two have one name.
    """
    if wanted:
        frames = [_frame_of(survey, facades, text, ground, options) for text in wanted]
        names = [frame.name for frame in frames]
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice is not None:
            raise BadInput(f"Two sections are called {twice}; give each --section a name of its own.")
        return frames
    height = float(survey.mesh.vertices[:, 2].max()) - ground
    level = options.plan_height if survey.georeference.metric and height > options.plan_height else 0.25 * height
    first = facades[0]
    across = max(facades, key=lambda f: abs(float(f.frame.normal @ first.frame.x)))
    through = [first] if across is first else [first, across]
    return [
        _level(survey, facades, ground, level),
        *(_upright(survey, f, 0.5 * float(f.frame.size[0])) for f in through),
    ]


def _frame_of(
    survey: Survey, facades: Sequence[Facade], text: str, ground: float, options: SectionOptions
) -> DrawingFrame:
    """Parse one argument of ``--section``.

    Args:
        survey: mesh in the local frame.
        facades: that an upright section may be named by.
        text: ``NAME=DISTANCE``, or ``NAME=x,y,z,nx,ny,nz``.
        ground: height that level sections are counted from.
        options: angle below which a plane is made level or upright.

    Raises:
        BadInput: it is none, or the plane misses the building.
    """
    plane = re.fullmatch(r"\s*([\w-]+)\s*=([-+0-9.eE\s]+(?:,[-+0-9.eE\s]+){5})", text)
    if plane is not None:
        return _along_plane(survey, facades, text, plane.group(1), plane.group(2), options)
    match = re.fullmatch(r"\s*([\w-]+)\s*=\s*([-+0-9.eE]+)\s*", text)
    known = {facade.name: facade for facade in facades}
    names = ", ".join(["z", *known])
    try:
        name, value = match.group(1), float(match.group(2))  # type: ignore[union-attr]
        if not np.isfinite(value) or not (name == "z" or name in known):
            raise ValueError(name)
    except (AttributeError, ValueError) as error:
        raise BadInput(
            f"--section takes NAME=DISTANCE with NAME one of {names}, or NAME=x,y,z,nx,ny,nz, not '{text}'."
        ) from error
    low, high = 0.0, float(known[name].frame.size[0]) if name != "z" else 0.0
    if name == "z":
        z = survey.mesh.vertices[:, 2]
        low, high = float(z.min()) - ground, float(z.max()) - ground
    if not low < value < high:
        raise BadInput(f"The section {text} misses the building, which reaches from {low:.3f} to {high:.3f} there.")
    return _level(survey, facades, ground, value) if name == "z" else _upright(survey, known[name], value)


def _along_plane(
    survey: Survey, facades: Sequence[Facade], text: str, name: str, numbers: str, options: SectionOptions
) -> DrawingFrame:
    """Cut through a point along a plane, both of the scene frame; seen from the side that the normal points to.

    Raises:
        BadInput: the numbers are none, or the normal has no direction.
    """
    try:
        values = np.array([float(number) for number in numbers.split(",")])
    except ValueError:
        values = np.full(6, np.nan)
    length = float(np.linalg.norm(values[3:]))
    if not np.isfinite(values).all() or not length > 0:
        raise BadInput(f"The section '{text}' is no plane; give NAME=x,y,z,nx,ny,nz with a normal that is not zero.")
    point = survey.local(values[:3])
    normal = survey.turn @ survey.georeference.rotation @ values[3:] / length
    if np.hypot(normal[0], normal[1]) < np.sin(np.radians(options.level_angle)):
        plan = plan_frame(survey, list(facades))
        return DrawingFrame(name, plan.origin + point[2] * plan.normal, plan.x, plan.y, plan.low, plan.high)
    up = np.array([0.0, 0.0, 1.0])
    if abs(normal[2]) < np.sin(np.radians(options.level_angle)):
        normal = np.array([normal[0], normal[1], 0.0]) / np.hypot(normal[0], normal[1])
        point = point - point[2] * up  # its y is the height
    x = np.cross(up, normal) / np.hypot(normal[0], normal[1])
    frame = DrawingFrame(name, point, x, np.cross(normal, x), np.zeros(2), np.zeros(2))
    at = frame.to_drawing(survey.mesh.vertices)[:, :2]
    origin = point + at[:, 0].min() * x  # x begins at its left end
    low, high = at.min(0) - (at[:, 0].min(), 0), at.max(0) - (at[:, 0].min(), 0)
    return DrawingFrame(name, origin, x, frame.y, low, high)


def _level(survey: Survey, facades: Sequence[Facade], ground: float, above: float) -> DrawingFrame:
    plan = plan_frame(survey, list(facades))
    z = ground + above
    return DrawingFrame(f"z-{above:.3g}", plan.origin + z * plan.normal, plan.x, plan.y, plan.low, plan.high)


def _upright(survey: Survey, facade: Facade, distance: float) -> DrawingFrame:
    """Cut upright across a facade, seen from its left end."""
    normal, up = -facade.frame.x, np.array([0.0, 0.0, 1.0])
    origin = facade.frame.origin + facade.frame.x * (facade.frame.low[0] + distance)
    frame = DrawingFrame(f"{facade.name}-{distance:.3g}", origin, np.cross(up, normal), up, np.zeros(2), np.zeros(2))
    at = frame.to_drawing(survey.mesh.vertices)[:, :2]
    return DrawingFrame(frame.name, origin, frame.x, up, at.min(0), at.max(0))
