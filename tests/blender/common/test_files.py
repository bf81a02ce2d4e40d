# SPDX-License-Identifier: GPL-3.0-or-later
"""Files that others open, and JSON files that are read again when they change."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

import pytest

from mgf_blender.common.errors import UserError
from mgf_blender.common.files import open_file
from mgf_blender.common.json_cache import JsonCache


@pytest.mark.skipif(sys.platform != "linux", reason="xdg-open is of Linux")
def test_opening_a_file_does_not_wait_for_its_program(tmp_path, monkeypatch):
    """Some desktops start the browser in the place of xdg-open: Blender stood still until it was closed."""
    opener = tmp_path / "xdg-open"
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    opener.write_text("#!/bin/sh\necho $$ > pid\nexec sleep 60\n")
    opener.chmod(0o755)
    monkeypatch.chdir(tmp_path)
    begun = time.monotonic()
    open_file(tmp_path)
    assert time.monotonic() - begun < 20
    os.kill(int((tmp_path / "pid").read_text()), 15)
    opener.write_text("#!/bin/sh\nexit 3\n")
    with pytest.raises(UserError, match="No program of the system opens"):
        open_file(tmp_path)


def test_a_json_file_is_read_again_when_it_changes(tmp_path):
    read, path = [], tmp_path / "a.json"
    cache = JsonCache(lambda path, data: read.append(data) or data["a"])
    path.write_text('{"a": 1}')
    os.utime(path, ns=(0, 0))  # as files out of some archives have it
    assert cache.get(path) == cache.get(path) == 1 and len(read) == 1
    path.write_text('{"a": 2, "b": 3}')
    os.utime(path, ns=(0, 0))
    assert cache.get(path) == 2 and len(read) == 2
    path.unlink()
    assert cache.get(path) is None and cache.get(Path("nowhere")) is None
