# SPDX-License-Identifier: GPL-3.0-or-later
"""Delaunay tetrahedra of points, made in a process of their own: ``python -m mgf_engine.mesh.delaunay FOLDER``.

tetgen works on one core for seconds, and no other Python thread goes on meanwhile. A process of its own ends when the
job is cancelled, and its memory goes with it. Points and result lie in a folder of the two of them.
"""

from __future__ import annotations

import contextlib
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mgf_engine.errors import EXIT_BAD_INPUT, BadInput
from mgf_engine.workers import end_with_the_job, wait_for

with contextlib.suppress(ModuleNotFoundError):  # one that is there and cannot be loaded says why itself
    from igl.copyleft import tetgen

COMMAND = (sys.executable, "-m", "mgf_engine.mesh.delaunay")
_POINTS, _TETRAHEDRA = "points.npy", "tetrahedra.npy"

Points = NDArray[np.float64]
Tetrahedra = NDArray[np.int32]


@contextlib.contextmanager
def begun(points: Points) -> Iterator[Callable[[Callable[[], None]], Tetrahedra]]:
    """Begins :func:`delaunay` of points beside what is done inside; gives a function that waits for the result.

    That function takes a check that is called while it waits, and may raise to cancel. Leaving ends the process.

    Raises:
        BadInput: as :func:`delaunay`, here or from the function.
    """
    _check(points)
    with tempfile.TemporaryDirectory(prefix="mgf-") as name:
        folder = Path(name)
        np.save(folder / _POINTS, points)
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}
        with subprocess.Popen([*COMMAND, name], **pipes) as process:  # type: ignore[call-overload]

            def result(check: Callable[[], None]) -> Tetrahedra:
                wait_for(process, check)
                if process.returncode != 0:
                    raise BadInput(_why(process))
                found: Tetrahedra = np.load(folder / _TETRAHEDRA)
                return found

            try:
                yield result
            finally:
                process.kill()


def delaunay(points: Points, method: str = "tetgen") -> Tetrahedra:
    """Delaunay tetrahedra [T, 4] of distinct points [M, 3], all of positive volume.

    Args:
        method: "tetgen" (libigl; fast) or "qhull" (SciPy; permissive licence, about ten times slower).

    Raises:
        BadInput: fewer than four points, or all in one plane, or the chosen method is not installed.
    """
    _check(points)
    if method == "tetgen":
        return _tetgen(points)
    from scipy.spatial import Delaunay

    return _positive(points, Delaunay(points).simplices.astype(np.int32))


def main(folder: Path) -> int:
    """The tetrahedra of the points in ``folder``; exit code 0, or EXIT_BAD_INPUT and a sentence on stderr."""
    try:
        np.save(folder / _TETRAHEDRA, delaunay(np.load(folder / _POINTS)))
    except BadInput as error:
        print(error, file=sys.stderr)
        return EXIT_BAD_INPUT
    return 0


def _why(process: subprocess.Popen[bytes]) -> str:
    said = b"" if process.stderr is None else process.stderr.read()
    if process.returncode == EXIT_BAD_INPUT:
        return said.decode(errors="replace").strip()
    return (
        f"The tetrahedra of the field could not be made (tetgen ended with code {process.returncode}); "
        "if memory ran out, lower max_gaussians."
    )


def _check(points: Points) -> None:
    if len(points) < 4 or _flat(points):
        raise BadInput("The field is a point, a line or a plane, and no surface can be made of it; train longer.")


def _flat(points: Points) -> bool:
    centred = points - points.mean(0)
    spread = np.linalg.svd(centred.T @ centred, compute_uv=False)
    return bool(spread[2] <= 1e-14 * spread[0])


def _tetgen(points: Points) -> Tetrahedra:
    if "tetgen" not in globals():
        raise BadInput("libigl is not installed; run 'pip install libigl' or choose the method 'qhull'.")
    low, size = points.min(0), float(np.ptp(points, axis=0).max())
    try:
        result = tetgen.tetrahedralize(np.ascontiguousarray((points - low) / size), flags="Q")
    except RuntimeError as error:
        raise BadInput(f"The tetrahedra of the field could not be made ({error}); train longer.") from error
    if len(result[0]) != len(points):
        raise RuntimeError("tetgen changed the points")
    return result[1].astype(np.int32)


def _positive(points: Points, tetrahedra: Tetrahedra) -> Tetrahedra:
    """The tetrahedra that have a volume, turned so that it is positive."""
    a, b, c, d = (points[tetrahedra[:, k]] for k in range(4))
    volume = np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a)
    turned = tetrahedra.copy()
    turned[volume < 0] = turned[volume < 0][:, [0, 1, 3, 2]]
    return turned[volume != 0]


if __name__ == "__main__":
    threading.Thread(target=end_with_the_job, daemon=True).start()
    sys.exit(main(Path(sys.argv[1])))
