# SPDX-License-Identifier: GPL-3.0-or-later
"""``mgf bench masks``: the masks of scenes with true masks, from many and few clicks, good and bad ones.

Only the scene and masks stages run. One row per scene and kind of clicks, as table, JSON, contact sheets and charts.
"""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.arguments import results_folder
from benchmarks.clicks import VARIANTS, make_clicks
from benchmarks.mask_scores import PhotoScore, score_photo
from mgf_engine.cli.arguments import Parser
from mgf_engine.errors import EXIT_DONE, BadInput
from mgf_engine.files.atomic import write_json
from mgf_engine.masks.build import build_masks
from mgf_engine.masks.prompts import read_prompts
from mgf_engine.masks.store import read_png
from mgf_engine.messages import Message, Reporter
from mgf_engine.model.scene import Scene
from mgf_engine.options.config import Config, make_config
from mgf_engine.scene.load import load_scene
from mgf_engine.system.machine import cores

SCENES = ("demo", "masks_block", "masks_hall", "masks_trees")
#: A child mask below this IoU is bad: it must be flagged.
BAD = 0.8
Row = dict[str, Any]


def masks_main(argv: Sequence[str]) -> int:
    """Entry point of ``mgf bench masks``; returns the exit code."""
    args = _parser().parse_args(argv)
    from benchmarks.mask_charts import write_chart

    cv2.setNumThreads(cores())
    wanted = [name for name in VARIANTS if not args.only or any(word in name for word in args.only)]
    if not wanted:
        raise BadInput(f"No kind of clicks has one of these names: {', '.join(args.only)}.")
    results_folder(args.out)
    rows: list[Row] = []
    print(header())
    for name in args.scenes or SCENES:
        folder = truth_folder(name)
        scene = _load(folder, args.out / "scenes" / Path(name).name, args.resolution)
        for variant in wanted:
            job = args.out / "jobs" / f"{Path(name).name}-{variant.replace(' ', '_').replace('/', '-')}"
            row = {"scene": Path(name).name, **measure_masks(folder, scene, variant, job, args.segmenter)}
            rows.append(row)
            print(line(row), flush=True)
    write_json(args.out / "masks.json", rows)
    chart = write_chart(rows, args.chart or args.out / "masks-clicks.png")
    print(f"{len(rows)} rows in {args.out / 'masks.json'}" + (f"; chart: {chart}" if chart else ""))
    return EXIT_DONE


def _parser() -> Parser:
    parser = Parser(prog="mgf bench masks", description="Measure masks on scenes with true masks.")
    parser.add_argument("--out", type=Path, default=Path("bench"), help="folder of results")
    parser.add_argument("--scenes", nargs="+", default=[], help=f"names or folders (default: {' '.join(SCENES)})")
    parser.add_argument(
        "--only", nargs="+", default=[], help=f"only kinds of clicks with one of these words: {', '.join(VARIANTS)}"
    )
    parser.add_argument("--resolution", type=int, default=Config.resolution, help="longest side while working, px")
    parser.add_argument("--segmenter", default="auto", help="auto, random_walker or efficientsam")
    parser.add_argument("--chart", type=Path, help="where the chart goes")
    return parser


def truth_folder(name: str) -> Path:
    """The folder of a scene with true masks: given as a path, or by its name, rendered where the cache lacks it."""
    if (Path(name) / "masks").is_dir():
        return Path(name)
    from benchmarks.catalogue import scene_spec
    from benchmarks.scenes import make_scene

    return make_scene(name, scene_spec(name))


def _load(folder: Path, target: Path, resolution: int) -> Scene:
    shutil.rmtree(target, ignore_errors=True)
    reporter = Reporter()
    reporter.stage("scene")
    return load_scene(folder, target, make_config({"resolution": resolution}), reporter)


def measure_masks(folder: Path, scene: Scene, variant: str, out: Path, segmenter: str = "auto") -> Row:
    """Make the masks of one scene from one kind of clicks and score them; a plain row for tables.

    Args:
        folder: the scene's folder with ``masks`` and ``elements``.
        variant: of :data:`benchmarks.clicks.VARIANTS`.
        out: emptied, then holds ``prompts.json`` and ``masks``.
    """
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    make_clicks(folder, variant, out / "prompts.json")
    messages: list[Message] = []
    reporter = Reporter(messages.append)
    reporter.stage("masks")
    config = make_config({"segmenter": segmenter, "second_level": "on"})
    row: Row = {"variant": variant, "clicked": len(json.loads((out / "prompts.json").read_text(encoding="utf-8")))}
    started = time.process_time()
    try:
        masks = build_masks(scene, out / "prompts.json", None, out / "masks", config, reporter)
    except BadInput as error:
        return {**row, "refused": str(error)}
    cpu = (time.process_time() - started) / len(scene.views)
    record = json.loads((out / "masks/scores.json").read_text(encoding="utf-8"))
    scores = [score_view(folder, v.name, labels) for v, labels in zip(scene.views, masks.labels, strict=True)]
    clicked = set(read_prompts(out / "prompts.json", scene))
    warned = " ".join(m["text"] for m in messages if m["type"] == "warning")
    return {
        **row, **summary(scene, scores, masks.used, clicked),
        "consistency": record["consistency"], "seconds_per_photo": record["seconds_per_photo"],
        "cpu_seconds_per_photo": round(cpu, 3), "warnings": warned,
    }  # fmt: skip


def score_view(folder: Path, name: str, labels: NDArray[np.uint8]) -> PhotoScore:
    """Score one photo's label map [H, W] against the truth in the scene's folder, at the label map's size."""
    h, w = labels.shape
    stem = Path(name).stem + ".png"
    true = [read_png(folder / kind / stem) for kind in ("masks", "elements")]
    if true[0] is None or true[1] is None:
        raise BadInput(f"The true mask of '{name}' in '{folder}' is missing; make the scene again.")
    sized = [cv2.resize(t, (w, h), interpolation=cv2.INTER_NEAREST).astype(np.uint8) for t in true if t is not None]
    return score_photo(labels, sized[0], sized[1])


def summary(scene: Scene, scores: list[PhotoScore], used: NDArray[np.bool_], clicked: set[int]) -> Row:
    """Means over roots and children; IoU in percent."""
    iou = np.array([s.iou for s in scores])
    child = np.array([i not in clicked for i in range(len(scores))]) & np.isfinite(iou)
    root = ~child & np.isfinite(iou)
    worst = int(np.where(child & used, iou, np.inf).argmin()) if (child & used).any() else -1
    return {
        "photos": len(scores),
        "roots": _percent(iou[root]),
        "children": _percent(iou[child]),
        "worst": None if worst < 0 else round(100 * float(iou[worst]), 1),
        "worst_photo": "" if worst < 0 else scene.views[worst].name,
        "silently_bad": int((np.isfinite(iou) & used & (iou < BAD)).sum()),
        "flagged": int((~used).sum()),
        "edge": _mean([s.edge for s in scores]),
        "occluded": _percent(np.array([s.occluded for s in scores])),
        "element_boundaries": _percent(np.array([s.element_boundaries for s in scores])),
        "element_overlap": _percent(np.array([s.element_overlap for s in scores])),
        "iou": {v.name: round(100 * float(x), 1) for v, x in zip(scene.views, iou, strict=True) if np.isfinite(x)},
    }


def _percent(values: NDArray[np.float64]) -> float | None:
    known = values[np.isfinite(values)]
    return round(100 * float(known.mean()), 1) if len(known) else None


def _mean(values: list[float]) -> float | None:
    known = [v for v in values if np.isfinite(v)]
    return round(float(np.mean(known)), 2) if known else None


_COLUMNS = (
    ("scene", "scene", 14), ("variant", "clicks", 26), ("clicked", "photos", 6), ("roots", "roots", 6),
    ("children", "child", 6), ("worst", "worst", 6), ("silently_bad", "silent", 6), ("flagged", "flags", 5),
    ("edge", "edge", 6), ("occluded", "occl", 5), ("consistency", "consist", 7), ("element_boundaries", "el.bd", 6),
    ("element_overlap", "el.iou", 6), ("seconds_per_photo", "s/photo", 7),
)  # fmt: skip


def header() -> str:
    """Return the first line of the table."""
    return "  ".join(name.ljust(width) for _, name, width in _COLUMNS)


def line(row: Row) -> str:
    """Return one row of the table, and what the engine said of it."""
    text = "  ".join(str("-" if row.get(key) is None else row[key]).ljust(width) for key, _, width in _COLUMNS)
    return text + "  " + (row.get("refused") or row.get("warnings") or "")[:100]
