# SPDX-License-Identifier: GPL-3.0-or-later
"""True elements reach the engine as elements, however many the building has."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.true_masks import few_labels, write_elements
from mgf_engine.errors import BadInput
from mgf_engine.masks.user_masks import to_labels


def strip(*values: int) -> np.ndarray:
    """An image with the wider fields first: so many pixels of each value as values follow it."""
    return np.concatenate([np.full(len(values) - i, v, np.uint8) for i, v in enumerate(values)])[None]


def test_elements_beyond_the_sixty_third_are_read_as_elements() -> None:
    labels = strip(0, 1, 255, 200, 77, 3)
    read = to_labels(few_labels(labels), Path("x.png"))
    assert np.unique(read).tolist() == [0, 1, 2, 3, 4, 255]
    assert ((read == 0) == (labels == 0)).all() and ((read == 255) == (labels == 255)).all()
    assert all(len(np.unique(read[labels == value])) == 1 for value in (1, 3, 77, 200))


def test_the_smallest_of_too_many_become_plain_building() -> None:
    labels = strip(0, 1, *range(2, 102))
    few = few_labels(labels)
    assert few.max() == 63 and (few[labels == 101] == 1).all() and (few[labels == 2] == 2).all()
    assert (to_labels(few, Path("x.png")) == few).all()


def test_a_damaged_image_is_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "scene" / "elements").mkdir(parents=True)
    cv2.imwrite(str(tmp_path / "scene" / "elements" / "a.png"), strip(0, 1, 90))
    assert cv2.imread(str(write_elements(tmp_path / "scene", tmp_path / "out") / "a.png"), -1).max() == 2
    (tmp_path / "scene" / "elements" / "b.png").write_bytes(b"no image")
    with pytest.raises(BadInput, match="make it again"):
        write_elements(tmp_path / "scene", tmp_path / "out")
