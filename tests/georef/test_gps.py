# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a photo was taken, by its headers: hemispheres, heights, accuracies, and what is no position."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from PIL import Image
from PIL.ExifTags import GPS, IFD

from mgf_engine.georef.gps import read_gps_position

PLACE: dict[int, Any] = {
    GPS.GPSLatitudeRef: "N", GPS.GPSLatitude: (48.0, 8.0, 13.2), GPS.GPSLongitudeRef: "E",
    GPS.GPSLongitude: (11.0, 34.0, 30.0), GPS.GPSAltitudeRef: b"\x00", GPS.GPSAltitude: 519.5,
}  # fmt: skip


def photo(path: Path, **changes: Any) -> Path:
    """A JPEG with these tags of GPS, less those that are None."""
    tags = {**PLACE, **{getattr(GPS, f"GPS{name}"): value for name, value in changes.items()}}
    exif = Image.Exif()
    exif.get_ifd(IFD.GPSInfo).update({tag: value for tag, value in tags.items() if value is not None})
    Image.new("RGB", (8, 6)).save(path / "a.jpg", exif=exif)
    return path / "a.jpg"


def test_degrees_minutes_and_seconds(tmp_path: Path) -> None:
    found = read_gps_position(photo(tmp_path), (4.0, 9.0))
    assert found is not None
    assert (found.latitude, found.longitude, found.height) == pytest.approx((48.137, 11.575, 519.5))
    assert found.sd == (4.0, 9.0) and found.has_height and not found.rtk and not found.ellipsoidal


@pytest.mark.parametrize(
    ("changes", "latitude", "longitude"),
    [
        ({"LatitudeRef": "S"}, -48.137, 11.575),
        ({"LongitudeRef": "W"}, 48.137, -11.575),
        ({"LatitudeRef": "s", "LongitudeRef": "w"}, -48.137, -11.575),
        ({"LatitudeRef": None}, 48.137, 11.575),
    ],
)
def test_hemispheres(tmp_path: Path, changes: dict, latitude: float, longitude: float) -> None:
    found = read_gps_position(photo(tmp_path, **changes))
    assert found is not None and (found.latitude, found.longitude) == pytest.approx((latitude, longitude))


@pytest.mark.parametrize(
    ("reference", "height"), [(b"\x00", 12.5), (b"\x01", -12.5), (b"\x02", 12.5), (b"\x03", -12.5), (None, 12.5)]
)
def test_heights_below_zero(tmp_path: Path, reference: bytes | None, height: float) -> None:
    """In Exif 3.0 the references 2 and 3 are above and below sea level."""
    found = read_gps_position(photo(tmp_path, AltitudeRef=reference, Altitude=12.5))
    assert found is not None and found.height == height


def test_a_photo_without_height_has_a_place_alone(tmp_path: Path) -> None:
    found = read_gps_position(photo(tmp_path, AltitudeRef=None, Altitude=None))
    assert found is not None and not found.has_height and found.latitude == pytest.approx(48.137)


def test_the_accuracy_of_the_photo_is_taken_where_it_has_one(tmp_path: Path) -> None:
    found = read_gps_position(photo(tmp_path, HPositioningError=1.5))
    assert found is not None and found.sd == (1.5, 3.0)
    unknown = read_gps_position(photo(tmp_path, HPositioningError=0.0), (3.0, 6.0))
    assert unknown is not None and unknown.sd == (3.0, 6.0)


@pytest.mark.parametrize(
    "changes",
    [
        {"Latitude": None}, {"Longitude": None}, {"Latitude": (0.0, 0.0, 0.0), "Longitude": (0.0, 0.0, 0.0)},
        {"Latitude": (95.0, 0.0, 0.0)}, {"Longitude": (181.0, 0.0, 0.0)}, {"Altitude": 30_000.0},
    ],
)  # fmt: skip
def test_what_is_no_place_on_earth_is_none(tmp_path: Path, changes: dict) -> None:
    assert read_gps_position(photo(tmp_path, **changes)) is None


def test_a_file_without_tags_or_no_file_is_none(tmp_path: Path) -> None:
    Image.new("RGB", (8, 6)).save(tmp_path / "plain.jpg")
    (tmp_path / "text.jpg").write_text("no photo")
    for name in ("plain.jpg", "text.jpg", "nothing.jpg"):
        assert read_gps_position(tmp_path / name) is None
