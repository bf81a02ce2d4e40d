# SPDX-License-Identifier: GPL-3.0-or-later
"""What the scene stage takes for thousands of photos: time and memory per photo ought to be the same for any number.

``python -m benchmarks.long_street FOLDER --photos 250 1000 5000`` photographs one façade as long as it takes, a photo
every half metre, and runs ``mgf scene`` on each. CPU seconds and peak memory are those of the whole command.
"""

from __future__ import annotations

import argparse
import resource
import struct
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

WIDTH, HEIGHT, FOCAL = 240, 160, 200.0
STEP, AWAY, TALL = 0.5, 10.0, 8.0  # metres: between photos, to the façade, its height
DENSITY = 25  # sparse points per metre of façade
PERIOD, PER_METRE = 50, 20  # metres until the façade repeats itself, and pixels of its texture in one


def main() -> int:
    """Make each street and print a row for it."""
    parser = argparse.ArgumentParser(description="Measure the scene stage with many photos.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--photos", type=int, nargs="+", default=[250, 1000, 5000])
    args = parser.parse_args()
    print("photos  CPU s  ms per photo  peak GB", flush=True)
    for count in args.photos:
        scene = args.folder / f"street-{count}"
        if not (scene / "sparse" / "0" / "points3D.bin").exists():
            make_street(scene, count)
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        command = [sys.executable, "-m", "mgf_engine", "scene", str(scene), "--out", str(args.folder / f"job-{count}")]
        subprocess.run([*command, "--resume"], check=True, capture_output=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)  # its peak is the largest of all children so far
        cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        print(f"{count:6}  {cpu:5.1f}  {1000 * cpu / count:12.1f}  {after.ru_maxrss / 1e6:7.2f}", flush=True)
    return 0


def make_street(folder: Path, count: int) -> None:
    """Write photos and COLMAP model of a façade, cameras in a row along it that look straight at it."""
    rng = np.random.default_rng(count)
    texture = cv2.GaussianBlur(rng.uniform(0, 255, (int(TALL * PER_METRE), PERIOD * PER_METRE, 3)), (0, 0), 1.5)
    texture = ((texture - texture.mean()) * 4 + 128).clip(0, 255).astype(np.uint8)
    (folder / "images").mkdir(parents=True)
    reach = AWAY * WIDTH / 2 / FOCAL
    points = rng.uniform((-reach, 0), (STEP * count + reach, TALL), (int(DENSITY * (STEP * count + 2 * reach)), 2))
    points = points[np.argsort(points[:, 0])]
    seen = []
    for index in range(count):
        x = STEP * index
        first, last = np.searchsorted(points[:, 0], (x - reach, x + reach))
        seen.append(np.arange(first, last))
        cv2.imwrite(str(folder / "images" / name_of(index)), _photo(texture, x))
    _write_model(folder / "sparse" / "0", points, seen)


def name_of(index: int) -> str:
    """Return the name of a photo."""
    return f"{index:05}.jpg"


def _photo(texture: NDArray[np.uint8], x: float) -> NDArray[np.uint8]:
    """Draw what the camera at ``x`` sees, [HEIGHT, WIDTH, 3]; it stands at half the façade's height."""
    u, v = np.meshgrid(np.arange(WIDTH) + 0.5 - WIDTH / 2, np.arange(HEIGHT) + 0.5 - HEIGHT / 2)
    column = (x + u * AWAY / FOCAL) % PERIOD * PER_METRE
    row = (TALL / 2 + v * AWAY / FOCAL) * PER_METRE
    return np.asarray(cv2.remap(texture, column.astype(np.float32), row.astype(np.float32), cv2.INTER_LINEAR))


def _write_model(folder: Path, points: NDArray[np.float64], seen: list[NDArray[np.int64]]) -> None:
    """Write a COLMAP model; y of the points points down, like the photos' rows, and the façade lies at z = AWAY."""
    folder.mkdir(parents=True)
    camera = struct.pack("<QiiQQ4d", 1, 1, 1, WIDTH, HEIGHT, FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2)  # 1: PINHOLE
    (folder / "cameras.bin").write_bytes(camera)
    tracks: list[list[tuple[int, int]]] = [[] for _ in points]
    with (folder / "images.bin").open("wb") as file:
        file.write(struct.pack("<Q", len(seen)))
        for index, rows in enumerate(seen):
            x = STEP * index
            file.write(
                struct.pack("<i7di", index + 1, 1, 0, 0, 0, -x, -TALL / 2, 0, 1) + name_of(index).encode() + b"\0"
            )
            keypoints = np.empty(len(rows), [("u", "<f8"), ("v", "<f8"), ("id", "<i8")])
            keypoints["u"] = (points[rows, 0] - x) * FOCAL / AWAY + WIDTH / 2
            keypoints["v"] = (points[rows, 1] - TALL / 2) * FOCAL / AWAY + HEIGHT / 2
            keypoints["id"] = rows + 1
            file.write(struct.pack("<Q", len(rows)) + keypoints.tobytes())
            for place, row in enumerate(rows.tolist()):
                tracks[row].append((index + 1, place))
    with (folder / "points3D.bin").open("wb") as file:
        file.write(struct.pack("<Q", len(points)))
        for row, track in enumerate(tracks):
            x, y = points[row]
            file.write(struct.pack("<Q3d3BdQ", row + 1, x, y, AWAY, 128, 128, 128, 0.5, len(track)))
            file.write(np.array(track, "<i4").tobytes())


if __name__ == "__main__":
    sys.exit(main())
