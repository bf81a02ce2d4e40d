# SPDX-License-Identifier: GPL-3.0-or-later
"""The CUDA sources built as C++ and run on the CPU, for tests on machines without a GPU.

One processor thread plays the threads of a block one after the other (``csrc/cuda/block.cuh``), and one launch runs
at a time, as on a stream. It shows that the sources compute the right numbers, and, run backwards (``reverse``), that
no thread depends on another of its phase. It says nothing about speed.
"""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from mgf_engine.native.build import LIBRARIES, TARGETS, host_target
from mgf_engine.native.cuda.launcher import Grid, pack
from mgf_engine.native.cuda.sources import FOLDER, KERNELS, digest, programs

#: Memory that nothing was written to holds a pattern, so that reading it shows (-ftrivial-auto-var-init).
FLAGS = (
    "-shared", "-O2", "-std=c++17", "-fPIC", "-fvisibility=hidden", "-Wall", "-Wextra", "-Wno-unused-function",
    "-ftrivial-auto-var-init=pattern", "-fno-sanitize=undefined", "-fno-math-errno", "-fno-exceptions", "-fno-rtti",
    "-nostdlib++", "-x", "c++",
)  # fmt: skip


class SourceOnCpu:
    """Runs the kernels of the CUDA sources on tensors of the CPU.

    Attributes:
        reverse: run blocks, warps and threads in opposite order.
        device: the CPU.
    """

    def __init__(self) -> None:
        self.reverse = False
        self.device = torch.device("cpu")
        self._library = ctypes.CDLL(str(build()))
        self._stream = threading.Lock()  # the build knows one running thread only

    def launch(self, name: str, grid: Grid, *arguments: Any) -> None:
        x, y = grid if isinstance(grid, tuple) else (grid, 1)
        if x * y == 0:
            return
        addresses, alive = pack(arguments, self.device)
        function = getattr(self._library, name)
        function.restype = None
        with self._stream:
            function(ctypes.c_int(x), ctypes.c_int(y), ctypes.c_int(self.reverse), addresses)
        del alive

    def read_later(self, tensor: Tensor) -> Callable[[], list[int]]:
        values: list[int] = tensor.tolist()
        return lambda: values


@cache
def build() -> Path:
    """Build the library where a source has changed, and return its path.

    Raises:
        RuntimeError: the compiler is missing or fails.
    """
    suffix = TARGETS[host_target()].suffix
    path = LIBRARIES / f"mgf-cuda-source-{digest()[:16]}{suffix}"
    if path.is_file():
        return path
    LIBRARIES.mkdir(exist_ok=True)
    sources = [str(FOLDER / f"{program}.cu") for program in programs()]
    with tempfile.TemporaryDirectory(prefix="partial", dir=LIBRARIES) as work:
        partial = Path(work) / path.name
        command = [sys.executable, "-m", "ziglang", "cc", *FLAGS, "-I", str(KERNELS), "-o", str(partial), *sources]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode:
            raise RuntimeError(f"Building the CUDA sources for the CPU failed:\n{done.stderr}")
        if done.stderr:
            print(done.stderr, file=sys.stderr)  # warnings
        for old in LIBRARIES.glob(f"mgf-cuda-source-*{suffix}"):
            old.unlink()
        os.replace(partial, path)
    return path
