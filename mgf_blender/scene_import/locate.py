# SPDX-License-Identifier: GPL-3.0-or-later
"""Find the model and the photos in the folder layouts people have."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from ..common.errors import UserError

_PHOTO_FOLDERS = ("images", "photos", "input", "rgb", "undistorted/images", "dense/images", ".")


def find_model(path: Path) -> Path:
    """The folder with cameras/images/points3D for a model file, its folder, or a project folder around it.

    Of several models the one with the largest ``images`` file is taken, which is the one with most photos.

    Raises:
        UserError: nothing there looks like a COLMAP model.
    """
    folder = path.parent if path.is_file() else path
    if not folder.is_dir():
        raise UserError("'{path}' does not exist; choose the folder of a COLMAP model or of its project.", path=path)
    found = [f for f in _model_folders(folder) if _images_file(f) is not None]
    if not found:
        raise UserError(
            "'{folder}' holds no COLMAP model (cameras, images and points3D as .bin or .txt); "
            "choose the model's folder or the folder around 'sparse'.",
            folder=folder,
        )
    return max(found, key=lambda f: _images_file(f).stat().st_size)  # type: ignore[union-attr]


def find_photo_folder(path: Path, model_folder: Path, names: list[str]) -> Path | None:
    """The folder under which most of ``names`` exist, or None when not one of them is found."""
    start = path.parent if path.is_file() else path
    best, most = None, 0
    for base in dict.fromkeys((start, model_folder, model_folder.parent, model_folder.parent.parent)):
        for sub in _PHOTO_FOLDERS:
            folder = base / sub
            hits = sum((folder / name).is_file() for name in names) if folder.is_dir() else 0
            if hits > most:
                best, most = folder, hits
        if most == len(names):
            break
    return best


def _images_file(folder: Path) -> Path | None:
    for suffix in (".bin", ".txt"):
        if (folder / f"images{suffix}").is_file() and (folder / f"cameras{suffix}").is_file():
            return folder / f"images{suffix}"
    return None


def _model_folders(folder: Path) -> Iterator[Path]:
    for base in (
        folder,
        folder / "sparse",
        folder / "colmap",
        folder / "colmap" / "sparse",
        folder / "dense" / "sparse",
    ):
        if base.is_dir():
            yield base
            yield from (child for child in sorted(base.iterdir()) if child.is_dir())
