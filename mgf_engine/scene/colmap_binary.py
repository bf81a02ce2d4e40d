# SPDX-License-Identifier: GPL-3.0-or-later
"""Read COLMAP's ``.bin`` files; every count is checked against the file's size before anything is allocated."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pycolmap
from numpy.typing import NDArray

from mgf_engine.scene.sparse import NO_POINT, Rigs, SparseCamera, SparseImage, SparsePoints, damaged, parameter_count

_KEYPOINT = np.dtype([("xy", "<f8", 2), ("point", "<u8")])
_POINT = np.dtype([("id", "<u8"), ("xyz", "<f8", 3), ("rgb", "u1", 3), ("error", "<f8"), ("track", "<u8")])
_ELEMENT = np.dtype([("image", "<u4"), ("keypoint", "<u4")])
_CHUNK = 200_000
_MAX_ID = 1 << 62


class _Bytes:
    """A file's bytes with a read position; reading past the end refuses the file."""

    def __init__(self, path: Path) -> None:
        self.path, self.data, self.at = path, path.read_bytes(), 0

    def take(self, form: str) -> tuple:
        size = struct.calcsize("<" + form)
        self.need(size, "it ends too early")
        values = struct.unpack_from("<" + form, self.data, self.at)
        self.at += size
        return values

    def array(self, dtype: np.dtype, count: int) -> np.ndarray:
        self.need(count * dtype.itemsize, f"it cannot hold {count} records")
        values = np.frombuffer(self.data, dtype, count, self.at)
        self.at += count * dtype.itemsize
        return values

    def count(self, smallest: int) -> int:
        """Read a u64 count of records that take at least ``smallest`` bytes each."""
        (value,) = self.take("Q")
        self.need(value * smallest, f"it cannot hold {value} records")
        return int(value)

    def name(self) -> str:
        end = self.data.find(b"\0", self.at)
        if end < 0:
            damaged(self.path, "a name has no end")
        raw = self.data[self.at : end]
        self.at = end + 1
        return decode(raw)

    def need(self, size: int, why: str) -> None:
        if size > len(self.data) - self.at:
            damaged(self.path, why)

    def finish(self) -> None:
        if self.at != len(self.data):
            damaged(self.path, f"{len(self.data) - self.at} bytes are left over")


def decode(raw: bytes) -> str:
    """Return a file name as text: UTF-8, or Latin-1 where it is not UTF-8."""
    try:
        return raw.decode("utf-8")
    except UnicodeDecodeError:
        return raw.decode("latin-1")


def read_cameras(path: Path) -> list[SparseCamera]:
    """Read ``cameras.bin``; raises BadInput when damaged or of an unknown model."""
    file = _Bytes(path)
    cameras = []
    names = {int(value): name for name, value in pycolmap.CameraModelId.__members__.items()}
    for _ in range(file.count(24)):
        camera_id, model_id, width, height = file.take("IiQQ")
        model = names.get(model_id, str(model_id))
        params = file.take("d" * parameter_count(model, path))
        cameras.append(SparseCamera(camera_id, model, width, height, params))
    file.finish()
    return cameras


def count_images(path: Path) -> int:
    """Return the number of registered photos that ``images.bin`` claims; -1 when it cannot be read."""
    with path.open("rb") as file:
        head = file.read(8)
    return struct.unpack("<Q", head)[0] if len(head) == 8 else -1


def read_images(path: Path) -> list[SparseImage]:
    """Read ``images.bin``; raises BadInput when damaged."""
    file = _Bytes(path)
    images = []
    for _ in range(file.count(73)):
        image_id, *pose, camera_id = file.take("I7dI")
        name = file.name()
        keypoints = file.array(_KEYPOINT, file.count(_KEYPOINT.itemsize))
        points = np.where(keypoints["point"] < _MAX_ID, keypoints["point"], NO_POINT).astype(np.int64)
        quaternion, translation = np.array(pose[:4]), np.array(pose[4:])
        xy = np.ascontiguousarray(keypoints["xy"])
        images.append(SparseImage(image_id, name, camera_id, quaternion, translation, xy, points))
    file.finish()
    return images


def read_names(path: Path) -> list[str]:
    """Read the photos' names in ``images.bin``; raises BadInput when damaged."""
    file, names = _Bytes(path), list[str]()
    for _ in range(file.count(73)):
        file.take("I7dI")
        names.append(file.name())
        file.array(_KEYPOINT, file.count(_KEYPOINT.itemsize))
    return names


def read_points(path: Path) -> SparsePoints:
    """Read ``points3D.bin``; raises BadInput when damaged."""
    file = _Bytes(path)
    count = file.count(_POINT.itemsize)
    heads, lengths = np.empty(count, np.int64), np.empty(count, np.int64)
    at, size, length_of = file.at, len(file.data), struct.Struct("<Q").unpack_from
    skip = _POINT.itemsize
    for i in range(count):
        if at + skip > size:
            damaged(path, "it ends too early")
        (length,) = length_of(file.data, at + skip - 8)
        heads[i], end = at, at + skip + 8 * length
        if end > size:
            damaged(path, "a track ends too early")
        lengths[i], at = length, end
    file.at = at
    file.finish()
    raw = np.frombuffer(file.data, np.uint8)
    points = _gather(raw, heads, _POINT)
    start = np.concatenate([[0], np.cumsum(lengths)])
    within = np.arange(start[-1]) - np.repeat(start[:-1], lengths)
    elements = _gather(raw, np.repeat(heads + skip, lengths) + 8 * within, _ELEMENT)
    if count and int(points["id"].max()) >= _MAX_ID:
        damaged(path, "a point has an impossible id")
    return SparsePoints(
        points["id"].astype(np.int64), points["xyz"].copy(), points["rgb"].copy(), points["error"].copy(), start,
        elements["image"].astype(np.int64), elements["keypoint"].astype(np.int64),
    )  # fmt: skip


def read_rigs(rigs_path: Path, frames_path: Path) -> Rigs:
    """Read ``rigs.bin`` and ``frames.bin``; raises BadInput when damaged."""
    file = _Bytes(rigs_path)
    rig_ids: list[int] = []
    sensors: list[int] = []
    for _ in range(file.count(8)):
        rig_id, count = file.take("II")
        rig_ids.append(rig_id)
        for i in range(count):
            kind, sensor = file.take("iI")
            sensors += [sensor] if kind == 0 else []
            if i > 0 and file.take("B")[0]:
                file.take("7d")
    file.finish()
    file = _Bytes(frames_path)
    frame_rigs: list[int] = []
    frame_images: list[int] = []
    for _ in range(file.count(68)):
        _, rig_id, *_ = file.take("II7d")
        frame_rigs.append(rig_id)
        (count,) = file.take("I")
        for _ in range(count):
            kind, _, data = file.take("iIQ")
            frame_images += [data] if kind == 0 else []
    file.finish()
    return Rigs(rig_ids, sensors, frame_rigs, frame_images)


def _gather(raw: NDArray[np.uint8], starts: NDArray[np.int64], dtype: np.dtype) -> np.ndarray:
    """Gather records of ``dtype`` that begin at the given byte offsets."""
    result = np.empty(len(starts), dtype)
    width = np.arange(dtype.itemsize)
    for i in range(0, len(starts), _CHUNK):
        part = starts[i : i + _CHUNK]
        result[i : i + _CHUNK] = raw[part[:, None] + width].view(dtype)[:, 0]
    return result
