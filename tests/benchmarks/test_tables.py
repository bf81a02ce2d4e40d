# SPDX-License-Identifier: GPL-3.0-or-later
"""A suite's table in a document."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.measure import origin
from benchmarks.tables import write_table
from mgf_engine.errors import BadInput


def row(variant: str, f1: float, seed: int = 0, **more: object) -> dict:
    scores = {"thresholds": [0.05, 0.1, 0.2], **{k: [f1, f1 + 1, f1 + 2] for k in ("f1", "accuracy", "completeness")}}
    return {
        "variant": variant, "scene": "/x/house", "seed": seed, "options": {"surface": "opacity", "iterations": 9},
        "geometry": scores, "cpu_seconds": 12.0, "peak_memory": 2e9, "commit": "abc1234", "machine": "CPU, 2 cores",
        "date": "2026-01-01", **more,
    }  # fmt: skip


def test_a_table_takes_the_place_of_the_one_before(tmp_path: Path) -> None:
    document = tmp_path / "results.md"
    document.write_text("# Results\n\nWritten by hand.\n")
    write_table(document, "training", "what training is worth", [row("start", 40.0)])
    write_table(document, "peers", "others", [row("GOF-like", 50.0)])
    rows = [row("start", 60.0), row("start", 64.0, seed=1, psnr=21.5), {"variant": "x", "scene": "s", "failed": "no"}]
    write_table(document, "training", "what training is worth", rows)
    assert max(map(len, document.read_text().split("\n| ")[-1].splitlines()[1:])) <= 120
    text = document.read_text()
    assert text.startswith("# Results\n\nWritten by hand.\n") and text.count("## What training is worth") == 1
    assert "| start | 2 | 62.0 ±2.0 / 63.0 ±2.0 / 64.0 ±2.0 | 62.0 / 62.0 | 21.50 | 12 | 2000 |" in text
    assert "SSIM" not in text and "LPIPS" not in text  # which nobody knows here
    assert "40.0" not in text and "GOF-like" in text and "Failed: x on `s`: no" in text
    words = " ".join(text.split())
    assert "commit abc1234, 2026-01-01, CPU, 2 cores" in words
    assert "mgf bench training --scenes house --seeds 2 --set iterations=9 --set surface=opacity --write" in words


def test_rows_of_several_commits_name_their_own(tmp_path: Path) -> None:
    document = tmp_path / "results.md"
    document.write_text("")
    write_table(document, "training", "t", [row("a", 1.0), row("b", 2.0, date="2026-01-03")])
    assert "| CPU s | MB |" in document.read_text()
    assert "commit abc1234, 2026-01-01 to 2026-01-03, CPU, 2 cores" in " ".join(document.read_text().split())
    later = row("b", 2.0, seed=1, commit="def5678")
    write_table(document, "training", "t", [row("a", 1.0), row("b", 2.0), later])
    text = document.read_text()
    assert "| CPU s | MB | commit |" in text and "| 2000 | abc1234 |" in text and "| 2000 | abc1234, def5678 |" in text
    assert "commits as the rows name them, 2026-01-01, CPU, 2 cores" in " ".join(text.split())


def test_the_command_names_samples_that_are_not_the_usual_ones(tmp_path: Path) -> None:
    document = tmp_path / "results.md"
    document.write_text("")
    rows = [row("a", 1.0, samples=200_000), row("tool", 1.0, samples=200_000, options={})]
    write_table(document, "peers", "others", rows, ["--paper-iterations 70"])
    assert "--paper-iterations 70 --set iterations=9 --set surface=opacity --samples 200000 --write" in (
        " ".join(document.read_text().split())
    )


def test_beside_whole_photos_all_meshes_are_scored_in_the_box_of_the_building_too(tmp_path: Path) -> None:
    document = tmp_path / "results.md"
    document.write_text("")
    boxed = {"in_box": row("", 44.0)["geometry"]}
    write_table(document, "peers", "others", [row("ours", 40.0, **boxed)])
    assert "box" not in document.read_text()
    whole = row("all", 30.0, whole_picture=True, **boxed)
    write_table(document, "peers", "others", [row("ours", 40.0, **boxed), whole])
    text = document.read_text()
    assert "| F1 at 5 / 10 / 20 cm | F1 in the building's box |" in text
    assert "| ours | 1 | 40.0 / 41.0 / 42.0 | 44.0 / 45.0 / 46.0 |" in text
    write_table(document, "peers", "others", [row("old", 40.0), whole])
    assert "box" not in document.read_text()  # where a result is of a version that did not score it


def test_without_results_the_document_stays(tmp_path: Path) -> None:
    document = tmp_path / "results.md"
    document.write_text("as it was")
    with pytest.raises(BadInput, match="has a result yet"):
        write_table(document, "peers", "others", [{"variant": "a", "scene": "s", "failed": "no"}])
    with pytest.raises(BadInput, match="name a Markdown file"):
        write_table(tmp_path / "missing.md", "peers", "others", [row("a", 1.0)])
    assert document.read_text() == "as it was"


def test_figures_say_where_they_are_from() -> None:
    assert set(origin()) == {"commit", "machine", "date"} and all(origin().values())


def test_a_picture_of_the_same_rows_stands_above_the_tables(tmp_path: Path) -> None:
    (tmp_path / "docs/pictures").mkdir(parents=True)
    document = tmp_path / "docs/results.md"
    document.write_text("")
    for _ in range(2):
        write_table(
            document, "pareto", "speed", [row("a", 1.0)], (), tmp_path / "docs/pictures" / "speed.png"
        )  # fmt: skip
    lines = document.read_text().splitlines()
    assert lines.count("![Speed](pictures/speed.png)") == 1
    assert lines.index("![Speed](pictures/speed.png)") == lines.index("## Speed") + 2 < lines.index("### `house`")
    assert "--chart docs/pictures/speed.png" in document.read_text()
