# SPDX-License-Identifier: GPL-3.0-or-later
"""The small painted house, and a finished job of it, made once for all tests of the pipeline."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.house_jobs import reconstruct

from benchmarks.synthetic.house import House, build_house


@pytest.fixture(scope="session")
def house(tmp_path_factory: pytest.TempPathFactory) -> House:
    return build_house(tmp_path_factory.mktemp("maison à côté"))


@pytest.fixture(scope="session")
def finished(house: House, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[dict]]:
    job = tmp_path_factory.mktemp("jobs") / "whole job"
    return job, reconstruct(house, job)
