# SPDX-License-Identifier: GPL-3.0-or-later
"""A scene folder being made worse: links to the original for whatever nobody touched."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pycolmap
from numpy.typing import NDArray

from benchmarks.prompts import click_prompts
from mgf_engine.errors import BadInput

Photo = NDArray[np.uint8]
_LINKS = ("elements", "truth.ply", "scene.json")  # sparse_truth is for scoring alone
#: Widths that levels in pixels are given for.
REFERENCE_WIDTH = 480.0


class SceneCopy:
    """Where a perturbation works.

    Attributes:
        source, folder: the original and the copy.
        rng: all randomness of the perturbation.
        other: another scene's folder, or None.
        scale, offset: the copy's frame: ``copied = scale * true + offset``.
    """

    def __init__(self, source: Path, folder: Path, rng: np.random.Generator, other: Path | None) -> None:
        self.source, self.folder, self.rng, self.other = source.resolve(), folder, rng, other
        self.scale, self.offset = 1.0, np.zeros(3)
        self._model_changed = self._photos_dropped = False
        folder.mkdir(parents=True)
        for name in _LINKS:
            if (self.source / name).exists():
                (folder / name).symlink_to(self.source / name)

    @cached_property
    def model(self) -> Any:
        """The COLMAP model; written when the copy is finished. Call :meth:`touch_model` after changing it."""
        return pycolmap.Reconstruction(self.source / "sparse/0")

    @property
    def images(self) -> list[Any]:
        """The registered photos in the order of their names."""
        return sorted((i for i in self.model.images.values() if i.has_pose), key=lambda i: str(i.name))

    @property
    def names(self) -> list[str]:
        """Names of the photos, as in the model."""
        return [str(image.name) for image in self.images]

    def touch_model(self) -> None:
        self._model_changed = True

    def drop_photos(self, keep: list[str]) -> None:
        """Leave only these photos; clicks are set anew on a fifth of them."""
        for image in self.images:
            if str(image.name) not in keep:
                self.model.deregister_frame(image.frame_id)
        self._model_changed = self._photos_dropped = True

    def pixels(self, level: float) -> float:
        """Return a level given in pixels of the reference width, in pixels of this scene's photos."""
        width = next(iter(self.model.cameras.values())).width
        return level * width / REFERENCE_WIDTH

    def photo(self, name: str) -> Photo:
        """Return the original photo, BGR uint8 [H, W, 3]."""
        return _read(self.source / "images" / name, cv2.IMREAD_COLOR)

    def write_photo(self, name: str, photo: NDArray[Any]) -> None:
        """Write a photo of the copy; values are rounded and clipped."""
        path = self.folder / "images" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        data = np.clip(np.round(photo), 0, 255).astype(np.uint8)
        quality = [cv2.IMWRITE_JPEG_QUALITY, 95] if path.suffix.lower() in (".jpg", ".jpeg") else []
        if not cv2.imwrite(str(path), data, quality):
            raise OSError(f"cannot write '{path}'")

    def mask(self, name: str) -> Photo:
        """Return the original true label map, uint8 [H, W]."""
        return _read(self.source / "masks" / _mask_name(name), cv2.IMREAD_UNCHANGED)

    def write_mask(self, name: str, labels: NDArray[Any]) -> None:
        path = self.folder / "masks" / _mask_name(name)
        path.parent.mkdir(parents=True, exist_ok=True)
        if not cv2.imwrite(str(path), labels.astype(np.uint8)):
            raise OSError(f"cannot write '{path}'")

    def finish(self) -> None:
        """Write the model if it changed, link everything else, set clicks."""
        names = [str(image.name) for image in self.images]
        if self._model_changed:
            target = self.folder / "sparse/0"
            target.mkdir(parents=True)
            self.model.write(target)
        else:
            (self.folder / "sparse").symlink_to(self.source / "sparse")
        for name in names:
            _link(self.folder / "images" / name, self.source / "images" / name)
            _link(self.folder / "masks" / _mask_name(name), self.source / "masks" / _mask_name(name))
        self._write_clicks(names)

    def _write_clicks(self, names: list[str]) -> None:
        """The original's clicks, or new ones on a fifth of the photos that are left (at least three, or all)."""
        target = self.folder / "prompts.json"
        if not self._photos_dropped:
            target.symlink_to(self.source / "prompts.json")
            return
        poses = np.array([[*i.projection_center(), *i.cam_from_world().rotation.matrix()[2]] for i in self.images])
        click_prompts(target, names, poses, [self.mask(name) for name in names])


def _read(path: Path, flags: int) -> Photo:
    picture = cv2.imread(str(path), flags)
    if picture is None:
        raise BadInput(f"The picture '{path}' cannot be read; make the scene again.")
    return np.asarray(picture, np.uint8)


def _mask_name(name: str) -> str:
    return str(Path(name).with_suffix(".png"))


def _link(path: Path, original: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.exists():
        path.symlink_to(original)
