# SPDX-License-Identifier: GPL-3.0-or-later
"""A mesh is warned of for a low mean confidence, and for low confidence on most of it; each is enough."""

from __future__ import annotations

import pytest

from mgf_engine.mesh.confidence import ConfidenceShares, MeshConfidence
from mgf_engine.mesh.confidence_warning import ConfidenceWarningOptions, low_confidence_warning

SHARES = ConfidenceShares(0.3, 0.3, 0.28, 0.12)


@pytest.mark.parametrize(
    ("mean", "low", "warned"), [(0.5, 0.64, False), (0.49, 0.0, True), (0.9, 0.65, True), (0.4, 0.9, True)]
)
def test_either_figure_is_enough(mean: float, low: float, warned: bool) -> None:
    text = low_confidence_warning(MeshConfidence(mean, low, SHARES))
    assert (text is not None) == warned
    assert not text or f"mean {mean:.2f} of 1, 12% of it seen by no photo" in text


def test_the_limits_are_options() -> None:
    found = MeshConfidence(0.6, 0.3, SHARES)
    assert low_confidence_warning(found, ConfidenceWarningOptions(mean=0.7)) is not None
    assert low_confidence_warning(found, ConfidenceWarningOptions(share=0.2)) is not None
