# SPDX-License-Identifier: GPL-3.0-or-later
"""Elevations and sections of a house whose every edge is known: DXF read by ezdxf, in real lengths."""

from __future__ import annotations

import xml.etree.ElementTree as Xml
from pathlib import Path
from typing import Any

import ezdxf
import numpy as np
import pytest
from support.finished_job import WINDOWS, FinishedJob

from benchmarks.synthetic.house import OFFSET
from mgf_engine.drawings.facades import find_facades
from mgf_engine.drawings.load import read_survey
from mgf_engine.drawings.model import Survey
from mgf_engine.drawings.section import cut
from mgf_engine.drawings.section_planes import section_frames
from mgf_engine.errors import BadInput

GROUND = float(OFFSET[2])


@pytest.fixture(scope="module")
def survey(finished: FinishedJob) -> Survey:
    return read_survey(finished.folder)


def segments(path: Path) -> dict[str, list[np.ndarray]]:
    """Layer -> its segments [2, 2]; heights from the ground."""
    document = ezdxf.readfile(path)
    audit = document.audit()
    assert not audit.has_errors and not audit.has_fixes
    found: dict[str, list[np.ndarray]] = {}
    for line in document.modelspace().query("LWPOLYLINE"):
        points = np.array(line.get_points("xy"))
        points = np.concatenate([points, points[:1]]) if line.closed else points
        found.setdefault(line.dxf.layer, []).extend(np.stack([points[:-1], points[1:]], 1))
    return found


def all_there(found: list[np.ndarray], true: list[tuple[float, float, float, float]], slack: float) -> bool:
    """Whether each true segment is found with both ends, in either direction, and nothing else is."""
    left = list(found)
    for x0, y0, x1, y1 in true:
        ends = np.array([[x0, y0], [x1, y1]])
        match = [k for k, s in enumerate(left) if min(np.abs(s - ends).max(), np.abs(s[::-1] - ends).max()) < slack]
        if not match:
            return False
        left.pop(match[0])
    return not left


def test_the_long_side_has_its_outline_its_eaves_and_its_windows(drawings: Path, index: dict[str, Any]) -> None:
    found = segments(drawings / "elevation-A.dxf")
    b, pixel = GROUND, index["pixel"]
    outline = [(0, b, 4, b), (4, b, 4, b + 3.2), (4, b + 3.2, 0, b + 3.2), (0, b + 3.2, 0, b)]
    assert all_there(found["OUTLINE"], outline, pixel)
    assert all_there(found["CREASE"], [(0, b + 2, 4, b + 2)], pixel)
    windows = []
    for left, right, low, high in WINDOWS:
        x0, x1, y0, y1 = left + 2, right + 2, b + low, b + high
        windows += [(x0, y0, x1, y0), (x1, y0, x1, y1), (x1, y1, x0, y1), (x0, y1, x0, y0)]
    assert all_there(found["PART-WINDOW"], windows, pixel)
    assert set(found) == {"OUTLINE", "CREASE", "PART-WINDOW"}


def test_the_gable_side_is_five_lines(drawings: Path, index: dict[str, Any]) -> None:
    found = segments(drawings / "elevation-B.dxf")
    b = GROUND
    gable = [(0, b, 3, b), (3, b, 3, b + 2), (3, b + 2, 1.5, b + 3.2), (1.5, b + 3.2, 0, b + 2), (0, b + 2, 0, b)]
    assert set(found) == {"OUTLINE"} and all_there(found["OUTLINE"], gable, index["pixel"])


def test_sections_have_their_area_and_are_hatched(drawings: Path, index: dict[str, Any]) -> None:
    areas = {name: facts["area"] for name, facts in index["files"].items() if facts["kind"] == "section"}
    assert areas["section-z-0.8.dxf"] == pytest.approx(4 * 3, rel=0.005)
    assert areas["section-A-2.dxf"] == pytest.approx(3 * 2 + 0.5 * 3 * 1.2, rel=0.005)
    assert areas["section-B-1.5.dxf"] == pytest.approx(4 * 3.2, rel=0.005)
    for name in areas:
        if name.endswith(".dxf"):
            document = ezdxf.readfile(drawings / name)
            (hatch,) = document.modelspace().query("HATCH")
            assert hatch.dxf.layer == "HATCH" and hatch.dxf.pattern_name == "ANSI31"


@pytest.mark.parametrize("height", [2.2, 2.5, 3.0])
def test_a_level_section_through_the_roof(survey: Survey, height: float) -> None:
    (frame,) = section_frames(survey, find_facades(survey), [f"z={height}"], GROUND)
    made = cut(survey, frame)
    assert made.closed and made.area == pytest.approx(4 * 3 * (3.2 - height) / 1.2, rel=0.005)


def plane_text(name: str, point: tuple[float, float, float], normal: tuple[float, float, float]) -> str:
    """A section through a point of the house's own frame."""
    return f"{name}=" + ",".join(f"{v:.9g}" for v in (*(np.array(point) + OFFSET), *normal))


@pytest.mark.parametrize(
    ("text", "area"),
    [
        (plane_text("cellar", (9, 9, 0.7), (0, 0.01, -2)), 4 * 3),  # half a degree off level is level
        (plane_text("gable", (0.3, 5, 5), (-1, 0.01, 0.02)), 3 * 2 + 0.5 * 3 * 1.2),
        (plane_text("turned", (0, 0, 1.0), (0, 0.5, 3**0.5 / 2)), 4 * 3 / (3**0.5 / 2)),  # 30 degrees off level
    ],
)
def test_a_section_along_any_plane(survey: Survey, text: str, area: float) -> None:
    (frame,) = section_frames(survey, find_facades(survey), [text], GROUND)
    made = cut(survey, frame)
    assert made.closed and made.area == pytest.approx(area, rel=0.005)
    assert frame.name == text.split("=")[0]


def test_the_frame_of_an_upright_plane_has_heights_and_begins_at_its_left_end(survey: Survey) -> None:
    text = plane_text("cut", (0.3, 5, 5), (-1, 0, 0))
    (frame,) = section_frames(survey, find_facades(survey), [text], GROUND)
    at = frame.to_drawing(survey.mesh.vertices)
    assert at[:, 0].min() == pytest.approx(0, abs=1e-9) and frame.size == pytest.approx([3, 3.2], abs=1e-6)
    assert at[:, 1] == pytest.approx(survey.mesh.vertices[:, 2], abs=1e-9)


@pytest.mark.parametrize(
    "text", ["z=-1", "z=9", "A=4.5", "west=1", "z", "A=x", "A=1,2,3", "p=0,0,0,0,0,0", "p=0,0,e,1,0,0"]
)
def test_a_section_that_cannot_be_is_refused(survey: Survey, text: str) -> None:
    with pytest.raises(BadInput):
        section_frames(survey, find_facades(survey), [text], GROUND)


def test_a_small_gap_of_the_mesh_is_bridged_and_a_large_one_is_not(
    survey: Survey, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A gable of 3 m with a gap at its eaves."""
    (frame,) = section_frames(survey, find_facades(survey), ["A=2"], GROUND)
    foot, top = frame.low, frame.high
    middle, eaves = 0.5 * (foot[0] + top[0]), foot[1] + 2.0
    for pixels, closed in ((5, True), (30, False)):
        gap = pixels * survey.working_pixel
        left = np.array([[foot[0], foot[1]], [foot[0], eaves], [middle, top[1]], [top[0], eaves]])
        right = np.array([[top[0], foot[1]], [top[0], eaves - gap]])
        paths = [frame.to_local(np.column_stack([p, np.zeros(len(p))])) for p in (left, right)]
        monkeypatch.setattr("mgf_engine.drawings.section._paths", lambda *_, paths=paths: paths)
        made = cut(survey, frame)
        assert made.closed is closed and bool(made.drawing.areas) is closed
        assert made.bridged == pytest.approx(gap if closed else 0.0)
    width = top[0] - foot[0]
    assert made.area == 0.0 and width > 0


def test_two_sections_of_one_name_are_refused(survey: Survey) -> None:
    with pytest.raises(BadInput, match="Two sections are called z-1"):
        section_frames(survey, find_facades(survey), ["z=1", "z=1.0"], GROUND)


def test_svg_has_a_group_for_each_layer_and_the_size_of_a_print(drawings: Path) -> None:
    root = Xml.parse(drawings / "elevation-A.svg").getroot()
    groups = [node.get("id") for node in root if node.get("id")]
    assert groups == ["OUTLINE", "CREASE", "PART-WINDOW"]
    assert float(root.get("width").removesuffix("mm")) == pytest.approx(1000 * 4 * 1.04 / 20, rel=1e-3)
    assert root.get("data-scale") == "1:20"
    outline = next(node for node in root if node.get("id") == "OUTLINE")
    assert float(outline.get("stroke-width")) == pytest.approx(0.5 * 20 / 1000)
