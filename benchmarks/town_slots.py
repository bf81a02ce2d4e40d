# SPDX-License-Identifier: GPL-3.0-or-later
"""What the engine of a town (Snakemake) adds to a plain loop, and how many buildings an hour go through 1, 2, … slots.

``python -m benchmarks.town_slots FOLDER --seconds 40 --slots 1 2`` lets stand-ins of buildings wait so long, first in a
plain loop with so many at a time, then under the Snakefile with so many cores. They take no processor time, so that the
figures are the engine's own, whatever else the machine does. ``--chart FILE`` draws them; ``--read`` draws what an
earlier run left in ``FOLDER/slots.json``.
"""

from __future__ import annotations

import argparse
import json
import resource
import shutil
import subprocess
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from mgf_engine.files.atomic import write_json
from mgf_engine.town.workflow import CONFIG, Executor, OptionalProducts, snakemake, write_config

#: In the place of Python: what the Snakefile calls with "-m module buildings/ID …".
_STAND_IN = '#!/bin/sh\nsleep {seconds}\necho "{{}}" > "$3/done.json"\n'


def make_stand_ins(town: Path, count: int, seconds: float, slots: int) -> Executor:
    """Write a town whose jobs only wait; returns what runs it.

    Args:
        town: its folder, made anew.
        count: number of buildings.
        seconds: that each waits.
        slots: jobs at a time.
    """
    shutil.rmtree(town, ignore_errors=True)
    rows = []
    for number in range(count):
        folder = town / "buildings" / f"house_{number}"
        folder.mkdir(parents=True)
        rows.append({"id": folder.name, "state": "ready", "estimate": {"bytes": 1e6}, "photos": []})
        for name in ("prompts.json", "building.json"):
            write_json(folder / name, {})
    write_json(town / "buildings.json", {"buildings": rows})
    script = town / "wait.sh"
    script.write_text(_STAND_IN.format(seconds=seconds))
    script.chmod(0o755)
    executor = Executor(cores=slots)
    write_config(town, executor, OptionalProducts(terrain=False, solids=False), count, 0, {"threads": 1})
    values = json.loads((town / CONFIG).read_text())
    write_json(town / CONFIG, {**values, "python": str(script.resolve())})
    return executor


def time_loop(town: Path, slots: int) -> float:
    """Run the jobs in a plain loop, so many at a time; returns the seconds it took."""
    began = time.perf_counter()
    commands = [[str(town / "wait.sh"), "-m", "worker", str(folder)] for folder in (town / "buildings").iterdir()]
    with ThreadPoolExecutor(slots) as pool:
        list(pool.map(lambda command: subprocess.run(command, check=True), commands))
    return time.perf_counter() - began


def time_engine(town: Path, executor: Executor) -> tuple[float, float]:
    """Run the jobs under Snakemake; returns the seconds by the clock, and those of processor time.

    Raises:
        RuntimeError: a job did not run.
    """
    began, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    with snakemake(town, executor, memory=1000) as process:
        process.wait()
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if process.returncode:
        raise RuntimeError((town / "snakemake.txt").read_text()[-2000:])
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return time.perf_counter() - began, cpu


def measure(folder: Path, count: int, seconds: float, slots: int) -> dict[str, Any]:
    """Measure loop and engine with so many slots; returns a row of figures."""
    town = folder / f"slots-{slots}"
    make_stand_ins(town, count, seconds, slots)
    loop = time_loop(town, slots)
    engine, cpu = time_engine(town, make_stand_ins(town, count, seconds, slots))
    return {
        "slots": slots, "buildings": count, "seconds_each": seconds, "loop": round(loop, 2),
        "engine": round(engine, 2), "overhead": round(engine / loop - 1, 4), "engine_cpu": round(cpu, 2),
    }  # fmt: skip


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Draw buildings per hour against slots, for the loop and for the engine."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(5.2, 3.4), layout="constrained")
    places = range(len(rows))
    for shift, key, name, color in ((-0.2, "loop", "plain loop", "#9d9da1"), (0.2, "engine", "Snakemake", "#4c78a8")):
        speeds = [3600 * row["buildings"] / row[key] for row in rows]
        bars = axes.bar([k + shift for k in places], speeds, 0.38, label=name, color=color)
        axes.bar_label(bars, fmt="%.0f", fontsize=8)
    axes.set_xticks(list(places), [str(row["slots"]) for row in rows])
    axes.set_xlabel("slots")
    axes.set_ylabel("buildings per hour")
    axes.set_title(f"{rows[0]['buildings']} buildings of {rows[0]['seconds_each']:g} s each", fontsize=10)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, loc="upper left")
    figure.savefig(path, dpi=110)


def main() -> int:
    """Measure, print a row for each number of slots, and draw."""
    parser = argparse.ArgumentParser(description="Measure what Snakemake adds to a plain loop over buildings.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--buildings", type=int, default=8)
    parser.add_argument("--seconds", type=float, default=40.0, help="that each building takes (default 40)")
    parser.add_argument("--slots", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--chart", type=Path, help="file of the picture (PNG or SVG)")
    parser.add_argument("--read", action="store_true", help="draw what an earlier run measured")
    args = parser.parse_args()
    table = args.folder / "slots.json"
    if not args.read:
        args.folder.mkdir(parents=True, exist_ok=True)
        rows = [measure(args.folder, args.buildings, args.seconds, slots) for slots in args.slots]
        write_json(table, rows)
    rows = json.loads(table.read_text())
    for row in rows:
        print("  ".join(f"{name} {value}" for name, value in row.items()))
    if args.chart is not None:
        draw(rows, args.chart)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
