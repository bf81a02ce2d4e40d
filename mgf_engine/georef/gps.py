# SPDX-License-Identifier: GPL-3.0-or-later
"""Read the GPS positions of photos: EXIF, and XMP of DJI drones with the accuracy of RTK.

Headers only are read. What is not there, or no number, is passed over: photos without GPS are usual.
"""

from __future__ import annotations

import math
import warnings
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from PIL import Image
from PIL.ExifTags import GPS, IFD

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
        up: unit vector upwards in the camera's frame (x right, y down, z forward) where the photo tells; else None.
    """

    latitude: float
    longitude: float
    height: float
    sd: tuple[float, float]
    ellipsoidal: bool = False
    rtk: bool = False
    up: tuple[float, float, float] | None = None

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
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with Image.open(path) as image:
                packet = image.info.get("xmp") or image.info.get("XML:com.adobe.xmp") or b""
                gps = dict(image.getexif().get_ifd(IFD.GPSInfo))
    except Exception:  # whatever a damaged header makes the reader raise
        return None
    xmp = read_xmp(packet)
    position = _position(gps, xmp, accuracy)
    return position if position is not None and _possible(position) else None


def _position(gps: dict[int, Any], xmp: dict[str, str], accuracy: tuple[float, float]) -> GpsPosition | None:
    """Combine EXIF's GPS and the XMP of DJI, which takes precedence; None without latitude and longitude."""
    latitude = _first(_number(xmp.get("GpsLatitude")), _degrees(gps, GPS.GPSLatitude, "S"))
    longitude = _first(
        _number(xmp.get("GpsLongitude")), _number(xmp.get("GpsLongtitude")), _degrees(gps, GPS.GPSLongitude, "W")
    )
    if latitude is None or longitude is None:
        return None
    height = _first(_number(xmp.get("AbsoluteAltitude")), _altitude(gps))
    rtk = xmp.get("RtkFlag") == _FIXED
    error = _number(gps.get(GPS.GPSHPositioningError))
    sd = (error, 2 * error) if error else accuracy
    across = [_number(xmp.get(name)) for name in ("RtkStdLat", "RtkStdLon")]
    along = _number(xmp.get("RtkStdHgt"))
    if across[0] and across[1] and along:
        sd = (max(across[0], across[1]), along)
    if height is None:
        height, sd = 0.0, (sd[0], _UNKNOWN)
    ellipsoidal = rtk or xmp.get("AltitudeType", "").lower().startswith("rtk")
    return GpsPosition(latitude, longitude, height, sd, ellipsoidal, rtk, _up(xmp))


def _up(xmp: dict[str, str]) -> tuple[float, float, float] | None:
    """Return "up" from pitch (0 level, -90 straight down) and roll of DJI's gimbal."""
    pitch, roll = _number(xmp.get("GimbalPitchDegree")), _number(xmp.get("GimbalRollDegree"))
    if pitch is None or roll is None:
        return None
    p, r = math.radians(pitch), math.radians(roll)
    return math.cos(p) * math.sin(r), -math.cos(p) * math.cos(r), math.sin(p)


def read_xmp(packet: bytes | str) -> dict[str, str]:
    """Read the properties of an XMP packet, local name -> text, from attributes and from elements; empty where it is
    damaged."""
    text = packet.decode("utf-8", "replace") if isinstance(packet, bytes) else packet
    if "<!" in text:  # no XMP has a document type, and nothing else should be expanded here
        return {}
    try:
        root = ElementTree.fromstring(text.strip("\x00 \t\r\n\ufeff"))
    except ElementTree.ParseError:
        return {}
    found: dict[str, str] = {}
    for element in root.iter():
        for name, value in element.attrib.items():
            found.setdefault(_local(name), value.strip())
        if element.text and element.text.strip():
            found.setdefault(_local(element.tag), element.text.strip())
    return found


def _local(name: str) -> str:
    return name.rsplit("}", 1)[-1]


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
    height, reference = _number(gps.get(GPS.GPSAltitude)), gps.get(GPS.GPSAltitudeRef)
    below = reference in (1, b"\x01", b"1", "1")
    return None if height is None else -height if below else height


def _number(value: Any) -> float | None:
    try:
        number = float(value)
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return number if math.isfinite(number) else None


def _first(*values: float | None) -> float | None:
    return next((value for value in values if value is not None), None)


def _possible(position: GpsPosition) -> bool:
    """Tell whether a position can be one: receivers without a fix write zeros."""
    known = abs(position.latitude) <= 90 and abs(position.longitude) <= 180 and abs(position.height) < 20_000
    return known and (abs(position.latitude) > 1e-9 or abs(position.longitude) > 1e-9)
