# SPDX-License-Identifier: GPL-3.0-or-later
"""Bundle adjustment with control points in a process of its own: ``python -m mgf_engine.georef.bundle_worker FOLDER``.

COLMAP and pyceres share Ceres' problem here, each with a build of Ceres of its own; what goes wrong between them ends
this process and not the job. One thread and fixed seeds: the result is always the same.
"""

from __future__ import annotations

import sys
import threading
from pathlib import Path

import numpy as np
import pycolmap
from numpy.typing import NDArray

from mgf_engine.scene.adjust_task import RESULT, TASK, AdjustmentTask, read_task, write_result
from mgf_engine.scene.adjust_worker import replaced_points
from mgf_engine.scene.colmap_bundle import Bundle
from mgf_engine.scene.sparse import SparseModel
from mgf_engine.system.subprocesses import end_with_the_job

Array = NDArray[np.float64]
#: Known coordinates of the model's last points, and their standard deviations.
KNOWN = "known.npz"


def main(folder: Path) -> int:
    """Do the task in ``folder`` and write the adjusted model beside it; exit code 0."""
    pycolmap.logging.minloglevel = int(pycolmap.logging.FATAL)
    pycolmap.set_random_seed(0)
    task = read_task(folder / TASK)
    with np.load(folder / KNOWN, allow_pickle=False) as file:
        model = adjust(task, file["targets"], file["sd"], *file["loss"].tolist())
    write_result(replaced_points(model, task.resolution, task.least_scale), folder / RESULT)
    return 0


def adjust(task: AdjustmentTask, targets: Array, sd: Array, loss: float, control_loss: float) -> SparseModel:
    """Adjust all images, focal lengths and points, the last points held near their known places.

    Residuals are working pixels whose standard deviation is ``task.before``; those of coordinates are brought to that.

    Args:
        task: model and chosen observations.
        targets, sd: known coordinates of the last points and their standard deviations, [N, 3] each.
        loss: scale of Cauchy's loss of observations, working pixels.
        control_loss: scale of Cauchy's loss of the coordinates, standard deviations; infinite for least squares.
    """
    import pyceres

    bundle = Bundle(task.model, task.resolution, task.chosen)
    config = pycolmap.BundleAdjustmentConfig()
    for number in bundle.reconstruction.images:
        config.add_image(number)
    adjuster = bundle.adjuster(config, loss)
    problem, kept = adjuster.problem, []  # what is added is not Ceres' to keep
    for number, target, own in zip(bundle.numbers[-len(targets) :].tolist(), targets, sd, strict=True):
        cost = pyceres.factors.NormalPrior(target, np.diag((own / task.before) ** 2))
        bent = pyceres.CauchyLoss(control_loss * task.before) if np.isfinite(control_loss) else pyceres.TrivialLoss()
        place = bundle.reconstruction.point3D(number).xyz
        problem.add_residual_block(cost, bent, [place])
        kept.append((cost, bent, place))
    adjuster.solve()
    return bundle.adjusted()


if __name__ == "__main__":
    threading.Thread(target=end_with_the_job, daemon=True).start()
    sys.exit(main(Path(sys.argv[1])))
