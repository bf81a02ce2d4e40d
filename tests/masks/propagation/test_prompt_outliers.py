# SPDX-License-Identifier: GPL-3.0-or-later
from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from mgf_engine.masks.prompts import Clicks
from mgf_engine.masks.propagation.prompt_outliers import on_points


@pytest.mark.parametrize(("column", "expected"), [(5.0, True), (25.0, False)])
def test_only_points_under_the_clicks_are_evidence(column: float, expected: bool) -> None:
    """Regions are ten pixels wide; in the second photo, regions 0 and 1 of its own hold a point."""
    graph = SimpleNamespace(
        observed=np.array([2, 7, 8]),
        start=np.array([0, 7]),
        scene=SimpleNamespace(observations=lambda index: np.array([0] if index == 0 else [1, 2])),
        regions=[SimpleNamespace(at=lambda uv: (uv[:, 0] // 10).astype(int))] * 2,
    )
    clicks = Clicks(np.array([[column, 3.0], [column + 2, 4.0]]), np.zeros((0, 2)))
    assert on_points(graph, 1, clicks) is expected
