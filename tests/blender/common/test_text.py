# SPDX-License-Identifier: GPL-3.0-or-later
"""Sentences are broken where the panel ends."""

from __future__ import annotations

from layouts import Recorder

from mgf_blender.common.text import draw_value, widest, wrapped


def short(text: str) -> bool:
    return len(text) <= 12


def test_lines_are_as_long_as_fits():
    assert wrapped("The engine ended with code 9.", short) == ["The engine", "ended with", "code 9."]
    assert wrapped("Cancelled", short) == ["Cancelled"] and wrapped("", short) == [""]


def test_long_words_are_broken_and_nothing_is_lost():
    lines = wrapped("In '/home/some/very/long/folder' is no Python.", short)
    assert all(map(short, lines)) and "".join(lines).replace(" ", "") == "In'/home/some/very/long/folder'isnoPython."
    assert wrapped("/home/a/b/c/d/e", short)[0] == "/home/a/b/c/"
    assert wrapped("'/home/abc/images', or", short) == ["'/home/abc/", "images', or"]
    assert wrapped("C:\\Users\\abcdef", short) == ["C:\\Users\\", "abcdef"]
    assert wrapped("/" + 13 * "a", short)[0] == "/" + 11 * "a"


def test_a_panel_too_narrow_for_a_letter_still_ends():
    assert wrapped("ab c", lambda text: False) == ["a", "b", "c"]


def test_a_long_value_is_broken_beside_its_name():
    recorder = Recorder()
    value = "random walker, which needs no weights; 'mgf weights' fetches those of EfficientSAM (41 MB)"
    draw_value(recorder, "segmenter of the masks", value)
    name, *lines = [text for text, _ in recorder.texts]
    assert name == "segmenter of the masks" and len(lines) > 1 and " ".join(lines) == value


def test_the_longest_text_that_fits_is_drawn():
    long = "Finding the building in all the photos, 42%, 12 min left"
    assert widest(["Training, 42%, 12 min left", "42%"]) == "Training, 42%, 12 min left"
    assert widest([long, "42%, 12 min left"]) == "42%, 12 min left" and widest([long]) == long
