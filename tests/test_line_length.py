# SPDX-License-Identifier: GPL-3.0-or-later
"""Lines of C and CUDA are no longer than those of Python, which ruff checks."""

from __future__ import annotations

import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]
SOURCES = [p for p in (ROOT / "mgf_engine/native/csrc").rglob("*") if p.suffix in {".c", ".h", ".cu", ".cuh"}]


def test_lines_of_kernels_fit_the_limit() -> None:
    limit = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["ruff"]["line-length"]
    lines = [(p.name, n, line) for p in SOURCES for n, line in enumerate(p.read_text(encoding="utf-8").split("\n"), 1)]
    assert len(lines) > 5000
    assert [f"{name}:{n}" for name, n, line in lines if len(line) > limit] == []
