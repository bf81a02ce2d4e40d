# SPDX-License-Identifier: GPL-3.0-or-later
"""One finished job of the painted house, and its drawings, for all tests here."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from support.finished_job import FinishedJob, finish_job

from mgf_engine.drawings.make import make_drawings
from mgf_engine.drawings.work import DrawingOptions
from mgf_engine.messages import Reporter


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory) -> FinishedJob:
    """The job, with what the scene says on record nowhere."""
    return finish_job(tmp_path_factory.mktemp("painted house with windows"))


@pytest.fixture(scope="session")
def drawings(finished: FinishedJob) -> Path:
    """The folder that ``mgf drawings`` made of it."""
    return make_drawings(finished.folder, None, DrawingOptions(), Reporter())


@pytest.fixture(scope="session")
def index(drawings: Path) -> dict[str, Any]:
    """Its ``drawings.json``."""
    return json.loads((drawings / "drawings.json").read_text(encoding="utf-8"))
