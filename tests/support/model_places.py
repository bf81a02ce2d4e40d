# SPDX-License-Identifier: GPL-3.0-or-later
"""Projects with several COLMAP models, and which one is meant: the engine and the add-on must choose alike, or the
mesh would not stand among the imported cameras."""

from __future__ import annotations

from pathlib import Path

#: name: number of photos of the model in each folder, and the folder that is taken.
SEVERAL: dict[str, tuple[dict[str, int], str]] = {
    "most photos": ({"sparse/0": 3, "sparse/1": 6, "sparse/2": 4}, "sparse/1"),
    "the first of equals": ({"sparse/0": 5, "sparse/1": 5, "dense/sparse": 5}, "sparse/0"),
    "COLMAP's own place before others": ({"sparse/0": 5, "sparse_old": 6, "dense/sparse": 6}, "sparse/0"),
    "a folder called sparse before any other": ({"aligned": 6, "dense/sparse": 5}, "dense/sparse"),
    "the given folder itself": ({".": 4, "backup": 5}, "."),
    "deeper down": ({"work/dense/sparse": 3, "work/dense/sparse/0": 4}, "work/dense/sparse/0"),
}


def write_project(folder: Path, models: dict[str, int]) -> None:
    """Text models with so many photos each."""
    for place, photos in models.items():
        target = folder / place
        target.mkdir(parents=True, exist_ok=True)
        (target / "cameras.txt").write_text("1 PINHOLE 640 480 500 500 320 240\n")
        lines = [f"{k + 1} 1 0 0 0 {k} 0 0 1 {k}.jpg\n\n" for k in range(photos)]
        (target / "images.txt").write_text("".join(lines))
        (target / "points3D.txt").write_text("1 0 0 5 90 90 90 0.5 1 0\n" * (9 - photos))  # size says nothing
