# SPDX-License-Identifier: GPL-3.0-or-later
"""Read the user's own masks: one PNG per photo, matched by name, used unchanged.

A mask is named like its photo, with ``.png`` in place of or after the photo's extension, in the same subfolder or
directly in the folder. What the pixels mean:

* transparency that varies: building where opaque by half or more;
* colour (or palette): building where not black;
* grey with two values: building at the larger one; 8 or 16 bit;
* grey label maps as this program writes them (0 outside, 1 building, 2 and up elements, 255 ignored; 1 present and
  no other value from 64 to 254): as they are;
* any other grey (soft edges): building from half of the largest value up.
"""

from __future__ import annotations

from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mgf_engine.errors import BadInput
from mgf_engine.files.images import png_size
from mgf_engine.masks.store import read_png
from mgf_engine.model.masks import BUILDING, IGNORE, building
from mgf_engine.model.scene import Scene, View
from mgf_engine.scene.cameras import warp_labels


def no_mask_fits(folder: Path, photo: str) -> BadInput:
    """Return what to raise where no mask in the folder is named like a photo, for example ``photo``."""
    example = PurePosixPath(photo.replace("\\", "/")).with_suffix(".png")
    return BadInput(f"No mask in '{folder}' fits a photo; name each like its photo, for example '{example}'.")


def read_user_masks(folder: Path, scene: Scene) -> list[NDArray[np.uint8] | None]:
    """Read label maps of the photos that have a mask in the folder, None for the others.

    Raises:
        BadInput: no mask fits a photo, a mask cannot be read or has another size, or all masks are empty or full.
    """
    if not folder.is_dir():
        raise BadInput(f"The mask folder '{folder}' does not exist; give a folder with one PNG per photo.")
    result = [_read_one(folder, view) for view in scene.views]
    given = [labels for labels in result if labels is not None]
    if not given:
        raise no_mask_fits(folder, scene.views[0].name)
    if not any(building(labels).any() for labels in given):
        raise BadInput(f"Every mask in '{folder}' is empty; the building should be white, the rest black.")
    if all(building(labels).all() for labels in given):
        raise BadInput(f"Every mask in '{folder}' covers its whole photo; switch masks off with use_masks=false.")
    return result


def _read_one(folder: Path, view: View) -> NDArray[np.uint8] | None:
    path = find_mask(folder, view.name)
    if path is None:
        return None
    original, working = (view.original_width, view.original_height), (view.width, view.height)
    try:
        size = png_size(path.read_bytes())
    except OSError as error:
        raise BadInput(f"The mask '{path}' cannot be read ({error.strerror}); check its permissions.") from error
    if size is not None and size not in (original, working):
        raise BadInput(
            f"The mask '{path}' has {size[0]} x {size[1]} pixels, but its photo has {original[0]} x {original[1]}; "
            "make the mask from the photo itself."
        )
    image = read_png(path, (original, working))
    if image is None:
        raise BadInput(f"The mask '{path}' cannot be read; save it as a PNG again.")
    labels = to_labels(image, path)
    return labels if size != original else warp_labels(view, labels)  # the former: made on the working photo


def find_mask(folder: Path, name: str) -> Path | None:
    """Find the mask of a photo by the photo's name (with ``/``); None where there is none."""
    photo = PurePosixPath(name)
    for candidate in (photo.with_suffix(".png"), PurePosixPath(f"{name}.png"), photo):
        for path in (folder / candidate, folder / candidate.name):
            if path.suffix.lower() == ".png" and path.is_file():
                return path
    return None


def to_labels(image: NDArray[Any], path: Path) -> NDArray[np.uint8]:
    """Convert an image to labels; image as stored, [H, W] or [H, W, C] -> uint8 [H, W].

    Raises:
        BadInput: the pixels are neither 8 nor 16 bit, or a colour mask has no black.
    """
    if image.dtype not in (np.uint8, np.uint16):
        raise BadInput(f"The mask '{path}' holds {image.dtype} pixels; save it as an 8-bit grey PNG.")
    if image.ndim == 3 and image.shape[2] in (2, 4):
        alpha, image = image[..., -1], image[..., :-1]
        if alpha.min() != alpha.max():
            return (alpha > np.iinfo(alpha.dtype).max // 2).astype(np.uint8)
    if image.ndim == 3:
        if image.shape[2] == 1 or (image == image[..., :1]).all():
            image = image[..., 0]
        else:
            inside = image.any(2)
            if inside.all():
                raise BadInput(f"The colour mask '{path}' has no black; paint everything but the building black.")
            return np.asarray(inside, np.uint8)
    return _grey_labels(image)


def _grey_labels(image: NDArray[Any]) -> NDArray[np.uint8]:
    values = np.unique(image)
    if len(values) == 1:
        return np.full(image.shape, BUILDING if values[0] > 0 else 0, np.uint8)
    if len(values) == 2 and not (values[0] == BUILDING and values[1] == IGNORE):
        return np.asarray(image == values[1], np.uint8)
    elements = values[(values > 0) & (values != IGNORE)]
    if BUILDING in values and elements.max() < 64:
        return image.astype(np.uint8)
    return np.asarray(image >= float(values[-1]) / 2, np.uint8)
