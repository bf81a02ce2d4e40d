# SPDX-License-Identifier: GPL-3.0-or-later
"""The report tells what would make the next mesh of a building better."""

from __future__ import annotations

from dataclasses import replace

import pytest

from mgf_engine.evaluation.advice import JobFacts, advice
from mgf_engine.mesh.confidence import ConfidenceShares

GOOD = JobFacts(ConfidenceShares(0.95, 0.05, 0, 0), 1000, 1000, (), trained=True)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            {"confidence": ConfidenceShares(0.5, 0.05, 0.25, 0.2)},
            "45% of the surface is shown by fewer than three photos",
        ),
        ({"confidence": ConfidenceShares(0.6, 0.4, 0, 0)}, "On 40% of the surface"),
        ({"weak_masks": tuple("abcdefg")}, "not used: a, b, c, d, e and 2 more."),
        ({"photo_side": 6000}, "--resolution 2000"),
        ({"photo_side": 1500}, "--resolution 1500"),
        ({"trained": False}, "--preset standard"),
    ],
)
def test_advice_follows_from_the_figures(change, said) -> None:
    told = advice(replace(GOOD, **change))
    assert len(told) == 1 and said in told[0]


def test_there_is_no_advice_where_nothing_is_wanting() -> None:
    assert advice(GOOD) == advice(replace(GOOD, confidence=None)) == []
