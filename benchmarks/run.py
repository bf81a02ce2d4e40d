# SPDX-License-Identifier: GPL-3.0-or-later
"""``mgf bench``: make scenes, run a suite, score every mesh against the truth, draw the page.

Every run is a process of its own (``python -m mgf_engine reconstruct``), so its time and memory are its own. A run
whose result is there already is not repeated: results lie in ``OUT/results/<key>.json``.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.arguments import count, engine_options, results_folder
from benchmarks.catalogue import SCENES, scene_spec
from benchmarks.measure import SAMPLES, SCORED, Prepared, measure, prepare_scene
from benchmarks.suites import PRINTED, SUITES, Run, SuiteSettings, half_of, suite_runs
from mgf_engine import __version__
from mgf_engine.cli.arguments import Parser
from mgf_engine.errors import EXIT_BAD_INPUT, EXIT_DONE, EXIT_FAULT, BadInput
from mgf_engine.files.atomic import write_json
from mgf_engine.options.config import make_config
from mgf_engine.options.user_input import named_values


def bench_main(argv: Sequence[str] | None = None) -> int:
    """Entry point of ``mgf bench``; returns the exit code."""
    args = list(sys.argv[1:] if argv is None else argv)
    try:
        if args[:1] == ["scenes"]:
            from benchmarks.scenes import scenes_main

            return scenes_main(args[1:])
        if args[:1] == ["masks"]:
            from benchmarks.masks import masks_main

            return masks_main(args[1:])
        if args[:1] == ["stability"]:
            from benchmarks.stability import stability_main

            return stability_main(args[1:])
        return _run_suite(_parser().parse_args(args))
    except BadInput as error:
        print(f"Error: {error}", file=sys.stderr)
        return EXIT_BAD_INPUT


def _parser() -> Parser:
    lines = "\n".join(f"  {name:<13} {text}" for name, text in SUITES.items())
    parser = Parser(
        prog="mgf bench",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        description="Measure the engine on scenes with known truth.",
        epilog=f"suites:\n{lines}\n  scenes      make a scene: 'mgf bench scenes --help'\n"
        "  masks         score the masks alone: 'mgf bench masks --help'\n"
        "  stability     where the method breaks: 'mgf bench stability --help'",
    )
    parser.add_argument("suite", choices=sorted(SUITES), help="what to measure", metavar="SUITE")
    parser.add_argument("--out", type=Path, default=Path("bench"), help="folder of jobs, results and the page")
    parser.add_argument("--scenes", nargs="+", default=[], help="instead of the suite's scenes: names or folders")
    parser.add_argument(
        "--half", choices=("tuning", "held-out"), help="only the suite's scenes for tuning, or those for reporting only"
    )
    parser.add_argument("--photos", type=int, help="fewer photos per scene")
    parser.add_argument("--width", type=int, help="width of the rendered photos in pixels")
    parser.add_argument("--seeds", type=count, default=1, help="runs per variant")
    parser.add_argument(
        "--paper-iterations", type=count, default=PRINTED, metavar="N",
        help=f"training of the paper's setting and of its peers, instead of {PRINTED:,} iterations",
    )  # fmt: skip
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="option given to every run")
    parser.add_argument("--only", nargs="+", default=[], help="only variants with one of these words in their name")
    parser.add_argument("--masks", choices=("prompts", "true"), default="prompts", help="from clicks, or the true ones")
    parser.add_argument("--poses", choices=("sfm", "true"), default="sfm", help="cameras: found, or the true ones")
    parser.add_argument(
        "--external", action="append", default=[], metavar="NAME=COMMAND",
        help="another tool for suites peers, surfaces and pareto; {images}, {scene}, {work} and {mesh} are filled in",
    )  # fmt: skip
    parser.add_argument("--samples", type=count, default=SAMPLES, help="points sampled on each mesh")
    parser.add_argument("--label", default="", help="part of every run's key: measure the same again under a new label")
    parser.add_argument("--keep-jobs", action="store_true", help="keep the whole job folders, not only mesh and report")
    parser.add_argument("--before", type=Path, metavar="JSON",
                        help="table of an earlier version (OUT/<suite>.json): a chart shows what moved")  # fmt: skip
    parser.add_argument("--write", type=Path, metavar="FILE",
                        help="put the table into this document, for example docs/results.md")  # fmt: skip
    parser.add_argument("--chart", type=Path, metavar="PNG",
                        help="draw speed against accuracy of all scenes into this picture")  # fmt: skip
    parser.add_argument("--page-only", action="store_true", help="draw the page from the results that are there")
    return parser


def _run_suite(args: argparse.Namespace) -> int:
    from benchmarks.charts import write_chart, write_page
    from benchmarks.tables import write_table

    options, tools = engine_options(args.set), named_values("--external", args.external)
    settings = SuiteSettings(
        args.scenes, args.seeds, options, args.masks, args.poses, tools, args.only, args.paper_iterations
    )
    runs = suite_runs(args.suite, settings)
    if args.half:
        runs = half_of(runs, args.half == "held-out")
    before = None if args.before is None else _read_table(args.before)
    results_folder(args.out)
    rows = _measured(args, runs)
    failed = sum("failed" in row for row in rows)
    write_json(args.out / f"{args.suite}.json", rows)
    page = write_page(args.suite, rows, args.out, before)
    if args.chart:
        write_chart(args.suite, rows, args.chart)
    if args.write:
        write_table(args.write, args.suite, SUITES[args.suite], rows, _further(args, tools), args.chart)
    print(f"{len(rows)} of {len(runs)} results, {failed} failed; page: {page}")
    return EXIT_FAULT if failed else EXIT_DONE


def _measured(args: argparse.Namespace, runs: Sequence[Run]) -> list[dict[str, Any]]:
    """Return the rows of all runs that have a result or failed; measures those that have none yet."""
    scenes: dict[str, Prepared] = {}
    rows: list[dict[str, Any]] = []
    for number, run in enumerate(runs, 1):
        path = args.out / "results" / f"{run.key(_label(args))}.json"
        if not path.exists() and not args.page_only:
            if run.scene not in scenes:
                scenes[run.scene] = prepare_scene(run.scene, args.photos, args.width)
            if args.suite == "resolution" and (most := _enlarged(run, scenes[run.scene])):
                print(f"{run.scene}: {run.variant} left out: its photos have {most} pixels; render with --width")
                continue
            print(f"[{number}/{len(runs)}] {run.scene}: {run.variant}, seed {run.seed}", flush=True)
            job = args.out / "jobs" / path.stem
            row = measure(run, scenes[run.scene], job, args.samples, args.keep_jobs, _stage_cache(args))
            if row.get("failed"):
                print(f"    failed: {row['failed']}", flush=True)
                rows.append(row)
                continue
            write_json(path, row)
        if path.exists():
            # Names may change between versions of a suite; the result stays the same.
            row = {**json.loads(path.read_text(encoding="utf-8")), "variant": run.variant, "group": run.group}
            rows.append(row | _size(run.scene, args))
            print(f"    {_headline(rows[-1])}", flush=True)
    return rows


def _enlarged(run: Run, scene: Prepared) -> int:
    """Return the longest side of a scene's photos, px, where a run is to work on larger ones; else 0. Photos are never
    enlarged."""
    most = max(max(camera.view.width, camera.view.height) for camera in scene.cameras)
    return most if make_config(run.options).resolution > most else 0


def _size(scene: str, args: argparse.Namespace) -> dict[str, int]:
    """How many photos of which width a scene of the catalogue has; nothing of a folder made before."""
    if scene not in SCENES:
        return {}
    spec = scene_spec(scene, photos=args.photos, width=args.width)
    return {"photos": spec.photos, "width": spec.width}


def _further(args: argparse.Namespace, tools: dict[str, str]) -> list[str]:
    """The words of the command that the rows of a table do not tell; of a tool's path its name alone."""
    words = [] if args.paper_iterations == PRINTED else [f"--paper-iterations {args.paper_iterations}"]
    words += [f"--{name} {value}" for name in ("photos", "width") if (value := getattr(args, name))]
    words += ["--only " + " ".join(shlex.quote(word) for word in args.only)] if args.only else []
    for name, command in tools.items():
        program, _, rest = command.partition(" ")
        words.append("--external " + shlex.quote(f"{name}={Path(program).name} {rest}".strip()))
    return words


def _read_table(path: Path) -> list[dict[str, Any]]:
    """The rows of a suite that was measured before.

    Raises:
        BadInput: the file cannot be read or is no such table.
    """
    try:
        rows = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise BadInput(f"Cannot read the earlier table '{path}' ({error}); give a suite's OUT/<suite>.json.") from error
    if not isinstance(rows, list) or not all(isinstance(r, dict) and {"variant", "scene"} <= r.keys() for r in rows):
        raise BadInput(f"'{path}' is no table of runs; give a suite's OUT/<suite>.json.")
    return rows


def _label(args: argparse.Namespace) -> str:
    """What else decides a result: the user's label, the scene's size, the samples."""
    return json.dumps([args.label, args.photos, args.width, args.samples])


def _stage_cache(args: argparse.Namespace) -> Path:
    """Return the folder of the stage cache; a new label or version begins anew, for the engine may have changed."""
    kind = hashlib.sha256(json.dumps([args.label, __version__]).encode()).hexdigest()[:12]
    return Path(args.out / "stage_cache" / kind)


def _headline(row: dict[str, Any]) -> str:
    f1 = "; ".join(
        f"{name} "
        + ", ".join(f"{v:.1f} at {t:.3g} m" for v, t in zip(row[key]["f1"], row[key]["thresholds"], strict=True))
        for key, name in SCORED.items()
        if key in row
    )
    psnr = row.get("psnr")
    return f"{f1}; PSNR {'-' if psnr is None else f'{psnr:.2f}'}; {row['seconds']:.0f} s"


if __name__ == "__main__":
    sys.exit(bench_main())
