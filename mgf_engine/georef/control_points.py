# SPDX-License-Identifier: GPL-3.0-or-later
"""Read control and check points and their marks in photos from the user's files.

Read are a CSV of points (name, east, north, height, accuracy, role) with a CSV of marks (name, photo, x, y), points as
Metashape exports them, and OpenDroneMap's ``gcp_list.txt``, which holds points and marks in one file. Pixels are those
of the photos as they were taken, the centre of the top-left pixel is (0.5, 0.5).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import NDArray

from mgf_engine.errors import BadInput
from mgf_engine.georef.options import ControlPointOptions
from mgf_engine.georef.tables import Table, number_in, read_table, read_text
from mgf_engine.scene.colmap import PHOTO_KINDS
from mgf_engine.scene.names import named_like

Array = NDArray[np.float64]
CONTROL, CHECK = "control", "check"
_POINT_COLUMNS = {
    "name": ("name", "label", "id", "point", "nr", "no", "marker", "gcp", "punkt"),
    "east": ("east", "easting", "x", "e", "rechtswert", "ost"),
    "north": ("north", "northing", "y", "n", "hochwert", "nord"),
    "height": ("height", "z", "h", "altitude", "elevation", "up", "hohe"),
    "accuracy": ("accuracy", "sd", "sigma", "accuracym", "accuracyxym", "accuracyxy", "xyaccuracy"),
    "vertical": ("accuracyzm", "accuracyz", "sdheight", "verticalaccuracy", "accuracyheight", "zaccuracy"),
    "role": ("role", "type", "use", "kind"),
    "enabled": ("enabled", "enable"),
}
_MARK_COLUMNS = {
    "name": ("name", "label", "point", "marker", "gcp", "id"),
    "photo": ("photo", "image", "camera", "file", "filename", "imagename", "picture"),
    "x": ("x", "u", "px", "imx", "column", "pixelx", "xpx", "xproj"),
    "y": ("y", "v", "py", "imy", "row", "pixely", "ypx", "yproj"),
}
CHECK_WORDS = ("check", "chk", "cp", "checkpoint", "c", "0", "false", "no", "off")


@dataclass(frozen=True)
class ControlPoint:
    """A point whose place is known: easting, northing, height; accuracy horizontal and vertical in metres."""

    name: str
    position: tuple[float, float, float]
    role: str = CONTROL
    sd: tuple[float, float] = (ControlPointOptions.accuracy, ControlPointOptions.accuracy)

    @property
    def accuracy(self) -> Array:
        """Of each coordinate, [3]."""
        return np.array([self.sd[0], self.sd[0], self.sd[1]])


@dataclass(frozen=True)
class Mark:
    """Where a point appears in a photo: index of the view, and pixels of the photo as taken."""

    point: str
    view: int
    pixel: tuple[float, float]


@dataclass(frozen=True)
class ControlPoints:
    """Control and check points, as the user's files hold them, and their marks in photos.

    Attributes:
        points: control and check points.
        marks: of these points.
        crs: what ``gcp_list.txt`` or a comment says, else empty.
        unknown_photos: photos named in the files that are no views.
        unlisted: names of marks that are of none of the points.
    """

    points: tuple[ControlPoint, ...] = ()
    marks: tuple[Mark, ...] = ()
    crs: str = ""
    unknown_photos: tuple[str, ...] = ()
    unlisted: tuple[str, ...] = ()

    def positions(self) -> Array:
        """Return the positions of all points, [N, 3]."""
        return np.array([p.position for p in self.points], np.float64).reshape(-1, 3)


def read_control(
    points: Path, marks: Path | None, photos: Sequence[str], accuracy: float = ControlPointOptions.accuracy
) -> ControlPoints:
    """Read points and marks from one or two files.

    Args:
        points: CSV of points, or ``gcp_list.txt``.
        marks: CSV of marks; None where the first file holds them.
        photos: names of the views.
        accuracy: of points whose file gives none, metres.

    Raises:
        BadInput: a file cannot be used; the sentence names the line.
    """
    control = read_points(points, photos, accuracy)
    if marks is not None:
        found, unknown_photos = read_marks(marks, photos)
        known = {p.name for p in control.points}
        kept = tuple(mark for mark in found if mark.point in known)
        if not kept:
            raise BadInput(
                f"No mark in '{marks}' is of a point in '{points}'; use the same names for the points in both files."
            )
        unlisted = tuple(dict.fromkeys(mark.point for mark in found if mark.point not in known))
        control = replace(control, marks=(*control.marks, *kept), unknown_photos=unknown_photos, unlisted=unlisted)
    if not control.marks:
        raise BadInput("Control points need marks in the photos; give them with --marks FILE.")
    return control


def read_points(path: Path, photos: Sequence[str], accuracy: float = ControlPointOptions.accuracy) -> ControlPoints:
    """Read the points of a file, with the marks where it holds those as well.

    Raises:
        BadInput: the file cannot be used.
    """
    odm = _odm(path, photos, accuracy)
    return odm if odm is not None else _points(path, accuracy)


def _points(path: Path, accuracy: float) -> ControlPoints:
    """Read a table of points; ``accuracy``: in metres, of points without one.

    Raises:
        BadInput: a column is missing, or a point is listed twice.
    """
    table = read_table(path, _POINT_COLUMNS)
    at = table.columns or dict(zip(("name", "east", "north", "height", "accuracy", "role"), range(6), strict=True))
    missing = [name for name in ("name", "east", "north", "height") if name not in at]
    if missing:
        raise BadInput(f"'{path}' has no column '{missing[0]}'; name the columns name, east, north, height.")
    found = [_point(table, row, at, accuracy) for row in range(len(table.rows))]
    names = [point.name for point in found]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise BadInput(f"The point '{twice}' is in '{path}' twice; give every point a name of its own.")
    return ControlPoints(tuple(found), crs=_crs_in(table.notes))


def _point(table: Table, row: int, at: dict[str, int], accuracy: float) -> ControlPoint:
    """Read one point of a table.

    Args:
        table: the file.
        row: of the point.
        at: column of each field.
        accuracy: of a point without one, metres.

    Raises:
        BadInput: it has no name, or a coordinate is no number.
    """
    name = table.text(row, at["name"])
    if not name:
        raise BadInput(f"Line {table.lines[row]} of '{table.path}' names no point; correct it.")
    east, north, height = (table.number(row, at[column]) for column in ("east", "north", "height"))
    across = _accuracy(table, row, at.get("accuracy"))
    along = _accuracy(table, row, at.get("vertical")) or across
    role = table.text(row, at.get("role"))
    if not role and not table.columns and number_in(table.text(row, 4)) is None:
        role = table.text(row, 4)  # no accuracy between height and role
    enabled = table.text(row, at.get("enabled")).lower() not in ("0", "false", "no")
    check = role.lower() in CHECK_WORDS or not enabled
    return ControlPoint(
        name, (east, north, height), CHECK if check else CONTROL, (across or accuracy, along or accuracy)
    )


def _accuracy(table: Table, row: int, column: int | None) -> float | None:
    """Read metres; Metashape's ``0.01/0.02`` (horizontal/vertical) reads as its first."""
    found = number_in(table.text(row, column).split("/")[0])
    return found if found is not None and found > 0 else None


def _crs_in(notes: list[str]) -> str:
    """Return the CRS that a comment like Metashape's ``CoordinateSystem: …`` names; empty without one."""
    return next((n.split(":", 1)[1].strip() for n in notes if n.lower().startswith(("coordinatesystem:", "crs:"))), "")


def read_marks(path: Path, photos: Sequence[str]) -> tuple[tuple[Mark, ...], tuple[str, ...]]:
    """Read the marks of a file, and the names of photos in it that are no views.

    Raises:
        BadInput: the file cannot be used, none of its photos is a view, or one may be any of several.
    """
    table = read_table(path, _MARK_COLUMNS)
    at = table.columns or dict(zip(("name", "photo", "x", "y"), range(4), strict=True))
    missing = [name for name in ("name", "photo", "x", "y") if name not in at]
    if missing:
        raise BadInput(f"'{path}' has no column '{missing[0]}'; name the columns name, photo, x, y.")
    if not table.columns and not any(named_like(table.text(row, 1), photos) for row in range(len(table.rows))):
        at = {**at, "name": 1, "photo": 0}  # the photo first, as other programs write it
    marks, unknown_photos = [], []
    for row in range(len(table.rows)):
        name = table.text(row, at["photo"])
        view = _view_of(name, photos, path)
        if view is None:
            unknown_photos.append(name)
            continue
        pixel = (table.number(row, at["x"]), table.number(row, at["y"]))
        marks.append(Mark(table.text(row, at["name"]), view, pixel))
    if not marks:
        raise _no_photo(path, unknown_photos)
    return tuple(marks), tuple(dict.fromkeys(unknown_photos))


def _view_of(name: str, photos: Sequence[str], path: Path) -> int | None:
    """Return the index of the photo that a file names; None where it is no view.

    Raises:
        BadInput: it may be one of several.
    """
    views = named_like(name, photos)
    if len(views) > 1:
        some = ", ".join(photos[view] for view in views[:3])
        raise BadInput(f"The photo '{name}' in '{path}' could be any of {some}; give its full name.")
    return views[0] if views else None


def _no_photo(path: Path, names: Sequence[str]) -> BadInput:
    return BadInput(f"No photo named in '{path}' is among the job's (such as '{names[0]}'); check the names.")


def _odm(path: Path, photos: Sequence[str], accuracy: float) -> ControlPoints | None:
    """Read OpenDroneMap's list; None where the file is none: first the CRS, then east, north, height, x, y, photo,
    name. A file is one where most of its lines are such rows; the CRS may be missing.

    Raises:
        BadInput: a line is no such row, a point lies in two places, or none of the photos is a view.
    """
    lines = [(number, line.strip()) for number, line in enumerate(read_text(path).splitlines(), start=1)]
    rows = [(number, line.split()) for number, line in lines if line and not line.startswith("#")]
    crs = "" if not rows or _is_odm_row(rows[0][1], photos) else " ".join(rows.pop(0)[1])
    if 2 * sum(_is_odm_row(row, photos) for _, row in rows) <= len(rows):
        return None
    points: dict[str, ControlPoint] = {}
    marks, unknown_photos = [], []
    for number, row in rows:
        values = [found for field in row[:5] if (found := number_in(field)) is not None]
        if len(row) < 6 or len(values) < 5:
            raise BadInput(
                f"Line {number} of '{path}' is not of the form east north height x y photo name; correct it."
            )
        east, north, height, x, y = values
        name = row[6] if len(row) > 6 else " ".join(row[:3])
        point = points.setdefault(name, ControlPoint(name, (east, north, height), sd=(accuracy, accuracy)))
        if point.position != (east, north, height):
            raise BadInput(f"The point '{name}' lies in two places in '{path}'; give every point a name of its own.")
        view = _view_of(row[5], photos, path)
        if view is None:
            unknown_photos.append(row[5])
        else:
            marks.append(Mark(name, view, (x, y)))
    if not marks:
        raise _no_photo(path, unknown_photos)
    return ControlPoints(tuple(points.values()), tuple(marks), crs, tuple(dict.fromkeys(unknown_photos)))


def _is_odm_row(row: Sequence[str], photos: Sequence[str]) -> bool:
    """Tell whether the fields of a line are five numbers and a photo; in a table of points a role may stand there."""
    if len(row) < 6 or any(number_in(field) is None for field in row[:5]):
        return False
    return bool(named_like(row[5], photos)) or PurePosixPath(row[5]).suffix.lower() in PHOTO_KINDS
