# SPDX-License-Identifier: GPL-3.0-or-later
"""The tables of a suite in a document: written by the command that measured them, with commit, machine and CPU seconds.

A table stands between two marks and takes the place of what stood there before; the text around it is left alone.
"""

from __future__ import annotations

import itertools
import os
import re
import textwrap
from collections.abc import Sequence
from pathlib import Path
from statistics import mean
from typing import Any

from benchmarks.measure import SAMPLES, THRESHOLDS
from mgf_engine.errors import BadInput
from mgf_engine.files.atomic import atomic_path

Row = dict[str, Any]
#: Meshes of whole photos are cut to the building's box before they are scored; beside them, all meshes are.
BOXED = "F1 in the building's box"
UNKNOWN = "–"
COLUMNS = (
    "setting", "seeds", "F1 at 5 / 10 / 20 cm", BOXED, "accuracy / completeness at 5 cm", "PSNR", "SSIM", "LPIPS",
    "Gaussians", "CPU s", "MB", "commit",
)  # fmt: skip


def write_table(
    document: Path, suite: str, title: str, rows: Sequence[Row], further: Sequence[str] = (), chart: Path | None = None
) -> None:
    """Put the suite's tables, one per scene, into the document.

    Args:
        title: what the suite measures.
        rows: as :func:`benchmarks.measure.measure` makes them; those without scores are named as failed.
        further: words of the command that the rows do not tell.
        chart: a picture that was drawn of the same rows; it stands above the tables.

    Raises:
        BadInput: the document cannot be read or written, or there is nothing to put into it.
    """
    done = [row for row in rows if "geometry" in row]
    if not done:
        raise BadInput(f"No run of suite '{suite}' has a result yet, so '{document}' was left as it is.")
    begin, end = f"<!-- mgf bench {suite}: begin -->", f"<!-- mgf bench {suite}: end -->"
    lines = _lines(suite, title, rows, done, further)
    if chart is not None:
        place = os.path.relpath(chart, document.parent).replace(os.sep, "/")
        lines[2:2] = [f"![{title[:1].upper()}{title[1:]}]({place})", ""]
        lines[-1] += f" The picture: `--chart docs/{place}`."
    block = "\n".join([begin, "", *lines, end])
    try:
        text = document.read_text(encoding="utf-8")
        found = re.search(re.escape(begin) + r".*?" + re.escape(end), text, re.DOTALL)
        if found:
            text = text[: found.start()] + block + text[found.end() :]
        else:
            text = text.rstrip("\n") + "\n\n" + block + "\n"
        with atomic_path(document) as temporary:
            temporary.write_text(text, encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise BadInput(f"Cannot write the table into '{document}' ({error}); name a Markdown file.") from error


def _lines(suite: str, title: str, rows: Sequence[Row], done: list[Row], further: Sequence[str]) -> list[str]:
    lines = [f"## {title[:1].upper()}{title[1:]}", ""]
    several = len({row.get("commit") for row in done}) > 1
    for scene in dict.fromkeys(row["scene"] for row in done):
        mine = [row for row in done if row["scene"] == scene]
        lines += [f"### `{Path(scene).name}`", "", *_table(mine, several), ""]
    failed = dict.fromkeys(f"{r['variant']} on `{Path(r['scene']).name}`: {r['failed']}" for r in rows if "failed" in r)
    lines += [f"Failed: {text}" for text in failed]
    return [*lines, _origin(suite, done, further)]


def _table(rows: list[Row], commits: bool) -> list[str]:
    """The table of one scene, without what no row knows, and without the box where no mesh is of whole photos.

    Args:
        rows: of the scene.
        commits: whether each row names its commit, since not all of the suite are of one.
    """
    boxed = any(r.get("whole_picture") for r in rows) and all("in_box" in r for r in rows)
    names = dict.fromkeys(row["variant"] for row in rows)
    table = [COLUMNS, *(_cells(name, [r for r in rows if r["variant"] == name]) for name in names)]
    chosen = {BOXED: boxed, "commit": commits}
    kept = [chosen.get(name, any(cells[place] != UNKNOWN for cells in table[1:])) for place, name in enumerate(COLUMNS)]
    shown = [list(itertools.compress(cells, kept)) for cells in table]
    lines = ["| " + " | ".join(cells) + " |" for cells in shown]
    return [lines[0], "|---" * len(shown[0]) + "|", *lines[1:]]


def _origin(suite: str, done: list[Row], further: Sequence[str]) -> str:
    """Which command, commit and machine the figures are of."""
    measured = _measured([row for row in done if "commit" in row])
    options = [row["options"] for row in done if row.get("options")]  # other tools have none
    names = sorted({name for given in options for name in given})
    same = {n: options[0].get(n) for n in names if len({str(given.get(n)) for given in options}) == 1}
    given = " ".join(f"--set {name}={value}" for name, value in same.items() if name != "preset")
    scenes = " ".join(dict.fromkeys(Path(row["scene"]).name for row in done))
    seeds = len({row["seed"] for row in done})
    repeated = f"--seeds {seeds}" if seeds > 1 else ""
    sampled = " ".join(f"--samples {n}" for n in sorted({row.get("samples", SAMPLES) for row in done} - {SAMPLES}))
    command = " ".join(f"mgf bench {suite} --scenes {scenes} {repeated} {' '.join(further)} {given} {sampled}".split())
    text = f"`{command} --write docs/results.md`: {measured}. Means over the seeds, ± half their spread."
    return textwrap.fill(text, 120, break_long_words=False, break_on_hyphens=False)


def _measured(rows: list[Row]) -> str:
    """Commit, dates and machines; where commits differ, each row of the table names its own."""
    commits = dict.fromkeys(row["commit"] for row in rows)
    days = sorted({row["date"] for row in rows})
    when = " to ".join(dict.fromkeys([*days[:1], *days[-1:]]))
    machines = " and ".join(dict.fromkeys(row["machine"] for row in rows))
    commit = f"commit {next(iter(commits))}" if len(commits) == 1 else "commits as the rows name them"
    return f"{commit}, {when}, {machines}"


def _cells(name: str, rows: list[Row]) -> list[str]:
    def of(key: str, threshold: float, scores: str = "geometry") -> list[float]:
        values = (row[scores] for row in rows)
        return [float(v[key][v["thresholds"].index(threshold)]) for v in values]

    f1 = " / ".join(_spread(of("f1", t)) for t in THRESHOLDS)
    known = all("in_box" in row for row in rows)
    boxed = " / ".join(_spread(of("f1", t, "in_box")) for t in THRESHOLDS) if known else UNKNOWN
    near = " / ".join(f"{mean(of(key, THRESHOLDS[0])):.1f}" for key in ("accuracy", "completeness"))
    return [
        name, str(len(rows)), f1, boxed, near, _average(rows, "psnr", "{:.2f}"), _average(rows, "ssim", "{:.3f}"),
        _average(rows, "lpips", "{:.3f}"), _average(rows, "gaussians", "{:,.0f}"),
        _average(rows, "cpu_seconds", "{:.0f}"), _average(rows, "peak_memory", "{:.0f}", 1e-6),
        ", ".join(dict.fromkeys(str(row["commit"]) for row in rows if "commit" in row)) or UNKNOWN,
    ]  # fmt: skip


def _spread(values: list[float]) -> str:
    return f"{mean(values):.1f}" + (f" ±{(max(values) - min(values)) / 2:.1f}" if len(values) > 1 else "")


def _average(rows: list[Row], key: str, form: str, factor: float = 1.0) -> str:
    values = [float(row[key]) for row in rows if row.get(key) is not None]
    return form.format(factor * mean(values)) if values else UNKNOWN
