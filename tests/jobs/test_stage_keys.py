# SPDX-License-Identifier: GPL-3.0-or-later
"""Which options and inputs decide which stages."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from mgf_engine.jobs.inputs import Inputs
from mgf_engine.jobs.stage_keys import adjusts_to_control, stage_keys
from mgf_engine.options.config import make_config
from mgf_engine.stages import STAGE_NAMES

INPUTS = Inputs(scene=["a.jpg", 1], names=("a.jpg", "b.jpg", "c.jpg", "d.jpg"), clicks=None, masks=["a.png", 2])


def changed(options: dict[str, Any], inputs: Inputs = INPUTS, before: dict[str, Any] | None = None) -> list[str]:
    """Names of the stages whose key is another one than with ``before`` and the same photos."""
    old, new = stage_keys(make_config(before or {}), INPUTS), stage_keys(make_config(options), inputs)
    return [name for name in STAGE_NAMES if old[name] != new[name]]


def test_every_stage_has_a_key_of_its_own_and_the_same_one_again() -> None:
    keys = stage_keys(make_config({}), INPUTS)
    assert list(keys) == list(STAGE_NAMES) and len(set(keys.values())) == len(keys)
    assert changed({}) == []


@pytest.mark.parametrize(
    ("options", "first"),
    [
        ({"resolution": 900}, "scene"),
        ({"random_walker.rounds": 3}, "masks"),
        ({"sh_degree": 1}, "field"),
        ({"max_faces": 5000}, "mesh"),
        ({"texture_size": 512}, "deliver"),
    ],
)
def test_an_option_changes_its_stage_and_the_later_ones(options: dict[str, Any], first: str) -> None:
    assert changed(options) == list(STAGE_NAMES[STAGE_NAMES.index(first) :])


def test_an_option_at_its_default_and_the_number_of_threads_change_nothing() -> None:
    assert changed({"resolution": make_config({}).resolution, "random_walker.rounds": 4, "threads": 3}) == []


def test_other_photos_change_all_and_other_masks_the_masks_and_what_follows() -> None:
    assert changed({}, replace(INPUTS, scene=["a.jpg", 9])) == list(STAGE_NAMES)
    assert changed({}, replace(INPUTS, masks=["a.png", 9])) == list(STAGE_NAMES[1:])
    plain = {"use_masks": False}
    assert changed(plain, replace(INPUTS, masks=["a.png", 9]), plain) == []


def test_a_limit_on_photos_counts_only_where_it_leaves_some_out() -> None:
    assert changed({"max_photos": 4}) == [] and changed({"max_photos": 3}) == list(STAGE_NAMES)


def test_control_points_count_in_the_scene_only_where_they_move_cameras() -> None:
    survey = replace(INPUTS, tables={"control": "hash"})
    moving, fixed = {"control": "p.csv"}, {"control": "p.csv", "control_adjust": False}
    assert adjusts_to_control(make_config(moving)) and not adjusts_to_control(make_config(fixed))
    assert changed(moving, survey, moving) == list(STAGE_NAMES)
    assert changed(fixed, survey, fixed) == ["deliver"]


def test_scale_bars_move_no_cameras() -> None:
    moving, bars = {"control": "p.csv"}, {"control": "p.csv", "scale_bars": "b.csv"}
    points = replace(INPUTS, tables={"control": "hash"})
    keys = stage_keys(make_config(moving), points)
    more = stage_keys(make_config(bars), replace(INPUTS, tables={"control": "hash", "scale_bars": "hash"}))
    assert [name for name in STAGE_NAMES if keys[name] != more[name]] == ["deliver"]
