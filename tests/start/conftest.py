# SPDX-License-Identifier: GPL-3.0-or-later
from __future__ import annotations

import pytest

from benchmarks.synthetic.plain_house import PlainHouse, make_plain_house


@pytest.fixture(scope="session")
def plain_house(tmp_path_factory: pytest.TempPathFactory) -> PlainHouse:
    return make_plain_house(tmp_path_factory.mktemp("plain") / "scene")
