# SPDX-License-Identifier: GPL-3.0-or-later
"""Read COLMAP's ``.txt`` files.

A text file that was cut off between two lines still parses, so two more things are looked at: the count in
COLMAP's header comment, and, where that header is there, the line end that COLMAP always writes last.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from mgf_engine.scene.colmap_binary import decode
from mgf_engine.scene.sparse import NO_POINT, Rigs, SparseCamera, SparseImage, SparsePoints, damaged, parameter_count

_COUNT = re.compile(r"#\s*Number of \w+:\s*(\d+)")
_INT_LIMIT = float(1 << 62)


def read_cameras(path: Path) -> list[SparseCamera]:
    """Read ``cameras.txt``; raises BadInput when damaged or of an unknown model."""
    lines, expected = _lines(path)
    cameras = []
    for line in _data(lines):
        fields = line.split()
        if len(fields) < 4:
            damaged(path, f"line '{line[:40]}' is too short")
        count = parameter_count(fields[1], path)
        if len(fields) != 4 + count:
            damaged(path, f"{fields[1]} takes {count} parameters, not {len(fields) - 4}")
        camera_id, width, height = (_int(fields[i], path) for i in (0, 2, 3))
        params = tuple(_numbers(fields[4:], path).tolist())
        cameras.append(SparseCamera(camera_id, fields[1], width, height, params))
    _check_count(path, len(cameras), expected)
    return cameras


def count_images(path: Path) -> int:
    """Return the number of photos in ``images.txt``; only meant for choosing between models."""
    lines, _ = _lines(path, strict=False)
    return sum(1 for _ in _image_lines(lines))


def read_images(path: Path) -> list[SparseImage]:
    """Read ``images.txt``; raises BadInput when damaged."""
    lines, expected = _lines(path)
    images = []
    for line, observed in _image_lines(lines):
        fields = line.split(maxsplit=9)
        if len(fields) != 10:
            damaged(path, f"line '{line[:40]}' is too short")
        pose = _numbers(fields[1:8], path)
        keypoints = _numbers(observed.split(), path)
        if len(keypoints) % 3:
            damaged(path, f"the keypoints of photo {fields[0]} are not triples")
        table = keypoints.reshape(-1, 3)
        point_ids = _ids(table[:, 2], path)
        xy = np.ascontiguousarray(table[:, :2])
        image_id, camera_id = _int(fields[0], path), _int(fields[8], path)
        images.append(SparseImage(image_id, fields[9], camera_id, pose[:4], pose[4:], xy, point_ids))
    _check_count(path, len(images), expected)
    return images


def read_names(path: Path) -> list[str]:
    """Read the photos' names in ``images.txt``; raises BadInput when damaged."""
    heads = [line.split(maxsplit=9) for line, _ in _image_lines(_lines(path)[0])]
    if any(len(fields) != 10 for fields in heads):
        damaged(path, "a photo's line is too short")
    return [fields[9] for fields in heads]


def read_points(path: Path) -> SparsePoints:
    """Read ``points3D.txt``; raises BadInput when damaged."""
    lines, expected = _lines(path)
    heads, tracks, lengths = [], [], []
    for line in _data(lines):
        fields = line.split()
        if len(fields) < 8 or len(fields) % 2:
            damaged(path, f"line '{line[:40]}' has {len(fields)} fields")
        heads.append(_numbers(fields[:8], path))
        tracks.append(_numbers(fields[8:], path))
        lengths.append((len(fields) - 8) // 2)
    _check_count(path, len(heads), expected)
    table = np.array(heads).reshape(-1, 8)
    elements = np.concatenate(tracks).reshape(-1, 2) if tracks else np.empty((0, 2))
    if not ((table[:, 4:7] >= 0) & (table[:, 4:7] <= 255)).all():
        damaged(path, "a colour is outside 0..255")
    return SparsePoints(
        _ids(table[:, 0], path), table[:, 1:4].copy(), table[:, 4:7].astype(np.uint8), table[:, 7].copy(),
        np.concatenate([[0], np.cumsum(lengths, dtype=np.int64)]).astype(np.int64),
        _ids(elements[:, 0], path), _ids(elements[:, 1], path),
    )  # fmt: skip


def read_rigs(rigs_path: Path, frames_path: Path) -> Rigs:
    """Read ``rigs.txt`` and ``frames.txt``; raises BadInput when damaged."""
    rig_ids: list[int] = []
    sensors: list[int] = []
    frame_rigs: list[int] = []
    frame_images: list[int] = []

    def rig(take: Callable[[], str]) -> None:
        rig_ids.append(_int(take(), rigs_path))
        for i in range(_int(take(), rigs_path)):
            kind, sensor = take(), _int(take(), rigs_path)
            sensors.extend([sensor] if kind == "CAMERA" else [])
            if i > 0 and take() == "1":
                _numbers([take() for _ in range(7)], rigs_path)

    def frame(take: Callable[[], str]) -> None:
        take()
        frame_rigs.append(_int(take(), frames_path))
        _numbers([take() for _ in range(7)], frames_path)
        for _ in range(_int(take(), frames_path)):
            kind, _, data = take(), _int(take(), frames_path), _int(take(), frames_path)
            frame_images.extend([data] if kind == "CAMERA" else [])

    _each_line(rigs_path, rig)
    _each_line(frames_path, frame)
    return Rigs(rig_ids, sensors, frame_rigs, frame_images)


def _each_line(path: Path, parse: Callable[[Callable[[], str]], None]) -> None:
    """Run ``parse`` on each data line; it takes the fields one by one and must take them all."""
    lines, expected = _lines(path)
    count = 0
    for line in _data(lines):
        fields = iter(line.split())
        try:
            parse(lambda fields=fields: next(fields))  # type: ignore[misc]
        except (StopIteration, RuntimeError):
            damaged(path, f"line '{line[:40]}' is too short")
        if next(fields, None) is not None:
            damaged(path, f"line '{line[:40]}' is too long")
        count += 1
    _check_count(path, count, expected)


def _lines(path: Path, *, strict: bool = True) -> tuple[list[str], int | None]:
    """Read all lines of a file, and the count that its header comment gives, None without one."""
    raw = path.read_bytes()
    lines = [decode(line.rstrip(b"\r")) for line in raw.split(b"\n")]
    counts = [int(m.group(1)) for line in lines[:20] if (m := _COUNT.match(line.strip()))]
    by_colmap = lines[0].startswith("#")
    if strict and by_colmap and not raw.endswith(b"\n"):
        damaged(path, "its last line has no end")
    if strict and b"\0" in raw:
        damaged(path, "it holds zero bytes")
    return lines, counts[0] if counts else None


def _data(lines: list[str]) -> Iterator[str]:
    """Yield lines that are neither empty nor comments."""
    return (line for raw in lines if (line := raw.strip()) and not line.startswith("#"))


def _image_lines(lines: list[str]) -> Iterator[tuple[str, str]]:
    """Yield the pairs of lines: a photo, and its keypoints (that line may be empty)."""
    rest = iter(lines)
    for raw in rest:
        line = raw.strip()
        if line and not line.startswith("#"):
            yield line, next(rest, "").strip()


def _check_count(path: Path, found: int, expected: int | None) -> None:
    if expected is not None and found < expected:
        damaged(path, f"its header speaks of {expected} entries, {found} are there")


def _numbers(fields: list[str], path: Path) -> np.ndarray:
    try:
        return np.array([float(f) for f in fields], np.float64)
    except ValueError:
        damaged(path, f"'{' '.join(fields)[:40]}' are not numbers")


def _int(field: str, path: Path) -> int:
    try:
        value = int(field)
    except ValueError:
        damaged(path, f"'{field[:40]}' is not a whole number")
    if not 0 <= value < 1 << 62:
        damaged(path, f"{value} is out of range")
    return value


def _ids(values: np.ndarray, path: Path) -> np.ndarray:
    """Return whole numbers that were read as float64; anything negative or beyond every real id means no point."""
    if not (np.isfinite(values) & (values == np.floor(values))).all():
        damaged(path, "an id is not a whole number")
    return np.where((values >= 0) & (values < _INT_LIMIT), values, NO_POINT).astype(np.int64)
