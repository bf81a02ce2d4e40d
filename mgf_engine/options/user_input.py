# SPDX-License-Identifier: GPL-3.0-or-later
"""Options as users give them: ``--set NAME=VALUE``, and config files."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mgf_engine.errors import BadInput, reason
from mgf_engine.options.algorithms import is_algorithm_option
from mgf_engine.options.config import option_fields


def option_pairs(texts: Sequence[str]) -> dict[str, str]:
    """Read options from texts NAME=VALUE or SECTION.NAME=VALUE as ``--set`` takes them, not converted yet.

    Options of algorithms keep their section, since their names are unique within it only.

    Raises:
        BadInput: a text is no such pair, or the option is in another section.
    """
    return {_without_section(name): value for name, value in named_values("--set", texts).items()}


def _without_section(name: str) -> str:
    """Return the name of an option given as ``name`` or ``section.name``; an unknown one is told of later."""
    name = name.replace("-", "_")
    if is_algorithm_option(name):
        return name
    section, dot, own = name.rpartition(".")
    true = {f.name: f.metadata["section"] for f in option_fields()}.get(own)
    if dot and true is not None and section != true:
        raise BadInput(f"Option {own} is in the section '{true}', not '{section}'; give --set {true}.{own}=VALUE.")
    return own if true is not None else name


def named_values(flag: str, texts: Sequence[str]) -> dict[str, str]:
    """Return texts NAME=VALUE given with a flag, as name -> value.

    Raises:
        BadInput: a text is no such pair.
    """
    result = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals:
            raise BadInput(f"{flag} takes NAME=VALUE, not '{text}'.")
        result[name.strip()] = value.strip()
    return result


def read_config(path: Path) -> dict[str, Any]:
    """Read options from a JSON file (an object of option names and values).

    Raises:
        BadInput: the file cannot be read or is not a JSON object.
    """
    try:
        given = json.loads(path.read_bytes())  # UTF-8, or UTF-16 as PowerShell writes
    except (OSError, ValueError, RecursionError) as error:
        raise BadInput(
            f"Cannot read the config '{path}' ({reason(error)}); give a JSON file of option names and values."
        ) from error
    if not isinstance(given, dict):
        raise BadInput(f"The config '{path}' must be a JSON object of option names and values.")
    return given
