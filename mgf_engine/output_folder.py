# SPDX-License-Identifier: GPL-3.0-or-later
"""A folder of files made from a finished job: made beside the old one, put in its place when it is whole."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from mgf_engine.errors import BadInput
from mgf_engine.system import cpu_seconds, peak_memory


@dataclass
class Cost:
    """CPU seconds of each deliverable, and the process's largest memory in bytes after it."""

    seconds: dict[str, float] = field(default_factory=dict)
    memory: dict[str, int] = field(default_factory=dict)

    @contextmanager
    def of(self, name: str) -> Iterator[None]:
        """Count what happens meanwhile."""
        begun = cpu_seconds()
        yield
        self.seconds[name] = round(self.seconds.get(name, 0.0) + cpu_seconds() - begun, 2)
        self.memory[name] = peak_memory()


def check_place(folder: Path, index: str, what: str) -> None:
    """Refuse a folder that holds anything else than an earlier run.

    Args:
        index: name of the file that an earlier run left there; what: what such a folder holds, in one word.

    Raises:
        BadInput: it is a file, or holds other files.
    """
    if folder.is_file():
        raise BadInput(f"The output '{folder}' is a file; give a folder.")
    if folder.is_dir() and any(folder.iterdir()) and not (folder / index).is_file():
        raise BadInput(f"The folder '{folder}' is not empty and holds no {what}; give an empty or new folder.")


@contextmanager
def new_folder(folder: Path) -> Iterator[Path]:
    """Return a folder beside that takes the place of ``folder`` when the block ends well, and is removed otherwise.

    Raises:
        BadInput: nothing can be written there.
    """
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        beside = Path(tempfile.mkdtemp(prefix=f".part-{folder.name}-", dir=folder.parent))
    except OSError as error:
        raise BadInput(f"Cannot write to '{folder.parent}' ({error.strerror}); give --out another folder.") from error
    try:
        yield beside
        if folder.exists():
            shutil.rmtree(folder)
        beside.chmod(0o755)
        beside.rename(folder)
    except BaseException:
        shutil.rmtree(beside, ignore_errors=True)
        raise
