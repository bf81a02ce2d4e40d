# SPDX-License-Identifier: GPL-3.0-or-later
from __future__ import annotations

from support.analytic import ball, camera

from mgf_engine.town.picture import best_view


def test_the_photo_that_shows_most_of_the_building_is_chosen_unless_it_cuts_it_off():
    mesh, whole, far = ball(0.5, 4), camera((1.7, 0, 0)), camera((6.0, 0, 0))
    cut, away = camera((1.6, 0, 0), target=(0, 0.6, 0)), camera((1.7, 0, 0), target=(5.0, 0, 0))
    assert best_view(mesh, [far, cut, whole, away]) == 2
    assert best_view(mesh, [away, far]) == 1
    assert best_view(mesh, [cut.resized(640, 512), whole]) == 1, "a larger photo is no better"
