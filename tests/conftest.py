# SPDX-License-Identifier: GPL-3.0-or-later
"""Shared by all tests; tests/blender runs in Blender's own Python, which has none of the engine's packages."""

import importlib.util

if importlib.util.find_spec("hypothesis"):
    from hypothesis import HealthCheck, settings

    # The same examples on every run, and no deadline: shared machines are slow at times.
    settings.register_profile(
        "mgf", deadline=None, derandomize=True, max_examples=50, suppress_health_check=[HealthCheck.too_slow]
    )
    settings.load_profile("mgf")
