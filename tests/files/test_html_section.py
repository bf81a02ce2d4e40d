# SPDX-License-Identifier: GPL-3.0-or-later
"""A section of a finished page is added once and replaced from then on; all around it stays."""

from __future__ import annotations

from pathlib import Path

from mgf_engine.files.html_section import replace_section

BEGIN, END = "<!-- lines -->", "<!-- /lines -->"


def test_a_section_is_added_before_the_end_of_the_page_and_replaced(tmp_path: Path) -> None:
    page = tmp_path / "report.html"
    page.write_text("<main>\n<h1>Über</h1>\n</main>\n<footer>", encoding="utf-8")
    for html in (f"{BEGIN}one{END}", f"{BEGIN}two\nlines{END}", f"{BEGIN}{END}"):
        replace_section(page, html, BEGIN, END)
        assert page.read_text(encoding="utf-8") == f"<main>\n<h1>Über</h1>\n{html}\n</main>\n<footer>"


def test_other_sections_stay(tmp_path: Path) -> None:
    page = tmp_path / "report.html"
    page.write_text(f"<main>{BEGIN}old{END}<b>kept</b></main>", encoding="utf-8")
    replace_section(page, "<!-- solid -->s<!-- /solid -->", "<!-- solid -->", "<!-- /solid -->")
    replace_section(page, f"{BEGIN}new{END}", BEGIN, END)
    text = page.read_text(encoding="utf-8")
    assert text == f"<main>{BEGIN}new{END}<b>kept</b><!-- solid -->s<!-- /solid -->\n</main>"
