# SPDX-License-Identifier: GPL-3.0-or-later
"""Quantities, sheets and the page of a house of known size."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from support.finished_job import FinishedJob

from benchmarks.synthetic.house import OFFSET
from mgf_engine.drawings.ground import TERRAIN, GroundLevel
from mgf_engine.drawings.load import read_survey
from mgf_engine.drawings.make import make_drawings
from mgf_engine.drawings.quantities import building_rows, deviation_picture
from mgf_engine.drawings.regions import survey_planes
from mgf_engine.drawings.sheets import choose_scale
from mgf_engine.drawings.work import DrawingOptions
from mgf_engine.errors import BadInput
from mgf_engine.messages import Reporter


@pytest.fixture
def rows(drawings: Path) -> dict[tuple[str, str], str]:
    """(of, quantity) -> value."""
    with open(drawings / "quantities.csv", encoding="utf-8", newline="") as file:
        return {(row["of"], row["quantity"]): row["value"] for row in csv.DictReader(file)}


def test_sizes_areas_and_heights_are_those_of_the_house(rows: dict[tuple[str, str], str]) -> None:
    assert float(rows["A", "width"]) == pytest.approx(4.0, abs=1e-3)
    assert float(rows["A", "area of all walls facing it"]) == pytest.approx(8.0, rel=1e-3)
    assert float(rows["B", "area of all walls facing it"]) == pytest.approx(3 * 2 + 1.8, rel=1e-3)
    assert float(rows["building", "eaves of the largest roof plane over the ground"]) == pytest.approx(2.0, abs=0.01)
    assert float(rows["building", "ridge over the ground"]) == pytest.approx(3.2, abs=0.01)
    assert float(rows["roof 1", "tilt"]) == pytest.approx(np.degrees(np.arctan(1.2 / 1.5)), abs=0.05)
    assert rows["building", "volume"] == ""  # the house has no floor


def test_heights_are_counted_from_the_ground_not_from_the_lowest_shred_of_the_mesh(finished: FinishedJob) -> None:
    survey = read_survey(finished.folder)
    rows = building_rows(survey, survey_planes(survey), GroundLevel(float(OFFSET[2]) + 0.5, TERRAIN))
    found = {(of, quantity): value for of, quantity, value, _ in rows}
    assert float(found["building", "ridge over the ground"]) == pytest.approx(2.7, abs=0.01)
    assert float(found["building", "highest point over the ground"]) == pytest.approx(2.7, abs=0.01)
    assert found["building", "ground is known from"] == TERRAIN


def test_the_windows_share_is_right(rows: dict[tuple[str, str], str]) -> None:
    assert float(rows["A", "share of window"]) == pytest.approx(100 * (0.7 * 0.8 + 0.9 * 0.8) / 8.0, abs=1.0)


def test_an_even_wall_deviates_nowhere(drawings: Path, rows: dict[tuple[str, str], str]) -> None:
    with rasterio.open(drawings / "deviation-A.tif") as file:
        deviation = file.read(1)
    assert np.isfinite(deviation).mean() > 0.5 and np.nanmax(np.abs(deviation)) < 1e-4
    assert float(rows["A", "deviation from the plane, RMS"]) == pytest.approx(0.0, abs=0.1)


def test_a_plumb_wall_has_no_sign_and_its_tilt_a_unit(drawings: Path) -> None:
    """The house has no true lengths: a thousandth of its unit to a unit is a thousandth."""
    with open(drawings / "quantities.csv", encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert not [row for row in rows if row["value"].startswith("-") and float(row["value"]) == 0]
    assert {row["unit"] for row in rows if row["quantity"] == "tilt outwards"} == {"1/1000"}


def test_the_scale_of_colors_names_its_unit() -> None:
    deviation = np.full((100, 300), 0.012, np.float32)
    metric, units = deviation_picture(deviation), deviation_picture(deviation, "1/1000 units")
    assert metric.shape == units.shape and len(metric) > 100 and (metric[:100] == units[:100]).all()
    assert (metric[100:, :, 3] == 255).all() and (metric[100:] != units[100:]).any()


def test_sheets_and_page_are_there(drawings: Path, index: dict[str, Any]) -> None:
    assert (drawings / "sheet-lines-A.pdf").read_bytes().startswith(b"%PDF")
    assert index["files"]["sheet-lines-A.pdf"]["scale"] == choose_scale(np.array([4.0, 3.2]), "A3") == 20
    section = next(name for name in index["files"] if name.startswith("sheet-section-A") and name.endswith(".svg"))
    text = (drawings / section).read_text(encoding="utf-8")
    assert "hatch" in text.lower() or "<pattern" in text
    page = (drawings / "drawings.html").read_text(encoding="utf-8")
    assert all(name in page for name in index["files"] if name != "drawings.html")


def test_quantities_stand_in_the_jobs_report_once(finished: FinishedJob, tmp_path: Path) -> None:
    report = finished.folder / "report.html"
    report.write_text("<html><main><h1>Report</h1></main></html>", encoding="utf-8")
    try:
        for _ in range(2):
            wanted = DrawingOptions(kinds=frozenset({"quantities"}))
            make_drawings(finished.folder, tmp_path / "out", wanted, Reporter())
        text = report.read_text(encoding="utf-8")
    finally:
        report.unlink()
    assert text.count("<h2>Quantities</h2>") == 1 and "share of window" in text
    assert (tmp_path / "out" / "drawings.html").as_uri() in text and text.endswith("</main></html>")


def test_what_fits_on_no_sheet_is_refused() -> None:
    assert choose_scale(np.array([30.0, 12.0]), "A1") == 50
    with pytest.raises(BadInput):
        choose_scale(np.array([1e6, 1e6]), "A3")
