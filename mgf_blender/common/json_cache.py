# SPDX-License-Identifier: GPL-3.0-or-later
"""JSON files of the engine that the interface asks for at every redraw: read again only when they change."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, Generic, TypeVar

T = TypeVar("T")


class JsonCache(Generic[T]):
    """What JSON files say, by their paths.

    Args:
        parse: makes the answer of a file's path and its content; it may raise what a wrong content leads to.
    """

    def __init__(self, parse: Callable[[Path, Any], T]) -> None:
        self._parse = parse
        self._known: dict[str, tuple[tuple[int, int], T | None]] = {}  # path -> time and size of the file, what it says

    def get(self, path: Path) -> T | None:
        """Return what a file says; None where it is missing or not what it should be."""
        try:
            now, known = path.stat(), self._known.get(str(path))
            stamp = now.st_mtime_ns, now.st_size
            if known is None or known[0] != stamp:
                known = self._known[str(path)] = stamp, self._read(path)
        except OSError:
            return None  # it may be readable at the next redraw
        return known[1]

    def clear(self) -> None:
        """Forget all files."""
        self._known.clear()

    def _read(self, path: Path) -> T | None:
        try:
            return self._parse(path, json.loads(path.read_text(encoding="utf-8-sig")))
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
            return None
