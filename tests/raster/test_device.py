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
from mgf_engine.config import make_config
from mgf_engine.errors import BadInput
from mgf_engine.messages import Message, Reporter
from mgf_engine.native.cuda import card, checked_cards, compiler
from mgf_engine.native.cuda.driver import Driver, DriverError
from mgf_engine.raster import device


@pytest.fixture(autouse=True)
def _fresh() -> Any:
    device.choose_device.cache_clear()
    yield
    device.choose_device.cache_clear()


def refuse() -> card.Found:
    raise BadInput("There is no card.")


def test_auto_says_why_it_takes_the_cpu(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(card, "find_card", refuse)
    monkeypatch.setattr(shutil, "which", lambda name: f"/usr/bin/{name}")
    choice = device.choose_device("auto")
    assert choice.device.type == "cpu" and choice.text == "Device: CPU. There is no card."
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    device.choose_device.cache_clear()
    assert device.choose_device("auto").surprising


def test_cuda_without_a_card_is_refused_in_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(card, "find_card", refuse)
    with pytest.raises(BadInput, match=r"no card.*--device cpu"):
        device.choose_device("cuda")


@pytest.fixture
def card_9000(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> card.Found:
    found = card.Found("Card 9000", 90, 24 * 2**30)
    monkeypatch.setattr(card, "find_card", lambda: found)
    monkeypatch.setattr(checked_cards, "driver_version", lambda: "999.1")
    monkeypatch.setenv("MGF_CACHE", str(tmp_path))
    return found


def test_who_has_no_card_is_not_told_to_install_for_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(card, "find_card", refuse)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    monkeypatch.setattr(shutil, "which", lambda name: None)
    choice = device.choose_device("auto")
    assert choice.text == "Device: CPU; no NVIDIA driver was found." and not choice.surprising
    with pytest.raises(BadInput, match="There is no card"):
        device.choose_device("cuda")


def test_auto_takes_a_card_only_once_it_has_passed(card_9000: card.Found) -> None:
    choice = device.choose_device("auto")
    assert choice.device.type == "cpu" and choice.surprising and "\n" not in choice.text
    assert "Card 9000" in choice.text and "mgf doctor --card" in choice.text and "--device cuda" in choice.text
    checked_cards.approve(card_9000)
    device.choose_device.cache_clear()
    assert device.choose_device("auto").device.type == "cuda"
    checked_cards.withdraw(card_9000)
    device.choose_device.cache_clear()
    assert device.choose_device("auto").device.type == "cpu"


@pytest.mark.usefixtures("card_9000")
def test_a_job_says_once_that_a_card_was_found() -> None:
    messages: list[Message] = []
    pipeline.prepare(make_config(), Reporter(messages.append))
    assert [m["type"] for m in messages if "Card 9000" in m.get("text", "")] == ["warning"]
    assert messages[0]["type"] == "device" and messages[0]["device"] == "cpu"


def test_a_pass_is_for_one_card_one_driver_and_one_state_of_the_kernels(
    card_9000: card.Found, monkeypatch: pytest.MonkeyPatch
) -> None:
    checked_cards.approve(card_9000)
    assert checked_cards.is_approved(card_9000) and not checked_cards.is_approved(card.Found("Card 9001", 90, 2**30))
    with monkeypatch.context() as changed:
        changed.setattr(checked_cards, "driver_version", lambda: "999.2")
        assert not checked_cards.is_approved(card_9000)
    with monkeypatch.context() as changed:
        changed.setattr(checked_cards, "digest", lambda: "other kernels")
        assert not checked_cards.is_approved(card_9000)
    assert checked_cards.is_approved(card_9000)
    for damage in ("{", "[]", '"x"'):
        checked_cards.record_file().write_text(damage)
        assert not checked_cards.is_approved(card_9000)


def test_a_card_is_taken_and_named(card_9000: card.Found) -> None:
    checked_cards.approve(card_9000)
    assert device.choose_device("auto").text == "Device: Card 9000, 24 GiB, because it passed the check."
    assert device.choose_device("cuda").device.type == "cuda"
    assert device.choose_device("cpu").device.type == "cpu"


def test_torch_without_cuda_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.version, "cuda", None)
    card.find_card.cache_clear()
    with pytest.raises(BadInput, match="build of torch has no CUDA"):
        card.find_card()
    card.find_card.cache_clear()


class FakeTorch:
    """torch as ``find_card`` sees it on a machine with a card, which answers the first operation as the test wants."""

    version = SimpleNamespace(cuda="12.8")
    cuda = SimpleNamespace(
        is_available=lambda: True,
        get_device_properties=lambda number: SimpleNamespace(name="Card 9000", major=9, minor=0, total_memory=2**34),
    )
    device = staticmethod(lambda kind, number: torch.device("cpu"))

    def __init__(self, answer: float | Exception) -> None:
        self.answer = answer

    def ones(self, *shape: int, device: torch.device) -> torch.Tensor:
        if isinstance(self.answer, Exception):
            raise self.answer
        return torch.full(shape, self.answer / 2)


@pytest.fixture
def find(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[float | Exception], card.Found]]:
    monkeypatch.setattr(card, "driver", lambda: None)
    monkeypatch.setattr(compiler, "library", lambda: SimpleNamespace(architectures=(90,)))

    def with_answer(answer: float | Exception) -> card.Found:
        monkeypatch.setattr(card, "torch", FakeTorch(answer))
        card.find_card.cache_clear()
        return card.find_card()

    yield with_answer
    card.find_card.cache_clear()


def test_torch_without_kernels_for_the_card_is_named(find: Callable[[float | Exception], card.Found]) -> None:
    assert find(2.0) == card.Found("Card 9000", 90, 2**34)
    words = "CUDA error: no kernel image is available for execution on the device\nFor debugging consider .."
    with pytest.raises(BadInput, match=r"cannot compute on the card Card 9000 \(CUDA error: no kernel .* device\); if"):
        find(RuntimeError(words))
    with pytest.raises(BadInput, match=r"\(RuntimeError\)"):
        find(RuntimeError())
    with pytest.raises(BadInput, match=r"adds one and one to 3\.0"):
        find(3.0)


def test_compiled_kernels_are_kept_and_damaged_ones_made_again(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    try:
        compiler.library()
    except BadInput as error:
        pytest.skip(str(error))
    monkeypatch.setenv("MGF_CACHE", str(tmp_path))
    first = card.cubin("adam", 90)
    (kept,) = (tmp_path / "kernels").iterdir()
    with monkeypatch.context() as patch:
        patch.setattr(compiler, "compile_program", lambda *a: pytest.fail("compiled again"))
        assert card.cubin("adam", 90) == first
    kept.write_bytes(b"broken")
    assert card.cubin("adam", 90)[:4] == b"\x7fELF" and kept.read_bytes()[:4] == b"\x7fELF"
    assert card.cubin("adam", 80) != first and len(list(kept.parent.iterdir())) == 2


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
