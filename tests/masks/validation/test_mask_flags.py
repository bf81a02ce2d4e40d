# SPDX-License-Identifier: GPL-3.0-or-later
"""Why a mask is left out."""

from __future__ import annotations

import numpy as np
import pytest

from mgf_engine.masks.validation.mask_flags import FlagOptions, flag_reason
from mgf_engine.model.masks import BUILDING

OPTIONS = FlagOptions()
BELOW = OPTIONS.flag_below
WHOLE = np.full((10, 10), BUILDING, np.uint8)


@pytest.mark.parametrize(
    ("labels", "score", "disagreement", "reason"),
    [
        (WHOLE, 1.0, 0.0, ""),
        (WHOLE, BELOW + 0.01, 0.99 - BELOW, ""),
        (WHOLE, BELOW - 0.01, 0.0, "mask and points agree only"),
        (WHOLE, 1.0, 1.01 - BELOW, "other photos contradict"),
        (np.zeros((10, 10), np.uint8), 1.0, 0.0, "hardly any building"),
    ],
)
def test_a_mask_is_left_out_for_one_reason(labels: np.ndarray, score: float, disagreement: float, reason: str) -> None:
    found = flag_reason(labels, score, disagreement, OPTIONS)
    assert found.startswith(reason) and bool(found) == bool(reason)
