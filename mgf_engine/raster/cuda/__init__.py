# SPDX-License-Identifier: GPL-3.0-or-later
"""The CUDA rasterizer: one set of sources, compiled at run time for the GPU, and as C++ for tests without one."""

from __future__ import annotations

from functools import cache

from mgf_engine.native.cuda.launcher import Launcher
from mgf_engine.raster.cuda.blending import Rasterizer


@cache
def launcher_on(backend: str) -> Launcher:
    """Return the launcher of the kernels: backend ``cuda`` on the GPU, ``cuda-source-on-cpu`` on the CPU.

    Raises:
        BadInput: ``cuda``, and there is no GPU, driver or compiler to use; the sentence says which.
    """
    if backend == "cuda":
        from mgf_engine.native.cuda.gpu import GpuLauncher

        return GpuLauncher()
    from mgf_engine.native.cuda.emulated import SourceOnCpu

    return SourceOnCpu()


@cache
def rasterizer_on(backend: str) -> Rasterizer:
    """Return the rasterizer of a backend; see :func:`launcher_on`."""
    return Rasterizer(launcher_on(backend))
