# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a photo has texture that tells depth: straight edges, however strong, have none."""

from __future__ import annotations

import numpy as np
import pytest

from mgf_engine.start.dense import _texture
from mgf_engine.start.options import DenseOptions

ROWS, COLUMNS = np.mgrid[:40, :40].astype(np.float32)


@pytest.mark.parametrize("picture", [0 * ROWS, 60 * (COLUMNS > 20), 60 * (ROWS > 20), 20 * ROWS])
def test_plain_places_and_straight_edges_have_no_texture(picture: np.ndarray) -> None:
    assert _texture(picture.astype(np.float32))[5:-5, 5:-5].max() < 0.1 * DenseOptions.texture


def test_it_is_the_gradient_where_that_is_least() -> None:
    steep, gentle = 4.0, 1.5  # L per px along columns and rows
    folded = steep * np.abs(COLUMNS % 8 - 4) + gentle * np.abs(ROWS % 8 - 4)
    found = np.median(_texture(folded.astype(np.float32))[8:-8, 8:-8])
    assert 0.5 * gentle < found <= gentle
    noise = np.random.default_rng(0).normal(scale=8.0, size=ROWS.shape).astype(np.float32)
    assert _texture(noise)[5:-5, 5:-5].min() > DenseOptions.texture
