# SPDX-License-Identifier: GPL-3.0-or-later
"""Photos without a COLMAP model: cameras and points by pycolmap's structure from motion on the CPU.

Features and matches live in a database in the job's ``scene/sfm`` folder; after an interruption COLMAP takes up what
the database already holds. A finished model is used again. While pairs are matched the database calls photos by
number, because COLMAP's list of pairs cannot hold names with spaces; the model gets the real names back.
"""

from __future__ import annotations

import json
import os
import shutil
import sqlite3
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import quote

import pycolmap

from mgf_engine.config import Config
from mgf_engine.errors import BadInput
from mgf_engine.messages import Reporter, log
from mgf_engine.scene.images import read_info
from mgf_engine.scene.pairs import choose_pairs
from mgf_engine.system import write_json

#: Up to this many photos every pair is matched; beyond it neighbours and photos that look alike.
EXHAUSTIVE_LIMIT = 60
_MAX_SIDE = 1600
_FEWEST = 3
_ADVICE = "take more photos with at least 60 % overlap, or give a COLMAP model"
#: Share of the whole that is done when features, matches are there.
_FEATURES_END, _MATCHES_END = 0.25, 0.6
_POLL_SECONDS = 0.3
_STATE = "state.json"


Share = Callable[[float], float]
Work = Callable[[pycolmap.CancellationToken], Any]


def reconstruct(root: Path, names: list[str], folder: Path, config: Config, reporter: Reporter, share: Share) -> Path:
    """Run structure from motion on a folder of photos.

    Args:
        root: the folder the names are relative to.
        names: the photos, sorted.
        folder: where database and model are kept.
        config: ``matching``, ``threads`` and ``seed`` are used.
        reporter: for progress and cancelling.
        share: maps 0..1 of this part to 0..1 of the stage.

    Returns:
        The folder of the model with the most photos.

    Raises:
        BadInput: there are too few photos, one cannot be read, or they do not fit together.
    """
    if len(names) < _FEWEST:
        raise BadInput(
            f"'{root}' holds no COLMAP model and {len(names)} photos; give a COLMAP scene or at least {_FEWEST} photos."
        )
    sizes = [_size_of(root / name) for name in names]
    exhaustive = config.matching == "exhaustive" or (config.matching == "auto" and len(names) <= EXHAUSTIVE_LIMIT)
    photos = [[name, *size] for name, size in zip(names, sizes, strict=True)]
    task = {"photos": photos, "exhaustive": exhaustive, "seed": config.seed}
    state = _take_up(folder, task)
    done = folder / "model"
    if (done / "points3D.bin").exists():
        return done
    pycolmap.logging.minloglevel = 2
    pycolmap.set_random_seed(config.seed)
    run = _Run(folder, root, names, config, reporter, share)
    if "names" not in state:
        state["names"] = run.extract(one_camera=len({s[:2] for s in sizes}) == 1)
        write_json(folder / _STATE, state)
    real_names = {int(image_id): name for image_id, name in state["names"].items()}
    run.match(real_names, exhaustive)
    _keep(run.map(), real_names, root, folder, reporter)
    return done


class _Run:
    """One run of structure from motion; its steps poll their progress while pycolmap works on another thread."""

    def __init__(
        self, folder: Path, root: Path, names: list[str], config: Config, reporter: Reporter, share: Share
    ) -> None:
        self.folder, self.database = folder, folder / "database.db"
        self.root, self.names, self.config = root, names, config
        self.reporter, self.share = reporter, share
        self.threads = config.threads or -1

    def extract(self, one_camera: bool) -> dict[int, str]:
        """SIFT features of every photo; returns the photos' names by image id."""
        options = pycolmap.FeatureExtractionOptions()
        options.max_image_size, options.use_gpu, options.num_threads = _MAX_SIDE, False, self.threads
        mode = pycolmap.CameraMode.SINGLE if one_camera else pycolmap.CameraMode.AUTO

        def work(token: pycolmap.CancellationToken) -> None:
            pycolmap.extract_features(
                self.database, self.root, image_names=self.names, camera_mode=mode, extraction_options=options,
                device=pycolmap.Device.cpu, cancellation_token=token,
            )  # fmt: skip

        self._watch(work, "features", 0.0, _FEATURES_END, lambda: self._rows("keypoints") / len(self.names))
        with pycolmap.Database.open(self.database) as database:
            return {int(image.image_id): image.name for image in database.read_all_images()}

    def match(self, real_names: dict[int, str], exhaustive: bool) -> None:
        """Matches of the chosen pairs, checked by epipolar geometry."""
        ids = sorted(real_names, key=lambda i: real_names[i])
        with pycolmap.Database.open(self.database) as database:
            pairs = choose_pairs(database, ids, exhaustive, self.config.seed)
            for image in database.read_all_images():
                image.name = _number(image.image_id)
                database.update_image(image)
        listing = self.folder / "pairs.txt"
        listing.write_text("".join(f"{_number(ids[i])} {_number(ids[j])}\n" for i, j in pairs))
        options = pycolmap.FeatureMatchingOptions()
        options.use_gpu, options.num_threads = False, self.threads
        pairing = pycolmap.ImportedPairingOptions()
        pairing.match_list_path = listing

        def work(token: pycolmap.CancellationToken) -> None:
            pycolmap.match_image_pairs(
                self.database, matching_options=options, pairing_options=pairing, device=pycolmap.Device.cpu,
                cancellation_token=token,
            )  # fmt: skip

        total = max(1, len(pairs))
        self._watch(work, "pairs", _FEATURES_END, _MATCHES_END, lambda: self._rows("two_view_geometries") / total)

    def map(self) -> list[pycolmap.Reconstruction]:
        """Cameras and points: every model the mapper finds."""
        options = pycolmap.IncrementalPipelineOptions()
        options.min_model_size, options.extract_colors = _FEWEST, False
        options.num_threads, options.random_seed = self.threads, self.config.seed
        registered = [0]
        found: dict[int, pycolmap.Reconstruction] = {}
        output = self.folder / "mapper"
        shutil.rmtree(output, ignore_errors=True)
        output.mkdir()

        def count() -> None:
            registered[0] += 1

        def work(token: pycolmap.CancellationToken) -> None:
            models = pycolmap.incremental_mapping(
                self.database, self.root, output, options=options, next_image_callback=count, cancellation_token=token
            )
            found.update(models)

        self._watch(work, "cameras", _MATCHES_END, 1.0, lambda: registered[0] / len(self.names))
        shutil.rmtree(output, ignore_errors=True)
        return list(found.values())

    def _watch(self, work: Work, what: str, start: float, end: float, fraction: Callable[[], float]) -> None:
        """Run ``work`` on a thread; report progress and pass on the request to cancel until it ends."""
        token, failure = pycolmap.CancellationToken(), []

        def body() -> None:
            try:
                work(token)
            except Exception as error:
                failure.append(error)

        thread = threading.Thread(target=body, daemon=True)
        thread.start()
        try:
            while thread.is_alive():
                thread.join(_POLL_SECONDS)
                done = min(1.0, fraction())
                self.reporter.progress(self.share(start + (end - start) * done), **{what: round(done * 100)})
        except BaseException:
            token.cancel()
            thread.join()
            raise
        if failure:
            log.error("structure from motion failed", exc_info=failure[0])
            raise BadInput(f"Structure from motion failed on '{self.root}' ({failure[0]}); {_ADVICE}.") from failure[0]

    def _rows(self, table: str) -> int:
        """Rows of a table in the database that pycolmap is writing; 0 while it cannot be read."""
        try:
            connection = sqlite3.connect(f"file:{quote(str(self.database))}?mode=ro", uri=True, timeout=0.1)
            try:
                return int(connection.execute(f"SELECT COUNT(*) FROM {table}").fetchone()[0])
            finally:
                connection.close()
        except sqlite3.Error:
            return 0


def _keep(
    models: list[pycolmap.Reconstruction], real_names: dict[int, str], root: Path, folder: Path, reporter: Reporter
) -> None:
    """Write the largest model under its photos' real names, with the points' colours.

    Raises:
        BadInput: no model has enough photos.
    """
    best = max(models, key=lambda m: m.num_reg_images(), default=None)
    if best is None or best.num_reg_images() < _FEWEST:
        raise BadInput(f"No cameras could be found from the {len(real_names)} photos in '{root}'; {_ADVICE}.")
    for image_id, image in best.images.items():
        image.name = real_names[image_id]
    best.extract_colors_for_all_images(root)
    left = len(real_names) - best.num_reg_images()
    if left:
        reporter.warning(f"{left} of {len(real_names)} photos could not be placed and are left out; {_ADVICE}.")
    partial = folder / "model.part"
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir()
    best.write_binary(partial)
    os.replace(partial, folder / "model")


def _take_up(folder: Path, task: dict[str, Any]) -> dict[str, Any]:
    """What an earlier run of the same task left; anything of another task is removed."""
    task = json.loads(json.dumps(task))
    try:
        state = json.loads((folder / _STATE).read_text(encoding="utf-8"))
        if state["task"] == task:
            return dict(state)
    except (OSError, ValueError, KeyError, TypeError):
        pass
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    state = {"task": task}
    write_json(folder / _STATE, state)
    return state


def _size_of(path: Path) -> tuple[int, int, int, int]:
    """Width, height, bytes and time of change."""
    info, status = read_info(path), path.stat()
    return info.width, info.height, status.st_size, status.st_mtime_ns


def _number(image_id: int) -> str:
    return f"{image_id:08d}"
