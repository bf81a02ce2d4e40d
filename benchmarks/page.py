# SPDX-License-Identifier: GPL-3.0-or-later
"""Pages of results, filled in from the templates beside this file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jinja2

from mgf_engine.files.atomic import atomic_path


def write_html(template: str, path: Path, **values: Any) -> Path:
    """Fill a template and write it to ``path`` at once or not at all; returns ``path``."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("benchmarks", "."), autoescape=True, undefined=jinja2.StrictUndefined
    )
    html = environment.get_template(template).render(**values)
    with atomic_path(path) as temporary:
        temporary.write_text(html, encoding="utf-8")
    return path
