# SPDX-License-Identifier: GPL-3.0-or-later
"""The check of a card, as far as it runs without one: its training iteration, and what it says where there is none."""

from __future__ import annotations

import pytest
import torch

from mgf_engine.bench import card
from mgf_engine.errors import BadInput
from mgf_engine.raster import device


def test_no_card_is_said_in_one_sentence(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture) -> None:
    def refuse() -> None:
        raise BadInput("There is no card.")

    monkeypatch.setattr(card, "find_card", refuse)
    assert card.main([]) == 2
    assert capsys.readouterr().err == "There is no card.\n"


def test_iterations_of_the_cuda_sources_train_as_those_in_c(monkeypatch: pytest.MonkeyPatch) -> None:
    """Render, compare, differentiate and step, three times over, all by one backend."""
    fields = {}
    for backend in ("cpu", "cuda-source-on-cpu"):
        monkeypatch.setattr(device, "CPU_BACKEND", backend)
        side = card.Training(600, 96, 64, torch.device("cpu"))
        start = side.optimiser.field.positions.clone()
        for _ in range(3):
            side.iterate()
        fields[backend] = side.optimiser.field
        assert not torch.equal(start, side.optimiser.field.positions)
    for name in card.TRAINED:
        a, b = (getattr(f, name).detach() for f in fields.values())
        # Adam's first steps are as long for tiny gradients as for large ones: where a sign is rounding, rows differ.
        assert ((a - b).abs() > 1e-3 * a.abs().max()).float().mean() < 0.01, name


def test_differences_beyond_the_limits_are_named() -> None:
    assert card._too_far({"color": 1e-6, "loss": 1.0, "gradient of sh": float("nan")}) == ["loss", "gradient of sh"]
