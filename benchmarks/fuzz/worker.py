# SPDX-License-Identifier: GPL-3.0-or-later
"""The child process of the fuzzer: damage, read and classify, in one loop, under a memory limit.

Where it stands is in ``state`` (cases done, as text) at all times, and the damaged file is on disk while it is read:
when the process dies, the parent finds both.
"""

from __future__ import annotations

import hashlib
import json
import os
import random
import re
import resource
import shutil
import sys
import traceback
import warnings
from pathlib import Path

from benchmarks.fuzz.mutate import mutate
from benchmarks.fuzz.target import check_sentence
from benchmarks.fuzz.targets import TARGETS
from mgf_engine.errors import BadInput

#: Bytes of address space a reader may take beyond what the process has when it starts.
HEADROOM = 1536 << 20
#: Growth of the resident memory by one case that is a finding.
MEMORY = 256 << 20
_CORPUS = 200


def try_reading(name: str, folder: Path) -> tuple[str, str]:
    """Read a folder: ("ok" | "refused" | "finding", what happened)."""
    try:
        TARGETS[name].read(folder)
    except BadInput as error:
        try:
            check_sentence(error)
        except AssertionError as unclear:
            return "finding", str(unclear)
        return "refused", str(error)
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt):
            raise
        place = traceback.extract_tb(error.__traceback__)[-1]
        return "finding", f"{type(error).__name__}: {error} ({Path(place.filename).name}:{place.lineno})"
    return "ok", ""


def run(name: str, cases: int, seed: int, folder: Path, findings: Path) -> dict[str, int]:
    """Fuzz one reader; every kind of finding is saved once. Returns how the cases ended."""
    target = TARGETS[name]
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    target.prepare(folder)
    outcome = try_reading(name, folder)
    if outcome[0] != "ok":
        raise RuntimeError(f"the sound files of '{name}' are not read: {outcome[1]}")
    sound = {file: (folder / file).read_bytes() for file in target.files}
    corpus = {file: [data] for file, data in sound.items()}
    rng = random.Random(f"{seed} {name}")
    counts = {"ok": 0, "refused": 0, "finding": 0}
    known: set[str] = set()
    state = os.open(folder.with_suffix(".state"), os.O_RDWR | os.O_CREAT)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for case in range(cases):
        file = rng.choice(list(sound))
        data = mutate(rng.choice(corpus[file]), target.files[file], rng)
        path = folder / file
        path.write_bytes(data)
        os.pwrite(state, f"{case:<12}{file:<80}".encode(), 0)
        kind, text = try_reading(name, folder)
        now = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        if (now - peak) * 1024 > MEMORY and kind != "finding":
            kind, text = "finding", f"memory grew by {(now - peak) >> 10} MB"
        peak = max(peak, now)
        counts[kind] += 1
        _keep(kind, text, name, file, data, known, corpus, findings)
        path.write_bytes(sound[file])
        if name == "scene-stage":
            shutil.rmtree(folder / "job", ignore_errors=True)
    os.close(state)
    return counts


def _keep(kind: str, text: str, name: str, file: str, data: bytes, known: set[str], corpus: dict[str, list[bytes]],
          findings: Path) -> None:  # fmt: skip
    """A new sort of answer makes the case a seed for more (it got somewhere new); a new finding is saved."""
    sort = re.sub(r"\d+|'[^']*'", "#", text)[:90]
    if (kind, file, sort) in known:
        return
    known.add((kind, file, sort))  # type: ignore[arg-type]
    if kind == "finding":
        save(findings, name, file, data, text)
    elif len(corpus[file]) < _CORPUS and len(data) < 1 << 16:
        corpus[file].append(data)


def save(findings: Path, name: str, file: str, data: bytes, text: str) -> Path:
    """A case as ``<target>/<hash>/<file>`` with what happened beside it."""
    folder = findings / name / hashlib.sha256(data).hexdigest()[:10]
    (folder / file).parent.mkdir(parents=True, exist_ok=True)
    (folder / file).write_bytes(data)
    (folder / "what.txt").write_text(text + "\n", encoding="utf-8", errors="replace")
    return folder


def limit_memory() -> None:
    """Bound the address space at what is taken now plus :data:`HEADROOM`."""
    taken = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (taken + HEADROOM, taken + HEADROOM))


def main() -> None:
    name, cases, seed, folder, findings = sys.argv[1:6]
    warnings.simplefilter("ignore")
    os.environ["OPENCV_LOG_LEVEL"] = "OFF"
    import cv2

    cv2.setNumThreads(1)
    TARGETS[name].prepare(_fresh(Path(folder)))
    try_reading(name, Path(folder))  # imports what the reader needs before the limit is set
    limit_memory()
    print(json.dumps(run(name, int(cases), int(seed), Path(folder), Path(findings))))


def _fresh(folder: Path) -> Path:
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    return folder


if __name__ == "__main__":
    main()
