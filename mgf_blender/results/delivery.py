# SPDX-License-Identifier: GPL-3.0-or-later
"""Read ``deliver.json`` of a finished job folder, and check it before anything in Blender changes."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any

import numpy as np

from ..common.errors import UserError, reason
from ..scene_import.cameras import CameraSpec

_TEXTURE = ("texture", "texture_uv")


@dataclass(frozen=True)
class ResultView:
    """A view of the job: its camera, the photo it worked on and, where one was made, its rendering."""

    camera: CameraSpec
    render: Path | None
    held_out: bool


@dataclass(frozen=True)
class Delivery:
    """The results of a job; files are absolute and exist, or None. The two of a texture come together."""

    folder: Path
    views: tuple[ResultView, ...]
    mesh: Path | None
    field: Path | None
    report: Path | None
    parts: Path | None
    texture: Path | None
    texture_uv: Path | None
    figures: dict[str, Any]


def read_delivery(folder: Path) -> Delivery:
    """Read ``deliver.json`` of a job folder.

    Raises:
        UserError: there is no such folder, the job has not finished, or the file cannot be used.
    """
    path = folder / "deliver.json"
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        if not folder.is_dir():
            raise UserError(
                "The job folder '{folder}' does not exist; choose the folder of a finished job.", folder=folder
            ) from error
        raise UserError(
            "'{folder}' holds no finished job (deliver.json is missing); resume the job first.", folder=folder
        ) from error
    except (OSError, ValueError, RecursionError) as error:
        raise UserError(
            "Cannot read '{path}' ({error}); run the job again with Resume.", path=path, error=reason(error)
        ) from error
    try:
        views = tuple(_view(folder, entry) for entry in content["views"])
        figures = dict(content.get("figures") or {})
        files = {key: _file(folder, content.get(key)) for key in ("mesh", "field", "report", "parts", *_TEXTURE)}
    except (KeyError, TypeError, ValueError, np.linalg.LinAlgError) as error:
        raise UserError(
            "'{path}' is not what this version reads ({error!r}); run the job again.", path=path, error=reason(error)
        ) from error
    for key in _TEXTURE:
        if files[key] is None and any(content.get(k) for k in _TEXTURE):
            raise UserError(
                "The texture in '{folder}' lacks its file '{name}'; run the job again.",
                folder=folder,
                name=content.get(key) or key,
            )
    return Delivery(folder, views, figures=figures, **files)


def _view(folder: Path, entry: dict[str, Any]) -> ResultView:
    to_world = np.array(entry["camera_to_world"], np.float64)
    if to_world.shape != (4, 4) or not np.isfinite(to_world).all():
        raise ValueError(f"camera_to_world of {entry.get('name')}")
    rotation = to_world[:3, :3].T
    camera = CameraSpec(
        str(entry["name"]), int(entry["width"]), int(entry["height"]),
        float(entry["fx"]), float(entry["fy"]), float(entry["cx"]), float(entry["cy"]),
        rotation, -rotation @ to_world[:3, 3], _file(folder, entry.get("file")),
        held=int(entry.get("held", 1)),
    )  # fmt: skip
    return ResultView(camera, _file(folder, entry.get("render")), bool(entry.get("held_out")))


def _file(folder: Path, name: object) -> Path | None:
    """Return an existing file of the job folder; names that lead out of it are refused."""
    if not isinstance(name, str) or not name:
        return None
    if PureWindowsPath(name).anchor or PurePosixPath(name).anchor:  # resolving it may ask a foreign server
        raise ValueError(f"'{name}' lies outside the job folder")
    path = (folder / name).resolve()
    if not path.is_relative_to(folder.resolve()):
        raise ValueError(f"'{name}' lies outside the job folder")
    return path if path.is_file() else None
