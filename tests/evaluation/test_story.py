# SPDX-License-Identifier: GPL-3.0-or-later
"""The sentences on what placed the surface follow the options of the job."""

from __future__ import annotations

import pytest

from mgf_engine.config import make_config
from mgf_engine.evaluation.story import placing


def test_by_default_matching_starts_and_ends_it() -> None:
    start, field, photos = placing(make_config(), 1500)
    assert start.startswith("Dense matching") and "closed surface" in start
    assert "trained for 1,500 iterations" in field and "fused into one" in field
    assert "correlate best, and once more on the finished mesh" in photos and "starting surface stays" in photos


def test_under_paper_the_field_is_the_surface() -> None:
    start, field, photos = placing(make_config({"preset": "paper"}), 7000)
    assert start.startswith("The sparse points") and "eq. 23-26" in field and photos.startswith("No photo is compared")


@pytest.mark.parametrize(
    ("given", "iterations", "part"),
    [
        ({"refine_rounds": 2}, 9, "2 times more"),
        ({"refine_rounds": 0}, 9, "correlate best; this decides"),
        ({"start": "dense"}, 9, "the field's depth stays"),
        ({"surface": "opacity"}, 9, "move the surface by"),
        ({"preset": "quick"}, 0, "The field, not trained, gives"),
        ({"use_masks": False}, 9, "gives points on the building"),
    ],
)
def test_each_sentence_says_what_was_set(given: dict, iterations: int, part: str) -> None:
    sentences = placing(make_config(given), iterations)
    assert len(sentences) == 3 and all(s[0].isupper() and s.endswith(".") for s in sentences)
    assert part in " ".join(sentences)
