# SPDX-License-Identifier: GPL-3.0-or-later
"""Parse and check values of options, given as text (command line) or plain data (JSON, Python)."""

from __future__ import annotations

import math
from typing import Any

from mgf_engine.errors import BadInput

_SWITCH = {"true": True, "on": True, "yes": True, "1": True, "false": False, "off": False, "no": False, "0": False}


def convert(name: str, value: Any, default: Any) -> Any:
    """Convert a value to the type of an option's default; a tuple may be text with commas between its numbers.

    Raises:
        BadInput: the value is of another type.
    """
    try:
        return parse_tuple(default, value) if isinstance(default, tuple) else parse(type(default), value)
    except (TypeError, ValueError, OverflowError) as error:
        raise BadInput(f"Option {name} takes {kind_name(default)}, not '{shorten(value)}'.") from error


def check_limits(name: str, value: Any, low: float | None, high: float | None) -> None:
    """Check that a number, or each number of a tuple, lies between two limits; None for no limit.

    Args:
        name: of the option, for the message.
        value: a number or a tuple of numbers.
        low: least value.
        high: largest value.

    Raises:
        BadInput: it does not.
    """
    for number in value if isinstance(value, tuple) else (value,):
        below, above = low is not None and number < low, high is not None and number > high
        if below or above:
            limit, wrong = (low, "at least") if below else (high, "at most")
            raise BadInput(f"Option {name} must be {wrong} {limit:.10g}, not {shorten(number)}.")


def parse(kind: type, value: Any) -> Any:
    """Convert a value to bool, int, finite float or str; ValueError or TypeError where it is no such value.

    Raises:
        ValueError: the text has no value of the type.
        TypeError: the value is of another type.
    """
    if kind is bool:
        key = str(value).strip().lower()
        if key not in _SWITCH:
            raise ValueError(value)
        return _SWITCH[key]
    if isinstance(value, bool):
        raise TypeError(value)
    if kind is int:
        if isinstance(value, float) and not value.is_integer():
            raise ValueError(value)
        return int(value)
    if kind is float:
        number = float(value)
        if not math.isfinite(number):
            raise ValueError(value)
        return number
    if not isinstance(value, str):
        raise TypeError(value)
    return value


def parse_tuple(default: tuple[Any, ...], value: Any) -> tuple[Any, ...]:
    """Convert a list, or text with commas, to as many numbers of the same types as the default has.

    Raises:
        ValueError: another number of values is wanted.
    """
    parts = value.split(",") if isinstance(value, str) else list(value)
    if len(parts) != len(default):
        raise ValueError(value)
    return tuple(parse(type(own), part) for own, part in zip(default, parts, strict=True))


def shorten(value: Any) -> str:
    """Shorten a value so that a sentence can hold it."""
    text = str(value) if not isinstance(value, int) or abs(value) < 10**50 else "a number of many digits"
    return text if len(text) <= 60 else text[:57] + "..."


def kind_name(default: Any) -> str:
    """Name the type of a default in words."""
    if isinstance(default, tuple):
        return f"{len(default)} numbers with commas between them"
    return {bool: "true or false", int: "a whole number", float: "a number", str: "text"}[type(default)]
