# SPDX-License-Identifier: GPL-3.0-or-later
"""Write and read the masks of a job: ``labels/<photo>.png``, ``scores.json``, ``points.bin``, ``parts.json``.

Label maps are 8-bit grey PNGs whose values are the labels. ``points.bin`` is one byte per sparse point, 1 for the
masked points P'; ``parts.json`` lists second-level parts with their elements and points. Files are written atomically;
``scores.json`` is written last, so its presence means that the others are complete.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.errors import BadInput, reason
from mgf_engine.files.atomic import atomic_path, write_json
from mgf_engine.files.images import png_size
from mgf_engine.masks.parts import Part
from mgf_engine.model.masks import MaskSet, building
from mgf_engine.model.scene import Scene
from mgf_engine.model.up_direction import UP_METHODS, UpDirection
from mgf_engine.native.parallel import parallel_map

VERSION = 1
_AGAIN = "run the masks stage again"  # what to do about files that cannot be used


def label_files(scene: Scene) -> list[str]:
    """Return the label map's path of each view, relative to the masks folder; unique even where file stems are not."""
    stems = [PurePosixPath(v.name).stem for v in scene.views]
    if len({s.casefold() for s in stems}) < len(stems):
        stems = [v.name.replace("/", "__") for v in scene.views]
    return [f"labels/{stem}.png" for stem in stems]


def save_masks(
    masks: MaskSet,
    scene: Scene,
    folder: Path,
    reasons: list[str],
    figures: dict[str, Any] | None = None,
    parts: Sequence[Part] = (),
    threads: int = 1,
) -> None:
    """Write a mask set.

    Args:
        masks: label maps and scores of all views.
        scene: the scene they belong to, whose photo names the files get.
        folder: the job's mask folder; made where it is missing.
        reasons: per view, why it is flagged (empty where it is fine).
        figures: whatever else is worth keeping in ``scores.json``.
        parts: scene-wide second-level parts, for ``parts.json``.
        threads: photos that are written at a time.
    """
    files = label_files(scene)
    (folder / "labels").mkdir(parents=True, exist_ok=True)
    for path in (folder / "labels").glob("*.png"):
        if f"labels/{path.name}" not in files:
            path.unlink()
    for _ in parallel_map(lambda i: write_image(folder / files[i], masks.labels[i]), range(len(files)), threads):
        pass
    with atomic_path(folder / "points.bin") as temporary:
        temporary.write_bytes(masks.point_mask.astype(np.uint8).tobytes())
    listed = [
        {"name": p.name, "elements": [[scene.views[v].name, label] for v, label in p.elements], "points": p.points}
        for p in parts
    ]
    write_json(folder / "parts.json", {"version": VERSION, "parts": listed})
    views = [
        {
            "name": view.name,
            "labels": file,
            "score": round(float(masks.scores[k]), 4),
            "used": bool(masks.used[k]),
            "flag": reasons[k],
            "building": round(float(building(masks.labels[k]).mean()), 4),
            **({"clicks": masks.clicks[k].round(2).tolist()} if masks.clicks else {}),
        }
        for k, (view, file) in enumerate(zip(scene.views, files, strict=True))
    ]
    up = None if masks.up is None else {**masks.up.__dict__, "vector": masks.up.vector.tolist()}
    write_json(folder / "scores.json", {"version": VERSION, **(figures or {}), "up": up, "views": views})


def read_masks(folder: Path, scene: Scene) -> MaskSet:
    """Read what :func:`save_masks` wrote for this scene.

    Raises:
        BadInput: files are missing, damaged, or belong to another scene.
    """
    try:
        data = json.loads((folder / "scores.json").read_text(encoding="utf-8"))
        views = data["views"]
        names = [v["name"] for v in views]
        scores = np.array([v["score"] for v in views], np.float64).clip(-1e9, 1e9).astype(np.float32)
        used = np.array([v["used"] for v in views], bool)
        files = [str(v["labels"]) for v in views]
        points = np.frombuffer((folder / "points.bin").read_bytes(), np.uint8).astype(bool)
        if scores.ndim != 1 or used.ndim != 1 or not np.isfinite(scores).all():
            raise ValueError("scores")
        clicks, up = _clicks(views), _up(data.get("up"))
    except (OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
        raise BadInput(f"Cannot read the masks in '{folder}' ({reason(error)}); {_AGAIN}.") from error
    if names != [v.name for v in scene.views] or files != label_files(scene) or len(points) != len(scene.points):
        raise BadInput(f"The masks in '{folder}' belong to another scene; {_AGAIN}.")
    labels = []
    for view, file in zip(scene.views, files, strict=True):
        image = read_png(folder / file, ((view.width, view.height),))
        if image is None or image.dtype != np.uint8 or image.shape != (view.height, view.width):
            raise BadInput(f"The mask '{folder / file}' is missing, damaged or of another size; {_AGAIN}.")
        labels.append(image)
    return MaskSet(tuple(labels), used, scores, points, clicks, up)


def read_up(folder: Path) -> UpDirection | None:
    """Read the direction up alone, without the masks; None where there is none.

    Raises:
        BadInput: the file is damaged.
    """
    try:
        return _up(json.loads((folder / "scores.json").read_text(encoding="utf-8")).get("up"))
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        raise BadInput(f"Cannot read the masks in '{folder}' ({reason(error)}); {_AGAIN}.") from error


def _clicks(views: list[dict[str, Any]]) -> tuple[NDArray[np.float32], ...]:
    """Read the clicks on the building in each view, [K, 2]; () where the masks are not from clicks."""
    if not all("clicks" in view for view in views):
        return ()
    clicks = tuple(np.array(view["clicks"], np.float64).reshape(-1, 2).clip(-1e9, 1e9) for view in views)
    if not all(np.isfinite(c).all() for c in clicks):
        raise ValueError("clicks")
    return tuple(c.astype(np.float32) for c in clicks)


def _up(stored: Any) -> UpDirection | None:
    """Read the direction up; None where the masks know none, or as those of earlier versions no more than a vector."""
    if not isinstance(stored, dict):
        return None
    vector, sd = np.array(stored["vector"], np.float64), float(stored["sd"])
    unit = vector.shape == (3,) and abs(np.linalg.norm(vector) - 1) < 1e-6
    if not unit or not 0 < sd < np.inf or stored["method"] not in UP_METHODS:
        raise ValueError("up")
    return UpDirection(vector, sd, str(stored["method"]), int(stored["edges"]))


def write_image(path: Path, image: NDArray[np.uint8]) -> None:
    """Write an image through memory, so that any path works on any system.

    Raises:
        OSError: the picture cannot be encoded.
    """
    ok, data = cv2.imencode(path.suffix, image)
    if not ok:
        raise OSError(f"cannot encode '{path}'")
    with atomic_path(path) as temporary:
        temporary.write_bytes(data.tobytes())


def read_png(path: Path, sizes: Collection[tuple[int, int]] | None = None) -> NDArray[Any] | None:
    """Read the image as stored (any depth and channels, BGR order), or None where it cannot be read.

    Args:
        sizes: widths and heights that are expected; an image whose header tells another is not decoded (a small file
            can unpack to gigabytes) and counts as unreadable.
    """
    try:
        data = path.read_bytes()
    except OSError:
        return None
    if not data or (sizes is not None and png_size(data) not in sizes):
        return None
    try:
        return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        return None
