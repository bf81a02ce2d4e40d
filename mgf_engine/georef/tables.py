# SPDX-License-Identifier: GPL-3.0-or-later
"""Read tables as surveyors write them: comma, semicolon, tab or blanks, with or without header, decimal commas."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from mgf_engine.errors import BadInput

_MOST_BYTES = 16 << 20
_DECIMAL_COMMA = re.compile(r"[+-]?\d+,\d+")


@dataclass(frozen=True)
class Table:
    """Rows of a file.

    Attributes:
        path: where it lies, for messages.
        columns: name -> position, where a heading named them; else empty.
        rows: the fields of each row.
        lines: the line of the file that each row stands in.
        notes: comment lines, without their sign.
    """

    path: Path
    columns: dict[str, int]
    rows: list[list[str]]
    lines: list[int]
    notes: list[str]

    def number(self, row: int, column: int) -> float:
        """Return the number in a field.

        Raises:
            BadInput: it is none.
        """
        found = number_in(self.rows[row][column]) if column < len(self.rows[row]) else None
        if found is None:
            text = self.rows[row][column] if column < len(self.rows[row]) else ""
            raise BadInput(f"Line {self.lines[row]} of '{self.path}' has '{text}' where a number belongs; correct it.")
        return found

    def text(self, row: int, column: int | None) -> str:
        """Return the text in a field; empty where there is none."""
        return self.rows[row][column] if column is not None and column < len(self.rows[row]) else ""


def read_table(path: Path, names: Mapping[str, tuple[str, ...]]) -> Table:
    """Read a table.

    Args:
        names: column -> what headings call it, lower case letters and digits only.

    Raises:
        BadInput: the file cannot be read, or holds no row.
    """
    lines = [line for line in enumerate(read_text(path).splitlines(), start=1) if line[1].strip()]
    notes = [text.strip().lstrip("#").strip() for _, text in lines if text.lstrip().startswith("#")]
    plain = [(number, text) for number, text in lines if not text.lstrip().startswith("#")]
    separator = _separator([text for _, text in plain])
    try:
        rows = [(number, _fields(text, separator)) for number, text in plain]
    except csv.Error as error:  # of fields longer than any table has
        raise BadInput(f"'{path}' is no text file; give a table with one point in each line.") from error
    columns: dict[str, int] = {}
    if rows and not any(number_in(field) is not None for field in rows[0][1]):
        columns = _heading(rows.pop(0)[1], names)
    else:  # Metashape's heading is a comment
        columns = next((c for c in (_heading(_fields(n, separator), names) for n in notes) if len(c) > 2), {})
    if not rows:
        raise BadInput(f"'{path}' holds no rows; give a table with one point in each line.")
    return Table(path, columns, [fields for _, fields in rows], [number for number, _ in rows], notes)


def read_text(path: Path) -> str:
    """Read a small text file in UTF-8 or, where it is not, the Western code page.

    Raises:
        BadInput: it cannot be read, or is no text.
    """
    try:
        if path.stat().st_size > _MOST_BYTES:
            raise BadInput(f"'{path}' is larger than a table of points can be; check which file it is.")
        data = path.read_bytes()
    except OSError as error:
        raise BadInput(f"Cannot read '{path}' ({error.strerror}); check the path.") from error
    if b"\0" in data:
        raise BadInput(f"'{path}' is no text file; give a table with one point in each line.")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("cp1252", "replace")


def number_in(text: str) -> float | None:
    """Return the number a field holds, with decimal point or comma; None where it holds none."""
    text = text.strip()
    if _DECIMAL_COMMA.fullmatch(text):
        text = text.replace(",", ".")
    try:
        found = float(text)
    except ValueError:
        return None
    return found if math.isfinite(found) else None


def _separator(lines: list[str]) -> str:
    """Detect the delimiter of the fields: semicolon, tab or comma if most lines hold it, else a space."""
    for sign in (";", "\t"):
        if 2 * sum(sign in line for line in lines) > len(lines):
            return sign
    commas = sum("," in line and not _has_decimal_commas(line) for line in lines)
    return "," if 2 * commas > len(lines) else " "


def _has_decimal_commas(line: str) -> bool:
    """Tell whether a line is three fields or more between blanks whose commas are all decimal ones."""
    fields = line.split()
    return len(fields) > 2 and all("," not in field or _DECIMAL_COMMA.fullmatch(field) for field in fields)


def _fields(text: str, separator: str) -> list[str]:
    if separator == " ":
        return [part.strip('"') for part in text.split()]
    parts = next(csv.reader([text], delimiter=separator, skipinitialspace=True))  # quotes may hold the separator
    return [part.strip() for part in parts]


def _heading(fields: list[str], names: Mapping[str, tuple[str, ...]]) -> dict[str, int]:
    """Return column -> position, by what the heading's fields are called; the first that fits."""
    found: dict[str, int] = {}
    for position, field in enumerate(fields):
        plain = re.sub(r"[^a-z0-9/]", "", field.lower())
        for column, known in names.items():
            if column not in found and any(part in known for part in (plain, *plain.split("/"))):
                found[column] = position
                break
    return found
