# SPDX-License-Identifier: GPL-3.0-or-later
"""The rim of background that is trained along with the building."""

from __future__ import annotations

import numpy as np
import pytest

from mgf_engine.field.targets import with_rim
from mgf_engine.masks.model import BACKGROUND, BUILDING, UNKNOWN


def labels() -> np.ndarray:
    result = np.full((40, 60), BACKGROUND, np.uint8)
    result[10:30, 20:40] = BUILDING
    result[12:15, 22:25] = 254
    result[10:30, 40:50] = UNKNOWN
    return result


def test_the_rim_is_an_element_of_its_own_around_the_building() -> None:
    found = with_rim(labels(), 3.0)
    rim = (labels() == BACKGROUND) & (found != BACKGROUND)
    assert len(np.unique(found[rim])) == 1 and found[rim][0] not in (BUILDING, 254, UNKNOWN)
    assert rim[10:30, 17:20].all() and not rim[10:30, :17].any()
    assert np.array_equal(found[~rim], labels()[~rim])  # what hides the building stays unknown


def test_bars_and_gaps_have_no_rim() -> None:
    """Between the bars of a frame everything would be rim, and be trained on what is behind."""
    frame = np.full((120, 200), BACKGROUND, np.uint8)
    frame[20:100, 20:80] = BUILDING
    frame[40:50, 40:50] = BACKGROUND  # a gap in a wall
    frame[20:100, 120:124] = frame[20:100, 150:154] = frame[60:64, 120:154] = BUILDING
    rim = with_rim(frame, 3.0) != frame
    assert rim[30:90, 80:83].all()  # beside the wall
    assert not rim[40:50, 40:50].any() and not rim[:, 110:].any()


@pytest.mark.parametrize("width", [0.0, 0.5])
def test_no_width_no_rim(width) -> None:
    assert np.array_equal(with_rim(labels(), width), labels())


def test_every_id_taken() -> None:
    full = labels()
    full[10, 20:40] = BUILDING
    full[15:28, 20:40] = (np.arange(13 * 20) % 253 + 2).reshape(13, 20)
    full[full == BUILDING] = 2
    full[10, 20] = BUILDING
    found = with_rim(full, 2.0)
    assert (found[8:10, 25:35] == 254).all()
