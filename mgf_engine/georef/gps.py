# SPDX-License-Identifier: GPL-3.0-or-later
"""Read the GPS positions of photos: EXIF, and XMP of DJI drones with the accuracy of RTK.

Headers only are read. What is not there, or no number, is passed over: photos without GPS are usual.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from PIL.ExifTags import GPS

from mgf_engine.files.photo_tags import number, read_photo_tags
from mgf_engine.georef.options import GpsFitOptions

_UNKNOWN = 1e4  # m, standard deviation of a height that is not given
_KNOWN = 1e3  # m, that of one from which it tells nothing
_FIXED = "50"  # DJI's RtkFlag: the ambiguities are solved


@dataclass(frozen=True)
class GpsPosition:
    """Where a photo was taken.

    Attributes:
        latitude, longitude: degrees, WGS 84.
        height: metres; see ``ellipsoidal``.
        sd: accuracy in metres, horizontal and vertical.
        ellipsoidal: the height is one above the ellipsoid; else above sea level, as most receivers give it.
        rtk: found by RTK.
    """

    latitude: float
    longitude: float
    height: float
    sd: tuple[float, float]
    ellipsoidal: bool = False
    rtk: bool = False

    @property
    def has_height(self) -> bool:
        """Whether the height tells anything."""
        return self.sd[1] < _KNOWN


def read_gps_position(path: Path, accuracy: tuple[float, float] = GpsFitOptions.accuracy) -> GpsPosition | None:
    """Read where a photo was taken; None without GPS, or where the file cannot be read.

    Args:
        path: of the photo.
        accuracy: horizontal and vertical, of a photo that gives none, metres.
    """
    tags = read_photo_tags(path)
    position = _position(tags.gps, tags.xmp, accuracy)
    return position if position is not None and _possible(position) else None


def _position(gps: dict[int, Any], xmp: dict[str, str], accuracy: tuple[float, float]) -> GpsPosition | None:
    """Combine EXIF's GPS and the XMP of DJI, which takes precedence; None without latitude and longitude."""
    latitude = _first(number(xmp.get("GpsLatitude")), _degrees(gps, GPS.GPSLatitude, "S"))
    longitude = _first(
        number(xmp.get("GpsLongitude")), number(xmp.get("GpsLongtitude")), _degrees(gps, GPS.GPSLongitude, "W")
    )
    if latitude is None or longitude is None:
        return None
    height = _first(number(xmp.get("AbsoluteAltitude")), _altitude(gps))
    rtk = xmp.get("RtkFlag") == _FIXED
    error = number(gps.get(GPS.GPSHPositioningError))
    sd = (error, 2 * error) if error else accuracy
    across = [number(xmp.get(name)) for name in ("RtkStdLat", "RtkStdLon")]
    along = number(xmp.get("RtkStdHgt"))
    if across[0] and across[1] and along:
        sd = (max(across[0], across[1]), along)
    if height is None:
        height, sd = 0.0, (sd[0], _UNKNOWN)
    ellipsoidal = rtk or xmp.get("AltitudeType", "").lower().startswith("rtk")
    return GpsPosition(latitude, longitude, height, sd, ellipsoidal, rtk)


def _degrees(gps: dict[int, Any], tag: GPS, negative: str) -> float | None:
    """Read a latitude or longitude of EXIF, given as degrees, minutes and seconds; ``negative``: reference of those
    below zero, which stands in the tag before."""
    parts: Any = gps.get(tag)
    reference = gps.get(tag - 1)
    try:
        degrees, minutes, seconds = ([float(part) for part in parts] + [0.0, 0.0])[:3]
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    value = degrees + minutes / 60 + seconds / 3600
    text = reference.decode("ascii", "replace") if isinstance(reference, bytes) else str(reference or "")
    return -value if text.strip("\x00 ").upper().startswith(negative) else value


def _altitude(gps: dict[int, Any]) -> float | None:
    height, reference = number(gps.get(GPS.GPSAltitude)), gps.get(GPS.GPSAltitudeRef)
    below = reference in (1, 3, b"\x01", b"\x03", b"1", "1")  # 3 since Exif 3.0
    return None if height is None else -height if below else height


def _first(*values: float | None) -> float | None:
    return next((value for value in values if value is not None), None)


def _possible(position: GpsPosition) -> bool:
    """Tell whether a position can be one: receivers without a fix write zeros."""
    known = abs(position.latitude) <= 90 and abs(position.longitude) <= 180 and abs(position.height) < 20_000
    return known and (abs(position.latitude) > 1e-9 or abs(position.longitude) > 1e-9)
