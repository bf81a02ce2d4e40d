# SPDX-License-Identifier: GPL-3.0-or-later
"""Structure from motion for photos without a COLMAP model, by pycolmap on the CPU.

Features and matches of each attempt live in a database in the job's ``scene/sfm`` folder; after an interruption COLMAP
takes up what the databases already hold. A finished model is used again. The work itself is done by :mod:`sfm_worker`
in another process. Progress is counted in its database, which must not happen inside the worker: Python's SQLite and
COLMAP's would undo each other's file locks.
"""

from __future__ import annotations

import json
import shutil
import sqlite3
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any
from urllib.parse import quote

from mgf_engine.errors import BadInput
from mgf_engine.files.atomic import write_json
from mgf_engine.files.images import PhotoInfo
from mgf_engine.messages import Reporter, log
from mgf_engine.options.algorithms import parameter
from mgf_engine.options.config import job_option
from mgf_engine.scene.colmap import MIN_SFM_PHOTOS, too_few_photos
from mgf_engine.scene.sfm_worker import AFFINE, DATABASE, MODEL, NO_MODEL, PLAIN, TASK
from mgf_engine.system.subprocesses import ended, worker

_ADVICE = "take more photos with at least 60 % overlap, or give a COLMAP model"
#: Share of an attempt that is done when the features, the matches are there.
_FEATURES_END, _MATCHES_END = 0.25, 0.6
#: Share of the whole that is done when the first attempt, which is nearly always the only one, ends.
_FIRST_END = 0.8

Share = Callable[[float], float]


@dataclass(frozen=True)
class SfmOptions:
    """Options of structure from motion."""

    exhaustive_photos: int = parameter(60, "Number of photos up to which matching 'auto' matches every pair")
    longest_side: int = parameter(1600, "Longest side of the photos that features are found in", "px", low=64)
    features: int = parameter(
        4096, "Maximum number of SIFT features of a photo; COLMAP's 8192 take four times as long to match", low=64
    )
    neighbours: int = parameter(10, "Number of following photos that each photo is matched with, if not all", low=1)
    similar: int = parameter(10, "Number of most similar photos that each photo is matched with, if not all")
    retry_below: float = parameter(
        0.95, "Share of registered photos below which affine-covariant features are tried as well", high=1
    )
    retry_matches: int = parameter(
        20,
        "Number of matches with another photo from which a photo that was left out is worth the second attempt",
        low=0,
    )
    forward_angle: float = parameter(
        8.0,
        "Minimum angle between the rays of two photos in forward motion, which may begin a model where others place "
        "fewer than half of the photos",
        "degrees",
        low=0.1,
        high=90,
    )
    matching: str = job_option("matching")
    seed: int = job_option("seed")
    threads: int = job_option("threads")

    def exhaustive(self, photos: int) -> bool:
        """Tell whether every pair of that many photos is matched."""
        return self.matching == "exhaustive" or (self.matching == "auto" and photos <= self.exhaustive_photos)


def run_sfm(
    root: Path, photos: Mapping[str, PhotoInfo], folder: Path, options: SfmOptions, reporter: Reporter, share: Share
) -> Path:
    """Run structure from motion on a folder of photos.

    Args:
        root: the folder the names are relative to.
        photos: name -> what its header says, sorted by name.
        folder: where database and model are kept.
        options: of features and matching.
        reporter: for progress and cancelling.
        share: maps 0..1 of this part to 0..1 of the stage.

    Returns:
        The folder of the model with the most photos.

    Raises:
        BadInput: there are too few photos, or they do not fit together.
    """
    names = list(photos)
    if len(names) < MIN_SFM_PHOTOS:
        raise too_few_photos(root, len(names), MIN_SFM_PHOTOS)
    sizes = [_size_of(root / name, info) for name, info in photos.items()]
    task = {
        "root": str(root), "names": names, "sizes": sizes, "one_camera": len({(w, h) for w, h, *_ in sizes}) == 1,
        "exhaustive": options.exhaustive(len(names)), "seed": options.seed, "threads": options.threads or -1,
        "longest_side": options.longest_side, "features": options.features, "neighbours": options.neighbours,
        "similar": options.similar, "retry_below": options.retry_below,
        "retry_matches": options.retry_matches, "forward_angle": options.forward_angle,
    }  # fmt: skip
    _prepare_folder(folder, task)
    if not (folder / MODEL / "points3D.bin").exists():
        code = _Worker(folder, len(names), reporter, share).run()
        if code == NO_MODEL:
            raise BadInput(f"No cameras could be found from the {len(names)} photos in '{root}'; {_ADVICE}.")
        if code != 0:
            raise BadInput(f"Structure from motion failed on '{root}' (COLMAP ended with code {code}); {_ADVICE}.")
    return folder / MODEL


class _Worker:
    """The worker process, its progress, and the request to cancel it."""

    def __init__(self, folder: Path, photos: int, reporter: Reporter, share: Share) -> None:
        self.folder, self.photos, self.reporter, self.share = folder, photos, reporter, share
        self.step, self.pairs, self.placed = "", 1, 0
        self.attempt, self.begun = PLAIN, 0.0
        self.registered: int | None = None  # photos of the first attempt, until that was said

    def run(self) -> int:
        """Start the worker and wait for its end; returns its exit code."""
        command = [sys.executable, "-m", "mgf_engine.scene.sfm_worker", str(self.folder)]
        pipe = subprocess.PIPE
        errors: list[bytes] = []
        with worker(command, stdin=pipe, stdout=pipe, stderr=pipe) as process:
            readers = [
                threading.Thread(target=self._follow, args=(process.stdout,), daemon=True),
                threading.Thread(target=lambda: errors.extend(process.stderr or ()), daemon=True),
            ]
            for reader in readers:
                reader.start()
            try:
                while not ended(process):
                    self._report()
                self._report()
            finally:
                process.kill()
                process.wait()
                for reader in readers:
                    reader.join()
        if errors:
            log.warning("structure from motion: %s", b"".join(errors[-40:]).decode("utf-8", "replace").strip())
        return process.returncode

    def _follow(self, stream: IO[bytes]) -> None:
        """Read the worker's lines: ``camera`` for each camera placed, ``again`` for the second attempt, else the name
        of a step."""
        for line in stream:
            word, *rest = line.decode("ascii", "replace").split()
            if word == "camera":
                self.placed += 1
            elif word == "again":
                self.registered, self.begun = int(rest[0]), time.monotonic()
                self.attempt, self.step, self.placed = AFFINE, "", 0
            else:
                self.step, self.pairs = word, max(1, int(rest[0])) if rest else self.pairs

    def _report(self) -> None:
        """Report the share of the work that is done, and that a second attempt begins."""
        if self.registered is not None:
            self.reporter.warning(
                f"{self.registered} of {self.photos} photos could be registered at first; structure from motion runs "
                "again with affine-covariant features, which match photos taken farther apart."
            )
            self.registered = None
        done, doing, left = self._share_done(), self.step or "starting", None
        if self.attempt == PLAIN:
            whole = _FIRST_END * done
        else:  # the time left follows from this attempt alone
            whole, doing = _FIRST_END + (1.0 - _FIRST_END) * done, f"{doing}, second attempt"
            left = (time.monotonic() - self.begun) * (1.0 - done) / done if done > 0.0 else None
        self.reporter.progress(self.share(whole), left, doing=doing)

    def _share_done(self) -> float:
        """Return the share of the attempt that is done, by the rows of the database and the cameras placed so far."""
        return {
            "features": lambda: _FEATURES_END * min(1.0, self._rows("keypoints") / self.photos),
            "pairs": lambda: (
                _FEATURES_END
                + (_MATCHES_END - _FEATURES_END) * min(1.0, self._rows("two_view_geometries") / self.pairs)
            ),
            "cameras": lambda: _MATCHES_END + (1.0 - _MATCHES_END) * min(1.0, self.placed / self.photos),
        }.get(self.step, lambda: 0.0)()

    def _rows(self, table: str) -> int:
        """Return the rows of a table in the database that the worker is writing; 0 while it cannot be read."""
        try:
            path = quote(str(self.folder / self.attempt / DATABASE))
            connection = sqlite3.connect(f"file:{path}?mode=ro", uri=True, timeout=0.1)
            try:
                return int(connection.execute(f"SELECT COUNT(*) FROM {table}").fetchone()[0])
            finally:
                connection.close()
        except sqlite3.Error:
            return 0


def _prepare_folder(folder: Path, task: dict[str, Any]) -> None:
    """Keep the database and model of an earlier run of the same task; else empty the folder."""
    try:
        if json.loads((folder / TASK).read_text(encoding="utf-8")) == json.loads(json.dumps(task)):
            return
    except (OSError, ValueError):
        pass
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    write_json(folder / TASK, task)


def _size_of(path: Path, info: PhotoInfo) -> tuple[int, int, int, int]:
    """Return width, height, bytes and time of change."""
    status = path.stat()
    return info.width, info.height, status.st_size, status.st_mtime_ns
