# SPDX-License-Identifier: GPL-3.0-or-later
"""The same input gives the same bits, run after run and for every number of threads."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import torch
from rendered import OUTPUTS, Result, camera, gaussians, random_weights, run

from mgf_engine.native import library


@pytest.fixture
def threads() -> Iterator[None]:
    before = library.threads()
    yield
    library.set_threads(before)


def once(count: int) -> Result:
    library.set_threads(count)
    field, view = gaussians(3000, seed=2, log_scale=-3.0), camera(120, 90, focal=100.0)
    weights = random_weights(view, OUTPUTS, 0, torch.ones(90, 120))
    return run(field, view, "cpu", weights, torch.ones(90, 120), sh_degree=2)


def test_same_bits_again_and_on_more_threads(variant: str, threads: None) -> None:
    first = once(1)
    for count in (1, 2, 2, 2, 3):
        other = once(count)
        for name in OUTPUTS:
            assert torch.equal(getattr(first.rendering, name), getattr(other.rendering, name)), name
        for name, gradient in first.gradients.items():
            assert torch.equal(gradient, other.gradients[name]), f"{name} on {count} threads"
        for a, b in zip(first.stats.all, other.stats.all, strict=True):
            assert torch.equal(a, b)


def test_thread_count_is_what_was_set(threads: None) -> None:
    library.set_threads(3)
    assert library.threads() == 3
    library.set_threads(0)
    assert library.threads() >= 1
