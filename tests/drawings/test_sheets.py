# SPDX-License-Identifier: GPL-3.0-or-later
"""Scales of sheets, and the direction of north on them."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from mgf_engine.drawings.model import DrawingFrame
from mgf_engine.drawings.sheets import FOOT, MARGIN, PAPERS, choose_scale, fitting_scale, north_in
from mgf_engine.errors import BadInput
from mgf_engine.georef.model import Georeference

X, Y, Z = np.eye(3)
ROOM = (np.array(PAPERS["A3"]) - 2 * MARGIN - (0, FOOT)) / 1000  # metres on paper


@pytest.mark.parametrize("paper,share,scale", [("A3", 1.0, 100), ("A3", 1.01, 200), ("A1", 1.01, 50), ("A3", 0.01, 5)])
def test_a_drawing_has_the_largest_round_scale_that_fits(paper: str, share: float, scale: int) -> None:
    size = 100 * ROOM * share * (1 - 1e-9)
    assert fitting_scale(size, paper) == scale and choose_scale(size, paper) == scale
    assert fitting_scale(size * (1, 0.1), paper) <= scale


def test_a_wanted_scale_is_taken_where_it_fits() -> None:
    assert choose_scale(100 * ROOM * 0.9, "A3", 150) == 150
    with pytest.raises(BadInput, match=r"does not fit on A3 at 1:50; give --scale 100 or a larger sheet"):
        choose_scale(100 * ROOM * 0.9, "A3", 50)


def test_what_fits_at_no_scale_is_refused() -> None:
    with pytest.raises(BadInput, match="give the scene true lengths"):
        choose_scale(6000 * ROOM, "A3")
    assert fitting_scale(6000 * ROOM, "A3") == 5000


@pytest.mark.parametrize(
    "x,y,known,north",
    [
        (X, Y, True, (0, 1)),
        (Y, -X, True, (1, 0)),
        (X, Y, False, None),
        (X, Z, True, None),  # a facade
        (X, (Y + Z) / 2**0.5, True, None),  # a slanted section
    ],
)
def test_north_is_on_drawings_from_above(x, y, known: bool, north: tuple[float, float] | None) -> None:
    survey = SimpleNamespace(georeference=Georeference(north_known=known))
    found = north_in(survey, DrawingFrame("plan", np.zeros(3), x, y, np.zeros(2), np.ones(2)))  # type: ignore[arg-type]
    if north is None:
        assert found is None
    else:
        np.testing.assert_allclose(found, north, atol=1e-12)
