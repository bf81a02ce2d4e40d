# SPDX-License-Identifier: GPL-3.0-or-later
"""Read what the headers of a photo tell of its camera: EXIF's GPS, and the XMP of drones.

What is not there, or no number, is passed over: photos without such tags are usual.
"""

from __future__ import annotations

import math
import warnings
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from PIL import Image
from PIL.ExifTags import IFD

_PNG_EXIF = {"exif", "Raw profile type exif"}


@dataclass(frozen=True)
class PhotoTags:
    """Tags of a photo.

    Attributes:
        gps: EXIF's GPS directory, tag -> value.
        xmp: properties of the XMP packet, local name -> text.
    """

    gps: dict[int, Any] = field(default_factory=dict)
    xmp: dict[str, str] = field(default_factory=dict)

    @property
    def up(self) -> tuple[float, float, float] | None:
        """Up by DJI's gimbal: unit vector in the camera's frame (x right, y down, z forward); None without."""
        pitch, roll = number(self.xmp.get("GimbalPitchDegree")), number(self.xmp.get("GimbalRollDegree"))
        if pitch is None or roll is None:
            return None
        p, r = math.radians(pitch), math.radians(roll)  # pitch: 0 level, -90 straight down
        return math.cos(p) * math.sin(r), -math.cos(p) * math.cos(r), math.sin(p)


def read_photo_tags(path: Path) -> PhotoTags:
    """Read the tags of a photo; none where the file cannot be read. Headers only are read."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with Image.open(path) as image:
                return tags_of(image)
    except Exception:  # whatever a damaged header makes the reader raise
        return PhotoTags()


def tags_of(image: Image.Image) -> PhotoTags:
    """Return the tags of an opened photo; none where they are damaged."""
    try:
        packet = image.info.get("xmp") or image.info.get("XML:com.adobe.xmp") or b""
        return PhotoTags(dict(exif_of(image).get_ifd(IFD.GPSInfo)), read_xmp(packet))
    except Exception:  # whatever a damaged header makes the reader raise
        return PhotoTags()


def exif_of(image: Image.Image) -> Image.Exif:
    """Return the EXIF of an opened photo, without decoding it.

    Pillow decodes a whole PNG to look for EXIF behind its pixels; only what stands before them counts.
    """
    return image.getexif() if image.format != "PNG" or not _PNG_EXIF.isdisjoint(image.info) else Image.Exif()


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


def number(value: Any) -> float | None:
    """Convert the value of a tag; None where it is no finite number."""
    try:
        number = float(value)
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return number if math.isfinite(number) else None
