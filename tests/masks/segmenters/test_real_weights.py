# SPDX-License-Identifier: GPL-3.0-or-later
"""EfficientSAM with its real weights, wherever they are: how well and how fast it draws the painted house.

MGF_TEST_WEIGHTS=~/.cache/mgf/weights .venv/bin/python -m pytest tests/masks/segmenters/test_real_weights.py
"""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from support.segmenters import install, iou

from benchmarks.synthetic.house import House
from mgf_engine.masks.build import build_masks
from mgf_engine.masks.segmenters.messages import describe_used_segmenter
from mgf_engine.model.masks import building
from mgf_engine.model.scene import Scene
from mgf_engine.options.config import make_config
from mgf_engine.weights import find_weights
from tests.masks.conftest import quiet

VARIABLE = "MGF_TEST_WEIGHTS"
SEGMENTERS = ["efficientsam", "random_walker"]


def measure(scene: Scene, house: House, segmenter: str, weights: Path, out: Path) -> tuple[list[float], float]:
    """IoU with the truth of every photo, and seconds per photo."""
    config = make_config({"segmenter": segmenter, "weights": str(weights), "device": "cpu"})
    started = time.perf_counter()
    masks = build_masks(scene, house.prompts, None, out, config, quiet())
    seconds = (time.perf_counter() - started) / len(scene.views)
    return [iou(building(m), house.masks[v.name]) for m, v in zip(masks.labels, scene.views, strict=True)], seconds


@pytest.mark.skipif(
    not os.environ.get(VARIABLE),
    reason=f"{VARIABLE} names no folder with the real EfficientSAM weights, which are not part of the project",
)
def test_real_weights(scene: Scene, house: House, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    folder = Path(os.environ[VARIABLE]).expanduser()
    found = find_weights(folder)
    assert found is not None, f"'{folder}' holds no complete pair of weights"
    for segmenter in SEGMENTERS:
        scores, seconds = measure(scene, house, segmenter, folder, tmp_path / segmenter)
        with capsys.disabled():
            print(f"\n{segmenter}: IoU {np.mean(scores):.3f} (least {min(scores):.3f}), {seconds:.2f} s per photo")
        assert np.mean(scores) > 0.85 and min(scores) > 0.6, segmenter
    assert describe_used_segmenter(tmp_path / "efficientsam") == "EfficientSAM"


def test_the_measurement_itself(
    scene: Scene, house: House, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    """The same on the small pair, so that the test above is known to run; random_walker, which needs no weights, has
    tests of its own."""
    monkeypatch.setattr(sys.modules[__name__], "SEGMENTERS", SEGMENTERS[:1])
    install(tmp_path / "weights", monkeypatch)
    monkeypatch.setenv(VARIABLE, str(tmp_path / "weights"))
    test_real_weights(scene, house, tmp_path, capsys)
