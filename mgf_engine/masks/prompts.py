# SPDX-License-Identifier: GPL-3.0-or-later
"""Read and check the user's clicks (``prompts.json``), and convert them to undistorted working pixels.

The file holds ``{"photo": {"positive": [[u, v], …], "negative": [[u, v], …], "parts": {"window": [[u, v], …]}}}``;
u, v are pixels of the user's own photo, (0, 0) its top-left corner.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mgf_engine.errors import BadInput
from mgf_engine.files.images import UnreadablePhoto, read_info
from mgf_engine.model.scene import Scene, View
from mgf_engine.scene.cameras import from_original
from mgf_engine.scene.names import named_like

Points = NDArray[np.float64]
_SHAPE = '{"photo": {"positive": [[u, v], ...], "negative": [[u, v], ...], "parts": {"window": [[u, v], ...]}}}'
_LARGEST_FILE = 32 << 20  # bytes; a thousand clicks on each of a thousand photos take less


def no_clicks() -> BadInput:
    """Make the error for a job with neither clicks nor masks."""
    return BadInput("There are no clicks on the building; give --prompts FILE, or --masks FOLDER with your own masks.")


def _none() -> Points:
    return np.zeros((0, 2))


@dataclass(frozen=True)
class Clicks:
    """Clicks on one photo, float64 [N, 2] each, in working pixels."""

    positive: Points = field(default_factory=_none)
    negative: Points = field(default_factory=_none)
    parts: dict[str, Points] = field(default_factory=dict)


Prompts = dict[int, Clicks]  # index of the view -> clicks


@dataclass(frozen=True)
class PromptsFile:
    """The content of a prompts file at the time it was read; ``path`` is named in messages."""

    path: Path
    content: bytes

    @classmethod
    def read(cls, path: Path) -> PromptsFile:
        """Read the file, unchecked but for its size; BadInput where that cannot be done.

        Raises:
            BadInput: the file is too large for clicks, cannot be read, or does not hold them in the known form.
        """
        try:
            if path.stat().st_size > _LARGEST_FILE:
                size = path.stat().st_size >> 20
                raise BadInput(f"'{path}' has {size} MB, too much for clicks; give the prompts file.")
            return cls(path, path.read_bytes())
        except OSError as error:
            raise BadInput(
                f"Cannot read the prompts file '{path}' ({error.strerror or error}); check the path."
            ) from error

    def digest(self) -> str:
        """Return a hash of the content."""
        return hashlib.sha256(self.content).hexdigest()


def read_prompts(given: Path | PromptsFile, scene: Scene, warn: Callable[[str], None] = lambda text: None) -> Prompts:
    """Read and check a prompts file.

    Args:
        given: path of the file, or its content.
        warn: called with a sentence if clicks are ignored because their photos have no camera.

    Raises:
        BadInput: it cannot be read, is malformed, names unknown photos, has clicks outside the frame, or has no
            click on the building at all.
    """
    data, path = _read_json(given), given.path if isinstance(given, PromptsFile) else given
    prompts: Prompts = {}
    names = [view.name for view in scene.views]
    left_out = [name for name in data if name.replace("\\", "/") in scene.left_out]
    unplaced = [name for name in data if name not in left_out and _is_unplaced(name, scene)]
    if unplaced:
        warn(
            f"{len(unplaced)} of {len(data)} photos with clicks are not in the COLMAP model (first: "
            f"'{unplaced[0]}'); their clicks are ignored."
        )
    for name, entry in data.items():
        if name in left_out or name in unplaced:
            continue
        index = _find_photo(name, names, path)
        if index in prompts:
            raise BadInput(f"'{path}' has two entries for the photo '{scene.views[index].name}'; merge them into one.")
        prompts[index] = _read_clicks(entry, scene.views[index], path)
    if unplaced and not prompts:
        raise BadInput(f"No photo with clicks in '{path}' is in the COLMAP model; click the building in some that are.")
    if left_out and not prompts:
        raise BadInput(f"All photos with clicks in '{path}' were left out of the scene; click the building in others.")
    if not any(len(c.positive) for c in prompts.values()):
        raise _none_on_building(path)
    return prompts


def check_prompts(given: PromptsFile, photos: Mapping[str, Path], *, placed: bool = False) -> None:
    """Check a prompts file as far as possible before the cameras are known.

    Args:
        given: the file.
        photos: name -> file of every photo.
        placed: whether the photos are those of a COLMAP model; clicks on other photos in their folder are ignored then.

    Raises:
        BadInput: as :func:`read_prompts` does.
    """
    clicks_on_building, names = 0, [name.replace("\\", "/") for name in photos]
    files = list(photos.values())
    for name, entry in _read_json(given).items():
        beside = placed and _lies_beside(name, dict(zip(names, files, strict=True)))
        frame = None if beside else _frame_of(files[_find_photo(name, names, given.path)], placed)
        for kind, title, values in _lists_of(entry, f"'{name}' in '{given.path}'"):
            pairs = _read_pairs(values, title)
            clicks_on_building += len(pairs) * (kind == "positive")
            if frame is not None:
                _check_frame(pairs, *frame, title)
    if not clicks_on_building:
        raise _none_on_building(given.path)


def _frame_of(photo: Path, placed: bool) -> tuple[tuple[int, int], int] | None:
    """Return the size of a photo as its camera will see it, and the EXIF orientation that this leaves out (1 for none).

    None stands for a photo that cannot be read, which the scene stage reports.

    Structure from motion sees the stored pixels. Whether the photos of a model are turned as EXIF says is the scene
    stage's to find: only what lies outside either way is wrong already.
    """
    try:
        info = read_info(photo)
    except UnreadablePhoto:
        return None
    if placed and info.turned_size != (info.width, info.height):
        return (max(info.turned_size), max(info.turned_size)), 1
    return (info.width, info.height), info.orientation


def clicked_names(given: Path | PromptsFile | None) -> list[str]:
    """Return the names of the photos with clicks, as in the prompts file; empty if it cannot be read.

    Mistakes in a file are reported by :func:`read_prompts`, when its clicks are needed.
    """
    if given is None:
        return []
    try:
        return sorted(_read_json(given))
    except BadInput:
        return []


def read_clicks_of(path: Path, view: View) -> Clicks:
    """Read the clicks on one photo; entries of other photos are not looked at.

    Raises:
        BadInput: the file cannot be read, has no entry for the photo, or the entry is malformed.
    """
    data = _read_json(path)
    names = list(data)
    found = named_like(view.name, names)
    if len(found) == 1:
        return _read_clicks(data[names[found[0]]], view, path)
    raise BadInput(f"'{path}' has no clicks on the photo '{view.name}'; click points on it first.")


def _read_json(given: Path | PromptsFile) -> dict[str, Any]:
    file = given if isinstance(given, PromptsFile) else PromptsFile.read(given)
    path = file.path
    try:
        data = json.loads(file.content, object_pairs_hook=_unique_keys)  # bytes: also UTF-16, as PowerShell writes
    except _DuplicateKey as error:
        raise BadInput(f"'{path}' holds '{error}' twice; merge the two entries into one.") from error
    except (ValueError, RecursionError) as error:
        raise BadInput(f"'{path}' is not valid JSON ({error}); it should look like {_SHAPE}.") from error
    if not isinstance(data, dict):
        raise BadInput(f"'{path}' should hold one entry per photo, like {_SHAPE}.")
    return data


class _DuplicateKey(Exception):
    pass


def _unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    result: dict[str, Any] = {}
    for key, value in pairs:
        if key in result:
            raise _DuplicateKey(key)
        result[key] = value
    return result


def _is_unplaced(name: str, scene: Scene) -> bool:
    """Tell whether a photo lies beside those of the scene without being among them."""
    return _lies_beside(name, {view.name: Path(view.photo) for view in scene.views if view.photo})


def _lies_beside(name: str, photos: Mapping[str, Path]) -> bool:
    """Tell whether a photo lies beside others (name -> file) without being one of them."""
    relative = PurePosixPath(name.replace("\\", "/"))
    if named_like(name, list(photos)) or relative.is_absolute() or ".." in relative.parts:
        return False
    roots = {file.parents[len(PurePosixPath(other).parts) - 1] for other, file in photos.items()}
    return any(os.path.isfile(root / relative) for root in roots)  # False also for names that no system allows


def _find_photo(name: str, photos: Sequence[str], path: Path) -> int:
    """Find a photo by its exact name, its file name, or either without regard to case or extension."""
    found = named_like(name, photos)
    if len(found) == 1:
        return found[0]
    if found:
        names = ", ".join(photos[i] for i in found[:3])
        raise BadInput(f"The photo '{name}' in '{path}' could be any of {names}; give its full name.")
    some = ", ".join(photos[:3])
    raise BadInput(f"'{path}' names the photo '{name}', which the scene does not have (it has {some}, ...).")


def _none_on_building(path: Path) -> BadInput:
    return BadInput(f"'{path}' has no click on the building; click at least one point on it in one photo.")


def _lists_of(entry: Any, where: str) -> list[tuple[str, str, Any]]:
    """Return what should be lists of clicks in a photo's entry, each after its kind and what messages call it."""
    if not isinstance(entry, dict):
        raise BadInput(f"The entry of {where} should be an object with 'positive' and 'negative', not {_short(entry)}.")
    unknown = sorted(set(entry) - {"positive", "negative", "parts"})
    if unknown:
        raise BadInput(f"The entry of {where} has '{unknown[0]}'; known are 'positive', 'negative' and 'parts'.")
    parts = entry.get("parts", {})
    if not isinstance(parts, dict):
        raise BadInput(f"'parts' of {where} should map names to clicks, not be {_short(parts)}.")
    own = [(kind, f"'{kind}' of {where}", entry.get(kind, [])) for kind in ("positive", "negative")]
    return [*own, *(("parts", f"the part '{name}' of {where}", values) for name, values in parts.items())]


def _read_clicks(entry: Any, view: View, path: Path) -> Clicks:
    lists = _lists_of(entry, f"'{view.name}' in '{path}'")
    positive, negative, *parts = (_read_points(values, view, title) for _, title, values in lists)
    return Clicks(positive, negative, dict(zip(map(str, entry.get("parts", {})), parts, strict=True)))


def _read_pairs(values: Any, title: str) -> list[tuple[float, float]]:
    if not isinstance(values, list):
        raise BadInput(f"{_upper(title)} should be a list of [u, v] pairs, not {_short(values)}.")
    for value in values:
        pair = isinstance(value, list) and len(value) == 2
        if not pair or not all(isinstance(c, int | float) and not isinstance(c, bool) for c in value):
            raise BadInput(f"{_upper(title)} holds {_short(value)}, which is not a pair of numbers [u, v].")
    return [(u, v) for u, v in values]


def _check_frame(pairs: Sequence[tuple[float, float]], size: tuple[int, int], held: int, title: str) -> None:
    stored = "" if held == 1 else " as stored, before its EXIF orientation turns it"
    for pair in pairs:
        u, v = (float(c) if abs(c) < 1e9 else math.inf for c in pair)
        if not (0 <= u <= size[0] and 0 <= v <= size[1]):
            raise BadInput(
                f"{_upper(title)} holds the click ({_short(pair[0])}, {_short(pair[1])}) outside the photo, which "
                f"has {size[0]} x {size[1]} pixels{stored}; click inside it."
            )


def _read_points(values: Any, view: View, title: str) -> Points:
    pairs = _read_pairs(values, title)
    _check_frame(pairs, (view.original_width, view.original_height), view.held, title)
    points = from_original(view, np.array(pairs, np.float64).reshape(-1, 2))
    if not np.isfinite(points).all():
        raise BadInput(
            f"{_upper(title)} holds a click outside the field of view of the lens; click nearer the photo's centre."
        )
    return np.clip(points, 0, (view.width - 1e-3, view.height - 1e-3))


def _upper(text: str) -> str:
    return text[0].upper() + text[1:]


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 40 else text[:37] + "..."
