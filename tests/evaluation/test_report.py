# SPDX-License-Identifier: GPL-3.0-or-later
"""The report says everything, survives odd values, and needs no network."""

from __future__ import annotations

import base64
import json
import re
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import torch

from mgf_engine.errors import BadInput
from mgf_engine.evaluation.curve import curve_svg, smoothed
from mgf_engine.evaluation.evenness import Evenness, PlaneEvenness
from mgf_engine.evaluation.images import score
from mgf_engine.evaluation.report import (
    ReportData,
    StageReport,
    ViewReport,
    embed,
    format_exact_duration,
    memory,
    write_report,
)
from mgf_engine.export import report as job_report
from mgf_engine.files.images import write_png
from mgf_engine.mesh.confidence import ConfidenceShares
from mgf_engine.options.config import as_dict, make_config


def view(name: str, held_out: bool, shift: int, pictures: bool = True) -> ViewReport:
    photo = np.random.default_rng(shift).integers(0, 256, (30, 40, 3)).astype(np.uint8)
    scores = score(photo, np.roll(photo, shift, 1), np.ones((30, 40), bool))
    return ViewReport(name, held_out, scores, {"Photo": photo, "Render": photo} if pictures else {})


@pytest.fixture
def data(tmp_path: Path) -> ReportData:
    config = make_config({"preset": "draft"})
    write_png(tmp_path / "sheet.png", np.zeros((20, 30, 3), np.uint8))
    return ReportData(
        title="St. <Mary> & Söhne", command="mgf reconstruct 'a b' --out job", config=as_dict(config),
        user_options={"preset": "draft"},
        views=[view("a.jpg", False, 1), view("b.jpg", True, 2), view("c.jpg", True, 3), view("d.jpg", False, 1, False)],
        counts={"photos": 4, "Gaussians": 123456, "faces": 98765},
        stages=[StageReport("scene", 1.5, 10**8), StageReport("field", 240.0, 2 * 10**9)], iterations=1500,
        seconds_per_part={"forward": 60.0, "backward": 120.0}, mesh_seconds_per_part={"cleaning": 30.0, "colours": 7.0},
        curve=[{"iteration": i, "psnr": 20 + i / 100, "gaussians": 1000 + i} for i in range(0, 1500, 10)],
        versions={"python": "3.11"}, machine={"processor": "Fast One"}, kernel="avx2", peak_memory=2_100_000_000,
        warnings=["One photo is <odd>; look at it."], turntable=[np.zeros((12, 16, 3), np.uint8)] * 8,
        relief=[np.zeros((12, 16, 3), np.uint8)] * 4,
        evenness=Evenness(0.02, (PlaneEvenness(0.5, 0.61, 3.25, 11.5, 2.5),)),
        confidence=ConfidenceShares(0.613, 0.2, 0.1, 0.087), confidence_pictures=[np.zeros((12, 16, 3), np.uint8)] * 4,
        advice=["Take a photo of the <back>."], pixel="12 mm",
        contact_sheet=tmp_path / "sheet.png", files={"mesh": "mesh.ply"}, figures={"f1": np.float32(0.5)},
    )  # fmt: skip


class Page(HTMLParser):
    """Tags must nest; text and addresses are collected."""

    VOID = {"meta", "img", "br", "link", "input", "hr"}

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.sources: list[str] = []
        self.text = ""
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.sources += [value or "" for key, value in attrs if key in ("src", "href", "xlink:href")]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.sources += [value or "" for key, value in attrs if key in ("src", "href", "xlink:href")]

    def handle_endtag(self, tag: str) -> None:
        if tag not in self.VOID:
            assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


def test_page(data: ReportData, tmp_path: Path) -> None:
    _, path = write_report(tmp_path, data)
    html = path.read_text(encoding="utf-8")
    page = Page(html)
    for text in (
        "St. <Mary> & Söhne",
        "One photo is <odd>",
        "123\u202f456",
        "b.jpg",
        "2.10 GB",
        "4 min 02 s",
        "avx2",
        "11.5°",
        "61 %",
        "61.3 %",
        "Take a photo of the <back>.",
        "12 mm",
    ):
        assert text in page.text
    assert page.text.index("b.jpg") < page.text.index("a.jpg")  # held-out views come first
    pictures = [s for s in page.sources if s.startswith("data:")]
    assert len(pictures) == 6 + 8 + 4 + 4 + 1
    assert "cleaning" in page.text and "81.1 %" in page.text
    assert "80.0 ms" in page.text  # 120 s of backward in 1500 iterations
    for name in data.config:
        assert name in page.text


def test_a_warning_about_masks_leads_to_them(data: ReportData, tmp_path: Path) -> None:
    data.warnings = ["2 of 4 masks are weak and left out (a.jpg); look at the contact sheet."]
    assert 'href="#masks"' in write_report(tmp_path, data)[1].read_text(encoding="utf-8")
    assert "* photos with clicks" in Page(write_report(tmp_path, data)[1].read_text(encoding="utf-8")).text
    data.contact_sheet = None
    assert 'href="#masks"' not in write_report(tmp_path, data)[1].read_text(encoding="utf-8")


def test_what_was_not_trained_is_no_training_view(data: ReportData, tmp_path: Path) -> None:
    assert 'class="badge">training view' in write_report(tmp_path, data)[1].read_text(encoding="utf-8")
    data.iterations = 0
    assert 'class="badge">training view' not in write_report(tmp_path, data)[1].read_text(encoding="utf-8")


def test_page_needs_no_network(data: ReportData, tmp_path: Path) -> None:
    html = write_report(tmp_path, data)[1].read_text(encoding="utf-8")
    for source in Page(html).sources:
        assert source.startswith(("data:image/jpeg;base64,", "#", "mesh.ply"))
    assert "@import" not in html and "url(http" not in html
    assert not re.search(r"<(script|link|iframe)[^>]+(src|href)=", html)


def test_figures(data: ReportData, tmp_path: Path) -> None:
    figures = json.loads(write_report(tmp_path, data)[0].read_text(encoding="utf-8"), parse_constant=pytest.fail)
    held_out = [v["scores"]["psnr"] for v in figures["views"] if v["held_out"]]
    assert figures["held_out"]["psnr"] == pytest.approx(np.mean(held_out))
    assert figures["training"]["lpips"] is None
    assert figures["seconds"] == 241.5 and figures["seed"] == 0 and figures["figures"] == {"f1": 0.5}
    assert figures["evenness"]["planes"][0]["angle_90"] == figures["evenness"]["mean"]["angle_90"] == 11.5
    assert figures["confidence"] == {"agreed": 0.613, "plain": 0.2, "few": 0.1, "unseen": 0.087}
    assert figures["advice"] == ["Take a photo of the <back>."]
    assert figures["config"]["preset"] == "draft" and len(figures["views"]) == 4
    assert sorted(p.name for p in tmp_path.iterdir()) == ["report.html", "report.json", "sheet.png"]


def test_a_bare_report(tmp_path: Path) -> None:
    figures, page = write_report(tmp_path, ReportData("empty", "", {}))
    Page(page.read_text(encoding="utf-8"))
    assert json.loads(figures.read_text())["held_out"] is json.loads(figures.read_text())["evenness"] is None


def test_odd_values(data: ReportData, tmp_path: Path) -> None:
    data.figures = {
        "nan": float("nan"),
        "inf": np.inf,
        "array": np.arange(3),
        "path": Path("a"),
        "deep": [{"x": -np.inf}],
    }
    data.views[0].scores = score(np.zeros((9, 9, 3), np.uint8), np.ones((9, 9, 3), np.uint8), np.zeros((9, 9), bool))
    data.peak_memory, data.curve = None, data.curve[:1]
    figures, page = write_report(tmp_path, data)
    Page(page.read_text(encoding="utf-8"))
    assert json.loads(figures.read_text(), parse_constant=pytest.fail)["figures"] == {
        "nan": None, "inf": None, "array": [0, 1, 2], "path": "a", "deep": [{"x": None}],
    }  # fmt: skip


def test_a_missing_picture_leaves_the_old_report(data: ReportData, tmp_path: Path) -> None:
    write_report(tmp_path, data)
    before = (tmp_path / "report.html").read_bytes(), (tmp_path / "report.json").read_bytes()
    data.title = "new"
    data.turntable = [tmp_path / "none.png"]
    with pytest.raises(BadInput):
        write_report(tmp_path, data)
    assert ((tmp_path / "report.html").read_bytes(), (tmp_path / "report.json").read_bytes()) == before


def test_pictures_are_shrunk_not_enlarged() -> None:
    def size(address: str) -> tuple[int, ...]:
        raw = np.frombuffer(base64.b64decode(address.split(",")[1]), np.uint8)
        return cv2.imdecode(raw, cv2.IMREAD_COLOR).shape[:2]

    assert size(embed(np.zeros((900, 1600, 3), np.uint8))) == (360, 640)
    assert size(embed(np.zeros((9, 16, 3), np.uint8))) == (9, 16)


def test_curve() -> None:
    entries = [{"iteration": i, "psnr": 20.0, "gaussians": 10} for i in range(5)]
    svg = curve_svg(entries)
    assert svg.startswith("<svg ") and "currentColor" in svg and svg == curve_svg(entries)
    assert 'width="' not in svg.split(">")[0] and 'class="plot"' in svg.split(">")[0]
    assert curve_svg(entries[:1]) == ""
    values = np.arange(100.0)
    assert np.allclose(smoothed(values)[5:-5], values[5:-5]) and len(smoothed(values)) == 100


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0.049, "0.05 s"),
        (12.34, "12.3 s"),
        (59.97, "1 min 00 s"),
        (245.4, "4 min 05 s"),
        (7385, "2 h 03 min"),
        (None, "–"),
    ],
)
def test_durations(seconds: float | None, text: str) -> None:
    assert format_exact_duration(seconds) == text


def test_memory() -> None:
    assert [memory(n) for n in (5_300_000, 1_234_000_000, None)] == ["5 MB", "1.23 GB", "–"]


def test_pictures_wait_for_the_page_in_the_size_it_shows(monkeypatch) -> None:
    height, width = 900, 1600
    rgb = np.random.default_rng(0).integers(0, 255, (height, width, 3), dtype=np.uint8)
    view = SimpleNamespace(name="a.jpg", height=height, width=width)
    scene = SimpleNamespace(views=[view], held_out=(0,), photo=lambda index: rgb)
    masks = SimpleNamespace(labels=[np.ones((height, width), np.uint8)], used=np.array([True]))
    drawn = SimpleNamespace(
        color=torch.rand(3, height, width), normal=torch.rand(3, height, width), alpha=torch.ones(height, width)
    )
    monkeypatch.setattr(job_report, "render_view", lambda *given: drawn)
    monkeypatch.setattr(job_report, "shaded", lambda *given, **how: rgb)
    report = job_report._view_report(0, job_report.JobResults(scene, masks, None, None), 0, True)
    monkeypatch.setattr(job_report, "draw_textured", lambda *given: (rgb, None))
    quality = job_report._show_texture(None, None, scene, masks, [report])
    assert quality is not None and quality > 40  # in full size: the same picture
    assert report.scores is not None
    assert len(report.pictures) == 7
    for caption, picture in report.pictures.items():
        assert picture.shape == (360, 640, 3), caption


def test_a_field_that_was_not_trained_is_not_shown(monkeypatch) -> None:
    rgb = np.zeros((30, 40, 3), np.uint8)
    scene = SimpleNamespace(views=[SimpleNamespace(name="a.jpg")], held_out=(0,), photo=lambda index: rgb)
    masks = SimpleNamespace(labels=[np.ones((30, 40), np.uint8)], used=np.array([True]))
    monkeypatch.setattr(job_report, "shaded", lambda *given, **how: rgb)
    report = job_report._view_report(0, job_report.JobResults(scene, masks, None, None), None, True)
    assert [*report.pictures] == ["photo", "mask", "mesh"] and report.scores is None
