# SPDX-License-Identifier: GPL-3.0-or-later
"""What segmenters are asked in tests, and how their answers are scored."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest

from mgf_engine.masks.segmenters.base import Hints
from mgf_engine.weights import WEIGHTS, WeightFile
from support.small_sam import write_pair


def hints(shape: tuple[int, int], **given: object) -> Hints:
    none = np.zeros((0, 2))
    fields = {"positive": none, "negative": none, "accepted": none, "rejected": none, "box": None}
    return Hints(**{**fields, "probability": np.zeros(shape, np.float32), **given})


def iou(a: np.ndarray, b: np.ndarray) -> float:
    return float((a & b).sum() / (a | b).sum())


def install(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Put the small pair where the real weights would be, with its own sizes and checksums."""
    names = [f.name for f in WEIGHTS["vitt"]]
    paths = write_pair(folder, *names)
    files = tuple(
        WeightFile(p.name, p.stat().st_size, hashlib.sha256(p.read_bytes()).hexdigest()) for p in paths
    )  # fmt: skip
    monkeypatch.setitem(WEIGHTS, "vitt", files)
