# SPDX-License-Identifier: GPL-3.0-or-later
"""Run a job on a disk that is full at each new file once: ``python -m benchmarks.full_disk RECORD reconstruct ...``.

Files are told apart by folder, ending and their number within an attempt, since temporary names are random. After
every failure the same job is resumed in the same process, until no file is left that has not failed.
"""

from __future__ import annotations

import contextlib
import errno
import io
import json
import os
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mgf_engine.cli.main import main as mgf

_WRITING = os.O_WRONLY | os.O_RDWR
SAID = "disk"


class FullDisk:
    """Fails the first opening for writing of every file below ``folder``."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.failed, self.attempt = folder.resolve(), list[str](), Counter[str]()

    def check(self, file: Any) -> None:
        """Raise "no space left" when this file has not failed yet."""
        if not isinstance(file, str | os.PathLike):
            return
        path = Path(os.path.abspath(os.fspath(file)))
        if self.folder not in path.parents or path.name in (".lock", "log.txt"):
            return
        name = str(Path(*(_without_random(part) for part in path.relative_to(self.folder).parts)))
        self.attempt[name] += 1
        key = f"{name} {self.attempt[name]}"
        if key not in self.failed:
            self.failed.append(key)
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))

    @contextlib.contextmanager
    def __call__(self) -> Iterator[None]:
        """While this lasts, files fail."""
        real_open, real_os_open = io.open, os.open

        def fake_open(file: Any, mode: str = "r", *args: Any, **more: Any) -> Any:
            if set(mode) & set("wax+"):
                self.check(file)
            return real_open(file, mode, *args, **more)

        def fake_os_open(file: Any, flags: int, *args: Any, **more: Any) -> int:
            if flags & _WRITING and flags & os.O_CREAT:
                self.check(file)
            return real_os_open(file, flags, *args, **more)

        import builtins

        builtins.open, io.open, os.open = fake_open, fake_open, fake_os_open  # type: ignore[assignment]
        try:
            yield
        finally:
            builtins.open, io.open, os.open = real_open, real_open, real_os_open


def _without_random(name: str) -> str:
    """Return the name of a file or folder without the random end of a temporary one."""
    return name.rpartition("-")[0] + Path(name).suffix if name.startswith(".part-") else name


def run(record: Path, args: list[str], most: int = 2000) -> int:
    """Resume until the job ends well; the exit code of the last attempt. Writes the files that failed to ``record``."""
    disk = FullDisk(Path(args[args.index("--out") + 1]))
    code = 2
    for _ in range(most):
        disk.attempt.clear()
        before, output = len(disk.failed), io.StringIO()
        with contextlib.redirect_stdout(output), disk():
            code = mgf([*args, "--progress", "json"])
        if code == 0 and len(disk.failed) == before:
            break
        last = json.loads(output.getvalue().splitlines()[-1])
        text = last.get("text", "")
        if code != 0 and (code != 2 or SAID not in text):
            print(f"{disk.failed[-1]}: exit code {code}: {text}")
            return 1
        if len(disk.failed) == before:
            print(f"the job ends without a full disk: {text}")
            return 1
    record.write_text(json.dumps(disk.failed, indent=1))
    return code


if __name__ == "__main__":
    sys.exit(run(Path(sys.argv[1]), sys.argv[2:]))
