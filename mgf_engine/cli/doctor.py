# SPDX-License-Identifier: GPL-3.0-or-later
"""``mgf doctor``: report the software and hardware that the engine finds, and what is missing, one line each."""

from __future__ import annotations

import platform
import sys
from pathlib import Path

from mgf_engine import __version__
from mgf_engine.errors import EXIT_DONE, EXIT_FAULT, BadInput
from mgf_engine.masks.segmenters.messages import describe_automatic_choice
from mgf_engine.system.machine import cores, cpu_name, is_installed, total_memory, versions
from mgf_engine.system.memory import GB, free_memory
from mgf_engine.weights import WEIGHTS, check_file, default_folder

#: The versions the engine is tested with.
CONSTRAINTS = "constraints.txt"
#: Extra -> what it is for, and what it brings, package by module.
EXTRAS: dict[str, tuple[str, dict[str, str]]] = {
    "survey": (
        "drawings, map coordinates",
        {"rasterio": "rasterio", "ezdxf": "ezdxf", "pyproj": "pyproj", "pyceres": "pyceres"},
    ),
    "models": (
        "mgf models, laser scans",
        {
            "xatlas": "xatlas", "fast_simplification": "fast-simplification", "DracoPy": "DracoPy",
            "pyproj": "pyproj", "ifcopenshell": "ifcopenshell", "pxr": "usd-core",
            "laspy": "laspy", "lazrs": "lazrs", "pye57": "pye57",
        },
    ),
    "town": (
        "many buildings",
        {
            "snakemake": "snakemake", "snakemake_executor_plugin_slurm": "snakemake-executor-plugin-slurm",
            "pyogrio": "pyogrio", "pyproj": "pyproj",
        },
    ),
}  # fmt: skip


def report(weights: Path | None = None) -> int:
    """Print the findings; returns 0 when a job can run here, 1 when something it needs is missing.

    Args:
        weights: folder with the EfficientSAM weights; None is the user's cache folder.

    Raises:
        BadInput: there is no such folder.
    """
    if weights is not None and not weights.is_dir():
        raise BadInput(f"'{weights}' is not a folder; give the folder of the weights.")
    print(f"mgf {__version__}")
    found = versions()
    for name, version in found.items():
        print(f"  {name:<32} {version}")
    print(f"  {'processor':<32} {cpu_name()}, {cores()} cores")
    print(f"  {'memory':<32} {total_memory() / GB:.1f} GB, {free_memory() / GB:.1f} GB free")
    problems = [f"{name} is missing; run {install_command(name)}." for name, v in found.items() if v == "missing"]
    try:
        from mgf_engine.native.library import variant

        print(f"  {'kernel variant':<32} {variant()}")
    except (ImportError, OSError, RuntimeError) as error:
        problems.append(f"The CPU kernels cannot be loaded: {error}")
    print(f"  {'CUDA':<32} {_cuda()}")
    for extra, (purpose, packages) in EXTRAS.items():
        print(f"  {purpose:<32} {_extra(extra, packages)}")
    for purpose, say in (("LPIPS in reports", _lpips), ("segmenter of the masks", describe_automatic_choice)):
        try:
            print(f"  {purpose:<32} {say(weights or default_folder())}")
        except BadInput as error:
            problems.append(str(error))
    for problem in problems:
        print(f"Problem: {problem}")
    if not problems:
        print("Everything a job needs is here.")
    return EXIT_FAULT if problems else EXIT_DONE


def _extra(extra: str, packages: dict[str, str]) -> str:
    """Say whether an extra is there, else what it lacks and how to get it."""
    missing = [name for module, name in packages.items() if _needed_here(name) and not is_installed(module)]
    return f"need {', '.join(missing)}: {install_command(f'mgf-engine[{extra}]')}" if missing else "yes"


def install_command(what: str) -> str:
    """Return how to install a package or extra in the versions the engine is tested with."""
    package = Path(__file__).parents[1]
    places = (package / CONSTRAINTS, package.parent / CONSTRAINTS)  # of a wheel, of a checkout
    pinned = next((f"-c '{path}' " for path in places if path.is_file()), "")
    return f"pip install {pinned}'{what}'"


def _needed_here(package: str) -> bool:
    """Tell whether this machine can have a package: pyceres has no wheels for Linux on ARM."""
    return package != "pyceres" or sys.platform != "linux" or platform.machine() == "x86_64"


def _lpips(folder: Path) -> str:
    """Say with which network LPIPS is measured, else how to get one.

    Raises:
        BadInput: weights are there, but damaged.
    """
    try:  # late, for it needs torch
        from mgf_engine.evaluation.lpips import NETWORKS, how_to_get
    except ImportError:
        return "torch is missing"
    for network, title in NETWORKS.items():
        files = WEIGHTS[network]
        if all((folder / f.name).is_file() for f in files):
            for file in files:
                check_file(folder / file.name, file, folder)
            return title
    return f"not measured; {how_to_get()}"


def _cuda() -> str:
    try:
        from mgf_engine.raster.device import choose_device
    except ImportError:
        return "torch is missing"
    return choose_device("auto").text.removeprefix("Device: ")
