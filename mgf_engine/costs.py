# SPDX-License-Identifier: GPL-3.0-or-later
"""Cost model of the stages: CPU seconds and bytes as functions of photos, pixels, iterations and Gaussians.

``mgf estimate`` and the start of a job use this table; the panel in Blender reads the same from ``mgf options``. The
coefficients of each stage are in :mod:`mgf_engine.stages`. They were fitted to finished jobs (docs/scale.md compares
measured and estimated figures).

A term is the product of its coefficient and the quantities in its name ("" for a constant):

========== ===========================================================
photos     photos that the job takes
pixels     millions of pixels of a photo while working
taken      millions of pixels of a photo as it was taken
building   millions of working pixels that show the building, all photos together
measured   photos that are compared with their renderings: those kept out, and three more
surface    the same where training starts on a surface, else 0; ``block_surface`` of one block
unplaced   photos whose cameras are to be found (0 with a COLMAP model)
found      millions of pixels of a photo while its features are found for that
pairs      pairs of those that are matched
passes     iterations of the training
gaussians  Gaussians, in 100,000; ``block_gaussians`` of one block
threads    worker threads
textured   millions of working pixels that show the building, 0 without a texture
texture    millions of pixels of the texture at most, 0 without one
========== ===========================================================
"""

from __future__ import annotations

import math
from typing import Any

from mgf_engine.stages import STAGES

Terms = dict[str, float]

#: Per stage ``cpu`` (seconds on one core of the machine that was measured), ``serial`` (the share of them that one
#: core works on alone) and ``bytes``. ``building``: share of the pixels before clicks or masks tell. ``gaussians``:
#: share of the allowed number of Gaussians that a field reaches, trained (``grown``) or not (``untrained``), or, where
#: that is fewer, ``least`` + ``per_pixel`` times the building's pixels; ``by_gradient`` in their place where the
#: gradient says what is cloned and split, which follows the texture and not the pixels. ``measured``: photos rendered
#: for the metrics besides the held-out ones. ``pairs``: photos that each photo is matched with where not all are.
#: ``second_attempt``: what structure from motion takes besides, on as many cores as the stage, where the first attempt
#: leaves out many photos. ``features_side``: longest side of the photos meanwhile, pixels. ``speed``: limits of the
#: measured speed of a machine. ``threads``: number from which more threads bring nothing.
COSTS: dict[str, Any] = {
    "stages": {stage.name: stage.cost for stage in STAGES},
    "building": 0.4,
    "gaussians": {"grown": 0.9, "untrained": 0.5, "least": 25_000, "per_pixel": 0.007, "by_gradient": 40_000},
    "measured": 3,
    "pairs": 25,
    "second_attempt": {"unplaced": 0.7, "unplaced found": 7.5, "pairs": 0.012, "pairs found": 0.06},
    "features_side": 1600,
    "speed": [0.1, 10.0],
    "threads": 16,
}


def amount(terms: Terms, quantities: dict[str, float]) -> float:
    """Evaluate the sum of terms for these quantities."""
    return sum(number * math.prod(quantities[q] for q in name.split()) for name, number in terms.items())


def seconds_of(stage: str, quantities: dict[str, float]) -> float:
    """Return the wall time of a stage on the reference machine, seconds, for the threads in ``quantities``."""
    cost = COSTS["stages"][stage]
    threads = min(COSTS["threads"], quantities["threads"])
    return amount(cost["cpu"], quantities) * (cost["serial"] + (1 - cost["serial"]) / threads)


def second_attempt_seconds(quantities: dict[str, float]) -> float:
    """Return the wall time of a second attempt of structure from motion on the reference machine, seconds."""
    threads = min(COSTS["threads"], quantities["threads"])
    serial = COSTS["stages"]["scene"]["serial"]
    return amount(COSTS["second_attempt"], quantities) * (serial + (1 - serial) / threads)


def bytes_of(stage: str, quantities: dict[str, float]) -> float:
    """Return the peak memory of a stage in bytes, for the number of threads in ``quantities``."""
    threads = min(COSTS["threads"], quantities["threads"])
    return amount(COSTS["stages"][stage]["bytes"], {**quantities, "threads": threads})


def least_bytes_of(stage: str, quantities: dict[str, float]) -> float:
    """Return the minimum memory of a stage in bytes: one photo is processed at a time."""
    return amount(COSTS["stages"][stage]["bytes"], {**quantities, "threads": 1})
