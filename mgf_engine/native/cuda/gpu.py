# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs the CUDA kernels on the GPU that torch uses: compiled on first use, kept on disk, started on torch's stream."""

from __future__ import annotations

import ctypes
import hashlib
import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from mgf_engine.errors import BadInput
from mgf_engine.files.atomic import atomic_path
from mgf_engine.native.cuda import compiler
from mgf_engine.native.cuda.driver import Driver, driver
from mgf_engine.native.cuda.launcher import THREADS, Grid, pack
from mgf_engine.native.cuda.sources import digest, program_of
from mgf_engine.system.machine import user_cache

_OLDEST = 75  # compute capability 7.5: match_any, and what today's compilers still know


@dataclass(frozen=True)
class Gpu:
    """The GPU torch would use.

    Attributes:
        name: its own name.
        architecture: compute capability, 90 for 9.0.
        memory: bytes.
    """

    name: str
    architecture: int
    memory: int


@cache
def find_gpu() -> Gpu:
    """Find the GPU, if kernels can be compiled for it and run on it.

    Raises:
        BadInput: why not, in one sentence.
    """
    if torch.version.cuda is None:
        raise BadInput("This build of torch has no CUDA; install one that has (pytorch.org).")
    driver()
    if not torch.cuda.is_available():
        raise BadInput("torch finds no GPU that CUDA can use; update the NVIDIA driver.")
    properties = torch.cuda.get_device_properties(0)
    architecture = 10 * properties.major + properties.minor
    if architecture < _OLDEST:
        raise BadInput(
            f"The GPU {properties.name} is too old: its compute capability is "
            f"{properties.major}.{properties.minor}, and 7.5 is needed."
        )
    if architecture not in (nvrtc := compiler.load_nvrtc()).architectures:
        raise BadInput(nvrtc.refusal(architecture))
    _try_torch(properties.name)
    return Gpu(properties.name, architecture, properties.total_memory)


def _try_torch(name: str) -> None:
    """Try an operation of torch: a build of it sees GPUs that it has no kernels for, and fails at the first
    operation."""
    try:
        found = float(torch.ones(2, device=torch.device("cuda", 0)).sum())
    except RuntimeError as error:
        why = str(error).strip().splitlines()[0].rstrip(".") if str(error).strip() else type(error).__name__
        raise BadInput(
            f"This build of torch cannot compute on the GPU {name} ({why}); "
            "if it was made for other GPUs, install one that knows this one (pytorch.org)."
        ) from error
    if found != 2.0:
        raise BadInput(f"The GPU {name} adds one and one to {found}; it or its driver is broken.")


class GpuLauncher:
    """Starts kernels on torch's current stream of the GPU; see :class:`mgf_engine.native.cuda.launcher.Launcher`."""

    def __init__(self) -> None:
        self.found = find_gpu()
        self.device = torch.device("cuda", 0)
        torch.zeros(1, device=self.device)  # torch makes its context now
        self._driver: Driver = driver()
        self._context = self._driver.context()
        self._functions: dict[str, ctypes.c_void_p] = {}
        self._modules: dict[str, ctypes.c_void_p] = {}
        self._lock = threading.Lock()

    def launch(self, name: str, grid: Grid, *arguments: Any) -> None:
        x, y = grid if isinstance(grid, tuple) else (grid, 1)
        if x * y == 0:
            return
        self._enter()
        function = self._functions.get(name) or self._load(name)
        addresses, alive = pack(arguments, self.device)
        stream = torch.cuda.current_stream(self.device).cuda_stream
        self._driver.launch(function, (x, y), THREADS, stream, addresses)
        del alive  # the driver has copied the arguments

    def read_later(self, tensor: Tensor) -> Callable[[], list[int]]:
        host = torch.empty(tensor.shape, dtype=tensor.dtype, pin_memory=True)
        host.copy_(tensor, non_blocking=True)
        arrived = torch.cuda.Event(blocking=True)  # sleeps where it waits: the host has other work for its cores
        arrived.record(torch.cuda.current_stream(self.device))

        def answer() -> list[int]:
            arrived.synchronize()
            found: list[int] = host.tolist()
            return found

        return answer

    def _enter(self) -> None:
        """Make the context current: backward passes run on threads of torch's own, which may not have it yet."""
        if self._driver.context().value != self._context.value:
            self._driver.use_context(self._context)

    def _load(self, name: str) -> ctypes.c_void_p:
        with self._lock:
            program = program_of(name)
            if program not in self._modules:
                self._modules[program] = self._driver.load(cubin(program, self.found.architecture))
            self._functions[name] = self._driver.function(self._modules[program], name)
            return self._functions[name]


def cache_folder() -> Path:
    """Return where compiled kernels are kept."""
    return user_cache() / "kernels"


def cubin(program: str, architecture: int) -> bytes:
    """Return a compiled program, from the disk where it was compiled before.

    The name holds everything the result depends on: the sources, the options, the architecture and the compiler. A
    cache that cannot be read or written only costs time.
    """
    nvrtc = compiler.load_nvrtc()
    key = hashlib.sha256(repr((digest(), compiler.options(architecture), nvrtc.version)).encode()).hexdigest()[:20]
    path = cache_folder() / f"{program}-sm{architecture}-{key}.cubin"
    try:
        kept = path.read_bytes()
        if kept[:4] == b"\x7fELF":
            return kept
    except OSError:
        pass
    made = compiler.compile_program(program, architecture).cubin
    try:
        with atomic_path(path) as temporary:
            temporary.write_bytes(made)
    except OSError:
        pass
    return made
