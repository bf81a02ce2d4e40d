# SPDX-License-Identifier: GPL-3.0-or-later
"""DXF and SVG of a square with a hole: layers, lengths, and where its coordinates are."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree as Xml

import ezdxf
import numpy as np
import pytest
from shapely import Polygon

from mgf_engine.drawings.model import CUT, DETAIL, HATCH, OUTLINE, PART, DrawingFrame, LineDrawing, Polyline
from mgf_engine.drawings.vector_files import file_shift, layer_name, write_dxf, write_svg
from mgf_engine.georef.model import Georeference

X, Y, Z = np.eye(3)
OFFSET = (500_000.0, 5_000_000.0, 100.0)
SURVEY = SimpleNamespace(georeference=Georeference(offset=OFFSET, crs="EPSG:25832", unit="metre"))
SVG = "{http://www.w3.org/2000/svg}"
FRAMES = {
    "plan": DrawingFrame("plan", np.zeros(3), X, Y, np.zeros(2), np.array([4.0, 3.0])),
    "front": DrawingFrame("A", np.zeros(3), X, Z, np.zeros(2), np.array([4.0, 3.0])),
    "turned plan": DrawingFrame("plan", np.zeros(3), Y, -X, np.zeros(2), np.array([4.0, 3.0])),
    "slanted": DrawingFrame("s", np.zeros(3), X, (Y + Z) / 2**0.5, np.zeros(2), np.array([4.0, 3.0])),
}


def drawing(frame: DrawingFrame) -> LineDrawing:
    ring = np.array([[0.0, 0], [4, 0], [4, 3], [0, 3], [0, 0]])
    hole = Polygon(ring, [[(1, 1), (2, 1), (2, 2), (1, 2)]])
    lines = [Polyline(ring, OUTLINE), Polyline(ring[:2], DETAIL), Polyline(ring[1:3], PART + "BAY_WINDOW")]
    return LineDrawing(frame, lines, [hole])


@pytest.mark.parametrize(
    "name,shift", [("plan", OFFSET[:2]), ("front", (0, 100.0)), ("turned plan", (0, 0)), ("slanted", (0, 0))]
)
def test_files_have_coordinates_of_the_crs_where_their_axes_are_its(name: str, shift: tuple[float, float]) -> None:
    np.testing.assert_array_equal(file_shift(FRAMES[name], SURVEY), shift)  # type: ignore[arg-type]


def test_layers_are_read_as_words() -> None:
    assert layer_name(PART + "BAY_WINDOW") == "bay window" and layer_name(CUT) == "cut"


def test_dxf_has_polylines_on_layers_and_hatched_areas(tmp_path: Path) -> None:
    write_dxf(tmp_path / "a.dxf", drawing(FRAMES["plan"]), SURVEY, 100)  # type: ignore[arg-type]
    document = ezdxf.readfile(tmp_path / "a.dxf")  # type: ignore[attr-defined]
    assert document.header["$INSUNITS"] == 6
    lines = {line.dxf.layer: line for line in document.modelspace().query("LWPOLYLINE")}
    assert set(lines) == {OUTLINE, DETAIL, PART + "BAY_WINDOW"}
    assert lines[OUTLINE].closed and len(lines[OUTLINE]) == 4 and not lines[DETAIL].closed
    np.testing.assert_allclose(lines[DETAIL].get_points("xy"), np.array([[0, 0], [4, 0]]) + OFFSET[:2])
    assert document.layers.get(OUTLINE).dxf.lineweight == 50 and document.layers.get(DETAIL).dxf.lineweight == 13
    (hatch,) = document.modelspace().query("HATCH")
    assert hatch.dxf.layer == HATCH and [len(path.vertices) for path in hatch.paths] == [4, 4]


def test_svg_has_the_size_of_a_print_and_says_what_to_add(tmp_path: Path) -> None:
    for name, says, top in (("plan", True, -3.08), ("front", False, -103.08)):
        write_svg(tmp_path / "a.svg", drawing(FRAMES[name]), SURVEY, 50)  # type: ignore[arg-type]
        root = Xml.parse(tmp_path / "a.svg").getroot()
        assert root.get("width") == f"{1000 * 4.16 / 50:.3f}mm" and root.get("height") == f"{1000 * 3.16 / 50:.3f}mm"
        assert [float(v) for v in str(root.get("viewBox")).split()] == pytest.approx([-0.08, top, 4.16, 3.16])
        assert (root.find(f"{SVG}desc") is not None) == says
        groups = [group.get("id") for group in root.findall(f"{SVG}g")]
        assert groups == [HATCH, OUTLINE, PART + "BAY_WINDOW", DETAIL]
    text = (tmp_path / "a.svg").read_text()
    assert 'd="M 0.0000 -100.0000 L 4.0000 -100.0000"' in text
