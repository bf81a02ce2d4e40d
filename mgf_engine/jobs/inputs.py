# SPDX-License-Identifier: GPL-3.0-or-later
"""Identity of a job's input files when the job was opened: COLMAP model, photos, clicks, masks.

Only files that the stages read are included, so that other files in the user's folders do not make stages run again.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mgf_engine.errors import BadInput
from mgf_engine.masks.prompts import PromptsFile
from mgf_engine.masks.user_masks import find_mask
from mgf_engine.scene.colmap import find_model, find_photos, list_photos, model_files, photo_names

_LARGEST_HASHED = 16 << 20  # bytes; of larger files size and time are compared


@dataclass(frozen=True)
class Inputs:
    """Identity of the user's files.

    Attributes:
        scene: the model's files by content and its photos by size and time, as plain lists.
        names: of the photos.
        clicks: the prompts file; None where there is none.
        masks: the user's masks by size and time; None where there are none.
        tables: control points, marks and scale bars, option -> hash of the file's content.
    """

    scene: list[Any]
    names: tuple[str, ...]
    clicks: PromptsFile | None
    masks: list[Any] | None
    tables: dict[str, str] = field(default_factory=dict)


def read_inputs(
    source: Path,
    prompts: Path | None,
    masks: Path | None,
    job: Path,
    tables: Mapping[str, str] | None = None,
    most_missing: float = 1.0,
) -> Inputs:
    """Read the identity of all files that the stages will read.

    Args:
        source, prompts, masks, job: resolved; ``job`` is the job's own folder, which may lie inside the source.
        tables: option -> path of a small file that it names.
        most_missing: share of a model's photos that may not be there, 0..1.

    Raises:
        BadInput: the model is damaged, too many of its photos are missing, or a file cannot be read.
    """
    if not source.is_dir():
        raise BadInput(f"The scene '{source}' is not a folder; give a COLMAP scene or a folder of photos.")
    try:
        scene, names = _scene(source, job, most_missing)
        clicks = PromptsFile.read(prompts) if prompts is not None else None
        own = None if masks is None else [[n, *_look(p)] for n in names if (p := find_mask(masks, n)) is not None]
        hashes = {name: hashlib.sha256(Path(path).read_bytes()).hexdigest() for name, path in (tables or {}).items()}
    except OSError as error:
        reason = error.strerror or str(error)
        raise BadInput(f"Cannot read '{error.filename or source}' ({reason}); check that it is there.") from error
    return Inputs(scene, tuple(names), clicks, own, hashes)


def _scene(source: Path, job: Path, most_missing: float) -> tuple[list[Any], list[str]]:
    """Return what is compared of the model and the photos; the photos' names."""
    model = find_model(source, job)
    if model is None:
        root, names = list_photos(source, job)
        return [_place(root, source), [[name, *_look(root / name)] for name in names]], names
    names = photo_names(model)
    photos = find_photos(names, model, source, job, most_missing)
    files = [[file.name, *_content(file)] for file in model_files(model)]
    looked_at = [
        [n, _place(p, source), *(_look(p) if p.is_file() else ["missing"])] for n, p in zip(names, photos, strict=True)
    ]
    return [_place(model, source), files, looked_at], [name.replace("\\", "/") for name in names]


def _content(file: Path) -> list[Any]:
    return [hashlib.sha256(file.read_bytes()).hexdigest()] if file.stat().st_size < _LARGEST_HASHED else _look(file)


def _look(file: Path) -> list[Any]:
    status = file.stat()
    return [status.st_size, status.st_mtime_ns]


def _place(path: Path, source: Path) -> str:
    return path.relative_to(source).as_posix() if path.is_relative_to(source) else path.as_posix()
