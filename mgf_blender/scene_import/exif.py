# SPDX-License-Identifier: GPL-3.0-or-later
"""Read the EXIF orientation of a JPEG: Blender shows the pixels as stored, and so do most COLMAP models."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import BinaryIO

_ORIENTATION = 0x0112
_EXIF = b"Exif\0\0"
_SIZES = {0xC0, 0xC1, 0xC2, 0xC3}  # markers of segments with the picture's size
_NO_SEGMENT = {0x01, *range(0xD0, 0xD9)}


def orientation_lacking(path: Path | None, size: tuple[int, int]) -> int:
    """Return the EXIF orientation that a photo of a camera of this size (width, height) still lacks; 1 for none.

    The camera of a model sees the stored pixels, or the turned photo: its aspect ratio tells.
    """
    if path is None or path.suffix.lower() not in {".jpg", ".jpeg"}:
        return 1
    try:
        with path.open("rb") as file:
            orientation, stored = _read(file)
    except (OSError, struct.error, IndexError):
        return 1
    same = stored is None or (stored[0] > stored[1]) == (size[0] > size[1])
    return orientation if same and 1 <= orientation <= 8 else 1


def _read(file: BinaryIO) -> tuple[int, tuple[int, int] | None]:
    """Return orientation, and stored width and height where the header has them."""
    orientation = 1
    if file.read(2) != b"\xff\xd8":
        return 1, None
    while True:
        mark = file.read(2)
        if len(mark) < 2 or mark[0] != 0xFF or mark[1] in {0xD9, 0xDA}:
            return orientation, None
        if mark[1] == 0xFF:  # a fill byte
            file.seek(-1, 1)
            continue
        if mark[1] in _NO_SEGMENT:
            continue
        (length,) = struct.unpack(">H", file.read(2))
        if mark[1] in _SIZES:
            height, width = struct.unpack(">xHH", file.read(5))
            return orientation, (width, height)
        if mark[1] == 0xE1:
            body = file.read(length - 2)
            if body.startswith(_EXIF):
                orientation = _orientation(body[len(_EXIF) :])
        else:
            file.seek(length - 2, 1)


def _orientation(tiff: bytes) -> int:
    """Return the orientation out of the first directory of an EXIF block."""
    order = "<" if tiff[:2] == b"II" else ">"
    (start,) = struct.unpack_from(order + "I", tiff, 4)
    (count,) = struct.unpack_from(order + "H", tiff, start)
    for entry in range(count):
        tag, _, _, value = struct.unpack_from(order + "HHIH", tiff, start + 2 + 12 * entry)
        if tag == _ORIENTATION:
            return int(value)
    return 1
