# SPDX-License-Identifier: GPL-3.0-or-later
"""Coordinate reference systems: their names, whether one can be built in, and places on Earth in their coordinates.

pyproj does it (the extra ``mgf-engine[survey]``); without it a job still has metres in a local frame.
"""

from __future__ import annotations

import re
import warnings
from typing import Any

import numpy as np
import pycolmap
from numpy.typing import NDArray

from mgf_engine.errors import BadInput

Array = NDArray[np.float64]
AUTO = "auto"
_WGS84 = "EPSG:4979"  # latitude, longitude, ellipsoidal height
_BEYOND = 3.0  # degrees
SURVEY = "pip install 'mgf-engine[survey]'"


def proj() -> Any:
    """Return the module pyproj.

    Raises:
        BadInput: it is not installed.
    """
    try:
        import pyproj
    except ImportError as error:
        raise BadInput(
            f"Projected coordinates need the package pyproj, which is not installed; get it by {SURVEY}, in "
            "the engine's environment."
        ) from error
    return pyproj


def to_enu(places: Array, origin: Array) -> Array:
    """Convert latitude, longitude, height [N, 3] to metres east, north and up of the origin [3] on WGS 84, [N, 3]."""
    transform = pycolmap.GPSTransform(pycolmap.GPSTransformEllipsoid.WGS84)
    return np.asarray(transform.ellipsoid_to_enu(places, *origin.tolist()))


class ProjectedCrs:
    """A projected CRS in metres, as coordinates easting, northing, height (float64).

    Attributes:
        name: ``EPSG:25832`` or what else pyproj reads.
        title: its full name.
    """

    def __init__(self, text: str, near: Array | None = None) -> None:
        """Read a CRS.

        Args:
            text: a code, a number, PROJ or WKT text, or ``auto`` for the UTM zone.
            near: latitude and longitude of the scene, for ``auto`` and for guesses.

        Raises:
            BadInput: there is no such CRS, or coordinates of it are no metres on the ground.
        """
        pyproj = proj()
        if text == AUTO:
            if near is None:
                raise BadInput(
                    "The UTM zone cannot be chosen without GPS in the photos; name the coordinate reference system, "
                    "such as --crs EPSG:25832."
                )
            text = utm_zone(float(near[0]), float(near[1]))
        self.name = normalise_crs(text)
        try:
            self.crs = pyproj.CRS.from_user_input(self.name)
        except pyproj.exceptions.CRSError as error:
            raise BadInput(
                f"There is no coordinate reference system '{text}'; give a code such as EPSG:25832, or auto."
            ) from error
        if self.crs.is_geographic or self.crs.is_geocentric:
            raise BadInput(
                f"{self.name} ({self.crs.name}) has no eastings and northings in metres; give a projected system"
                f"{_such_as(near)}."
            )
        if not self.crs.is_projected and not self.crs.is_compound:
            raise BadInput(f"{self.name} ({self.crs.name}) is no projected system; give one{_such_as(near)}.")
        units = {axis.unit_name for axis in self.crs.axis_info[:2]}
        if units != {"metre"}:
            raise BadInput(f"{self.name} counts in {units.pop()}, not in metres; give a system in metres.")
        if stretches(self.crs):
            raise BadInput(
                f"{self.name} ({self.crs.name}) stretches lengths away from the equator, in the middle of Europe to "
                f"one and a half; give a system in true metres{_such_as(near)}."
            )
        self.title = self.crs.name
        self.to_wgs84 = pyproj.Transformer.from_crs(self.crs.to_3d(), _WGS84, always_xy=True)
        self.vertical = len(self.crs.axis_info) > 2

    def project(self, places: Array) -> Array:
        """Convert latitude, longitude, height [N, 3] to easting, northing, height [N, 3]; inf where there is none."""
        x, y, z = self.to_wgs84.transform(places[:, 1], places[:, 0], places[:, 2], direction="INVERSE")
        return np.stack([x, y, z], 1)

    def places(self, points: Array) -> Array:
        """Convert easting, northing, height [N, 3] to latitude, longitude, ellipsoidal height [N, 3]."""
        longitude, latitude, height = self.to_wgs84.transform(points[:, 0], points[:, 1], points[:, 2])
        return np.stack([latitude, longitude, height], 1)

    def covers(self, points: Array) -> bool:
        """Tell whether most of the points lie in the area that the CRS is made for, or a little beyond it."""
        area = self.crs.area_of_use
        if area is None:
            return True
        found = self.places(points)
        inside = (found[:, 0] > area.south - _BEYOND) & (found[:, 0] < area.north + _BEYOND)
        inside &= (found[:, 1] > area.west - _BEYOND) & (found[:, 1] < area.east + _BEYOND)
        return bool(np.isfinite(found).all() and np.mean(inside) > 0.5)

    @property
    def area(self) -> str:
        """What the CRS is made for, in words."""
        return str(self.crs.area_of_use.name).rstrip(".") if self.crs.area_of_use is not None else "unknown"

    def heights(self) -> tuple[str, str]:
        """Return the kind of the heights of the CRS, and a warning if the grid for them is missing, else empty."""
        if not self.vertical or self.crs.is_geographic:
            return "ellipsoidal", ""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # it warns of the same grid
            group = proj().transformer.TransformerGroup(_WGS84, self.crs, always_xy=True)
        title = str(self.crs.sub_crs_list[-1].name) if self.crs.is_compound else self.crs.name
        if group.best_available:
            return title, ""
        return "ellipsoidal", (
            f"Heights stay ellipsoidal: the grid for {title} is not on this machine ('projsync' of pyproj gets it)."
        )

    def wkt(self) -> str:
        """Return the CRS as ``.prj`` files have it (ESRI's WKT where it can be had)."""
        pyproj = proj()
        try:
            return str(self.crs.to_wkt("WKT1_ESRI"))
        except pyproj.exceptions.CRSError:
            return str(self.crs.to_wkt("WKT1_GDAL"))


def stretches(crs: Any) -> bool:
    """Tell whether lengths in a CRS of pyproj are those of a map of the world, which grow towards the poles."""
    method = crs.coordinate_operation.method_name if crs.coordinate_operation is not None else ""
    return bool(re.match("Mercator|Popular Visualisation", method))  # not transverse or oblique ones


def normalise_crs(text: str) -> str:
    """Return a CRS as pyproj reads it: a bare number is a code of EPSG; ODM's ``WGS84 UTM 32N`` is one, too."""
    text = text.strip()
    if re.fullmatch(r"\d{4,6}", text):
        return f"EPSG:{text}"
    if re.fullmatch(r"(?i)epsg:\s*\d+", text):
        return "EPSG:" + text.split(":")[1].strip()
    utm = re.fullmatch(r"(?i)WGS\s*84\s+UTM\s+(?:zone\s+)?(\d{1,2})\s*([NS])", text)
    if utm and 1 <= int(utm[1]) <= 60:
        return f"EPSG:{(32600 if utm[2].upper() == 'N' else 32700) + int(utm[1])}"
    return text


def utm_zone(latitude: float, longitude: float) -> str:
    """Return the code of the UTM zone on WGS 84 of a place, without the exceptions of Norway and Svalbard."""
    return f"EPSG:{(32600 if latitude >= 0 else 32700) + utm_zone_number(longitude)}"


def utm_zone_number(longitude: float) -> int:
    """Return the number of the UTM zone of a longitude, 1..60."""
    return int(np.clip((longitude + 180) // 6, 0, 59)) + 1


def _such_as(near: Array | None) -> str:
    return f" such as {utm_zone(float(near[0]), float(near[1]))} here" if near is not None else " such as EPSG:25832"
