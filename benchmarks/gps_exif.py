# SPDX-License-Identifier: GPL-3.0-or-later
"""EXIF of a photo that says where it was taken."""

from __future__ import annotations

from PIL import Image

#: EXIF's tag of the GPS fields.
GPS = 0x8825


def gps_exif(latitude: float, longitude: float, height: float) -> Image.Exif:
    """Return EXIF with a place: degrees, negative in the south and west, and metres."""
    exif = Image.Exif()
    exif[GPS] = {
        1: "N" if latitude >= 0 else "S", 2: _sexagesimal(latitude), 3: "E" if longitude >= 0 else "W",
        4: _sexagesimal(longitude), 5: b"\0" if height >= 0 else b"\1", 6: abs(height),
    }  # fmt: skip
    return exif


def _sexagesimal(degrees: float) -> tuple[float, float, float]:
    """Return whole degrees, whole minutes and seconds of the absolute value."""
    whole = abs(degrees)
    minutes = 60 * (whole % 1)
    return float(int(whole)), float(int(minutes)), 60 * (minutes % 1)
