# SPDX-License-Identifier: GPL-3.0-or-later
"""Leave out photos that are missing or cannot be read, with one warning, if enough others are left."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from mgf_engine.errors import BadInput
from mgf_engine.files.images import UnreadablePhoto, read_rgb
from mgf_engine.messages import Reporter
from mgf_engine.scene.colmap import too_many_lost

_NAMED = 3  # photos that the warning names


def find_unreadable(root: Path, names: Sequence[str]) -> dict[str, UnreadablePhoto]:
    """Decode photos of a folder; returns those that cannot be read, name -> what is wrong."""
    found: dict[str, UnreadablePhoto] = {}
    for name in names:
        try:
            read_rgb(root / name)
        except UnreadablePhoto as error:
            found[name] = error
    return found


def check_readable(unreadable: Mapping[str, UnreadablePhoto], count: int, largest_share: float) -> None:
    """Refuse a scene most of whose photos cannot be read: a disk or a copy failed, and the rest would give half a
    building.

    Args:
        unreadable: photos that cannot be read, by name.
        count: number of photos, those included.
        largest_share: of the photos that may be left out, 0..1.

    Raises:
        BadInput: too few are left; all are counted, the first is named.
    """
    lost = list(unreadable.values())
    if not too_many_lost(len(lost), count, largest_share):
        return
    if len(lost) == 1:
        raise lost[0]
    raise BadInput(f"{len(lost)} of {count} photos cannot be used, the first of them: {lost[0]}")


def warn_of_unreadable(unreadable: Mapping[str, UnreadablePhoto], count: int, reporter: Reporter) -> None:
    """Name the photos that are left out because they cannot be read; see :func:`check_readable`."""
    if unreadable:
        names = [f"'{name}'" for name in unreadable]
        named = ", ".join(names[:_NAMED] + ["..."] * (len(names) > _NAMED))
        reporter.warning(
            f"{len(names)} of {count} photos are missing or cannot be read and are left out ({named}); put the "
            "files back or export the photos again, and run again."
        )
