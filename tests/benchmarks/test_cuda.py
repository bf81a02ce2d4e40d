# SPDX-License-Identifier: GPL-3.0-or-later
"""The check of a GPU, as far as it runs without one: its training iteration, and what it says where there is none."""

from __future__ import annotations

import json
import os
import sys
import time
from pathlib import Path
from typing import Any

import pytest
import torch

from benchmarks import cuda
from mgf_engine.cli.main import main
from mgf_engine.errors import BadInput
from mgf_engine.field import cuda_check, cuda_compare
from mgf_engine.native.cuda import checked_gpus
from mgf_engine.native.cuda.driver import DriverError
from mgf_engine.native.cuda.gpu import Gpu
from mgf_engine.raster import device
from mgf_engine.raster.cuda import rasterizer_on

SOURCE = "cuda-source-on-cpu"


def test_no_gpu_is_said_in_one_sentence(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture) -> None:
    def refuse() -> None:
        raise BadInput("There is no GPU.")

    monkeypatch.setattr(cuda, "find_gpu", refuse)
    assert cuda.main([]) == 2
    assert capsys.readouterr().err == "There is no GPU.\n"


def test_iterations_of_the_cuda_sources_train_as_those_in_c(monkeypatch: pytest.MonkeyPatch) -> None:
    """Render, compare, differentiate and step, three times over, all by one backend."""
    fields = {}
    for backend in ("cpu", "cuda-source-on-cpu"):
        monkeypatch.setattr(device, "CPU_BACKEND", backend)
        side = cuda_compare.Training(600, 96, 64, torch.device("cpu"))
        start = side.optimiser.field.positions.clone()
        for _ in range(3):
            side.iterate()
        fields[backend] = side.optimiser.field
        assert not torch.equal(start, side.optimiser.field.positions)
    for name in cuda_compare.TRAINED:
        a, b = (getattr(f, name).detach() for f in fields.values())
        # Adam's first steps are as long for tiny gradients as for large ones: where a sign is rounding, rows differ.
        assert ((a - b).abs() > 1e-3 * a.abs().max()).float().mean() < 0.01, name


def test_differences_beyond_the_limits_are_named() -> None:
    assert cuda_compare.beyond_limits({"color": 1e-6, "loss": 1.0, "gradient of sh": float("nan")}) == [
        "loss",
        "gradient of sh",
    ]


@pytest.fixture
def no_gpu_but_its_sources(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is asked of a GPU is done by the CUDA sources on the CPU."""

    class Training(cuda_compare.Training):
        def __init__(self, n: int, width: int, height: int, place: torch.device) -> None:
            self.backend = SOURCE if place.type == "cuda" else "cpu"
            super().__init__(n, width, height, torch.device("cpu"))

        def forward(self, wait: bool) -> tuple[Any, Any]:
            monkeypatch.setattr(device, "CPU_BACKEND", self.backend)
            return super().forward(wait)

    monkeypatch.setattr(cuda_compare, "Training", Training)
    monkeypatch.setattr(cuda_compare, "rasterizer_on", lambda backend: rasterizer_on(SOURCE))


@pytest.mark.usefixtures("no_gpu_but_its_sources")
def test_comparison_looks_at_renderings_that_do_not_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    rasterizer_on(SOURCE).capacity.restore()
    found = cuda_compare.compare(600, 96, 64)
    assert cuda_compare.beyond_limits(found) == []
    assert {"color", "color without waiting", "gradient of sh", "loss"} <= set(found)
    monkeypatch.setattr(rasterizer_on(SOURCE).capacity, "take", lambda gaussians, tiles: 3)  # draws nothing
    assert "color without waiting" in cuda_compare.beyond_limits(cuda_compare.compare(600, 96, 64))


@pytest.mark.usefixtures("no_gpu_but_its_sources")
def test_training_twice_is_compared_to_the_last_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    assert cuda_compare.same_training(200, 48, 32)
    step, steps = cuda_compare.Optimiser.step, iter(range(10**6))

    def shaky(self: cuda_compare.Optimiser, *given: Any) -> None:
        step(self, *given)
        if next(steps) == 25:
            self.field.positions[0, 0] += 1e-6

    monkeypatch.setattr(cuda_compare.Optimiser, "step", shaky)
    assert not cuda_compare.same_training(200, 48, 32)


@pytest.mark.parametrize("lines, passes", [
    ("RACECHECK SUMMARY: 0 hazards displayed (0 errors, 0 warnings)", True),
    ("RACECHECK SUMMARY: 10 hazards displayed (10 errors, 0 warnings)", False),
    ("ERROR SUMMARY: 0 errors", True),
    ("ERROR SUMMARY: 20 errors", False),
    ("compute-sanitizer is not installed", True),
    ("compute-sanitizer ended with code 0", False),
])  # fmt: skip
def test_only_no_hazards_pass(lines: str, passes: bool) -> None:
    assert cuda.found_nothing(lines) == passes


@pytest.fixture
def sanitizer(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A compute-sanitizer to be written by the test."""
    if sys.platform == "win32":
        pytest.skip("the stand-in is a script of a POSIX shell")
    path = tmp_path / "compute-sanitizer"
    path.write_text("#!/bin/sh\necho no words\n")
    path.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    return path


def test_a_tools_summary_is_its_last_line(sanitizer: Path) -> None:
    assert cuda.sanitize("racecheck") == "compute-sanitizer ended with code 0"
    sanitizer.write_text('#!/bin/sh\necho "========= $2 $PYTORCH_NO_CUDA_MEMORY_CACHING ERROR SUMMARY: 0 errors"\n')
    assert cuda.sanitize("memcheck") == "memcheck 1 ERROR SUMMARY: 0 errors"


def test_a_tool_that_takes_too_long_is_ended_with_all_it_started(
    sanitizer: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    alive = sanitizer.parent / "alive"
    sanitizer.write_text(f"#!/bin/sh\n(while true; do date > {alive}; sleep 0.05; done) &\nsleep 60\n")
    monkeypatch.setattr(cuda, "_TOOL_SECONDS", 1.0)
    line = cuda.sanitize("racecheck")
    assert line.startswith("racecheck was stopped, since it took longer than 1 seconds") and alive.exists()
    assert not cuda.found_nothing(line)
    alive.unlink()
    time.sleep(0.3)
    assert not alive.exists()


def test_figures_survive_a_tool_that_fails(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture) -> None:
    monkeypatch.setattr(cuda, "find_gpu", lambda: Gpu("RTX 9000", 90, 2**34))
    monkeypatch.setattr(cuda, "compare", lambda *size: {"color": 1e-7})
    monkeypatch.setattr(cuda, "sanitize", lambda tool: f"SUMMARY: {10 * (tool == 'memcheck')} errors")
    assert cuda.main(["--only-compare", "--racecheck", "--json"]) == 1
    printed = capsys.readouterr()
    assert json.loads(printed.out)["differences from the CPU"] == {"color": 1e-7}
    assert printed.err == "Failed: memcheck\n"


@pytest.mark.parametrize("gpu_done, refused", [(False, False), (True, False), (False, True)])
def test_an_iteration_that_waits_is_seen(monkeypatch: pytest.MonkeyPatch, gpu_done: bool, refused: bool) -> None:
    modes: list[str] = []

    class Training:
        def __init__(self, *size: Any) -> None: ...

        def iterate(self) -> None:
            if refused and modes:
                raise RuntimeError("called a synchronizing operation")

    class Event:
        def record(self) -> None: ...

        def query(self) -> bool:
            return gpu_done

    monkeypatch.setattr(cuda, "Training", Training)
    monkeypatch.setattr(cuda, "keep_busy", lambda: None)
    for name, value in {"synchronize": lambda: None, "Event": Event}.items():
        monkeypatch.setattr(torch.cuda, name, value)
    monkeypatch.setattr(torch.cuda, "set_sync_debug_mode", modes.append)
    passes = cuda.check_waiting(10, cuda.corner_view(48, 32))
    assert passes == (not gpu_done and not refused) and modes == ["error", "default"]


@pytest.fixture
def remembered(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Gpu:
    found = Gpu("RTX 9000", 90, 2**34)
    monkeypatch.setattr(cuda_check, "find_gpu", lambda: found)
    monkeypatch.setattr(checked_gpus, "driver_version", lambda: "999.1")
    monkeypatch.setattr(cuda_check, "driver_version", lambda: "999.1")
    monkeypatch.setenv("MGF_CACHE", str(tmp_path))
    for name, value in {"GAUSSIANS": 600, "WIDTH": 96, "HEIGHT": 64, "ROUNDS": 8}.items():
        monkeypatch.setattr(cuda_check, name, value)
    return found


@pytest.mark.usefixtures("no_gpu_but_its_sources")
def test_doctor_remembers_a_gpu_that_passed_and_forgets_one_that_fails(
    remembered: Gpu, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    """The CUDA sources, built for the CPU, in place of the GPU: the whole check runs, only not on a GPU."""
    assert main(["doctor", "--gpu"]) == 0
    said = capsys.readouterr().out
    assert "RTX 9000" in said and "gradient of positions" in said and "training, 8 iterations" in said
    assert "passed" in said and checked_gpus.is_approved(remembered)

    step = cuda_compare.Optimiser.step

    def slow(self: cuda_compare.Optimiser, *given: Any) -> None:
        if device.CPU_BACKEND == "cpu":
            step(self, *given)

    with monkeypatch.context() as broken:
        broken.setattr(cuda_compare.Optimiser, "step", slow)
        assert main(["doctor", "--card"]) == 1  # the old name
    said = capsys.readouterr().out
    assert "Problem: The GPU did not pass: after 8 iterations" in said and not checked_gpus.is_approved(remembered)


def test_a_check_that_the_driver_stops_is_a_failed_one(
    remembered: Gpu, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    def stop(*size: int) -> dict[str, float]:
        raise DriverError("cuLaunchKernel failed: an illegal memory access was encountered (700)")

    checked_gpus.approve(remembered)
    monkeypatch.setattr(cuda_compare, "compare", stop)
    assert main(["doctor", "--gpu"]) == 1
    assert "illegal memory access" in capsys.readouterr().out and not checked_gpus.is_approved(remembered)


def test_doctor_says_where_there_is_no_gpu(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture) -> None:
    def refuse() -> None:
        raise BadInput("There is no GPU.")

    monkeypatch.setattr(cuda_check, "find_gpu", refuse)
    assert main(["doctor", "--gpu"]) == 2
    assert capsys.readouterr().err == "Error: There is no GPU.\n"
