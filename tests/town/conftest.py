# SPDX-License-Identifier: GPL-3.0-or-later
"""A street of two houses that all tests of towns share."""

from __future__ import annotations

import pytest

from benchmarks.synthetic.street import Street, build_street


@pytest.fixture(scope="session")
def short_street(tmp_path_factory: pytest.TempPathFactory) -> Street:
    """Sixteen photos, which is enough for jobs; nobody writes into its folder."""
    return build_street(tmp_path_factory.mktemp("street"), 16)
