# SPDX-License-Identifier: GPL-3.0-or-later
"""The models' section of a job's report: how far each model lies from the mesh."""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import Any

from mgf_engine.files.html_section import replace_section
from mgf_engine.models.work import Work

MARKS = "<!-- models -->", "<!-- /models -->"


def add_to_report(page: Path, work: Work) -> None:
    """Put the section into a finished report, in the place of an earlier one; nothing where there is no report."""
    if page.is_file():
        replace_section(page, models_html(work), *MARKS)


def models_html(work: Work) -> str:
    """Return the section, between the marks by which a later one finds it."""
    factor, unit = (100, "cm") if work.survey.georeference.metric else (1, work.survey.unit)
    heads = ["File", "Faces", f"RMS ({unit})", f"90 % below ({unit})", f"95 % below ({unit})", "Notes"]
    rows = ["".join(f'<th class="{"" if k in (0, 5) else "number"}">{head}</th>' for k, head in enumerate(heads))]
    for name, facts in work.files.items():
        deviation = facts.get("deviation") or {}
        lengths = [f"{factor * deviation[key]:.3g}" if key in deviation else "" for key in ("rms", "p90", "p95")]
        numbers = "".join(f'<td class="number">{text}</td>' for text in (facts.get("faces", ""), *lengths))
        link = f'<a href="models/{escape(name)}">{escape(name)}</a>'
        rows.append(f'<td>{link}</td>{numbers}<td class="soft">{escape(_note(facts))}</td>')
    table = "\n".join(f"<tr>{row}</tr>" for row in rows)
    text = "Distances of levels of detail are to the full mesh, on both surfaces; of solids from the mesh to the solid."
    head = '<h2>Models</h2>\n<div class="card">\n<table>\n'
    return f'{MARKS[0]}\n{head}{table}\n</table>\n<p class="soft">{text}</p>\n</div>\n{MARKS[1]}'


def _note(facts: dict[str, Any]) -> str:
    """Return the last column of the table: what matters most about a file of its kind."""
    if facts["kind"] == "lod":
        return f"outline overlaps by {100 * facts['silhouette']:.1f} %"
    if "unseen" in facts:
        unseen = ", ".join(f"{100 * share:.0f} % of the {kind}" for kind, share in facts["unseen"].items())
        return f"LoD{facts['lod']}; not seen by photos: {unseen}"
    if facts["kind"] == "points":
        return f"{facts['points']} points"
    return ""
