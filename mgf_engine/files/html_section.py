# SPDX-License-Identifier: GPL-3.0-or-later
"""Sections of finished HTML pages that a later run replaces, such as those of drawings and models in a job's report."""

from __future__ import annotations

from pathlib import Path

from mgf_engine.files.atomic import atomic_path


def replace_section(page: Path, html: str, begin: str, end: str) -> None:
    """Put a new section into a finished page, in the place of the old one; before its end where it has none.

    Args:
        page: the HTML file.
        html: from its mark ``begin`` to its mark ``end``, by which the next one finds it.
        begin: mark at the section's beginning.
        end: mark at its end.
    """
    text = page.read_text(encoding="utf-8")
    first, last = text.find(begin), text.find(end)
    if first < 0 or last < first:
        first = last = text.rfind("</main>")
        html, last = html + "\n", last - len(end)
    with atomic_path(page) as temporary:
        temporary.write_text(text[:first] + html + text[last + len(end) :], encoding="utf-8")
