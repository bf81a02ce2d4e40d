# SPDX-License-Identifier: GPL-3.0-or-later
import contextlib
import os
import subprocess
import sys
from pathlib import Path

import pytest

from mgf_engine.files import atomic
from mgf_engine.files.atomic import atomic_path, write_json


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    write_json(path, [1])
    with pytest.raises(ValueError, match="half way"), atomic_path(path) as temporary:
        temporary.write_text("half")
        raise ValueError("half way")
    assert path.read_text().split() == ["[", "1", "]"]
    assert [p.name for p in tmp_path.iterdir()] == ["a.json"]


@pytest.mark.parametrize(("windows", "tries", "written"), [(True, 3, True), (True, 1000, False), (False, 1, False)])
def test_on_windows_a_file_that_is_being_read_is_waited_for(tmp_path, monkeypatch, windows, tries, written) -> None:
    write_json(tmp_path / "a.json", [1])
    held, waited, replace = [tries], [], os.replace

    def held_open(new: Path, old: Path) -> None:
        held[0] -= 1
        if held[0] >= 0:
            raise PermissionError(13, "The process cannot access the file")
        replace(new, old)

    monkeypatch.setattr(atomic, "_WINDOWS", windows)
    monkeypatch.setattr(os, "replace", held_open)
    monkeypatch.setattr(atomic.time, "sleep", waited.append)
    with contextlib.nullcontext() if written else pytest.raises(PermissionError):
        write_json(tmp_path / "a.json", [2])
    assert (tmp_path / "a.json").read_text().split() == ["[", "2" if written else "1", "]"]
    assert sum(waited) < 2.5
    assert (len(waited) > 0) == windows
    assert [p.name for p in tmp_path.iterdir()] == ["a.json"]


@pytest.mark.skipif(os.name != "posix", reason="rights of files are a matter of POSIX systems")
@pytest.mark.parametrize("umask", ["022", "077"])
def test_files_get_the_rights_the_user_wants(tmp_path: Path, umask: str) -> None:
    code = "import sys, pathlib, mgf_engine.files.atomic as f; f.write_json(pathlib.Path(sys.argv[1]), 1)"
    subprocess.run(["sh", "-c", f'umask {umask}; "$0" -c "$1" "$2"', sys.executable, code, tmp_path / "a"], check=True)
    assert (tmp_path / "a").stat().st_mode & 0o777 == 0o666 & ~int(umask, 8)
