# SPDX-License-Identifier: GPL-3.0-or-later
"""How many photos may be damaged, and what is said of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.synthetic.colmap_scene import Messages, write_photo
from mgf_engine.errors import BadInput
from mgf_engine.files.images import UnreadablePhoto
from mgf_engine.scene.unreadable import check_readable, find_unreadable, warn_of_unreadable


def lost(count: int) -> dict[str, UnreadablePhoto]:
    return {f"{i}.jpg": UnreadablePhoto(f"Photo {i} is damaged.") for i in range(count)}


@pytest.mark.parametrize(("damaged", "count"), [(0, 0), (0, 2), (1, 4), (2, 5), (5, 10)])
def test_at_most_half_may_be_damaged_and_three_must_be_left(damaged: int, count: int) -> None:
    check_readable(lost(damaged), count, 0.5)


@pytest.mark.parametrize(
    ("damaged", "count", "text"),
    [
        (1, 3, "Photo 0 is damaged."),  # two are left
        (3, 5, "3 of 5 photos cannot be used, the first of them: Photo 0 is damaged."),
        (6, 10, "6 of 10 photos cannot be used, the first of them: Photo 0 is damaged."),
    ],
)
def test_too_few_are_refused(damaged: int, count: int, text: str) -> None:
    with pytest.raises(BadInput) as error:
        check_readable(lost(damaged), count, 0.5)
    assert str(error.value) == text


@pytest.mark.parametrize(
    ("damaged", "named"),
    [(1, "('0.jpg')"), (3, "('0.jpg', '1.jpg', '2.jpg')"), (4, "('0.jpg', '1.jpg', '2.jpg', ...)")],
)
def test_the_first_three_are_named(damaged: int, named: str) -> None:
    messages = Messages()
    warn_of_unreadable(lost(damaged), 300, messages.reporter)
    said = f"{damaged} of 300 photos are missing or cannot be read and are left out {named};"
    assert messages.warnings[0].startswith(said)


def test_nothing_is_said_where_all_can_be_read() -> None:
    messages = Messages()
    warn_of_unreadable({}, 300, messages.reporter)
    assert messages.warnings == []


def test_photos_are_decoded_to_find_damaged_ones(tmp_path: Path) -> None:
    for name in ("a.png", "b.png"):
        write_photo(tmp_path / name, np.random.default_rng(0).integers(0, 255, (30, 40, 3)).astype(np.uint8))
    content = (tmp_path / "b.png").read_bytes()
    (tmp_path / "b.png").write_bytes(content[: len(content) // 2])
    assert list(find_unreadable(tmp_path, ["a.png", "b.png", "gone.png"])) == ["b.png", "gone.png"]
