# SPDX-License-Identifier: GPL-3.0-or-later
"""Compiles the CUDA sources for a GPU with NVRTC, the compiler as a library; no GPU is needed to compile.

``python -m mgf_engine.native.cuda.compiler`` compiles everything for every architecture of :data:`ARCHITECTURES` and
prints how many registers each kernel takes and what spills into memory.

NVRTC is looked for where pip puts it (``pip install nvidia-cuda-nvrtc``; builds of torch for CUDA bring their own),
then where the system does. Environment: ``MGF_NVRTC`` names the library to load instead.
"""

from __future__ import annotations

import argparse
import ctypes
import importlib.util
import os
import re
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from mgf_engine.errors import BadInput
from mgf_engine.native.cuda.driver import DriverError, driver
from mgf_engine.native.cuda.sources import FOLDER, KERNELS, programs

#: Compute capabilities that the kernels are compiled and checked for: Turing, Ampere (two), Ada, Hopper, Blackwell.
ARCHITECTURES = (75, 80, 86, 89, 90, 120)

#: NVRTC has no system headers; the few types the kernels want have the same sizes on every system.
_STDINT = b"""#pragma once
typedef signed char int8_t;
typedef unsigned char uint8_t;
typedef unsigned short uint16_t;
typedef int int32_t;
typedef unsigned int uint32_t;
typedef long long int64_t;
"""
_HINT = "run 'pip install nvidia-cuda-nvrtc'"
_NAMES = {
    "linux": ("libnvrtc.so.13", "libnvrtc.so.12", "libnvrtc.so"),
    "win32": ("nvrtc64_130_0.dll", "nvrtc64_120_0.dll"),
}


@dataclass(frozen=True)
class Usage:
    """What one kernel takes of a multiprocessor: registers a thread, bytes spilled a thread, shared memory a block."""

    kernel: str
    registers: int
    spilled: int
    shared: int


@dataclass(frozen=True)
class Compiled:
    """A program for one architecture: the cubin, and what its kernels take."""

    cubin: bytes
    usage: tuple[Usage, ...]


def options(architecture: int) -> tuple[str, ...]:
    """Return compiler options; they belong to the name under which results are kept."""
    return (
        f"--gpu-architecture=sm_{architecture}", "--std=c++17", "--device-as-default-execution-space",
        "--extra-device-vectorization", "--ptxas-options=-v",
    )  # fmt: skip


def compile_program(program: str, architecture: int) -> Compiled:
    """Compile ``kernels/cuda/{program}.cu`` for a compute capability (90 is 9.0).

    Raises:
        BadInput: NVRTC cannot be found or does not know the architecture.
        RuntimeError: the source does not compile.
    """
    nvrtc = load_nvrtc()
    if architecture not in nvrtc.architectures:
        raise BadInput(nvrtc.refusal(architecture))
    source = (FOLDER / f"{program}.cu").read_bytes()
    given = [f"--include-path={KERNELS}", *options(architecture)]
    cubin, log = nvrtc.compile(source, f"{program}.cu", given)
    return Compiled(cubin, _usage(log))


def _usage(log: str) -> tuple[Usage, ...]:
    """Return registers, spills and shared memory from what ptxas says."""
    found = []
    for part in re.split(r"Compiling entry function '", log)[1:]:
        registers = re.search(r"Used (\d+) registers", part)
        stores, loads = (re.search(rf"(\d+) bytes spill {kind}", part) for kind in ("stores", "loads"))
        shared = re.search(r"(\d+) bytes smem", part)
        values = [int(m.group(1)) if m else 0 for m in (registers, stores, loads, shared)]
        found.append(Usage(part.split("'")[0], values[0], max(values[1], values[2]), values[3]))
    return tuple(found)


class Nvrtc:
    """The few calls of NVRTC that are needed, through ctypes."""

    def __init__(self, path: str) -> None:
        _load_builtins(Path(path))
        self._library = ctypes.CDLL(path)
        major, minor = ctypes.c_int(), ctypes.c_int()
        self._call("nvrtcVersion", ctypes.byref(major), ctypes.byref(minor))
        self.path, self.version = path, (major.value, minor.value)
        count = ctypes.c_int()
        self._call("nvrtcGetNumSupportedArchs", ctypes.byref(count))
        known = (ctypes.c_int * count.value)()
        self._call("nvrtcGetSupportedArchs", known)
        self.architectures = tuple(known)

    def refusal(self, architecture: int) -> str:
        """Return why this compiler cannot compile for an architecture, in one sentence."""
        newest, oldest = max(self.architectures), min(self.architectures)
        return (
            f"The CUDA compiler NVRTC {self.version[0]}.{self.version[1]} cannot compile for compute capability "
            f"{architecture // 10}.{architecture % 10}: its oldest is {oldest // 10}.{oldest % 10} and its newest is "
            f"{newest // 10}.{newest % 10}; install another version of nvidia-cuda-nvrtc."
        )

    def compile(self, source: bytes, name: str, options: Sequence[str]) -> tuple[bytes, str]:
        """Return the cubin of a source, and the compiler's remarks; RuntimeError with them when it does not compile.

        Raises:
            RuntimeError: the source does not compile; with the compiler's log.
        """
        program = ctypes.c_void_p()
        headers, names = (ctypes.c_char_p * 1)(_STDINT), (ctypes.c_char_p * 1)(b"stdint.h")
        self._call("nvrtcCreateProgram", ctypes.byref(program), source, name.encode(), 1, headers, names)
        try:
            encoded = (ctypes.c_char_p * len(options))(*(o.encode() for o in options))
            code = self._library.nvrtcCompileProgram(program, len(options), encoded)
            log = self._bytes("nvrtcGetProgramLog", program).rstrip(b"\0").decode(errors="replace")
            if code:
                raise RuntimeError(f"The CUDA source {name} does not compile:\n{log}")
            return self._bytes("nvrtcGetCUBIN", program), log
        finally:
            self._call("nvrtcDestroyProgram", ctypes.byref(program))

    def _bytes(self, name: str, program: ctypes.c_void_p) -> bytes:
        size = ctypes.c_size_t()
        self._call(name + "Size", program, ctypes.byref(size))
        data = ctypes.create_string_buffer(size.value)
        self._call(name, program, data)
        return data.raw

    def _call(self, name: str, *arguments: Any) -> None:
        code = getattr(self._library, name)(*arguments)
        if code:
            self._library.nvrtcGetErrorString.restype = ctypes.c_char_p
            raise RuntimeError(f"{name} failed: {self._library.nvrtcGetErrorString(code).decode()}")


def _load_builtins(path: Path) -> None:
    """Load NVRTC's second library, which it looks for by name alone; once loaded it is found wherever it lies."""
    if not path.is_absolute():
        return
    pattern = "libnvrtc-builtins.so.*"
    if sys.platform == "win32":
        os.add_dll_directory(str(path.parent))
        pattern = "nvrtc-builtins64_*.dll"
    for builtins in sorted(path.parent.glob(pattern)):
        ctypes.CDLL(str(builtins), mode=ctypes.RTLD_GLOBAL)


@cache
def load_nvrtc() -> Nvrtc:
    """Return NVRTC, loaded once: the first that the driver can run the results of, where there is a driver.

    Raises:
        BadInput: it cannot be found or loaded, or is newer than the driver.
    """
    tried, too_new, known = [], [], _known_to_driver()
    for path in _candidates():
        try:
            found = Nvrtc(path)
        except (OSError, AttributeError, RuntimeError) as error:
            tried.append(f"{path}: {error}")
            continue
        if known is None or found.version[0] <= known[0]:
            return found
        too_new.append(found.version)
    if too_new and known:
        raise BadInput(_newer_than_driver(too_new[0], known))
    detail = f" ({tried[0]})" if tried else ""
    raise BadInput(f"The CUDA compiler NVRTC is not installed{detail}; {_HINT}.")


def _newer_than_driver(version: tuple[int, int], known: tuple[int, int]) -> str:
    """Say in one sentence what to do about an NVRTC whose results the driver cannot load."""
    return (
        f"The CUDA compiler NVRTC {version[0]}.{version[1]} is newer than the NVIDIA driver, which knows CUDA "
        f"{known[0]}.{known[1]}; update the driver, or run 'pip install nvidia-cuda-nvrtc-cu{known[0]}'."
    )


def _known_to_driver() -> tuple[int, int] | None:
    """Return the newest CUDA that this machine's driver knows; None: no driver, and nothing to run either."""
    try:
        return driver().version()
    except (BadInput, DriverError):
        return None


def _candidates() -> list[str]:
    """Return paths and names to try: the environment's, pip's (the version of torch's CUDA first), the system's."""
    if os.environ.get("MGF_NVRTC"):
        return [os.environ["MGF_NVRTC"]]
    pattern = "nvrtc64_*.dll" if sys.platform == "win32" else "libnvrtc.so.*"
    spec = importlib.util.find_spec("nvidia")
    roots = [Path(p) for p in (spec.submodule_search_locations or [])] if spec else []
    found = [
        p for root in roots for p in root.glob(f"**/{pattern}") if "builtins" not in p.name and ".alt." not in p.name
    ]
    import torch

    major = (torch.version.cuda or "").split(".")[0]
    found.sort(key=lambda p: (f".so.{major}" not in p.name and f"_{major}0" not in p.name, str(p)))
    return [*map(str, found), *_NAMES.get(sys.platform, ())]


def compile_all(architectures: Sequence[int] = ARCHITECTURES, threads: int = 0) -> dict[tuple[str, int], Compiled]:
    """Return every program for every architecture, (program, architecture) -> result."""
    jobs = [(program, architecture) for architecture in architectures for program in programs()]
    with ThreadPoolExecutor(threads or os.cpu_count() or 1) as pool:
        return dict(zip(jobs, pool.map(lambda job: compile_program(*job), jobs), strict=True))


def usage_table(results: dict[tuple[str, int], Compiled]) -> str:
    """Return Markdown: registers per kernel and architecture, with bytes spilled in brackets where there are any."""
    architectures = sorted({architecture for _, architecture in results})
    lines = ["| kernel | shared memory | " + " | ".join(f"sm_{a}" for a in architectures) + " |"]
    lines.append("|---" * (len(architectures) + 2) + "|")
    by_kernel: dict[str, dict[int, Usage]] = {}
    for (_, architecture), compiled in results.items():
        for usage in compiled.usage:
            by_kernel.setdefault(usage.kernel, {})[architecture] = usage
    for kernel, found in sorted(by_kernel.items()):
        cells = [
            f"{found[a].registers}" + (f" ({found[a].spilled} B)" if found[a].spilled else "") for a in architectures
        ]
        shared = max(u.shared for u in found.values())
        lines.append(f"| `{kernel}` | {shared / 1024:.1f} kB | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description="Compile the CUDA kernels for every architecture; needs no GPU.")
    parser.add_argument("--architectures", type=int, nargs="+", default=list(ARCHITECTURES), help="such as 89")
    given = parser.parse_args(arguments)
    try:
        nvrtc = load_nvrtc()
        results = compile_all(given.architectures)
    except (BadInput, RuntimeError) as error:
        print(error, file=sys.stderr)
        return 1
    print(f"NVRTC {nvrtc.version[0]}.{nvrtc.version[1]} ({nvrtc.path})\n")
    print(usage_table(results))
    return 0


if __name__ == "__main__":
    sys.exit(main())
