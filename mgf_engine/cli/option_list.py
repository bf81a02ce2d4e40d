# SPDX-License-Identifier: GPL-3.0-or-later
"""List the options of a job as text for the terminal (``mgf options``)."""

from __future__ import annotations

import textwrap
from typing import Any

from mgf_engine.options.algorithms import algorithms_schema

_NAME, _VALUE = 19, 13  # columns
_ALGORITHMS = (
    "Options of the algorithms, for experiments. Give them after --set (--set tsdf.band=1.5) or in a JSON file after "
    "--config. A number with several parts is given with commas (5,14)."
)
_INTRODUCTION = (
    "Options of 'mgf reconstruct' and of the stage commands. Give an option as a flag (--max-photos 60, --no-texture), "
    "after --set (--set max_photos=60), or in a JSON file after --config."
)


def options_text(schema: dict[str, Any], width: int) -> str:
    """Format a schema of :func:`mgf_engine.options.config.options_schema` as a table: name, default, meaning.

    Args:
        width: number of columns of the terminal.
    """
    width = max(width, 60)
    lines = textwrap.wrap(_INTRODUCTION, width, break_on_hyphens=False)
    for section in schema["sections"]:
        lines += ["", section]
        for entry in (o for o in schema["options"] if o["section"] == section):
            lines += _entry_lines(entry, width)
    return "\n".join(lines)


def algorithms_text(width: int) -> str:
    """Format the options of the algorithms as a table: name, default, meaning.

    Args:
        width: number of columns of the terminal.
    """
    width = max(width, 60)
    lines = textwrap.wrap(_ALGORITHMS, width, break_on_hyphens=False)
    title = ""
    for entry in algorithms_schema():
        if entry["algorithm"] != title:
            title = entry["algorithm"]
            lines += ["", f"{title} ({entry['stage']})"]
        lines.append(f"  {entry['name']}={default_text(entry['default'], entry['unit'])}")
        lines += textwrap.wrap(
            entry["help"], width, break_on_hyphens=False, initial_indent=" " * 6, subsequent_indent=" " * 6
        )
    return "\n".join(lines)


def option_meaning(entry: dict[str, Any]) -> str:
    """Return the help of one option of the schema, with its choices."""
    return entry["help"] + (f" {{{', '.join(entry['choices'])}}}" if entry["choices"] else "")


def default_text(value: bool | int | float | str | tuple[float, ...], unit: str = "") -> str:
    """Format a default: on or off, a number with its unit, a word, or a dash for empty text."""
    if isinstance(value, bool):
        return "on" if value else "off"
    if isinstance(value, tuple):
        return f"{','.join(f'{number:g}' for number in value)} {unit}".strip()
    text = f"{value:g}" if isinstance(value, float) else str(value) or "-"
    return f"{text} {unit}" if unit else text


def _entry_lines(entry: dict[str, Any], width: int) -> list[str]:
    head = f"  {entry['name']:<{_NAME}} {default_text(entry['default'], entry['unit']):<{_VALUE}} "
    meaning = textwrap.wrap(option_meaning(entry), width - len(head), break_on_hyphens=False)
    return [head + meaning[0], *(" " * len(head) + line for line in meaning[1:])]
