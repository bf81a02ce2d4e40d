# SPDX-License-Identifier: GPL-3.0-or-later
"""The report of a job: ``report.json`` for programs and ``report.html``, one file without a network, for people.

The caller fills a :class:`ReportData`; nothing is computed here but means and shares. Pictures are embedded, so that
the page can be moved or sent as it is.
"""

from __future__ import annotations

import base64
import math
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.evaluation.curve import curve_svg
from mgf_engine.evaluation.evenness import Evenness
from mgf_engine.evaluation.images import Scores, mean_scores
from mgf_engine.evaluation.lpips import how_to_get
from mgf_engine.evaluation.pictures import ERROR_LIMIT
from mgf_engine.files.atomic import atomic_path, write_json
from mgf_engine.files.images import read_rgb
from mgf_engine.mesh.confidence import ConfidenceShares

FORMAT = 1
#: Longest side and JPEG quality of embedded pictures; a view's six pictures take about 250 kB.
_PICTURE_SIDE, _QUALITY = 640, 82
_CONTACT_SIDE = 1600

Picture = NDArray[np.uint8] | Path


@dataclass
class ViewReport:
    """One photo and what was made of it.

    Attributes:
        name: the photo's name.
        held_out: kept out of training; the headline figures are means over these views.
        scores: None when nothing was rendered or the mask is empty.
        pictures: caption -> RGB uint8 [h, w, 3] or a picture file, in the order they are shown; may be empty for a
            view that only appears in the table.
        note: one short remark, such as why the mask was not used.
    """

    name: str
    held_out: bool
    scores: Scores | None = None
    pictures: dict[str, Picture] = field(default_factory=dict)
    note: str = ""


@dataclass
class StageReport:
    """One stage's cost: seconds of wall and of CPU time, ``peak_memory`` in bytes of it and its workers, or None."""

    name: str
    seconds: float
    peak_memory: int | None = None
    cpu_seconds: float | None = None


@dataclass
class ReportData:
    """Everything the report says, as plain data.

    Attributes:
        title: the scene's name.
        command: the command line that makes this result again.
        config: every option, name -> value.
        user_options: the options the user gave (shown apart from the defaults).
        views: all photos; held-out ones with pictures first in the page.
        counts: what was counted, label -> number, in the order shown (photos, points, masked points, Gaussians,
            vertices, faces ...).
        stages: cost per stage, in order.
        iterations: training iterations done.
        seconds_per_part: part of a training iteration -> seconds over the whole run.
        mesh_seconds_per_part: part of the mesh stage -> seconds.
        curve: training curve; entries with ``iteration``, ``psnr``, ``gaussians`` and anything else.
        curve_drawing: what :func:`mgf_engine.evaluation.curve.curve_svg` makes of it, where that was drawn before.
        versions: name -> version of Python, system and packages.
        machine: label -> text (processor, cores, memory, device).
        kernel: the kernel variant that ran.
        peak_memory: bytes, of the whole job.
        warnings: sentences the user should read.
        turntable: RGB pictures of the mesh from all around.
        relief: pictures of it from fewer sides, without colours and lit from the side.
        evenness: its largest planes and how even they are, or None.
        confidence: shares of its area by how well photos confirm them, or None.
        confidence_pictures: pictures of it coloured by confidence.
        advice: sentences on what would make the next mesh better.
        pixel: what a pixel of the working photos covers on the building, as text; empty where nobody knows.
        contact_sheet: picture of all masks, or None.
        lpips: the network that LPIPS was measured with; empty where it was not.
        surface_source: what placed the surface, in three sentences.
        files: label -> path of a result, relative to the job folder.
        figures: further figures that only go into ``report.json``.
        georeference: where the building is, plain data for ``report.json``; ``georeference_html`` says it in the page.
    """

    title: str
    command: str
    config: dict[str, Any]
    user_options: dict[str, Any] = field(default_factory=dict)
    views: list[ViewReport] = field(default_factory=list)
    counts: dict[str, float] = field(default_factory=dict)
    stages: list[StageReport] = field(default_factory=list)
    iterations: int = 0
    seconds_per_part: dict[str, float] = field(default_factory=dict)
    mesh_seconds_per_part: dict[str, float] = field(default_factory=dict)
    curve: list[dict[str, Any]] = field(default_factory=list)
    curve_drawing: str | None = None
    versions: dict[str, str] = field(default_factory=dict)
    machine: dict[str, str] = field(default_factory=dict)
    kernel: str = ""
    peak_memory: int | None = None
    warnings: list[str] = field(default_factory=list)
    turntable: list[Picture] = field(default_factory=list)
    relief: list[Picture] = field(default_factory=list)
    evenness: Evenness | None = None
    confidence: ConfidenceShares | None = None
    confidence_pictures: list[Picture] = field(default_factory=list)
    advice: list[str] = field(default_factory=list)
    pixel: str = ""
    contact_sheet: Path | None = None
    lpips: str = ""
    surface_source: list[str] = field(default_factory=list)
    files: dict[str, str] = field(default_factory=dict)
    figures: dict[str, Any] = field(default_factory=dict)
    georeference: dict[str, Any] = field(default_factory=dict)
    georeference_html: str = ""


def write_report(folder: Path, data: ReportData) -> tuple[Path, Path]:
    """Write ``report.json`` and ``report.html`` into the job folder, each at once or not at all.

    Raises:
        OSError: the folder cannot be written.
        BadInput: a picture given as a file cannot be read.
    """
    figures, page = folder / "report.json", folder / "report.html"
    html = _render(data)
    write_json(figures, report_figures(data))
    with atomic_path(page) as temporary:
        temporary.write_text(html, encoding="utf-8")
    return figures, page


def report_figures(data: ReportData) -> dict[str, Any]:
    """Return the content of ``report.json``: every figure of the page, no pictures; numbers are finite or null.

    Keys: ``format, title, command, seed, config, given, held_out`` and ``training`` (mean scores), ``views`` (scores
    per view), ``counts, stages, seconds, iterations, seconds_per_part, mesh_seconds_per_part, curve, versions, machine,
    kernel, peak_memory, warnings, advice, files, figures, evenness, confidence, georeference``.
    """
    held_out, training = _means(data)
    result = {
        "format": FORMAT, "title": data.title, "command": data.command, "seed": data.config.get("seed"),
        "config": data.config, "given": data.user_options,
        "held_out": asdict(held_out) if held_out else None, "training": asdict(training) if training else None,
        "views": [
            {"name": v.name, "held_out": v.held_out, "note": v.note, "scores": asdict(v.scores) if v.scores else None}
            for v in data.views
        ],
        "counts": data.counts, "stages": [asdict(s) for s in data.stages], "seconds": _total_seconds(data),
        "iterations": data.iterations, "seconds_per_part": data.seconds_per_part,
        "mesh_seconds_per_part": data.mesh_seconds_per_part, "curve": data.curve,
        "versions": data.versions, "machine": data.machine, "kernel": data.kernel, "peak_memory": data.peak_memory,
        "warnings": data.warnings, "advice": data.advice, "files": data.files, "figures": data.figures,
        "evenness": data.evenness.as_dict() if data.evenness else None,
        "confidence": asdict(data.confidence) if data.confidence else {},
        "georeference": data.georeference,
    }  # fmt: skip
    plain: dict[str, Any] = plain_data(result)
    return plain


def _render(data: ReportData) -> str:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("mgf_engine", "evaluation"), autoescape=True, undefined=StrictUndefined, trim_blocks=True,
        lstrip_blocks=True,
    )  # fmt: skip
    environment.filters.update(
        duration=format_exact_duration,
        memory=memory,
        score=_score_text,
        count=_count_text,
        value=_value_text,
    )
    held_out, training = _means(data)
    shown = sorted((v for v in data.views if v.pictures), key=lambda v: not v.held_out)
    return environment.get_template("report.html.j2").render(
        data=data, held_out=held_out, training=training,
        total=_total_seconds(data),
        stages=_bars([(s.name, s.seconds) for s in data.stages]),
        parts=_bars(sorted(data.seconds_per_part.items(), key=lambda p: -p[1])),
        mesh_parts=_bars(list(data.mesh_seconds_per_part.items())),
        shown=[(v, [(caption, embed(p)) for caption, p in v.pictures.items()]) for v in shown],
        turntable=[embed(p) for p in data.turntable],
        relief=[embed(p) for p in data.relief],
        confidence_pictures=[embed(p) for p in data.confidence_pictures],
        contact_sheet=embed(data.contact_sheet, _CONTACT_SIDE) if data.contact_sheet else "",
        captions={caption for v in shown for caption in v.pictures},
        trained=data.iterations > 0,
        curve=curve_svg(data.curve) if data.curve_drawing is None else data.curve_drawing,
        error_limit=round(255 * ERROR_LIMIT), how_to_get_lpips=how_to_get(),
    )  # fmt: skip


def embed(picture: Picture, side: int = _PICTURE_SIDE) -> str:
    """Return a picture as a ``data:`` address, shrunk to ``side`` pixels at most (never enlarged).

    Raises:
        ValueError: the picture has an unknown number of channels, or cannot be encoded.
    """
    image = limit_side(read_rgb(picture) if isinstance(picture, Path) else picture, side)
    bgr = cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2BGR)
    ok, encoded = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    if not ok:
        raise ValueError(f"Cannot encode a picture of shape {image.shape}")
    return "data:image/jpeg;base64," + base64.b64encode(encoded.tobytes()).decode("ascii")


def limit_side(image: NDArray[np.uint8], side: int = _PICTURE_SIDE) -> NDArray[np.uint8]:
    """Return a picture as the page shows it, ``side`` pixels at most (never enlarged)."""
    scale = min(1.0, side / max(image.shape[:2]))
    if scale == 1.0:
        return image
    size = (max(1, round(image.shape[1] * scale)), max(1, round(image.shape[0] * scale)))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


def format_exact_duration(seconds: float | None) -> str:
    """Return seconds as people say them: ``0.42 s``, ``12.3 s``, ``4 min 05 s``, ``2 h 03 min``."""
    if seconds is None:
        return "–"
    if seconds < 1:
        return f"{seconds:.2f} s"
    if seconds < 59.95:
        return f"{seconds:.1f} s"
    whole = round(seconds)
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"


def memory(count: int | None) -> str:
    """Return bytes as MB or GB (powers of ten)."""
    if count is None:
        return "–"
    return f"{count / 1e9:.2f} GB" if count >= 1e9 else f"{count / 1e6:.0f} MB"


def _means(data: ReportData) -> tuple[Scores | None, Scores | None]:
    """Average the scores of the held-out and of the training views; None where there are none."""
    groups = [[v.scores for v in data.views if v.scores and v.held_out is held_out] for held_out in (True, False)]
    held_out, training = (mean_scores(group) if group else None for group in groups)
    return held_out, training


def _total_seconds(data: ReportData) -> float:
    return sum(stage.seconds for stage in data.stages)


def _bars(rows: list[tuple[str, float]]) -> list[tuple[str, float, float, float]]:
    """Return name, seconds, share of the sum and share of the longest (the bar's length) of each row."""
    total, longest = sum(s for _, s in rows) or 1.0, max((s for _, s in rows), default=1.0) or 1.0
    return [(name, seconds, seconds / total, seconds / longest) for name, seconds in rows]


def plain_data(value: Any) -> Any:
    """Return only what JSON knows: numpy numbers become Python's, paths text, what is not finite null."""
    if isinstance(value, dict):
        return {str(k): plain_data(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain_data(v) for v in value]
    if isinstance(value, np.ndarray | np.generic):
        return plain_data(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, str | bool | int) else str(value)


def _score_text(value: float | None, digits: int) -> str:
    return "–" if value is None else f"{value:.{digits}f}"


def _count_text(value: float) -> str:
    return f"{value:,}".replace(",", "\u202f")


def _value_text(value: Any) -> str:
    if isinstance(value, bool):
        return "on" if value else "off"
    return f"{value:g}" if isinstance(value, float) else str(value) or "–"
