# SPDX-License-Identifier: GPL-3.0-or-later
"""Make a good scene worse in one known way: a table of perturbations, each with its levels from harmless to hopeless.

A perturbed scene is a folder like the generator's; what is not touched is a link to the original. The truth stays
the original's: ``perturbation.json`` says what was done, and the similarity that leads back to the true frame.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from benchmarks import perturb_masks as masks
from benchmarks import perturb_model as model
from benchmarks import perturb_photos as photos
from benchmarks import perturb_surfaces as surfaces
from benchmarks.perturb_copy import SceneCopy
from mgf_engine.errors import BadInput
from mgf_engine.files.atomic import write_json

RECORD = "perturbation.json"


@dataclass(frozen=True)
class Perturbation:
    """One way a scene gets worse.

    Attributes:
        title, unit: for charts and tables.
        levels: what is measured; the first leaves the scene as it is.
        apply: changes a copy of the scene to a level.
        masks: where runs take their masks from: ``prompts`` (clicks) or ``given`` (the copy's own ``masks`` folder:
            what the perturbation does to the field and the mesh alone).
    """

    title: str
    unit: str
    levels: tuple[float, ...]
    apply: Callable[[SceneCopy, float], None] = field(repr=False)
    masks: str = "prompts"


PERTURBATIONS: dict[str, Perturbation] = {
    "photos": Perturbation("Photos left", "", (30, 15, 8, 6, 4, 3), model.keep_photos),
    "side": Perturbation("Photos from one side", "degrees", (360, 240, 180, 120, 60), model.keep_side),
    "noise": Perturbation("Low light: sensor noise", "grey values", (0, 10, 25, 50, 90), photos.add_noise),
    "exposure": Perturbation("Exposure of each photo", "± EV", (0, 1, 2, 3), photos.change_exposure),
    "white_balance": Perturbation("White balance of each photo", "± EV", (0, 0.3, 0.6, 1.2), photos.change_balance),
    "blur": Perturbation("Motion blur", "px of 480", (0, 3, 6, 12, 24), photos.blur),
    "shadows": Perturbation("Moving shadows", "share of light lost", (0, 0.3, 0.6, 0.85), photos.cast_shadows),
    "foreign": Perturbation("Photos of another place", "photos", (0, 1, 3, 8, 15), photos.swap_foreign),
    "pose": Perturbation("Pose noise", "px of 480", (0, 0.5, 1, 2, 4), model.shake_poses, "given"),
    "focal": Perturbation("Focal length wrong", "%", (0, 1, 3, 10, 30), model.wrong_focal, "given"),
    "points_missing": Perturbation("Sparse points missing", "of all", (0, 0.5, 0.9, 0.97), model.drop_points),
    "points_outliers": Perturbation("Sparse points anywhere", "of all", (0, 0.25, 0.5, 0.8), model.scatter_points),
    "masks_eroded": Perturbation("Given masks eroded", "px of 480", (0, 4, 10, 25), masks.erode, "given"),
    "masks_dilated": Perturbation("Given masks dilated", "px of 480", (0, 4, 10, 25), masks.dilate, "given"),
    "masks_holes": Perturbation("Holes in given masks", "of the area", (0, 0.1, 0.3, 0.6), masks.punch_holes, "given"),
    "masks_wrong": Perturbation("Given masks wrong", "of the photos", (0, 0.1, 0.2, 0.35, 0.5), masks.replace, "given"),
    "scale": Perturbation("Scale of the scene", "factor", (1, 1e-3, 1e3), model.scale, "given"),
    "offset": Perturbation("Offset of the coordinates", "m", (0, 1e3, 1e6), model.offset, "given"),
    "blurred": Perturbation("Blurred photos among sharp ones", "photos", (0, 3, 8, 15), photos.blur_some),
    "walls": Perturbation("Plain walls: texture lost", "of all", (0, 0.5, 0.8, 1.0), surfaces.fade_walls),
    "mirrors": Perturbation("Windows that mirror", "of all", (0, 0.5, 1.0), surfaces.mirror_windows),
}  # fmt: skip


def perturb(source: Path, target: Path, name: str, level: float, seed: int = 0, other: Path | None = None) -> Path:
    """Write the scene in ``source`` into ``target``, made worse.

    Args:
        source: a synthetic scene with all its folders, see ``mgf bench scenes``.
        target: emptied first.
        name: of :data:`PERTURBATIONS`.
        level: in the perturbation's own unit.
        other: another scene whose photos ``foreign`` takes; without it, photos of the same scene turned upside down.

    Returns:
        ``target``.

    Raises:
        BadInput: no such perturbation, or the source is no scene.
    """
    if name not in PERTURBATIONS:
        raise BadInput(f"There is no perturbation '{name}'; take one of {', '.join(PERTURBATIONS)}.")
    if not (source / "scene.json").exists() or not (source / "sparse/0").is_dir():
        raise BadInput(f"'{source}' is no synthetic scene; make one with 'mgf bench scenes'.")
    shutil.rmtree(target, ignore_errors=True)
    place = list(PERTURBATIONS).index(name)
    copy = SceneCopy(source, target, np.random.default_rng([seed, place]), other)
    if level != PERTURBATIONS[name].levels[0]:
        PERTURBATIONS[name].apply(copy, level)
    copy.finish()
    record = {"name": name, "level": level, "seed": seed, "scale": copy.scale, "offset": list(copy.offset)}
    write_json(target / RECORD, record)
    return target
