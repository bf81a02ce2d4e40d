# SPDX-License-Identifier: GPL-3.0-or-later
"""``mgf bench stability``: the failure map. One thing at a time gets worse; F1 and PSNR follow, with masks and without.

Most rows make a copy of one scene worse; some need scenes of their own, which are rendered when they are asked for.

Every run is a process of its own. Results are kept as ``OUT/results/<key>.json`` and not made again, so the map may be
made in pieces (``--only``) and is drawn from whatever is there.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from benchmarks.arguments import count, engine_options, results_folder
from benchmarks.catalogue import SCENES, SceneSpec, spec_dict
from benchmarks.features import NoModel
from benchmarks.measure import Prepared, f1_at, measure, prepare_folder, prepare_scene
from benchmarks.perturb import PERTURBATIONS, RECORD, Perturbation, perturb
from benchmarks.scene_series import SERIES, Series
from benchmarks.scenes import make_scene
from benchmarks.suites import Options, Run
from mgf_engine.cli.arguments import Parser
from mgf_engine.errors import EXIT_BAD_INPUT, EXIT_DONE, EXIT_FAULT, BadInput
from mgf_engine.files.atomic import write_json
from mgf_engine.options.user_input import option_pairs

Row = dict[str, Any]
#: Every row of the map by name.
ROWS: dict[str, Perturbation | Series] = {**PERTURBATIONS, **SERIES}
#: Small enough that a run takes less than a minute of one core.
SMALL: Options = {
    "preset": "draft", "resolution": 240, "iterations": 300, "max_gaussians": 8_000, "second_level": "off",
    "texture": False, "sh_degree": 1, "refine_rounds": 0,
}  # fmt: skip
#: Where the F1 of the curves is taken, metres.
DISTANCE = 0.10
#: Shares of the undisturbed F1: kept well, and useless.
KEPT, USELESS = 0.9, 0.5
MODES = ("masks", "no masks")


def stability_main(argv: Sequence[str]) -> int:
    """Entry point of ``mgf bench stability``; returns the exit code (1 when a run ended in a fault)."""
    from benchmarks.stability_charts import write_page

    args = _parser().parse_args(argv)
    wanted = list(_runs(_chosen(args.only), args.modes, args.levels, args.seeds))
    if not wanted:
        raise BadInput("No perturbation has one of these levels; 'mgf bench stability --help' lists them.")
    engine_options(args.set)
    results_folder(args.out)
    source = prepare_scene(args.scene)
    rows: list[Row] = []
    for name, level, mode, seed in wanted:
        row = _row(args, source, name, level, mode, seed)
        if row is not None:
            rows.append(row)
            print(describe(row), flush=True)
    for line in spreads(rows):
        print(line)
    write_json(args.out / "stability.json", rows)
    page = write_page(summarise(rows), args.out)
    faults = [row for row in rows if row.get("code") not in (None, EXIT_BAD_INPUT)]
    print(f"{len(rows)} rows, {len(faults)} faults; page: {page}")
    return EXIT_FAULT if faults else EXIT_DONE


def _parser() -> Parser:
    names = "\n".join(f"  {name:<16} {p.title}: {', '.join(f'{v:g}' for v in p.levels)} {p.unit}"
                      for name, p in ROWS.items())  # fmt: skip
    parser = Parser(
        prog="mgf bench stability", formatter_class=argparse.RawDescriptionHelpFormatter,
        description="Where the method breaks: F1 and PSNR as one thing gets worse.", epilog=f"perturbations:\n{names}",
    )  # fmt: skip
    parser.add_argument("--out", type=Path, default=Path("bench/stability"), help="folder of results and the page")
    parser.add_argument("--scene", default="demo", help="name or folder of a synthetic scene (default demo)")
    parser.add_argument("--other", type=Path, help="another scene, whose photos stand for 'another place'")
    parser.add_argument("--only", nargs="+", default=[], metavar="NAME", help="only these perturbations")
    parser.add_argument("--levels", nargs="+", type=float, default=[], help="only these levels")
    parser.add_argument("--modes", nargs="+", choices=MODES, default=list(MODES), help="with masks, without, or both")
    parser.add_argument("--seeds", type=count, default=1, help="runs per level")
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="option given to every run")
    parser.add_argument("--samples", type=count, default=60_000, help="points sampled on each mesh")
    parser.add_argument("--label", default="", help="part of every run's key: measure again under a new label")
    parser.add_argument("--page-only", action="store_true", help="draw the page from the results that are there")
    return parser


def _chosen(only: Sequence[str]) -> list[str]:
    unknown = [name for name in only if name not in ROWS]
    if unknown:
        raise BadInput(f"There is no perturbation '{unknown[0]}'; take some of {', '.join(ROWS)}.")
    return list(only) or list(ROWS)


def _runs(
    names: Sequence[str], modes: Sequence[str], levels: Sequence[float], seeds: int
) -> Iterator[tuple[str, float, str, int]]:
    """What is measured, in order; masks that are given wrong mean nothing to runs without masks."""
    for name in names:
        entry = ROWS[name]
        for level in entry.levels:
            for mode in modes:
                if (levels and level not in levels) or (mode == "no masks" and name.startswith("masks_")):
                    continue
                for seed in range(seeds):
                    yield name, level, mode, seed


@dataclass(frozen=True)
class _Case:
    """One run of the map: what it is, what its result depends on besides, and what makes its scene.

    ``scene`` takes the folder to make it in; a scene that is rendered lies in the cache instead.
    """

    run: Run
    depends: list[Any]
    scene: Callable[[Path], Prepared]


def _row(args: argparse.Namespace, source: Prepared, name: str, level: float, mode: str, seed: int) -> Row | None:
    """The result of one run: an earlier one, or made now; None when it is missing and nothing is to be made."""
    entry = ROWS[name]
    options = {**SMALL, **option_pairs(args.set), **({"use_masks": False} if mode == "no masks" else {})}
    if isinstance(entry, Series):
        case = _rendered(entry, options, name, level, mode, seed)
    else:
        case = _copied(args.other, source, options, name, level, mode, seed)
    key = case.run.key(json.dumps([args.label, args.samples, *case.depends]))
    path = args.out / "results" / f"{key}.json"
    if path.exists():
        row = json.loads(path.read_text(encoding="utf-8"))
    elif args.page_only:
        return None
    else:
        row = _measured(args, case, path)
    if isinstance(entry, Series) and entry.by_pixel and "geometry" in row:
        row["threshold"] = round(2 * row["ground_pixel"], 4)
    return {**row, "name": name, "level": level, "mode": mode}


def _copied(
    other: Path | None, source: Prepared, options: Options, name: str, level: float, mode: str, seed: int
) -> _Case:
    """A run on a copy of the scene that was made worse."""
    entry = PERTURBATIONS[name]
    undisturbed = level == entry.levels[0]
    what = "undisturbed" if undisturbed else f"{name} {level:g}"  # one run serves all perturbations
    kind = "true" if entry.masks == "given" and mode == "masks" else "prompts"
    elsewhere = other.name if other and name == "foreign" and not undisturbed else ""

    def scene(folder: Path) -> Prepared:
        perturb(source.folder, folder, name, level, seed, other)
        return _of_copy(source, folder)

    return _Case(Run(f"{what}, {mode}", source.folder.name, options, seed, kind), [what, elsewhere], scene)


def _rendered(entry: Series, options: Options, name: str, level: float, mode: str, seed: int) -> _Case:
    """A run on a scene of its own."""
    own = entry.scenes[level]
    run = Run(f"{name} {level:g}, {mode}", name, {**options, **own.options}, seed, entry.masks)
    return _Case(
        run, [spec_dict(own.spec)], lambda _: prepare_folder(make_scene(_scene_name(own.spec, name), own.spec))
    )


def _scene_name(spec: SceneSpec, series: str) -> str:
    """A name for the cache; a scene of the catalogue is not rendered twice."""
    return next((name for name, known in SCENES.items() if known == spec), f"stability_{series}")


def _measured(args: argparse.Namespace, case: _Case, path: Path) -> Row:
    """Measure and keep the result; faults are not kept: they are to be mended and tried again."""
    folder = args.out / "scenes" / path.stem
    try:
        row = measure(case.run, case.scene(folder), args.out / "jobs" / path.stem, args.samples, keep_job=False)
    except NoModel as error:
        row = {"seed": case.run.seed, "cpu_seconds": 0.0, "code": EXIT_BAD_INPUT, "failed": str(error)}
    if folder.exists():
        shutil.rmtree(folder)
    if outcome(row) != "fault":
        path.parent.mkdir(parents=True, exist_ok=True)
        write_json(path, row)
    return row


def _of_copy(source: Prepared, folder: Path) -> Prepared:
    """The perturbed copy, scored with the original's cameras and masks."""
    record = json.loads((folder / RECORD).read_text(encoding="utf-8"))
    return replace(source, folder=folder.resolve(), scale=record["scale"], offset=tuple(record["offset"]))


def f1_of(row: Row) -> float:
    """F1 in percent at :data:`DISTANCE` (or the row's own); 0 for a run that was refused or failed."""
    if "geometry" not in row:
        return 0.0
    return f1_at(row, row.get("threshold", DISTANCE))


def outcome(row: Row) -> str:
    """How a run ended: ``fault``, ``refused``, ``warned`` or ``silent``."""
    if "geometry" in row:
        value = f1_of(row)
        if not math.isfinite(value):
            return "fault"
        return "warned" if row.get("warnings") else "silent"
    return "refused" if row.get("code") == EXIT_BAD_INPUT else "fault"


def describe(row: Row) -> str:
    """One line for the terminal."""
    text = row.get("failed") or " ".join(row.get("warnings", []))
    psnr = row.get("psnr")
    return (
        f"{row['name']:<16} {row['level']:<7g} {row['mode']:<9} F1 {f1_of(row):5.1f}  "
        f"PSNR {'-' if psnr is None else f'{psnr:.1f}'}  {row['cpu_seconds']:4.0f} CPU s  {outcome(row)}  {text[:150]}"
    )


def spreads(rows: Sequence[Row]) -> list[str]:
    """A line for each level that several seeds measured: range and spread of F1 and PSNR."""
    lines = []
    for place in dict.fromkeys((row["name"], row["level"], row["mode"]) for row in rows):
        mine = [row for row in rows if (row["name"], row["level"], row["mode"]) == place]
        if len(mine) < 2:
            continue
        parts = []
        for title, values in (("F1", [f1_of(r) for r in mine]), ("PSNR", [r["psnr"] for r in mine if r.get("psnr")])):
            if values:
                low, high = min(values), max(values)
                parts.append(f"{title} {low:.2f} .. {high:.2f}, spread {high - low:.2f}")
        lines.append(f"{place[0]} {place[1]:g} {place[2]}, {len(mine)} seeds: {'; '.join(parts)}")
    return lines


def summarise(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Per perturbation: the curves (means over seeds) and at which level each becomes useless.

    Returns:
        dicts with ``name``, ``entry`` (of :data:`ROWS`), ``curves``: mode -> list of points (``level``, ``f1``,
        ``share`` of the undisturbed F1, ``psnr``, ``outcome``, ``text``), ``useless`` and ``kept``: mode -> level (None
        where the curve stays above).
    """
    result = []
    for name in dict.fromkeys(row["name"] for row in rows):
        entry = ROWS[name]
        curves = {mode: _curve([r for r in rows if r["name"] == name and r["mode"] == mode], entry) for mode in MODES}
        curves = {mode: curve for mode, curve in curves.items() if curve}
        result.append({
            "name": name, "entry": entry, "curves": curves,
            "useless": {mode: crossing(curve, USELESS) for mode, curve in curves.items()},
            "kept": {mode: crossing(curve, KEPT) for mode, curve in curves.items()},
        })  # fmt: skip
    return result


def _curve(rows: Sequence[Row], entry: Perturbation | Series) -> list[dict[str, Any]]:
    points: list[dict[str, Any]] = []
    for level in entry.levels:
        mine = [row for row in rows if row["level"] == level]
        if not mine:
            continue
        psnr = [row["psnr"] for row in mine if row.get("psnr") is not None]
        texts = [row.get("failed") or " ".join(row.get("warnings", [])) for row in mine]
        worst = max(mine, key=lambda row: ("silent", "warned", "refused", "fault").index(outcome(row)))
        points.append({
            "level": level, "f1": sum(map(f1_of, mine)) / len(mine), "psnr": sum(psnr) / len(psnr) if psnr else None,
            "outcome": outcome(worst), "text": next((t for t in texts if t), ""),
        })  # fmt: skip
    whole = points[0]["f1"] if points and points[0]["level"] == entry.levels[0] else None
    for point in points:
        point["share"] = point["f1"] / whole if whole else None
    return points


def crossing(curve: Sequence[dict[str, Any]], share: float) -> float | None:
    """The level at which the curve first falls below this share of its start, between two levels linearly; or None."""
    for before, after in itertools.pairwise(curve):
        if after["share"] is None:
            return None
        if after["share"] < share:
            part = (before["share"] - share) / (before["share"] - after["share"])
            return float(before["level"] + part * (after["level"] - before["level"]))
    return None
