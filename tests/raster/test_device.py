# SPDX-License-Identifier: GPL-3.0-or-later
"""Which device is chosen, what is said about it, and what is kept of compiled kernels."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch

from mgf_engine import pipeline
from mgf_engine.errors import BadInput
from mgf_engine.messages import Message, Reporter
from mgf_engine.native.cuda import checked_gpus, compiler, gpu
from mgf_engine.native.cuda.driver import Driver, DriverError
from mgf_engine.options.config import make_config
from mgf_engine.raster import device


@pytest.fixture(autouse=True)
def _fresh() -> Any:
    device.choose_device.cache_clear()
    yield
    device.choose_device.cache_clear()


def refuse() -> gpu.Gpu:
    raise BadInput("There is no GPU.")


def test_auto_says_why_it_takes_the_cpu(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gpu, "find_gpu", refuse)
    monkeypatch.setattr(shutil, "which", lambda name: f"/usr/bin/{name}")
    choice = device.choose_device("auto")
    assert choice.device.type == "cpu" and choice.text == "Device: CPU. There is no GPU."
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    device.choose_device.cache_clear()
    assert device.choose_device("auto").surprising


def test_cuda_without_a_gpu_is_refused_in_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gpu, "find_gpu", refuse)
    with pytest.raises(BadInput, match=r"no GPU.*--device cpu"):
        device.choose_device("cuda")


@pytest.fixture
def gpu_9000(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> gpu.Gpu:
    found = gpu.Gpu("RTX 9000", 90, 24 * 2**30)
    monkeypatch.setattr(gpu, "find_gpu", lambda: found)
    monkeypatch.setattr(checked_gpus, "driver_version", lambda: "999.1")
    monkeypatch.setenv("MGF_CACHE", str(tmp_path))
    return found


def test_who_has_no_gpu_is_not_told_to_install_for_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gpu, "find_gpu", refuse)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    monkeypatch.setattr(shutil, "which", lambda name: None)
    choice = device.choose_device("auto")
    assert choice.text == "Device: CPU; no NVIDIA driver was found." and not choice.surprising
    with pytest.raises(BadInput, match="There is no GPU"):
        device.choose_device("cuda")


def test_auto_takes_a_gpu_only_once_it_has_passed(gpu_9000: gpu.Gpu) -> None:
    choice = device.choose_device("auto")
    assert choice.device.type == "cpu" and choice.surprising and "\n" not in choice.text
    assert "RTX 9000" in choice.text and "mgf doctor --gpu" in choice.text and "--device cuda" in choice.text
    checked_gpus.approve(gpu_9000)
    device.choose_device.cache_clear()
    assert device.choose_device("auto").device.type == "cuda"
    checked_gpus.withdraw(gpu_9000)
    device.choose_device.cache_clear()
    assert device.choose_device("auto").device.type == "cpu"


@pytest.mark.usefixtures("gpu_9000")
def test_a_job_says_once_that_a_gpu_was_found() -> None:
    messages: list[Message] = []
    pipeline.prepare(make_config(), Reporter(messages.append))
    assert [m["type"] for m in messages if "RTX 9000" in m.get("text", "")] == ["warning"]
    assert messages[0]["type"] == "device" and messages[0]["device"] == "cpu"


def test_a_pass_is_for_one_gpu_one_driver_and_one_state_of_the_kernels(
    gpu_9000: gpu.Gpu, monkeypatch: pytest.MonkeyPatch
) -> None:
    checked_gpus.approve(gpu_9000)
    assert checked_gpus.is_approved(gpu_9000) and not checked_gpus.is_approved(gpu.Gpu("RTX 9001", 90, 2**30))
    with monkeypatch.context() as changed:
        changed.setattr(checked_gpus, "driver_version", lambda: "999.2")
        assert not checked_gpus.is_approved(gpu_9000)
    with monkeypatch.context() as changed:
        changed.setattr(checked_gpus, "digest", lambda: "other kernels")
        assert not checked_gpus.is_approved(gpu_9000)
    assert checked_gpus.is_approved(gpu_9000)
    for damage in ("{", "[]", '"x"'):
        checked_gpus.record_file().write_text(damage)
        assert not checked_gpus.is_approved(gpu_9000)


def test_a_gpu_is_taken_and_named(gpu_9000: gpu.Gpu) -> None:
    checked_gpus.approve(gpu_9000)
    assert device.choose_device("auto").text == "Device: RTX 9000, 24 GiB, because it passed the check."
    assert device.choose_device("cuda").device.type == "cuda"
    assert device.choose_device("cpu").device.type == "cpu"


def test_torch_without_cuda_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.version, "cuda", None)
    gpu.find_gpu.cache_clear()
    with pytest.raises(BadInput, match="build of torch has no CUDA"):
        gpu.find_gpu()
    gpu.find_gpu.cache_clear()


class FakeTorch:
    """torch as ``find_gpu`` sees it on a machine with a GPU, which answers the first operation as the test wants."""

    version = SimpleNamespace(cuda="12.8")
    cuda = SimpleNamespace(
        is_available=lambda: True,
        get_device_properties=lambda number: SimpleNamespace(name="RTX 9000", major=9, minor=0, total_memory=2**34),
    )
    device = staticmethod(lambda kind, number: torch.device("cpu"))

    def __init__(self, answer: float | Exception) -> None:
        self.answer = answer

    def ones(self, *shape: int, device: torch.device) -> torch.Tensor:
        if isinstance(self.answer, Exception):
            raise self.answer
        return torch.full(shape, self.answer / 2)


@pytest.fixture
def find(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[float | Exception], gpu.Gpu]]:
    monkeypatch.setattr(gpu, "driver", lambda: None)
    monkeypatch.setattr(compiler, "load_nvrtc", lambda: SimpleNamespace(architectures=(90,)))

    def with_answer(answer: float | Exception) -> gpu.Gpu:
        monkeypatch.setattr(gpu, "torch", FakeTorch(answer))
        gpu.find_gpu.cache_clear()
        return gpu.find_gpu()

    yield with_answer
    gpu.find_gpu.cache_clear()


def test_torch_without_kernels_for_the_gpu_is_named(find: Callable[[float | Exception], gpu.Gpu]) -> None:
    assert find(2.0) == gpu.Gpu("RTX 9000", 90, 2**34)
    words = "CUDA error: no kernel image is available for execution on the device\nFor debugging consider .."
    with pytest.raises(BadInput, match=r"cannot compute on the GPU RTX 9000 \(CUDA error: no kernel .* device\); if"):
        find(RuntimeError(words))
    with pytest.raises(BadInput, match=r"\(RuntimeError\)"):
        find(RuntimeError())
    with pytest.raises(BadInput, match=r"adds one and one to 3\.0"):
        find(3.0)


def test_compiled_kernels_are_kept_and_damaged_ones_made_again(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    try:
        compiler.load_nvrtc()
    except BadInput as error:
        pytest.skip(str(error))
    monkeypatch.setenv("MGF_CACHE", str(tmp_path))
    first = gpu.cubin("adam", 90)
    (kept,) = (tmp_path / "kernels").iterdir()
    with monkeypatch.context() as patch:
        patch.setattr(compiler, "compile_program", lambda *a: pytest.fail("compiled again"))
        assert gpu.cubin("adam", 90) == first
    kept.write_bytes(b"broken")
    assert gpu.cubin("adam", 90)[:4] == b"\x7fELF" and kept.read_bytes()[:4] == b"\x7fELF"
    assert gpu.cubin("adam", 80) != first and len(list(kept.parent.iterdir())) == 2


class Stub:
    """A driver that answers every call with one code."""

    def __init__(self, code: int) -> None:
        self.code = code

    def cuInit(self, flags: int) -> int:
        return 0

    def cuGetErrorString(self, code: int, text: Any) -> int:
        text._obj.value = b"it broke"
        return 0

    def __getattr__(self, name: str) -> Any:
        return lambda *arguments: self.code


def test_failures_of_the_driver_carry_its_words() -> None:
    with pytest.raises(DriverError, match=r"cuModuleLoadData failed: it broke \(700\)"):
        Driver(Stub(700)).load(b"")
    with pytest.raises(MemoryError, match="too little memory"):
        Driver(Stub(2)).load(b"")
