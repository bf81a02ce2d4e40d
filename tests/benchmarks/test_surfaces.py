# SPDX-License-Identifier: GPL-3.0-or-later
"""The suite of hard materials: its runs, its two tables and its charts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from benchmarks.catalogue import SURFACES
from benchmarks.charts import write_page
from benchmarks.measure import THRESHOLDS
from benchmarks.scenes import building_parts
from benchmarks.suites import SuiteSettings, half_of, suite_runs
from benchmarks.surface_charts import (
    CLASSES,
    class_scores,
    common_scenes,
    material_class,
    surface_figures,
    surface_tables,
)
from mgf_engine.errors import BadInput
from mgf_engine.options.presets import PRESETS


def row(
    variant: str, scene: str, f1: float, materials: dict[str, tuple[float, float]], cpu: float = 10.0
) -> dict[str, Any]:
    """A row with the same F1 at each threshold; materials are name -> share and F1."""
    values = {
        name: {
            "share": share,
            "f1": [value] * 4,
            "normal_median": value / 10,
            "normal_90": None if name == "glass" else 20.0,
        }
        for name, (share, value) in materials.items()
    }
    hygiene = {"faces": 1, "components": 1, "holes": 0}
    geometry = {"thresholds": [0.05, 0.07, 0.1, 0.2], "f1": [f1] * 4, "materials": values, "hygiene": hygiene,
                "accuracy": [f1], "completeness": [f1], "outside_crop": 0.0}  # fmt: skip
    return {"variant": variant, "scene": scene, "seed": 0, "group": variant, "geometry": geometry, "seconds": cpu,
            "cpu_seconds": cpu, "peak_memory": 1e9, "faces": 1}  # fmt: skip


ROWS = [
    row("ours", "a", 80.0, {"brick": (60.0, 90.0), "glass": (40.0, 50.0)}),
    row("ours", "b", 60.0, {"stone": (20.0, 50.0), "clean_white": (80.0, 70.0)}),
    row("theirs", "a", 70.0, {"brick": (60.0, 80.0), "glass": (40.0, 40.0)}, cpu=1000.0),
]


def test_each_preset_and_each_tool_runs_on_each_scene() -> None:
    runs = suite_runs("surfaces", SuiteSettings(commands={"theirs": "tool {mesh}"}))
    assert {run.scene for run in runs} == set(SURFACES)
    assert {run.variant for run in runs} == {*(f"preset {name}" for name in PRESETS), "theirs"}
    halves = [{run.scene for run in half_of(runs, held_out)} for held_out in (False, True)]
    assert halves[0] | halves[1] == set(SURFACES) and not halves[0] & halves[1]
    with pytest.raises(BadInput, match="None of the scenes"):
        half_of(suite_runs("smoke"), held_out=True)


def test_no_material_is_in_two_classes() -> None:
    members = [name for some in CLASSES.values() for name in some]
    assert len(members) == len(set(members))
    assert material_class("slate") == "slate and dark metal" and material_class("ivory") == "other"


def test_classes_are_means_weighted_by_area() -> None:
    scores = class_scores(r for r in ROWS if r["variant"] == "ours")
    stone = scores["brick and stone"]
    assert stone["f1"] == pytest.approx([(60 * 90 + 20 * 50) / 80] * len(THRESHOLDS))
    assert stone["share"] == pytest.approx(40.0) and stone["normal_90"] == pytest.approx(20.0)
    assert scores["glass"]["normal_90"] is None and scores["plain plaster"]["f1"][0] == pytest.approx(70.0)


def test_tables_compare_what_all_variants_did() -> None:
    scenes, materials = surface_tables(ROWS)
    assert scenes["columns"] == ["scene", "ours", "theirs"]
    assert scenes["lines"][0] == ["a", "80.0 / 80.0 / 80.0; 10", "70.0 / 70.0 / 70.0; 1000"]
    assert scenes["lines"][1][2] == "–"
    assert scenes["lines"][-1][1:] == scenes["lines"][0][1:]  # scene b was not done by both
    assert [line[0] for line in materials["lines"]] == ["brick and stone", "glass"]
    assert surface_tables([])[0]["lines"] == []


def test_the_page_has_both_charts(tmp_path: Path) -> None:
    page = write_page("surfaces", ROWS, tmp_path).read_text(encoding="utf-8")
    for name in ("surfaces-f1-cpu", "surfaces-materials"):
        assert f"charts/{name}.svg" in page and (tmp_path / "charts" / f"{name}.png").stat().st_size > 1000
    assert "brick and stone" in page
    assert write_page("surfaces", [], tmp_path).exists()


def test_means_are_over_the_scenes_that_every_variant_did() -> None:
    assert common_scenes(ROWS) == {"a"} and common_scenes(ROWS[:2]) == {"a", "b"} and common_scenes([]) == set()
    figures = {name: figure for name, _, figure in surface_figures(ROWS)}
    (axes, *_) = figures["surfaces-f1-cpu"].axes
    means = [tuple(spots.get_offsets()[0]) for spots in axes.collections if spots.get_label() in ("ours", "theirs")]
    assert means == [(10.0, 80.0), (1000.0, 70.0)]
    labels = [label.get_text() for label in figures["surfaces-materials"].axes[0].get_yticklabels()]
    assert labels == ["brick and stone", "glass"]


@pytest.mark.parametrize("scene", sorted(SURFACES))
def test_every_material_of_the_scenes_has_a_class(scene: str) -> None:
    assert all(material_class(part.material) != "other" for part in building_parts(SURFACES[scene]))
