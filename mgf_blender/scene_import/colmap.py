# SPDX-License-Identifier: GPL-3.0-or-later
"""Read a COLMAP model (.bin or .txt) with numpy alone, because Blender's Python has no pycolmap.

Only what Blender shows is read: cameras, poses and sparse points with colour, error and track length. COLMAP's
conventions hold: ``camera = R @ world + t``, x right, y down, z forward; the centre of the top-left pixel is
(0.5, 0.5).
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..common.errors import UserError, reason

#: Model number in .bin files -> (name in .txt files, number of parameters). The COLMAP 4 list.
CAMERA_MODELS = {
    0: ("SIMPLE_PINHOLE", 3), 1: ("PINHOLE", 4), 2: ("SIMPLE_RADIAL", 4), 3: ("RADIAL", 5), 4: ("OPENCV", 8),
    5: ("OPENCV_FISHEYE", 8), 6: ("FULL_OPENCV", 12), 7: ("FOV", 5), 8: ("SIMPLE_RADIAL_FISHEYE", 4),
    9: ("RADIAL_FISHEYE", 5), 10: ("THIN_PRISM_FISHEYE", 12), 11: ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
    12: ("SIMPLE_DIVISION", 4), 13: ("DIVISION", 5), 14: ("SIMPLE_FISHEYE", 3), 15: ("FISHEYE", 4), 16: ("EUCM", 6),
}  # fmt: skip
_COUNTS = dict(CAMERA_MODELS.values())
_ONE_FOCAL = {"SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE"}
_ONE_FOCAL |= {"SIMPLE_DIVISION", "SIMPLE_FISHEYE"}
_NEVER_STRAIGHT = {"FISHEYE", "EUCM", "FOV"}


@dataclass(frozen=True)
class Camera:
    """Intrinsics in pixels; ``distorted`` says that a pinhole camera only comes close."""

    model: str
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distorted: bool


@dataclass(frozen=True)
class Photo:
    """A registered photo: ``camera = rotation @ world + translation`` (float64 [3, 3] and [3]).

    ``observed`` counts the sparse points seen in it.
    """

    id: int
    name: str
    camera: Camera
    rotation: np.ndarray
    translation: np.ndarray
    observed: int = 0

    @property
    def centre(self) -> np.ndarray:
        """Camera centre in the model's frame, [3]."""
        return -self.rotation.T @ self.translation


@dataclass(frozen=True)
class Points:
    """Sparse points: xyz float64 [P, 3], rgb uint8 [P, 3], error float32 [P] in pixels, track_length int32 [P]."""

    xyz: np.ndarray
    rgb: np.ndarray
    error: np.ndarray
    track_length: np.ndarray


@dataclass(frozen=True)
class Model:
    """A COLMAP model; photos in the order of their names."""

    folder: Path
    photos: tuple[Photo, ...]
    points: Points


def read_model(folder: Path) -> Model:
    """Read the model whose files lie in ``folder`` (see :func:`.locate.find_model` for other folders).

    Raises:
        UserError: a file is missing, cut short, or holds values that cannot be used.
    """
    suffix = ".bin" if (folder / "images.bin").is_file() else ".txt"
    readers = (_cameras_bin, _photos_bin, _points_bin) if suffix == ".bin" else (_cameras_txt, _photos_txt, _points_txt)
    tables = []
    for name, reader in zip(("cameras", "images", "points3D"), readers, strict=True):
        path = folder / (name + suffix)
        if name == "points3D" and not path.exists():
            tables.append(_points([], [], [], []))
            continue
        try:
            tables.append(reader(path.read_bytes()))
        except OSError as error:
            raise UserError(
                "Cannot read '{path}' ({reason}); the model needs this file.",
                path=path,
                reason=reason(error),
            ) from error
        except UserError as error:
            raise UserError("'{path}': {error}", path=path, error=error) from error
        except (struct.error, ValueError, IndexError, OverflowError, MemoryError) as error:
            raise UserError(
                "'{path}' is damaged or ends too early; export the model from COLMAP again.", path=path
            ) from error
    cameras, rows, points = tables
    if not rows:
        raise UserError("The model in '{folder}' has no registered photos; run COLMAP's mapper again.", folder=folder)
    photos = [_photo(row, cameras, folder) for row in rows]
    return Model(folder, tuple(sorted(photos, key=lambda p: p.name)), points)


def count_photos(path: Path) -> int:
    """Return the number of photos that ``images.bin`` claims or ``images.txt`` has, -1 when it cannot be so many."""
    try:
        if path.suffix == ".txt":
            return len(_photos_txt(path.read_bytes()))
        with path.open("rb") as file:
            (count,) = _U64.unpack(file.read(_U64.size))
        return count if count * _PHOTO_HEAD.size <= path.stat().st_size else -1
    except (OSError, struct.error, ValueError, IndexError, OverflowError):
        return -1


def quaternion_to_matrix(q: np.ndarray) -> np.ndarray:
    """Return rotation [3, 3] of the quaternion (w, x, y, z), which need not have length one."""
    w, x, y, z = np.asarray(q, np.float64) / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def make_camera(model: str, width: int, height: int, params: tuple[float, ...]) -> Camera:
    """Make the pinhole part of a COLMAP camera.

    Args:
        model: COLMAP's name of the camera model.
        width: of the photos, pixels.
        height: of the photos, pixels.
        params: of the model, in COLMAP's order.

    Raises:
        UserError: the model is unknown or a number is unusable.
    """
    if model not in _COUNTS:
        raise UserError(
            "the camera model '{model}' is not supported; undistort the photos with COLMAP first.", model=model
        )
    if len(params) != _COUNTS[model]:
        raise UserError(
            "a {model} camera has {count} parameters instead of {expected}.",
            model=model,
            count=len(params),
            expected=_COUNTS[model],
        )
    if model in _ONE_FOCAL:
        fx, fy, cx, cy, rest = params[0], params[0], params[1], params[2], params[3:]
    else:
        fx, fy, cx, cy, rest = *params[:4], params[4:]
    if not (np.isfinite(params).all() and fx > 0 and fy > 0 and 0 < width < 1 << 20 and 0 < height < 1 << 20):
        raise UserError("a camera has an impossible size or focal length; export the model from COLMAP again.")
    never = model.endswith("FISHEYE") or model in _NEVER_STRAIGHT
    return Camera(model, int(width), int(height), fx, fy, cx, cy, never or any(abs(k) > 1e-12 for k in rest))


class _Row(NamedTuple):
    """A photo as the files hold it: rotation as a quaternion (w, x, y, z)."""

    number: int
    name: str
    camera: int
    quaternion: np.ndarray
    translation: np.ndarray
    observed: int


def _photo(row: _Row, cameras: dict[int, Camera], folder: Path) -> Photo:
    if row.camera not in cameras:
        raise UserError(
            "The photo '{name}' in '{folder}' uses camera {camera_id}, which the model does not hold.",
            name=row.name,
            folder=folder,
            camera_id=row.camera,
        )
    q, t = row.quaternion, row.translation
    if not (np.isfinite(q).all() and np.isfinite(t).all() and 1e-6 < np.abs(q).max() < 1e6):
        raise UserError(
            "The pose of the photo '{name}' in '{folder}' is not a number; export the model again.",
            name=row.name,
            folder=folder,
        )
    return Photo(row.number, row.name, cameras[row.camera], quaternion_to_matrix(q), t, row.observed)


def _points(xyz: ArrayLike, rgb: ArrayLike, error: ArrayLike, length: ArrayLike) -> Points:
    points = Points(
        np.array(xyz, np.float64).reshape(-1, 3),
        np.array(rgb, np.uint8).reshape(-1, 3),
        np.clip(np.array(error, np.float64), 0, 1e30).astype(np.float32),
        np.array(length, np.int32),
    )
    good = np.isfinite(points.xyz).all(axis=1)
    if good.all():
        return points
    return Points(points.xyz[good], points.rgb[good], points.error[good], points.track_length[good])


class _Cursor:
    """Walks through a binary file; every read past the end raises ``struct.error``."""

    def __init__(self, data: bytes) -> None:
        self.data, self.at = data, 0

    def take(self, layout: struct.Struct) -> tuple:
        values = layout.unpack_from(self.data, self.at)
        self.at += layout.size
        return values

    def count(self, smallest: int) -> int:
        """Return a record count, refused when the file cannot hold that many records of ``smallest`` bytes."""
        (n,) = self.take(_U64)
        if n * smallest > len(self.data) - self.at:
            raise ValueError("count beyond the end of the file")
        return n

    def skip(self, size: int) -> None:
        if self.at + size > len(self.data):
            raise ValueError("record beyond the end of the file")
        self.at += size

    def text(self) -> str:
        end = self.data.index(b"\0", self.at)
        value = decode(self.data[self.at : end])
        self.at = end + 1
        return value


_U64 = struct.Struct("<Q")
_CAMERA_HEAD = struct.Struct("<IiQQ")
_PHOTO_HEAD = struct.Struct("<I7dI")
_KEYPOINT = np.dtype([("uv", "<f8", 2), ("point", "<i8")])
_POINT = np.dtype([("id", "<u8"), ("xyz", "<f8", 3), ("rgb", "u1", 3), ("error", "<f8"), ("length", "<u8")])


def _cameras_bin(data: bytes) -> dict[int, Camera]:
    cursor, cameras = _Cursor(data), {}
    for _ in range(cursor.count(_CAMERA_HEAD.size + 8)):
        number, kind, width, height = cursor.take(_CAMERA_HEAD)
        if kind not in CAMERA_MODELS:
            raise UserError(
                "camera model number {kind} is not supported; undistort the photos with COLMAP first.", kind=kind
            )
        name, n = CAMERA_MODELS[kind]
        cameras[number] = make_camera(name, width, height, cursor.take(struct.Struct(f"<{n}d")))
    return cameras


def _photos_bin(data: bytes) -> list[_Row]:
    cursor, rows = _Cursor(data), []
    for _ in range(cursor.count(_PHOTO_HEAD.size + 9)):
        number, qw, qx, qy, qz, tx, ty, tz, camera_id = cursor.take(_PHOTO_HEAD)
        name = cursor.text()
        (n,) = cursor.take(_U64)
        start = cursor.at
        cursor.skip(n * _KEYPOINT.itemsize)
        observed = int((np.frombuffer(data, _KEYPOINT, n, start)["point"] >= 0).sum())
        rows.append(_Row(number, name, camera_id, np.array([qw, qx, qy, qz]), np.array([tx, ty, tz]), observed))
    return rows


def _points_bin(data: bytes) -> Points:
    cursor = _Cursor(data)
    count = cursor.count(_POINT.itemsize)
    if count == 0:
        return _points([], [], [], [])
    starts, at, read, to_length = list[int](), cursor.at, _U64.unpack_from, _POINT.itemsize - _U64.size
    for _ in range(count):  # only the lengths are read one by one: Blender waits, and there may be a million points
        starts.append(at)
        at += _POINT.itemsize + 8 * read(data, at + to_length)[0]
    cursor.skip(at - cursor.at)
    windows = np.lib.stride_tricks.sliding_window_view(np.frombuffer(data, np.uint8), _POINT.itemsize)
    heads = windows[starts].view(_POINT)[:, 0]
    return _points(heads["xyz"], heads["rgb"], heads["error"], heads["length"])


def decode(raw: bytes) -> str:
    """Return text as the engine reads it: UTF-8, or Latin-1 where it is not UTF-8, as Windows writes photo names."""
    try:
        return raw.decode("utf-8")
    except UnicodeDecodeError:
        return raw.decode("latin-1")


def _lines(data: bytes) -> Iterator[str]:
    for raw in data.split(b"\n"):
        line = decode(raw.rstrip(b"\r"))
        if not line.lstrip().startswith("#"):
            yield line


def _cameras_txt(data: bytes) -> dict[int, Camera]:
    cameras = {}
    for line in _lines(data):
        words = line.split()
        if words:
            params = tuple(float(w) for w in words[4:])
            cameras[int(words[0])] = make_camera(words[1], int(words[2]), int(words[3]), params)
    return cameras


def _photos_txt(data: bytes) -> list[_Row]:
    # Two lines per photo; the second (its keypoints) may be empty, so blank lines count inside a pair.
    rows, lines = [], _lines(data)
    for line in lines:
        words = line.split(maxsplit=9)
        if not words:
            continue
        q, t = np.array([float(w) for w in words[1:5]]), np.array([float(w) for w in words[5:8]])
        observed = sum(not number.startswith("-") for number in next(lines, "").split()[2::3])
        rows.append(_Row(int(words[0]), words[9].rstrip(), int(words[8]), q, t, observed))
    return rows


def _points_txt(data: bytes) -> Points:
    xyz, rgb, error, length = [], [], [], []
    for line in _lines(data):
        words = line.split()
        if words:
            xyz.append([float(w) for w in words[1:4]])
            rgb.append([int(w) for w in words[4:7]])
            error.append(float(words[7]))
            length.append((len(words) - 8) // 2)
    return _points(xyz, rgb, error, length)
