# SPDX-License-Identifier: GPL-3.0-or-later
"""Check and clean the output folder of a town."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from mgf_engine.errors import BadInput
from mgf_engine.jobs.job_folder import check_no_file, make_folder, remove_refused, same_folder
from mgf_engine.town.plan import BUILDINGS, FILE, SCENE

#: What a town leaves that ended before its plan was whole; hidden files besides.
_OF_A_TOWN = {SCENE, BUILDINGS, FILE, "georef.json", "buildings.geojson", "map.png", "town.html"}


@contextmanager
def town_folder(folder: Path, source: Path) -> Iterator[None]:
    """Make the folder; take it away again if the town is refused before anything was made.

    Args:
        folder: where the town goes.
        source: the scene's folder.

    Raises:
        BadInput: it is a file or the scene itself, holds something else than a town, or cannot be written to.
    """
    check_no_file(folder)
    if same_folder(folder.resolve(), source.resolve()):
        raise BadInput("The output folder is the scene itself; give another folder.")
    new = not folder.exists()
    if not new and not (folder / FILE).is_file() and any(_is_foreign(path) for path in folder.iterdir()):
        raise BadInput(f"The output folder '{folder}' is not empty and holds no town; give an empty or new folder.")
    make_folder(folder)
    try:
        yield
    except BadInput:
        if new:
            remove_refused(folder)
        raise


def _is_foreign(path: Path) -> bool:
    return path.name not in _OF_A_TOWN and not path.name.startswith(".")
