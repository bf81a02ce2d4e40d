# SPDX-License-Identifier: GPL-3.0-or-later
"""The plain house, and its starting surface, made once."""

from __future__ import annotations

import pytest
from support.plain_start import PlainStart, make_plain_start

from benchmarks.synthetic.plain_house import PlainHouse, make_plain_house


@pytest.fixture(scope="session")
def plain_house(tmp_path_factory: pytest.TempPathFactory) -> PlainHouse:
    return make_plain_house(tmp_path_factory.mktemp("plain") / "scene")


@pytest.fixture(scope="session")
def plain_start(plain_house: PlainHouse) -> PlainStart:
    return make_plain_start(plain_house)
