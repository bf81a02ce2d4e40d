# SPDX-License-Identifier: GPL-3.0-or-later
"""The CUDA sources compile for every architecture, with registers to spare; no card is needed for that."""

from __future__ import annotations

import pytest

from mgf_engine.errors import BadInput
from mgf_engine.raster.cuda import compiler
from mgf_engine.raster.cuda.sources import programs


def _nvrtc() -> compiler.Nvrtc:
    try:
        return compiler.library()
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
    compiler.library.cache_clear()
    with pytest.raises(BadInput, match="pip install nvidia-cuda-nvrtc"):
        compiler.library()
    compiler.library.cache_clear()


def test_broken_source_shows_the_compilers_words() -> None:
    with pytest.raises(RuntimeError, match="undefined"):
        _nvrtc().compile(b"__global__ void f() { nonsense(); }", "broken.cu", compiler.options(90))
