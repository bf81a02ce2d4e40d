# SPDX-License-Identifier: GPL-3.0-or-later
"""Folders of photos that jobs are started on."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.jobs import write_photo_folder


@pytest.fixture
def source(tmp_path: Path) -> Path:
    return write_photo_folder(tmp_path / "scene Ω")


@pytest.fixture
def model(source: Path) -> Path:
    """The source with a model that names its photo."""
    names = {"cameras": "1 PINHOLE 4 4 1 1 2 2\n", "images": "1 1 0 0 0 0 0 0 1 a.jpg\n\n", "points3D": ""}
    for name, text in names.items():
        (source / f"{name}.txt").write_text(text)
    return source
