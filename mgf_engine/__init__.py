# SPDX-License-Identifier: GPL-3.0-or-later
"""MGF engine: reconstruct a clean mesh of a building from photos.

    import mgf_engine as mgf
    job = mgf.reconstruct("photos", "prompts.json", "job")

A job has five stages, scene -> masks -> field -> mesh -> deliver, which pass their results through the job folder. Each
step is also a function: :func:`read_scene`, :func:`make_masks`, :func:`train`, :func:`extract_mesh`, :func:`render`,
:func:`evaluate`. They are imported on first use, so that ``import mgf_engine`` loads neither numpy nor torch. Nothing
in this package imports ``bpy``.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mgf_engine.api import (
        Reconstruction,
        evaluate,
        extract_mesh,
        make_masks,
        read_scene,
        reconstruct,
        render,
        train,
    )
    from mgf_engine.errors import BadInput, Cancelled

__version__ = "0.1.0"
__all__ = [
    "BadInput",
    "Cancelled",
    "Reconstruction",
    "__version__",
    "evaluate",
    "extract_mesh",
    "make_masks",
    "read_scene",
    "reconstruct",
    "render",
    "train",
]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module 'mgf_engine' has no attribute '{name}'")
    return getattr(import_module("mgf_engine.errors" if name in ("BadInput", "Cancelled") else "mgf_engine.api"), name)


def __dir__() -> list[str]:
    return __all__
