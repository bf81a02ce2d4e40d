# SPDX-License-Identifier: GPL-3.0-or-later
"""The few calls of the CUDA driver that are needed, through ctypes: load a cubin, find a kernel, launch it."""

from __future__ import annotations

import ctypes
import sys
from functools import cache
from typing import Any

from mgf_engine.errors import BadInput

_NAMES = {"win32": ("nvcuda.dll",)}
_OUT_OF_MEMORY = 2


class DriverError(RuntimeError):
    """A call of the driver failed."""


class Driver:
    """The driver's library. Calls need a current context, which torch makes on first use of a GPU."""

    def __init__(self, library: Any) -> None:
        self._library = library
        self.call("cuInit", 0)

    def version(self) -> tuple[int, int]:
        """Return the newest CUDA it knows, (12, 8) for 12.8."""
        found = ctypes.c_int()
        self.call("cuDriverGetVersion", ctypes.byref(found))
        return found.value // 1000, found.value % 1000 // 10

    def load(self, cubin: bytes) -> ctypes.c_void_p:
        """Read a module from a cubin, in the current context."""
        module = ctypes.c_void_p()
        self.call("cuModuleLoadData", ctypes.byref(module), cubin)
        return module

    def function(self, module: ctypes.c_void_p, name: str) -> ctypes.c_void_p:
        found = ctypes.c_void_p()
        self.call("cuModuleGetFunction", ctypes.byref(found), module, name.encode())
        return found

    def launch(
        self, function: ctypes.c_void_p, grid: tuple[int, int], threads: int, stream: int, arguments: Any
    ) -> None:
        """Start a kernel on a stream.

        Args:
            function: handle of the kernel.
            grid: blocks in x and y.
            threads: in each block.
            stream: handle of the stream; 0 for the default one.
            arguments: array of the addresses of the kernel's arguments.
        """
        self.call(
            "cuLaunchKernel", function, *grid, 1, threads, 1, 1, 0, ctypes.c_void_p(stream), arguments, None
        )  # fmt: skip

    def context(self) -> ctypes.c_void_p:
        """Return the context of this thread; null when there is none."""
        found = ctypes.c_void_p()
        self.call("cuCtxGetCurrent", ctypes.byref(found))
        return found

    def use_context(self, context: ctypes.c_void_p) -> None:
        self.call("cuCtxSetCurrent", context)

    def call(self, name: str, *arguments: Any) -> None:
        """Call a function of the driver.

        Raises:
            MemoryError: the GPU has too little memory.
            DriverError: anything else, in the driver's own words.
        """
        code = getattr(self._library, name)(*arguments)
        if code == 0:
            return
        if code == _OUT_OF_MEMORY:
            raise MemoryError(f"The GPU has too little memory ({name}).")
        raise DriverError(f"{name} failed: {self._words(code)}")

    def _words(self, code: int) -> str:
        text = ctypes.c_char_p()
        self._library.cuGetErrorString(code, ctypes.byref(text))
        return (text.value or b"unknown error").decode(errors="replace") + f" ({code})"


@cache
def driver() -> Driver:
    """Return the driver, loaded once.

    Raises:
        BadInput: there is no NVIDIA driver, or it finds no GPU.
    """
    for name in _NAMES.get(sys.platform, ("libcuda.so.1",)):
        try:
            return Driver(ctypes.CDLL(name))
        except OSError:
            continue
        except DriverError as error:
            raise BadInput(f"The NVIDIA driver cannot be used: {error}.") from error
    raise BadInput("This machine has no NVIDIA driver; install one if it has an NVIDIA GPU.")
