# SPDX-License-Identifier: GPL-3.0-or-later
"""Shared by all tests; tests/blender runs in Blender's own Python, which has none of the engine's packages."""

import importlib.util
import json
import os
from pathlib import Path

import pytest

if importlib.util.find_spec("hypothesis"):
    from hypothesis import HealthCheck, settings

    # The same examples on every run, and no deadline: shared machines are slow at times.
    settings.register_profile(
        "mgf", deadline=None, derandomize=True, max_examples=50, suppress_health_check=[HealthCheck.too_slow]
    )
    settings.load_profile("mgf")


@pytest.fixture(autouse=True, scope="session")
def _kernels_of_another_machine(tmp_path_factory):
    """With MGF_TEST_KERNELS=linux-aarch64 (or windows-x86_64) the tests run on that target's kernels in an emulator.

    MGF_TEST_KERNELS_CALLS names a file that then says how often each kernel was called.
    """
    target = os.environ.get("MGF_TEST_KERNELS")
    if not target:
        yield
        return
    from foreign.remote import kernels_of, start

    with kernels_of(start(target, tmp_path_factory.mktemp("host"))) as remote:
        yield
        calls = remote.calls
    if "MGF_TEST_KERNELS_CALLS" in os.environ:
        Path(os.environ["MGF_TEST_KERNELS_CALLS"]).write_text(json.dumps(calls))
