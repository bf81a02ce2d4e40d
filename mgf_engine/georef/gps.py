# SPDX-License-Identifier: GPL-3.0-or-later
"""Read the GPS positions of photos: EXIF, and XMP of DJI drones with the accuracy of RTK.

Headers only are read. What is not there, or no number, is passed over: photos without a place are usual.
"""

from __future__ import annotations

import math
import warnings
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from PIL import Image

from mgf_engine.georef.options import GpsFitOptions

_GPS_IFD = 0x8825
_ALTITUDE_REF, _ALTITUDE, _ERROR = 5, 6, 31
_FIXED = "50"  # DJI's RtkFlag: the ambiguities are solved


@dataclass(frozen=True)
class Place:
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


def read_place(path: Path, accuracy: tuple[float, float] = GpsFitOptions.accuracy) -> Place | None:
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
                gps = dict(image.getexif().get_ifd(_GPS_IFD))
    except Exception:  # whatever a damaged header makes the reader raise
        return None
    xmp = read_xmp(packet)
    place = _place(gps, xmp, accuracy)
    return place if place is not None and _possible(place) else None


def _place(gps: dict[int, Any], xmp: dict[str, str], accuracy: tuple[float, float]) -> Place | None:
    """Combine EXIF's GPS and the XMP of DJI, which takes precedence; None without latitude and longitude."""
    latitude = _first(_number(xmp.get("GpsLatitude")), _degrees(gps.get(2), gps.get(1), "S"))
    longitude = _first(
        _number(xmp.get("GpsLongitude")), _number(xmp.get("GpsLongtitude")), _degrees(gps.get(4), gps.get(3), "W")
    )
    if latitude is None or longitude is None:
        return None
    height = _first(_number(xmp.get("AbsoluteAltitude")), _altitude(gps))
    rtk = xmp.get("RtkFlag") == _FIXED
    error = _number(gps.get(_ERROR))
    sd = (error, 2 * error) if error else accuracy
    across = [_number(xmp.get(name)) for name in ("RtkStdLat", "RtkStdLon")]
    along = _number(xmp.get("RtkStdHgt"))
    if across[0] and across[1] and along:
        sd = (max(across[0], across[1]), along)
    if height is None:
        height, sd = 0.0, (sd[0], 1e4)  # it counts for nothing
    ellipsoidal = rtk or xmp.get("AltitudeType", "").lower().startswith("rtk")
    return Place(latitude, longitude, height, sd, ellipsoidal, rtk, _up(xmp))


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


def _degrees(parts: Any, reference: Any, negative: str) -> float | None:
    """Convert degrees, minutes and seconds of EXIF to one signed number."""
    try:
        degrees, minutes, seconds = ([float(part) for part in parts] + [0.0, 0.0])[:3]
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    value = degrees + minutes / 60 + seconds / 3600
    text = reference.decode("ascii", "replace") if isinstance(reference, bytes) else str(reference or "")
    return -value if text.strip("\x00 ").upper().startswith(negative) else value


def _altitude(gps: dict[int, Any]) -> float | None:
    height, reference = _number(gps.get(_ALTITUDE)), gps.get(_ALTITUDE_REF)
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


def _possible(place: Place) -> bool:
    """Tell whether a position can be one: receivers without a fix write zeros."""
    known = abs(place.latitude) <= 90 and abs(place.longitude) <= 180 and abs(place.height) < 20_000
    return known and (abs(place.latitude) > 1e-9 or abs(place.longitude) > 1e-9)
