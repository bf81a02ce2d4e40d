# SPDX-License-Identifier: GPL-3.0-or-later
"""Run the fuzzer: ``python -m benchmarks.fuzz --cases 1000000 [--only ply job] [--out fuzz-findings]``.

Each reader runs in children of its own, in batches; a child that dies or stands still is a finding, and the next batch
begins behind it. Exit code 1 when there is any finding.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.fuzz.targets import TARGETS
from benchmarks.fuzz.worker import save

BATCH = 20_000
#: Seconds without a finished case after which a reader counts as hanging.
PATIENCE = 60.0


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.fuzz", description="Feed damaged files to every reader."
    )
    parser.add_argument("--cases", type=int, default=1_000_000, help="in total, shared out among the readers")
    parser.add_argument("--only", nargs="+", choices=sorted(TARGETS), default=sorted(TARGETS), help="these readers")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("fuzz-findings"), help="where findings are saved")
    args = parser.parse_args()
    total = sum(TARGETS[name].weight for name in args.only)
    done = found = 0.0
    with tempfile.TemporaryDirectory(dir="/dev/shm" if Path("/dev/shm").is_dir() else None) as work:
        for name in args.only:
            counts = fuzz(name, round(args.cases * TARGETS[name].weight / total), args.seed, Path(work), args.out)
            done += sum(counts[k] for k in ("ok", "refused", "finding"))
            found += counts["finding"]
            print(f"{name:<12} {json.dumps(counts)}", flush=True)
    print(f"{done:.0f} cases, {found:.0f} findings" + (f" in {args.out}" if found else ""))
    return 1 if found else 0


def fuzz(name: str, cases: int, seed: int, work: Path, out: Path) -> dict[str, float]:
    """All cases of one reader, in batches."""
    counts: dict[str, float] = {"ok": 0, "refused": 0, "finding": 0}
    started = time.monotonic()
    left, batch = cases, 0
    while left > 0:
        size = min(left, BATCH)
        result, lost = _batch(name, size, seed * 1_000_003 + batch, work / name, out)
        for key, value in result.items():
            counts[key] += value
        left -= lost or size
        batch += 1
    counts["seconds"] = round(time.monotonic() - started)
    return counts


def _batch(name: str, size: int, seed: int, folder: Path, out: Path) -> tuple[dict[str, int], int]:
    """One child; its counts, and how many cases it did when it died (0 when it lived)."""
    command = [sys.executable, "-m", "benchmarks.fuzz.worker", name, str(size), str(seed), str(folder), str(out)]
    state = folder.with_suffix(".state")
    state.unlink(missing_ok=True)
    child = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, errors="replace",
                             env={**os.environ, "OPENCV_LOG_LEVEL": "OFF"})  # fmt: skip
    last, since = "", time.monotonic()
    while True:
        try:
            output, errors = child.communicate(timeout=5)
            break
        except subprocess.TimeoutExpired:
            now = state.read_text()[:12] if state.exists() else ""
            if now != last:
                last, since = now, time.monotonic()
            elif time.monotonic() - since > PATIENCE:
                child.kill()
                output, errors = child.communicate()
                break
    if child.returncode == 0:
        return json.loads(output.splitlines()[-1]), 0
    if not state.exists():
        raise SystemExit(f"the fuzzer of '{name}' does not start:\n{errors}")
    text = state.read_text()
    done, file = int(text[:12]) + 1, text[12:].strip()
    what = f"exit code {child.returncode}" + (" (stood still)" if child.returncode == -9 else "")
    kept = save(out, name, file, (folder / file).read_bytes(), f"{what}\n{errors[-2000:]}")
    print(f"{name}: {what}, see {kept}", flush=True)
    shutil.rmtree(folder, ignore_errors=True)
    return {"ok": 0, "refused": done - 1, "finding": 1}, done


if __name__ == "__main__":
    sys.exit(main())
