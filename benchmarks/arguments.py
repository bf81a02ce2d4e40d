# SPDX-License-Identifier: GPL-3.0-or-later
"""What the commands of ``mgf bench`` ask of their arguments, checked before anything is rendered or run."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from mgf_engine.errors import BadInput
from mgf_engine.options.config import make_config
from mgf_engine.options.user_input import option_pairs


def count(text: str) -> int:
    """Return a whole number from 1, for argparse."""
    try:
        value = int(text)
    except ValueError:
        value = 0
    if value < 1:
        raise argparse.ArgumentTypeError(f"takes a whole number from 1, not '{text}'")
    return value


def picture_size(text: str) -> tuple[int, int]:
    """Return width and height in pixels from a text like 750x500, for argparse."""
    width, _, height = text.partition("x")
    if not (width.isdecimal() and height.isdecimal() and int(width) and int(height)):
        raise argparse.ArgumentTypeError(f"takes a width and a height in pixels like 750x500, not '{text}'")
    return int(width), int(height)


def engine_options(texts: Sequence[str]) -> dict[str, str]:
    """Return the engine's options from NAME=VALUE texts, as text.

    Raises:
        BadInput: a text is no pair, or the engine would refuse the option.
    """
    options = option_pairs(texts)
    make_config(options)
    return options


def results_folder(folder: Path) -> Path:
    """Return the folder, made where it is missing.

    Raises:
        BadInput: it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInput(f"Cannot write results to '{folder}' ({error.strerror}); give another folder.") from error
    return folder
