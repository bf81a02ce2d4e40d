# SPDX-License-Identifier: GPL-3.0-or-later
"""Structure from motion in a process of its own: ``python -m mgf_engine.scene.sfm_worker FOLDER``.

A crash inside COLMAP ends this process and not the job, cancelling is ending it, and its memory goes with it. It says
on stdout which step it is at (``features``, ``pairs COUNT``, ``camera`` per placed photo, ``again COUNT`` before the
second attempt, with the photos that the first one placed) and ends when its stdin closes, so that it never outlives the
job. While pairs are matched the database calls photos by number, because COLMAP's list of pairs cannot hold names with
spaces; the model gets the real names back.

The first attempt has plain SIFT features. They change with the angle that a surface is seen at, and around the corners
of a building too few match: the mapper then makes several small models. The second attempt, for photos that the first
one cannot place although they match others, has features whose shape is adapted to the surface (affine-covariant,
Mikolajczyk and Schmid 2004) and whose descriptors are pooled over its sizes (Dong and Soatto 2015); they take longer to
find. COLMAP's thresholds stay as they are: with lower ones photos are placed wrongly. One exception: where they place
fewer than half of the photos, as where all look along a street that the camera goes down, a pair in forward motion may
begin the model, too.
"""

from __future__ import annotations

import json
import shutil
import sys
import threading
from pathlib import Path
from typing import Any

import pycolmap

from mgf_engine.files.atomic import atomic_folder, write_json
from mgf_engine.scene.colmap import MIN_SFM_PHOTOS
from mgf_engine.scene.pairs import choose_pairs
from mgf_engine.system.subprocesses import end_with_the_job

TASK, NAMES, DATABASE, MODEL = "task.json", "names.json", "database.db", "model"
#: Folders of the attempts.
PLAIN, AFFINE = "sift", "affine"
#: Exit code when the photos give no model.
NO_MODEL = 3


def main(folder: Path) -> int:
    """Run or go on with the task in ``folder``; exit code 0 with a model written, NO_MODEL when none was found."""
    task: dict[str, Any] = json.loads((folder / TASK).read_text(encoding="utf-8"))
    pycolmap.logging.minloglevel = 2
    pycolmap.set_random_seed(task["seed"])
    best, photos = _attempt(folder / PLAIN, task, affine=False)
    placed = _placed(best)
    if placed < task["retry_below"] * photos and _may_match(folder / PLAIN, best, task["retry_matches"]):
        _say(f"again {placed}")
        second, _ = _attempt(folder / AFFINE, task, affine=True)
        best = max(best, second, key=_placed)
    if best is None:
        return NO_MODEL
    best.extract_colors_for_all_images(task["root"])
    _write(best, folder / MODEL)
    return 0


def _may_match(folder: Path, best: pycolmap.Reconstruction | None, matches: int) -> bool:
    """Tell whether a photo that was left out shares so many verified matches with any other one.

    Where none does, the photos show other things, and no features match them.
    """
    with pycolmap.Database.open(folder / DATABASE) as database:
        pairs, inliers = database.read_two_view_geometry_num_inliers()
    placed = set(best.reg_image_ids()) if best else set()
    left_out = (
        count
        for pair, count in zip(pairs, inliers, strict=True)
        if not placed.issuperset(pycolmap.pair_id_to_image_pair(pair))
    )
    return max(left_out, default=0) >= matches


def _attempt(folder: Path, task: dict[str, Any], affine: bool) -> tuple[pycolmap.Reconstruction | None, int]:
    """Return the model with the most photos and the number of photos that could be read; go on with what is there."""
    folder.mkdir(exist_ok=True)
    if not (folder / NAMES).exists():
        _say("features")
        _extract(folder, task, affine)
    names = {int(key): name for key, name in json.loads((folder / NAMES).read_text(encoding="utf-8")).items()}
    if (folder / MODEL).exists():
        return pycolmap.Reconstruction(folder / MODEL), len(names)
    _match(folder, task, names)
    _say("cameras")
    best = _map(folder, task)
    if 2 * _placed(best) < len(names):
        best = max(best, _map(folder, task, task["forward_angle"]), key=_placed)
    if best is None:
        return None, len(names)
    for image_id, image in best.images.items():
        image.name = names[image_id]
    _write(best, folder / MODEL)
    return best, len(names)


def _write(model: pycolmap.Reconstruction, target: Path) -> None:
    with atomic_folder(target) as partial:
        model.write_binary(partial)


def _extract(folder: Path, task: dict[str, Any], affine: bool) -> None:
    """Extract SIFT features of every photo; the photos' names by image id are kept when all are done."""
    options = pycolmap.FeatureExtractionOptions()
    options.max_image_size, options.use_gpu, options.num_threads = task["longest_side"], False, task["threads"]
    options.sift.max_num_features = task["features"]
    options.sift.estimate_affine_shape = options.sift.domain_size_pooling = affine
    mode = pycolmap.CameraMode.SINGLE if task["one_camera"] else pycolmap.CameraMode.AUTO
    pycolmap.extract_features(
        folder / DATABASE, task["root"], image_names=task["names"], camera_mode=mode, extraction_options=options,
        device=pycolmap.Device.cpu,
    )  # fmt: skip
    with pycolmap.Database.open(folder / DATABASE) as database:
        write_json(folder / NAMES, {int(image.image_id): image.name for image in database.read_all_images()})


def _match(folder: Path, task: dict[str, Any], names: dict[int, str]) -> None:
    """Match the chosen pairs and check the matches by epipolar geometry."""
    ids = sorted(names, key=lambda i: names[i])
    with pycolmap.Database.open(folder / DATABASE) as database:
        pairs = choose_pairs(database, ids, task["exhaustive"], task["seed"], task["neighbours"], task["similar"])
        for image in database.read_all_images():
            image.name = _number(image.image_id)
            database.update_image(image)
    _say(f"pairs {len(pairs)}")
    listing = folder / "pairs.txt"
    listing.write_text("".join(f"{_number(ids[i])} {_number(ids[j])}\n" for i, j in pairs), encoding="ascii")
    options = pycolmap.FeatureMatchingOptions()
    options.use_gpu, options.num_threads = False, task["threads"]
    pairing = pycolmap.ImportedPairingOptions()
    pairing.match_list_path = listing
    pycolmap.match_image_pairs(
        folder / DATABASE, matching_options=options, pairing_options=pairing, device=pycolmap.Device.cpu
    )


def _map(folder: Path, task: dict[str, Any], forward_angle: float = 0.0) -> pycolmap.Reconstruction | None:
    """Run the mapper; None where it places too few photos.

    Args:
        folder: of the attempt, which holds the database.
        task: options.
        forward_angle: degrees; a pair may begin the model in forward motion, too, where the rays to its points meet
            under this angle in the median. 0 for COLMAP's own limits.

    Returns:
        Cameras and points of the model with the most photos.
    """
    options = pycolmap.IncrementalPipelineOptions()
    options.min_model_size, options.extract_colors = MIN_SFM_PHOTOS, False
    options.num_threads, options.random_seed = task["threads"], task["seed"]
    if forward_angle > 0:
        options.mapper.init_max_forward_motion = 1.0
        options.mapper.init_min_tri_angle = forward_angle
    output = folder / "mapper"
    shutil.rmtree(output, ignore_errors=True)
    output.mkdir()
    models = pycolmap.incremental_mapping(
        folder / DATABASE, task["root"], output, options=options, next_image_callback=lambda: _say("camera")
    )
    shutil.rmtree(output, ignore_errors=True)
    best = max(models.values(), key=_placed, default=None)
    return best if _placed(best) >= MIN_SFM_PHOTOS else None


def _placed(model: pycolmap.Reconstruction | None) -> int:
    return model.num_reg_images() if model else 0


def _number(image_id: int) -> str:
    return f"{image_id:08d}"


def _say(line: str) -> None:
    print(line, flush=True)


if __name__ == "__main__":
    threading.Thread(target=end_with_the_job, daemon=True).start()
    sys.exit(main(Path(sys.argv[1])))
