# SPDX-License-Identifier: GPL-3.0-or-later
"""Find the model and the photos in the folder layouts people have."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import NamedTuple

from ..common.errors import UserError
from .colmap import count_photos

#: Where models are looked for: COLMAP's own places, those of other tools, any folder. The engine looks in the same
#: (``mgf_engine/scene/colmap.py``), for the mesh must be made with the cameras that are imported here.
_PLACES = (("", "sparse", "sparse/*"), ("*/sparse", "*/sparse/*", "*/*/sparse", "*/*/sparse/*"), ("*",))
_PHOTO_KINDS = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".webp", ".bmp", ".ppm", ".pgm")
#: Not read by the engine, which says so.
_UNREAD_KINDS = (".heic", ".heif", ".avif", ".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".orf", ".rw2")
_PHOTO_FOLDERS = ("images", "photos", "input", "rgb", "undistorted/images", "dense/images", ".")


def find_model(path: Path) -> Path:
    """Find the folder with cameras/images/points3D for a model file, its folder, or a project folder around it.

    Of several models the one in the most usual place is taken, there the one with most photos, and of equals the first.

    Raises:
        UserError: nothing there looks like a COLMAP model, or a folder of models cannot be read.
    """
    folder = path.parent if path.is_file() else path
    if not folder.is_dir():
        raise UserError("'{path}' does not exist; choose the folder of a COLMAP model or of its project.", path=path)
    found = list(_models(folder))
    if not found:
        raise UserError(
            "'{folder}' holds no COLMAP model (cameras, images and points3D as .bin or .txt); "
            "choose the model's folder or the folder around 'sparse'.",
            folder=folder,
        )
    return max(found, key=_claim).folder if len(found) > 1 else found[0].folder  # max keeps the first of equals


def holds_model(folder: Path) -> bool:
    """Tell whether a COLMAP model lies in a folder, or where :func:`find_model` looks below it.

    Raises:
        UserError: a folder of models cannot be read.
    """
    return next(_models(folder), None) is not None


def holds_photos(folder: Path) -> bool:
    """Tell whether photos lie below a folder, of whatever kind; like the engine, this looks into no hidden folder.

    Raises:
        UserError: none is found, and a folder cannot be read.
    """
    locked = list[OSError]()
    for _, subfolders, names in os.walk(folder, onerror=locked.append):
        subfolders[:] = [name for name in subfolders if not name.startswith(".")]
        if any(name.lower().endswith(_PHOTO_KINDS + _UNREAD_KINDS) and not name.startswith(".") for name in names):
            return True
    if locked:
        raise _locked(locked[0].filename)
    return False


def find_photo_folder(path: Path, model_folder: Path, names: list[str]) -> Path | None:
    """Find the folder under which most of ``names`` exist, or None when not one of them is found."""
    start = path.parent if path.is_file() else path
    best, most = None, 0
    for base in dict.fromkeys((start, model_folder, model_folder.parent, model_folder.parent.parent)):
        for sub in _PHOTO_FOLDERS:
            folder = base / sub
            hits = sum(find_photo(folder, name) is not None for name in names) if folder.is_dir() else 0
            if hits > most:
                best, most = folder, hits
        if most == len(names):
            break
    return best


def find_photo(folder: Path, name: str) -> Path | None:
    """Find the file of a photo below a folder, or None. Of a name that is a whole path the last part will do."""
    plain = plain_name(name)
    whole = plain != name.replace("\\", "/")
    places = (plain, PurePosixPath(plain).name) if whole else (plain,)
    return next((path for place in places if os.path.isfile(path := folder / place)), None)


def plain_name(name: str, windows: bool = os.sep == "\\") -> str:
    """Return a photo's name as a path below a folder, with slashes: names from Windows hold backslashes, and a foreign
    model may hold a drive or a server, which Windows would log in at when asked for the file. The engine does the
    same."""
    path = PureWindowsPath(name) if windows else PurePosixPath(name.replace("\\", "/"))
    return path.relative_to(path.anchor).as_posix()


class _Found(NamedTuple):
    """A model: its folder, the kind of its files, and the number of its group of places."""

    folder: Path
    kind: str
    rank: int


def _claim(model: _Found) -> tuple[bool, bool, int, int]:
    """Return how much speaks for one of several: sound, with points, place, photos."""
    photos = count_photos(model.folder / f"images{model.kind}")
    return photos >= 0, (model.folder / f"points3D{model.kind}").is_file(), -model.rank, photos


def _models(folder: Path) -> Iterator[_Found]:
    """Yield folders with a model below ``folder``, the usual places first.

    Raises:
        UserError: one of the usual places cannot be read: what it holds must not count as missing.
    """
    seen = set()
    for rank, places in enumerate(_PLACES):
        for place in places:
            for base in sorted(folder.glob(place)) if place else [folder]:
                if rank == 0 and os.path.isdir(base) and not os.access(base, os.R_OK | os.X_OK):
                    raise _locked(base)
                kind = _kind(base) if base.is_dir() and base not in seen else ""
                seen.add(base)
                if kind:
                    yield _Found(base, kind, rank)


def _kind(folder: Path) -> str:
    """Return ``.bin`` or ``.txt``, or nothing where there is no model."""
    for kind in (".bin", ".txt"):
        if all(os.path.isfile(folder / f"{part}{kind}") for part in ("images", "cameras")):
            return kind
    return ""


def _locked(folder: Path | str) -> UserError:
    """Return the engine's sentence for a folder that may not be looked into."""
    return UserError("No permission for '{path}'; change its permissions or give another folder.", path=folder)
