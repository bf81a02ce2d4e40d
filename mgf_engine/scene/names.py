# SPDX-License-Identifier: GPL-3.0-or-later
"""Match photo names given by people: as in the model, by file name alone, in other case, with another extension."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import PurePosixPath

#: How names are compared, strictest first.
_KEYS: tuple[Callable[[str], str], ...] = (
    lambda n: n,
    lambda n: PurePosixPath(n).name,
    lambda n: n.casefold(),
    lambda n: PurePosixPath(n).name.casefold(),
    lambda n: PurePosixPath(n).stem.casefold(),
)


def named_like(name: str, names: Sequence[str]) -> list[int]:
    """Return positions of the names that ``name`` can stand for, by the strictest comparison that finds any."""
    wanted = name.replace("\\", "/")
    for key in _KEYS:
        found = [i for i, other in enumerate(names) if key(other.replace("\\", "/")) == key(wanted)]
        if found:
            return found
    return []
