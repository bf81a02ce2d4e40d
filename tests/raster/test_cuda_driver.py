# SPDX-License-Identifier: GPL-3.0-or-later
"""What talks to the driver, with a driver made of Python that runs the CUDA sources on the CPU."""

from __future__ import annotations

import ctypes
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from rendered import OUTPUTS, camera, gaussians, random_weights, run

from mgf_engine.native.cuda import gpu
from mgf_engine.native.cuda.driver import Driver
from mgf_engine.native.cuda.emulated import SourceOnCpu
from mgf_engine.native.cuda.gpu import Gpu, GpuLauncher
from mgf_engine.native.cuda.launcher import THREADS
from mgf_engine.raster.api import render
from mgf_engine.raster.cuda import blending, launcher_on

CONTEXT, STREAM = 77, 4242


class EmulatedDriver:
    """The calls of libcuda that the engine makes; a kernel that is started runs at once, on the host's memory.

    Attributes:
        current: context of the calling thread.
        modules: cubins that were loaded.
        started: names of the kernels that ran.
        events: per event of torch that was made, what happened to it last.
    """

    def __init__(self) -> None:
        source = launcher_on("cuda-source-on-cpu")
        assert isinstance(source, SourceOnCpu)
        self._kernels = source._library
        self.current: int | None = CONTEXT
        self.modules: list[bytes] = []
        self._names: list[str] = []
        self.started: list[str] = []
        self.events: list[str] = []

    def cuInit(self, flags: int) -> int:
        return 0

    def cuCtxGetCurrent(self, out: Any) -> int:
        out._obj.value = self.current
        return 0

    def cuCtxSetCurrent(self, context: ctypes.c_void_p) -> int:
        self.current = context.value
        return 0

    def cuModuleLoadData(self, out: Any, cubin: bytes) -> int:
        self.modules.append(cubin)
        out._obj.value = len(self.modules)
        return 0

    def cuModuleGetFunction(self, out: Any, module: ctypes.c_void_p, name: bytes) -> int:
        assert module.value in range(1, len(self.modules) + 1)
        self._names.append(name.decode())
        out._obj.value = len(self._names)
        return 0

    def cuLaunchKernel(self, function: ctypes.c_void_p, *numbers: Any) -> int:
        x, y, z, threads, one, also_one, shared, stream, arguments, extra = numbers
        assert self.current == CONTEXT and stream.value == STREAM
        assert (z, threads, one, also_one, shared, extra) == (1, THREADS, 1, 1, 0, None)
        name = self._names[function.value - 1]
        kernel = getattr(self._kernels, name)
        kernel.restype = None
        kernel(ctypes.c_int(x), ctypes.c_int(y), ctypes.c_int(False), arguments)
        self.started.append(name)
        return 0


@pytest.fixture
def emulated(monkeypatch: pytest.MonkeyPatch) -> EmulatedDriver:
    """A GPU whose memory is the host's, put in the place of the CUDA sources' own launcher."""
    library = EmulatedDriver()
    monkeypatch.setattr(gpu, "find_gpu", lambda: Gpu("GPU of paper", 90, 2**30))
    monkeypatch.setattr(gpu, "driver", lambda: Driver(library))
    monkeypatch.setattr(gpu, "cubin", lambda program, architecture: f"{program} {architecture}".encode())
    cpu, stream = torch.device("cpu"), SimpleNamespace(cuda_stream=STREAM)

    class Event:
        def __init__(self, blocking: bool) -> None:
            library.events.append("made")

        def record(self, on: Any) -> None:
            assert on is stream
            library.events[-1] = "recorded"
            self.number = len(library.events) - 1

        def synchronize(self) -> None:
            assert library.events[self.number] != "made"
            library.events[self.number] = "waited for"

    monkeypatch.setattr(gpu, "torch", SimpleNamespace(
        device=lambda *place: cpu, zeros=torch.zeros,
        empty=lambda shape, dtype, pin_memory: torch.empty(shape, dtype=dtype),
        cuda=SimpleNamespace(current_stream=lambda device: stream, Event=Event),
    ))  # fmt: skip
    rasterizer = blending.Rasterizer(GpuLauncher())
    monkeypatch.setattr("mgf_engine.raster.cuda.rasterizer_on", lambda backend: rasterizer)
    return library


def test_a_rendering_through_the_driver_is_that_of_the_sources(emulated: EmulatedDriver) -> None:
    field, view = gaussians(120, seed=5), camera(48, 40)
    weights = random_weights(view, OUTPUTS, 0, torch.ones(40, 48))
    through = run(field, view, "cuda-source-on-cpu", weights, torch.ones(40, 48), sh_degree=1)
    started = list(emulated.started)
    assert {"project", "radix_scatter", "list_fill", "blend_all", "project_backward"} <= set(started)
    # Every program is compiled and loaded once, for the GPU's own architecture, whichever of its kernels is wanted.
    assert len(emulated.modules) == len(set(emulated.modules)) and all(m.endswith(b" 90") for m in emulated.modules)
    again = run(field, view, "cuda-source-on-cpu", weights, torch.ones(40, 48), sh_degree=1)
    assert emulated.started[len(started) :] == started and len(emulated.modules) == len(set(emulated.modules))
    for name in OUTPUTS:
        assert torch.equal(getattr(through.rendering, name), getattr(again.rendering, name)), name


def test_it_draws_what_the_c_kernels_draw(emulated: EmulatedDriver) -> None:
    field, view = gaussians(120, seed=5), camera(48, 40)
    there, here = (render(field, view, sh_degree=1, backend=name) for name in ("cuda-source-on-cpu", "cpu"))
    assert emulated.started
    assert (there.color - here.color).abs().max() < 1e-4 and float(here.alpha.max()) > 0.5


def test_a_thread_without_a_context_gets_that_of_torch(emulated: EmulatedDriver) -> None:
    emulated.current = None  # as on the threads that run backward passes
    render(gaussians(20), camera(), sh_degree=0, backend="cuda-source-on-cpu")
    assert emulated.current == CONTEXT and emulated.started


def test_answers_are_waited_for_two_renderings_later(emulated: EmulatedDriver) -> None:
    field, view = gaussians(60), camera()
    pictures = [render(field, view, sh_degree=0, backend="cuda-source-on-cpu", wait=False).color for _ in range(5)]
    # The first waits for itself, without an event; of the four others the last two are still on their way.
    assert emulated.events == ["waited for", "waited for", "recorded", "recorded"]
    assert all(torch.equal(picture, pictures[0]) for picture in pictures)
