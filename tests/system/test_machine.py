# SPDX-License-Identifier: GPL-3.0-or-later
import subprocess
import sys
from pathlib import Path

import pytest

from mgf_engine.native.cuda.gpu import cache_folder
from mgf_engine.system.machine import peak_memory, user_cache, versions
from mgf_engine.weights import default_folder


def test_figures_of_the_machine() -> None:
    assert peak_memory() > 10 << 20
    assert versions()["numpy"] != "missing"


def test_a_program_started_by_a_large_one_is_not_taken_for_large() -> None:
    child = "from mgf_engine.system.machine import peak_memory; print(peak_memory())"
    parent = (
        "import subprocess, sys; big = b'x' * (600 << 20); "
        f"print(subprocess.run([sys.executable, '-c', {child!r}], capture_output=True, text=True).stdout)"
    )
    run = subprocess.run([sys.executable, "-c", parent], capture_output=True, text=True, check=True)
    assert 10 << 20 < int(run.stdout) < 400 << 20


def test_all_that_is_cached_goes_where_the_variable_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The page on the command line says so of the whole folder; the variable moved compiled GPU kernels alone."""
    monkeypatch.setenv("MGF_CACHE", str(tmp_path))
    places = (user_cache(), default_folder().parent, cache_folder().parent)
    assert set(places) == {tmp_path}
