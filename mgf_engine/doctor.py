# SPDX-License-Identifier: GPL-3.0-or-later
"""``mgf doctor``: what this machine offers the engine, and what is missing, one line each."""

from __future__ import annotations

import importlib.util
from pathlib import Path

from mgf_engine import __version__
from mgf_engine.drawings.command import NEEDED
from mgf_engine.errors import EXIT_DONE, EXIT_FAULT, BadInput
from mgf_engine.georef.crs import SURVEY
from mgf_engine.masks.segmenters.download import default_folder
from mgf_engine.masks.segmenters.notice import standing
from mgf_engine.memory import GB, free_memory
from mgf_engine.system import cores, cpu_name, total_memory, versions

SURVEY_PACKAGES = (*NEEDED, "pyproj", "pyceres")


def report(weights: Path | None = None) -> int:
    """Print the findings; returns 0 when a job can run here, 1 when something it needs is missing.

    Args:
        weights: folder with the EfficientSAM weights; None is the user's cache folder.
    """
    print(f"mgf {__version__}")
    found = versions()
    for name, version in found.items():
        print(f"  {name:<32} {version}")
    print(f"  {'processor':<32} {cpu_name()}, {cores()} cores")
    print(f"  {'memory':<32} {total_memory() / GB:.1f} GB, {free_memory() / GB:.1f} GB free")
    problems = [f"{name} is missing; run 'pip install {name}'." for name, v in found.items() if v == "missing"]
    try:
        from mgf_engine.native.library import variant

        print(f"  {'kernel variant':<32} {variant()}")
    except (ImportError, OSError, RuntimeError) as error:
        problems.append(f"The CPU kernels cannot be loaded: {error}")
    print(f"  {'CUDA':<32} {_cuda()}")
    print(f"  {'drawings, map coordinates':<32} {_survey()}")
    try:
        print(f"  {'segmenter of the masks':<32} {standing(weights or default_folder())}")
    except BadInput as error:
        problems.append(str(error))
    for problem in problems:
        print(f"Problem: {problem}")
    if not problems:
        print("Everything a job needs is here.")
    return EXIT_FAULT if problems else EXIT_DONE


def _survey() -> str:
    missing = [name for name in SURVEY_PACKAGES if importlib.util.find_spec(name) is None]
    return f"need {', '.join(missing)}: {SURVEY}" if missing else "yes"


def _cuda() -> str:
    try:
        from mgf_engine.raster.device import choose_device
    except ImportError:
        return "torch is missing"
    return choose_device("auto").text.removeprefix("Device: ")
