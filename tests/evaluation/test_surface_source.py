# SPDX-License-Identifier: GPL-3.0-or-later
"""The sentences on what placed the surface follow the options of the job."""

from __future__ import annotations

import pytest

from mgf_engine.evaluation.surface_source import explain_surface
from mgf_engine.options.config import make_config


def test_by_default_matching_starts_and_ends_it() -> None:
    start, field, photos = explain_surface(make_config(), 1500)
    assert start.startswith("Dense matching") and "closed surface" in start
    assert "trained for 1,500 iterations" in field and "fused into one" in field
    assert "choose at each pixel between the field and that surface" in photos
    assert "correlate best, and once more on the finished mesh" in photos
    assert photos.endswith("the starting surface stays. In the end nearly flat parts are projected onto their planes.")


def test_under_paper_the_field_is_the_surface() -> None:
    start, field, photos = explain_surface(make_config({"preset": "paper"}), 7000)
    assert start.startswith("The sparse points") and "eq. 23-26" in field and photos.startswith("No photo is compared")
    assert photos.endswith("as accurate as the field.")


@pytest.mark.parametrize(
    ("given", "iterations", "part"),
    [
        ({"refine_rounds": 2}, 9, "2 times more"),
        ({"refine_rounds": 0}, 9, "correlate best. This decides"),
        ({"start": "dense"}, 9, "the field's depth stays"),
        ({"surface": "opacity"}, 9, "move the surface by"),
        ({"preset": "quick"}, 0, "The field is not trained: its Gaussians"),
        ({"use_masks": False}, 9, "gives points on the building"),
        ({"flatten": False}, 9, "the starting surface stays."),
        ({"match_photos": False}, 9, "as accurate as the field. In the end nearly"),
        ({"start": "sparse"}, 9, "photos then move each depth"),
    ],
)
def test_each_sentence_says_what_was_set(given: dict, iterations: int, part: str) -> None:
    sentences = explain_surface(make_config(given), iterations)
    assert len(sentences) == 3 and all(s[0].isupper() and s.endswith(".") for s in sentences)
    assert part in " ".join(sentences)
