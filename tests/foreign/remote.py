# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels of another processor or system in place of this one's: every call goes to ``host.c`` in an emulator.

With :func:`kernels_of` entered, whatever calls :func:`mgf_engine.native.library.call` or ``parallel`` has its arrays
copied to the emulated process and back, so any test can be run on the foreign kernels as it is.
"""

from __future__ import annotations

import ctypes
import re
import shutil
import struct
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from torch import Tensor

from mgf_engine.mesh import photometric, tsdf
from mgf_engine.native import build, library
from mgf_engine.raster import loss
from mgf_engine.scene import patch_match
from mgf_engine.start import lines, tetrahedra

HOST = Path(__file__).parent / "host.c"
#: Target -> the program that runs its programs; "" where this machine does.
EMULATORS = {"linux-x86_64": "", "linux-aarch64": "qemu-aarch64", "windows-x86_64": "wine"}
#: How to get them.
PACKAGES = {"qemu-aarch64": "apt install qemu-user", "wine": "apt install wine wine64"}
MOST_KNOWN = 300  # arrays whose addresses may be handed on: the latest
_BEGINS, _ENDS = "mgf_collapse_begin", "mgf_collapse_end"  # what is given to the first is used until the last
_REFERENCE = type(ctypes.byref(ctypes.c_int32()))


def emulator_of(target: str) -> str | None:
    """The program that runs a target's programs here, "" where none is needed, None where it is not installed."""
    name = EMULATORS[target]
    if not name:
        return "" if build.host_target() == target else None
    return shutil.which(name)


def exported() -> list[str]:
    """Names of all kernels."""
    text = "\n".join(p.read_text(encoding="utf-8") for p in sorted(build.KERNELS.rglob("*.c")))
    return sorted(set(re.findall(r"^MGF_API \w+ (\w+)\(", text, re.MULTILINE)))


def start(target: str, folder: Path, variant: str = "") -> subprocess.Popen[bytes]:
    """Build the host for a target in ``folder`` and start it.

    Linux on ARM: the kernels' sources linked in, since an emulated loader would need that system's C library. Else the
    very library that is shipped is loaded.
    """
    emulator = emulator_of(target)
    assert emulator is not None, f"no emulator for {target}"
    program = folder / ("host.exe" if target.startswith("windows") else "host")
    compiler = [
        sys.executable,
        "-m",
        "ziglang",
        "cc",
        "-O1",
        "-std=gnu17",
        "-Wall",
        "-Wextra",
        "-o",
        str(program),
        str(HOST),
    ]
    if target == "linux-aarch64":
        table = folder / "table.h"
        table.write_text("".join(f"KERNEL({name})\n" for name in exported()))
        flags = [f for f in build.FLAGS if f not in ("-shared", "-fPIC", "-O1")]
        cpu = build.VARIANTS["aarch64"]["neon"]
        sources = [str(p) for p in sorted(build.KERNELS.rglob("*.c"))]
        flags += ["-I", str(build.KERNELS), f'-DTABLE="{table}"']
        given = ["-static", "-target", "aarch64-linux-musl", f"-mcpu={cpu}", *flags, *sources]
        arguments: list[str] = []
    else:
        (path,) = build.build([target], [variant or next(iter(build.VARIANTS[build.TARGETS[target].family]))])
        given = ["-target", build.TARGETS[target].triple, *(["-ldl"] if target.startswith("linux") else [])]
        arguments = [f"Z:{path}".replace("/", "\\") if target.startswith("windows") else str(path)]
    subprocess.run([*compiler, *given], check=True)
    command = [*([emulator] if emulator else []), str(program), *arguments]
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)


@contextmanager
def kernels_of(process: subprocess.Popen[bytes]) -> Iterator[Remote]:
    """The kernels behind a host process in place of this machine's; ends the process."""
    remote = Remote(process)
    with ExitStack() as stack:
        stack.callback(remote.end)
        stack.enter_context(patch.object(library, "_open", lambda variant: remote))
        stack.enter_context(patch.object(library, "_current", remote))
        stack.enter_context(patch.object(library, "_to_c", remote.argument))
        for module, name, arrays in _ADDRESSES:
            stack.enter_context(patch.object(module, name, remote.noting(getattr(module, name), arrays)))
        yield remote


#: Functions that put addresses of arrays into arrays or hand on a part of one, and what arrays those are.
_ADDRESSES: list[tuple[Any, str, Callable[..., list[Any]]]] = [
    (loss._Pass, "_at_box", lambda self, map: [map]),
    (loss, "_address", lambda value: [value]),
    (tsdf.TsdfField, "_view_struct", lambda self, m: [m.mask, m.pixels, m.rows]),
    *((module, "by_reference", lambda table: [table, *table.arrays]) for module in (lines, tetrahedra)),
    (photometric, "_struct", lambda surfaces, first: [a for s in surfaces for a in (s.quads, s.depth)]),
    (patch_match, "photo_struct", lambda first, photos: [a for p in photos for a in p[:2] if a is not None]),
]


class Remote:
    """Stands for the loaded library. Its kernels run one after the other, on the arrays' copies."""

    def __init__(self, process: subprocess.Popen[bytes]) -> None:
        self._process = process
        self._known: dict[int, tuple[int, Any]] = {}  # address -> size, what keeps it alive
        self._held: dict[int, tuple[int, Any]] = {}
        self._lock = threading.Lock()
        self.calls: dict[str, int] = {}

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)

        def kernel(*arguments: Any) -> int:
            with self._lock:
                return self._call(name, arguments)

        return kernel

    def argument(self, value: Any) -> Any:
        """Stands for ``library._to_c``: arrays stay arrays."""
        if isinstance(value, np.ndarray):
            assert value.flags.c_contiguous
        elif isinstance(value, Tensor):
            assert value.is_contiguous() and value.device.type == "cpu"
        return value

    def noting(self, function: Callable[..., Any], arrays: Callable[..., list[Any]]) -> Callable[..., Any]:
        """``function``, which hands on addresses in ``arrays`` of its arguments."""

        def noted(*arguments: Any) -> Any:
            for array in arrays(*arguments):
                if isinstance(array, np.ndarray | Tensor | ctypes.Structure):
                    base, size = _extent(array)
                    self._known.pop(base, None)
                    self._known[base] = (size, array)
                    if len(self._known) > MOST_KNOWN:
                        del self._known[next(iter(self._known))]
            return function(*arguments)

        return noted

    def end(self) -> None:
        assert self._process.stdin and self._process.stdout
        self._process.stdin.close()
        self._process.wait()
        self._process.stdout.close()

    def _call(self, name: str, arguments: tuple[Any, ...]) -> int:
        self.calls[name] = self.calls.get(name, 0) + 1
        sent: dict[int, tuple[int, Any]] = {}
        packed = [self._pack(value, sent) for value in arguments]
        moves = self._moves(sent)
        if name == _BEGINS:
            self._held = {}
        self._held |= sent
        keep = name.startswith("mgf_collapse") and name != _ENDS
        request = [struct.pack("<Q", len(name)), name.encode(), struct.pack("<QQ", keep, len(sent))]
        for base, (size, _) in sent.items():
            request += [struct.pack("<QQ", base, size), ctypes.string_at(base, size)]
        request += [struct.pack("<Q", len(moves)), *(struct.pack("<4Q", *move) for move in moves)]
        request += [struct.pack("<Q", len(packed)), *packed]
        assert self._process.stdin and self._process.stdout
        self._process.stdin.write(b"".join(request))
        self._process.stdin.flush()
        (result,) = struct.unpack("<q", self._read(8))
        for base, (size, _) in self._held.items():
            left = self._read(size)
            if left != ctypes.string_at(base, size):
                ctypes.memmove(base, left, size)
        if not keep:
            self._held = {}
        return int(result)

    def _read(self, size: int) -> bytes:
        assert self._process.stdout
        data = self._process.stdout.read(size)
        if len(data) != size:
            raise RuntimeError(f"the foreign kernels ended with code {self._process.wait()}")
        return data

    def _pack(self, value: Any, sent: dict[int, tuple[int, Any]]) -> bytes:
        """An argument: kind, and value or place."""
        if isinstance(value, float):
            return struct.pack("<QfIQ", ord("f"), value, 0, 0)
        if isinstance(value, int):
            return struct.pack("<QqQ", ord("i"), value, 0)
        if value is None or (isinstance(value, ctypes.c_void_p) and not value.value):
            return struct.pack("<QqQ", ord("i"), 0, 0)
        if isinstance(value, _REFERENCE):
            counter = value._obj  # type: ignore[attr-defined]
            base, size, at = ctypes.addressof(counter), ctypes.sizeof(counter), ctypes.addressof(counter)
            keep: Any = counter
        elif isinstance(value, ctypes.c_void_p):
            at = int(value.value or 0)
            base, (size, keep) = self._around(at)
        else:
            (base, size), keep = _extent(value), value
            at = value.data_ptr() if isinstance(value, Tensor) else value.ctypes.data
        if not size or (isinstance(value, np.ndarray | Tensor) and not value.nbytes):  # where it lies means nothing
            return struct.pack("<QqQ", ord("i"), 0, 0)
        if size > sent.get(base, (0, None))[0]:
            sent[base] = (size, keep)
        return struct.pack("<QQQ", ord("p"), base, at - base)

    def _around(self, address: int) -> tuple[int, tuple[int, Any]]:
        for base, known in self._known.items():
            if base <= address < base + known[0]:
                return base, known
        raise AssertionError(f"a kernel is given the unknown address {address:x}")

    def _moves(self, sent: dict[int, tuple[int, Any]]) -> list[tuple[int, int, int, int]]:
        """Addresses of known arrays within the arrays that are sent, which then are sent, too: (array, offset, ...)."""
        moves = []
        bases = np.array(sorted(self._known), np.uint64)
        for base, (size, array) in list(sent.items()):
            holds = isinstance(array, ctypes.Structure) or (
                isinstance(array, np.ndarray) and array.dtype.kind in "iV" and array.itemsize >= 8
            )
            if not holds or size % 8 or size > 1 << 16:
                continue
            words = np.frombuffer(ctypes.string_at(base, size), np.uint64)
            before = np.searchsorted(bases, words, "right")
            for index in np.flatnonzero(before > 0).tolist():
                found, word = int(bases[before[index] - 1]), int(words[index])
                if word < found + self._known[found][0]:
                    sent[found] = self._known[found]
                    moves.append((base, 8 * index, found, word - found))
        return moves


def _extent(array: Any) -> tuple[int, int]:
    """Address and bytes of all the memory an array or tensor lies in."""
    if isinstance(array, Tensor):
        storage = array.untyped_storage()
        return storage.data_ptr(), storage.nbytes()
    if isinstance(array, ctypes.Structure):
        return ctypes.addressof(array), ctypes.sizeof(array)
    return array.ctypes.data, array.nbytes
