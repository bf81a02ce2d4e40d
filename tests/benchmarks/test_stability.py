# SPDX-License-Identifier: GPL-3.0-or-later
"""The failure map's arithmetic, its page, and a whole pass with a stand-in for the runs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks import stability
from benchmarks.features import NoModel
from benchmarks.measure import Prepared
from benchmarks.perturb import PERTURBATIONS, RECORD
from benchmarks.run import bench_main
from benchmarks.scene_series import SERIES
from benchmarks.stability import crossing, outcome, spreads, stability_main, summarise
from benchmarks.stability_charts import markdown
from mgf_engine.errors import BadInput
from mgf_engine.options.config import make_config


def row(name: str, level: float, mode: str = "masks", f1: float | None = 80.0, **more: Any) -> dict[str, Any]:
    scores = {} if f1 is None else {"geometry": {"thresholds": [0.05, 0.1], "f1": [1.0, f1]}}
    return {"name": name, "level": level, "mode": mode, "psnr": 20.0, "cpu_seconds": 5.0, **scores, **more}


def test_the_options_of_every_run_exist() -> None:
    config = make_config(stability.SMALL)
    assert {name: getattr(config, name) for name in stability.SMALL} == stability.SMALL


@pytest.mark.parametrize(
    ("entry", "expected"),
    [
        (row("pose", 0), "silent"),
        (row("pose", 0, warnings=["Something."]), "warned"),
        (row("pose", 0, f1=None, code=2, failed="No."), "refused"),
        (row("pose", 0, f1=None, code=1, failed="Unexpected error: X"), "fault"),
        (row("pose", 0, f1=None, code=-11, failed=""), "fault"),
        (row("pose", 0, f1=float("nan")), "fault"),
    ],
)
def test_how_a_run_ended(entry: dict[str, Any], expected: str) -> None:
    assert outcome(entry) == expected


def test_curves_are_shares_of_the_undisturbed_run_and_cross_between_levels() -> None:
    rows = [row("pose", 0), row("pose", 1, f1=72.0), row("pose", 4, f1=None, code=2, failed="Poses are off.")]
    rows += [row("pose", 0, "no masks", 60.0), row("pose", 4, "no masks", 59.0)]
    (entry,) = summarise(rows)
    shares = [point["share"] for point in entry["curves"]["masks"]]
    assert shares == pytest.approx([1.0, 0.9, 0.0])
    assert entry["useless"]["masks"] == pytest.approx(1 + 3 * 0.4 / 0.9)
    assert entry["useless"]["no masks"] is None
    assert entry["curves"]["masks"][-1]["outcome"] == "refused"
    assert "Poses are off." in markdown([entry])


def test_crossing_downwards_levels() -> None:
    curve = [{"level": 30.0, "share": 1.0}, {"level": 10.0, "share": 0.8}, {"level": 3.0, "share": 0.1}]
    assert crossing(curve, 0.9) == pytest.approx(20.0)
    assert crossing(curve, 0.05) is None


def test_several_seeds_show_their_spread() -> None:
    rows = [row("blur", 0, f1=value, psnr=psnr) for value, psnr in ((80.0, 22.0), (80.4, 22.5), (79.9, 22.25))]
    assert spreads([*rows, row("blur", 3)]) == [
        "blur 0 masks, 3 seeds: F1 79.90 .. 80.40, spread 0.50; PSNR 22.00 .. 22.50, spread 0.50"
    ]


def test_several_seeds_are_averaged_and_the_worst_outcome_counts() -> None:
    (entry,) = summarise([row("noise", 0), row("noise", 10, f1=70.0), row("noise", 10, f1=50.0, warnings=["W."])])
    assert entry["curves"]["masks"][1]["f1"] == pytest.approx(60.0)
    assert entry["curves"]["masks"][1]["outcome"] == "warned"


@pytest.fixture
def scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder in place of a scene; runs score what their level says, undisturbed ones 90."""
    folder = tmp_path / "scene"
    folder.mkdir()
    made: list[tuple[str, float]] = []

    def fake_perturb(source: Path, target: Path, name: str, level: float, seed: int, other: Path | None) -> Path:
        target.mkdir(parents=True)
        (target / RECORD).write_text(json.dumps({"scale": 2.0, "offset": [1.0, 0, 0]}))
        made.append((name, level))
        return target

    def fake_measure(run: Any, prepared: Prepared, job: Path, samples: int, keep_job: bool) -> dict[str, Any]:
        assert prepared.folder.is_dir()
        assert (prepared.scale, prepared.offset) == (2.0, (1.0, 0, 0))
        if "4" in run.variant:
            return {"code": 1, "failed": "Unexpected error: X", "cpu_seconds": 1.0}
        return row("x", 0, f1=90.0 if "undisturbed" in run.variant else 45.0, masks=run.masks)

    monkeypatch.setattr(stability, "perturb", fake_perturb)
    monkeypatch.setattr(stability, "measure", fake_measure)
    monkeypatch.setattr(stability, "prepare_scene", lambda name: Prepared(folder, [], 0.1, np.zeros((2, 3))))
    monkeypatch.setattr(stability, "made", made, raising=False)
    return folder


def arguments(scene: Path, tmp_path: Path, *more: str) -> list[str]:
    return ["--scene", str(scene), "--out", str(tmp_path / "out"), *more]


def test_a_pass_keeps_results_and_draws_the_page(scene: Path, tmp_path: Path) -> None:
    args = arguments(scene, tmp_path, "--only", "pose", "masks_eroded", "--levels", "0", "1")
    assert stability_main(args) == 0
    made = list(stability.made)  # type: ignore[attr-defined]
    assert stability_main(args) == 0
    assert stability.made == made  # type: ignore[attr-defined]  # nothing is run twice
    assert not (tmp_path / "out/scenes").exists() or not list((tmp_path / "out/scenes").iterdir())
    rows = json.loads((tmp_path / "out/stability.json").read_text())
    assert {(r["name"], r["level"], r["mode"]) for r in rows} == {
        ("pose", 0, "masks"), ("pose", 0, "no masks"), ("pose", 1, "masks"), ("pose", 1, "no masks"),
        ("masks_eroded", 0, "masks"),
    }  # fmt: skip
    page = (tmp_path / "out/stability.html").read_text()
    assert PERTURBATIONS["pose"].title in page
    assert (tmp_path / "out/charts/stability-f1.png").stat().st_size > 1000


def test_rows_with_scenes_of_their_own(scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []
    monkeypatch.setattr(stability, "make_scene", lambda name, spec: asked.append((name, spec)) or scene)
    monkeypatch.setattr(stability, "prepare_folder", lambda folder: Prepared(folder, [], 0.06, np.zeros((2, 3))))

    def fake_measure(run: Any, prepared: Prepared, job: Path, samples: int, keep_job: bool) -> dict[str, Any]:
        scores = {"thresholds": [0.1, 0.12], "f1": [40.0, 70.0 if run.options["resolution"] == 240 else 60.0]}
        return {**row("x", 0), "geometry": scores, "ground_pixel": 0.06}

    monkeypatch.setattr(stability, "measure", fake_measure)
    args = arguments(scene, tmp_path, "--only", "far", "bars", "--levels", "1", "2.3", "2.1", "--modes", "masks")
    assert stability_main(args) == 0
    assert stability_main(args) == 0  # nothing is rendered or run twice
    assert [name for name, _ in asked] == ["demo", "stability_far", "steel_frame_hall40"]
    assert asked[1][1].rings[0].distance == pytest.approx(2.3 * asked[0][1].rings[0].distance)
    rows = json.loads((tmp_path / "out/stability.json").read_text())
    # From afar a pixel is larger, so two of them are the measure; bars are measured at 10 cm.
    assert [(r["name"], r["level"], stability.f1_of(r)) for r in rows] == [
        ("far", 1, 70.0), ("far", 2.3, 70.0), ("bars", 2.1, 40.0),
    ]  # fmt: skip


def test_photos_that_cannot_be_placed_are_a_refusal(
    scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def unplaced(name: str, spec: Any) -> Path:
        raise NoModel("Structure from motion found no model.")

    monkeypatch.setattr(stability, "make_scene", unplaced)
    args = arguments(scene, tmp_path, "--only", "repeats", "--levels", "0.1", "--modes", "masks")
    assert stability_main(args) == 0
    (only,) = json.loads((tmp_path / "out/stability.json").read_text())
    assert (stability.outcome(only), stability.f1_of(only)) == ("refused", 0.0)


def test_levels_of_every_series_are_ordered_from_harmless_to_hopeless() -> None:
    for entry in SERIES.values():
        assert list(entry.levels) in (sorted(entry.levels), sorted(entry.levels, reverse=True))
        for level in entry.scenes.values():
            make_config(level.options)
            assert level.spec.photos >= 24


def test_a_fault_is_reported_and_tried_again(scene: Path, tmp_path: Path) -> None:
    args = arguments(scene, tmp_path, "--only", "pose", "--levels", "4", "--modes", "masks")
    assert stability_main(args) == 1
    assert stability_main(args) == 1
    assert len(stability.made) == 2  # type: ignore[attr-defined]


def test_unknown_perturbations_are_refused(scene: Path) -> None:
    with pytest.raises(BadInput, match="no perturbation"):
        stability_main(["--scene", str(scene), "--only", "weather"])
    assert bench_main(["stability", "--only", "weather"]) == 2
