# SPDX-License-Identifier: GPL-3.0-or-later
"""A disk with room for the engine, whatever this machine has left."""

import pytest
from installation import set_free


@pytest.fixture(autouse=True)
def room(monkeypatch: pytest.MonkeyPatch) -> None:
    set_free(monkeypatch, 64 << 30)
