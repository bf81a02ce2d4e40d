# SPDX-License-Identifier: GPL-3.0-or-later
"""What the mesh stage is given: options of a job and a reporter."""

from __future__ import annotations

from typing import Any

from mgf_engine.mesh.options import ExtractionOptions
from mgf_engine.messages import Reporter
from mgf_engine.options.config import make_config


def mesh_options(given: dict[str, Any]) -> ExtractionOptions:
    """What the mesh stage makes of the options of a job."""
    return make_config(given).algorithm(ExtractionOptions)


def reporter(sink=lambda message: None) -> Reporter:
    result = Reporter(sink, min_interval=0.0)
    result.stage("mesh")
    return result
