# SPDX-License-Identifier: GPL-3.0-or-later
"""The crop box: the part of space that is meshed, given in scene coordinates.

A box is the image of the cube -1..1 under an affine map, so it may be turned, stretched and sheared. It acts in the
mesh stage alone: what stands behind the box in a photo has to be modelled all the same, or Gaussians inside it would
take those colours.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mgf_engine.errors import BadInput, reason
from mgf_engine.model.scene import Scene, Similarity

_HOW = "give 6 numbers (lowest x y z, highest x y z), 16 (the matrix from the cube -1..1, row by row), or a file"

_LARGEST = 1e15  # of any coordinate


@dataclass(frozen=True)
class CropBox:
    """A box in one frame; ``to_cube`` float64 [4, 4] takes points of that frame into the cube -1..1."""

    to_cube: NDArray[np.float64]

    def contains(self, points: NDArray[np.float64], grow: float = 0.0) -> NDArray[np.bool_]:
        """Find the points [N, 3] in the box, enlarged by the share ``grow`` on every side; bool [N]."""
        local = points @ self.to_cube[:3, :3].T + self.to_cube[:3, 3]
        return np.asarray((np.abs(local) <= 1.0 + grow).all(1))

    def planes(self) -> NDArray[np.float64]:
        """Return six planes [6, 4]; a point p is inside when ``n . p + d >= 0`` for each (n, d)."""
        rows, last = self.to_cube[:3], np.array([0.0, 0.0, 0.0, 1.0])
        return np.concatenate([last - rows, last + rows])

    def normalised(self, frame: Similarity) -> CropBox:
        """Return the box of the scene frame in the normalised frame."""
        back = np.eye(4)
        back[:3, :3] = frame.rotation.T / frame.scale
        back[:3, 3] = -frame.rotation.T @ frame.translation / frame.scale
        return CropBox(self.to_cube @ back)


def crop_of(text: str, scene: Scene) -> CropBox | None:
    """Return the box of the option ``crop_box`` in the normalised frame of a scene; None when there is none."""
    box = parse_crop_box(text)
    return None if box is None else box.normalised(scene.to_normalised)


def parse_crop_box(text: str) -> CropBox | None:
    """Parse the box of the option's text, in the scene frame; None for an empty text.

    Raises:
        BadInput: the text is no box.
    """
    words = _words(text)
    if not words:
        return None
    try:
        numbers = np.array([float(w) for w in words])
    except ValueError as error:
        raise BadInput(f"The crop box holds '{text[:60]}', which is no list of numbers; {_HOW}.") from error
    if not np.isfinite(numbers).all():
        raise BadInput(f"The crop box holds a number that is not finite; {_HOW}.")
    if np.abs(numbers).max() > _LARGEST:
        raise BadInput(f"The crop box holds a number that is too large (over {_LARGEST:g}); {_HOW}.")
    if len(numbers) not in (6, 16):
        raise BadInput(f"The crop box has {len(numbers)} numbers; {_HOW}.")
    return CropBox(_inverse(_matrix(numbers)))


def read_crop_box(text: str) -> str:
    """Read the numbers of a crop box given as such or as the name of a file, checked, as one line of text.

    Raises:
        BadInput: there is no such file, or it holds no box.
    """
    text = text.strip()
    if text and not _is_numbers(text):
        try:
            text = Path(text).read_text(encoding="utf-8-sig")  # editors on Windows begin with a mark
        except (OSError, ValueError) as error:
            raise BadInput(f"Cannot read the crop box '{text[:60]}' ({reason(error)}); {_HOW}.") from error
    parse_crop_box(text)
    return " ".join(_words(text))


def _words(text: str) -> list[str]:
    return [w for w in re.split(r"[\s,;\[\]]+", text) if w]


def _is_numbers(text: str) -> bool:
    try:
        return bool([float(w) for w in _words(text)])
    except ValueError:
        return False


def _matrix(numbers: NDArray[np.float64]) -> NDArray[np.float64]:
    if len(numbers) == 16:
        return numbers.reshape(4, 4)
    low, high = numbers[:3], numbers[3:]
    matrix = np.diag([*(high - low) / 2, 1.0])
    matrix[:3, 3] = (low + high) / 2
    return matrix


def _inverse(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    sides = np.linalg.norm(matrix[:3, :3], axis=0)
    if not np.array_equal(matrix[3], (0, 0, 0, 1)) or sides.min() <= 0:
        raise BadInput(f"The crop box is flat or its last row is not 0 0 0 1; {_HOW}.")
    if abs(np.linalg.det(matrix[:3, :3] / sides)) < 1e-6:
        raise BadInput(f"The crop box is flat; {_HOW}.")
    return np.asarray(np.linalg.inv(matrix), np.float64)
