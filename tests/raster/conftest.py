# SPDX-License-Identifier: GPL-3.0-or-later
"""Every rasterizer test runs on every backend: the reference, and the C kernels in every variant this machine runs."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import torch
from rendered import skip_without_gpu

from mgf_engine.native import library


def _backends() -> list[str]:
    try:
        variants = library.runnable_variants()
    except RuntimeError:  # not built: one test fails with the message that says what to do
        variants = [""]
    return ["reference", *(f"cpu:{variant}" for variant in variants), "cuda-source-on-cpu", "cuda"]


@pytest.fixture(autouse=True, scope="package")
def _one_thread_for_torch() -> Iterator[None]:
    """The reference works on small tensors, where torch's own threads cost more than they bring."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(params=_backends())
def backend(request: pytest.FixtureRequest) -> Iterator[str]:
    """Name for ``render(backend=...)``; the kernel variant is loaded for the test."""
    name, _, variant = request.param.partition(":")
    if name == "cpu":
        library.use_variant(variant)
    skip_without_gpu(name)
    yield name
    if name == "cpu":
        library.use_variant("")


@pytest.fixture(params=[b for b in _backends() if b.startswith("cpu")])
def variant(request: pytest.FixtureRequest) -> Iterator[str]:
    """Name of a kernel variant, loaded for the test."""
    name = request.param.partition(":")[2]
    library.use_variant(name)
    yield name
    library.use_variant("")
