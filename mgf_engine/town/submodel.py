# SPDX-License-Identifier: GPL-3.0-or-later
"""The part of a scene that shows one building, as a COLMAP scene of its own: some photos, and the points around it.

The photos stay where they are: the folder holds links to them.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import NDArray

from mgf_engine.errors import BadInput
from mgf_engine.files.atomic import atomic_path
from mgf_engine.scene.colmap import plain_name
from mgf_engine.scene.sparse import NO_POINT, SparseImage, SparseModel

_FEWEST_VIEWS = 2  # that still see a point


def write_submodel(
    model: SparseModel, names: Sequence[str], kept: NDArray[np.bool_], photos: dict[str, Path], folder: Path
) -> int:
    """Write ``sparse/0`` and links in ``images``; what is the same already is not touched.

    Args:
        model: of the whole scene.
        names: the photos wanted, as the model names them.
        kept: bool [P], points of the model that are wanted, as far as two of the photos see them.
        photos: where each photo lies.
        folder: of the new scene.

    Returns:
        The number of points.

    Raises:
        BadInput: this disk can hold no links.
    """
    wanted = set(names)
    images = [image for image in model.images if image.name in wanted]
    points, ids = model.points, {image.id for image in images}
    here = np.isin(points.image_ids, np.array(sorted(ids), np.int64))
    counts = np.bincount(points.track_point[here], minlength=len(points.ids))
    rows = np.flatnonzero(kept & (counts >= _FEWEST_VIEWS))
    _write(folder / "sparse/0/cameras.txt", _camera_lines(model, images))
    place: dict[int, NDArray[np.int64]] = {}
    _write(folder / "sparse/0/images.txt", _image_lines(images, points.ids[rows], place))
    _write(folder / "sparse/0/points3D.txt", _point_lines(model, rows, here, place))
    for image in images:
        _link(photos[image.name], folder / "images" / PurePosixPath(plain_name(image.name)))
    _unlink_others(folder / "images", {plain_name(image.name) for image in images})
    return len(rows)


def _camera_lines(model: SparseModel, images: list[SparseImage]) -> list[str]:
    used = sorted({image.camera_id for image in images})
    cameras = [model.cameras[k] for k in used]
    return [f"{c.id} {c.model} {c.width} {c.height} {' '.join(f'{v:.17g}' for v in c.params)}" for c in cameras]


def _image_lines(images: list[SparseImage], ids: NDArray[np.int64], place: dict[int, NDArray[np.int64]]) -> list[str]:
    """Return two lines for each photo; ``place`` gets the new index of each of its keypoints, -1 where it is
    dropped."""
    lines = []
    for image in images:
        used = (image.point_ids != NO_POINT) & np.isin(image.point_ids, ids)
        place[image.id] = np.where(used, np.cumsum(used) - 1, -1)
        pose = " ".join(f"{v:.17g}" for v in (*image.quaternion, *image.translation))
        lines.append(f"{image.id} {pose} {image.camera_id} {image.name}")
        spots = zip(image.keypoints[used].tolist(), image.point_ids[used].tolist(), strict=True)
        lines.append(" ".join(f"{x:.9g} {y:.9g} {point}" for (x, y), point in spots))
    return lines


def _point_lines(
    model: SparseModel, rows: NDArray[np.int64], here: NDArray[np.bool_], place: dict[int, NDArray[np.int64]]
) -> list[str]:
    points, lines = model.points, []
    for row in rows.tolist():
        track = np.arange(points.start[row], points.start[row + 1])
        track = track[here[track]]
        seen = " ".join(
            f"{image} {place[image][keypoint]}"
            for image, keypoint in zip(points.image_ids[track].tolist(), points.keypoint[track].tolist(), strict=True)
        )
        x, y, z = points.xyz[row].tolist()
        r, g, b = points.rgb[row].tolist()
        lines.append(f"{points.ids[row]} {x:.17g} {y:.17g} {z:.17g} {r} {g} {b} {points.errors[row]:.6g} {seen}")
    return lines


def _write(path: Path, lines: list[str]) -> None:
    write_if_changed(path, "\n".join(lines) + "\n")


def write_if_changed(path: Path, text: str) -> bool:
    """Write a file unless it holds the same already, so that its time tells when it changed; whether it was written."""
    content = text.encode("utf-8")
    if path.is_file() and path.read_bytes() == content:
        return False
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)
    return True


def _link(photo: Path, link: Path) -> None:
    """Link a photo at a path, symbolically where the system allows it.

    Raises:
        BadInput: neither a symbolic nor a hard link can be made.
    """
    if link.is_symlink() and Path(os.readlink(link)) == photo:
        return
    link.parent.mkdir(parents=True, exist_ok=True)
    link.unlink(missing_ok=True)
    try:
        link.symlink_to(photo)
    except OSError:  # Windows lets administrators alone make symbolic links, unless its developer mode is on
        try:
            os.link(photo, link)
        except OSError as error:
            raise BadInput(
                f"Cannot link the photo '{photo}' from '{link.parent}' ({error.strerror}); put the output on the "
                "disk of the photos, or switch on Windows' developer mode."
            ) from error


def _unlink_others(folder: Path, names: set[str]) -> None:
    for path in [*folder.rglob("*")]:
        if (path.is_symlink() or path.is_file()) and path.relative_to(folder).as_posix() not in names:
            path.unlink()
