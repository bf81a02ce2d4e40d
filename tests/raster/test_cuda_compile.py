# SPDX-License-Identifier: GPL-3.0-or-later
"""The CUDA sources compile for every architecture, with registers to spare; no GPU is needed for that."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from mgf_engine.errors import BadInput
from mgf_engine.native.cuda import compiler
from mgf_engine.native.cuda.driver import Driver
from mgf_engine.native.cuda.sources import programs


def _nvrtc() -> compiler.Nvrtc:
    try:
        return compiler.load_nvrtc()
    except BadInput as error:
        pytest.skip(str(error))


@pytest.mark.parametrize("architecture", compiler.ARCHITECTURES)
def test_compiles_without_spilling(architecture: int) -> None:
    _nvrtc()
    found = compiler.compile_all([architecture])
    names = {usage.kernel for compiled in found.values() for usage in compiled.usage}
    assert names == {name for kernels in programs().values() for name in kernels}
    for (program, _), compiled in found.items():
        assert compiled.cubin[:4] == b"\x7fELF", program
        for usage in compiled.usage:
            assert usage.spilled <= 8, usage  # ptxas may give up a register to fit one more block on a multiprocessor
            assert usage.registers <= 128, usage  # so that two blocks of 256 threads share a multiprocessor
            assert usage.shared <= 48 * 1024, usage


def test_unknown_architecture_is_refused() -> None:
    newest = max(_nvrtc().architectures)
    with pytest.raises(BadInput, match=f"newest is {newest // 10}"):
        compiler.compile_program("sort", 20)


def test_missing_compiler_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MGF_NVRTC", "/nowhere/libnvrtc.so")
    compiler.load_nvrtc.cache_clear()
    with pytest.raises(BadInput, match="pip install nvidia-cuda-nvrtc"):
        compiler.load_nvrtc()
    compiler.load_nvrtc.cache_clear()


def test_broken_source_shows_the_compilers_words() -> None:
    with pytest.raises(RuntimeError, match="undefined"):
        _nvrtc().compile(b"__global__ void f() { nonsense(); }", "broken.cu", compiler.options(90))


class DriverOf:
    """A driver that knows CUDA up to a version: 12040 for 12.4."""

    def __init__(self, version: int) -> None:
        self.version = version

    def cuInit(self, flags: int) -> int:
        return 0

    def cuDriverGetVersion(self, out: Any) -> int:
        out._obj.value = self.version
        return 0


class CompilerAt:
    """An NVRTC whose path is its version."""

    def __init__(self, path: str) -> None:
        self.version = tuple(map(int, path.split(".")))


@pytest.fixture
def choose(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[int, list[str]], Any]]:
    """The compiler that is chosen of several for a driver."""

    def of(driver: int, versions: list[str]) -> Any:
        monkeypatch.setattr(compiler, "driver", lambda: Driver(DriverOf(driver)))
        monkeypatch.setattr(compiler, "Nvrtc", CompilerAt)
        monkeypatch.setattr(compiler, "_candidates", lambda: versions)
        compiler.load_nvrtc.cache_clear()
        return compiler.load_nvrtc()

    yield of
    compiler.load_nvrtc.cache_clear()


def test_a_compiler_newer_than_the_driver_is_passed_over(choose: Callable[[int, list[str]], Any]) -> None:
    assert choose(12040, ["13.0", "12.8"]).version == (12, 8)  # a newer minor version is no matter
    assert choose(13000, ["13.0", "12.8"]).version == (13, 0)
    with pytest.raises(BadInput, match=r"NVRTC 13\.0 is newer than .* CUDA 12\.4; update .*nvidia-cuda-nvrtc-cu12'\.$"):
        choose(12040, ["13.0"])


def test_without_a_driver_any_compiler_will_do(
    choose: Callable[[int, list[str]], Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing() -> Driver:
        raise BadInput("no driver")

    with pytest.raises(BadInput):
        choose(11080, ["13.0"])
    monkeypatch.setattr(compiler, "driver", missing)
    assert compiler.load_nvrtc().version == (13, 0)


@pytest.mark.parametrize("system, builtins", [
    ("win32", "nvrtc-builtins64_130.dll"), ("linux", "libnvrtc-builtins.so.13.0"),
])  # fmt: skip
def test_the_second_library_is_loaded_beside_the_first(
    system: str, builtins: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    for name in ("nvrtc64_130_0.dll", "libnvrtc.so.13", builtins):
        (tmp_path / name).write_bytes(b"")
    loaded: list[str] = []
    monkeypatch.setattr(sys, "platform", system)
    monkeypatch.setattr(os, "add_dll_directory", loaded.append, raising=False)
    monkeypatch.setattr(ctypes, "CDLL", lambda path, mode: loaded.append(path))
    compiler._load_builtins(tmp_path / "nvrtc64_130_0.dll")
    folder = [str(tmp_path)] if system == "win32" else []
    assert loaded == [*folder, str(tmp_path / builtins)]
    compiler._load_builtins(Path("nvrtc64_130_0.dll"))  # the system's own finds its second by itself
    assert len(loaded) == len(folder) + 1
