# SPDX-License-Identifier: GPL-3.0-or-later
"""Record of the GPUs that have passed ``mgf doctor --gpu`` here: ``--device auto`` takes no other.

A pass counts for one GPU, one driver and one state of the kernels' sources; after a change of any it is made again.
"""

from __future__ import annotations

import ctypes
import json
import sys
import time
from pathlib import Path

from mgf_engine.errors import BadInput
from mgf_engine.files.atomic import write_json
from mgf_engine.native.cuda.driver import driver
from mgf_engine.native.cuda.gpu import Gpu, cache_folder
from mgf_engine.native.cuda.sources import digest


def record_file() -> Path:
    """Return where passes are remembered, as JSON: key -> when."""
    return cache_folder().parent / "gpus.json"


def is_approved(found: Gpu) -> bool:
    """Tell whether this very GPU has passed."""
    return _key(found) in _passes()


def approve(found: Gpu) -> None:
    """Remember that the GPU has passed.

    Raises:
        BadInput: the file cannot be written.
    """
    path = record_file()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_json(path, {**_passes(), _key(found): time.strftime("%Y-%m-%d %H:%M:%S")})
    except OSError as error:
        raise BadInput(
            f"Cannot store the result of the check in '{path}' ({error.strerror}); free some space."
        ) from error


def withdraw(found: Gpu) -> None:
    """Forget an earlier pass of a GPU that fails now."""
    passes = _passes()
    if passes.pop(_key(found), None) is not None:
        write_json(record_file(), passes)


def driver_version() -> str:
    """Return the driver's own version where its management library tells, else the newest CUDA it knows."""
    try:
        library = ctypes.CDLL("nvml.dll" if sys.platform == "win32" else "libnvidia-ml.so.1")
        text = ctypes.create_string_buffer(96)
        if library.nvmlInit_v2() == 0 and library.nvmlSystemGetDriverVersion(text, 96) == 0:
            return text.value.decode(errors="replace")
    except (OSError, AttributeError):
        pass
    return "CUDA {}.{}".format(*driver().version())


def _key(found: Gpu) -> str:
    return f"{found.name}, driver {driver_version()}, kernels {digest()[:16]}"


def _passes() -> dict[str, str]:
    """Return what is remembered; a file that cannot be read only costs another check."""
    try:
        known = json.loads(record_file().read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    return known if isinstance(known, dict) else {}
