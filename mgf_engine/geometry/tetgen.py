# SPDX-License-Identifier: GPL-3.0-or-later
"""Delaunay tetrahedra of points by TetGen, in a worker process: ``python -m mgf_engine.geometry.tetgen COUNT``.

tetgen works on one core for seconds, and no other Python thread goes on meanwhile. A process of its own ends when the
job is cancelled, and its memory goes with it. Points and result go through pipes.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait

import numpy as np
from numpy.typing import NDArray

from mgf_engine.errors import EXIT_BAD_INPUT, BadInput
from mgf_engine.geometry.delaunay import check_volume, scaled
from mgf_engine.system.memory import fits_beside, require
from mgf_engine.system.subprocesses import end_with_the_job, worker

with contextlib.suppress(ModuleNotFoundError):  # one that is there and cannot be loaded says why itself
    from igl.copyleft import tetgen

COMMAND = (sys.executable, "-m", "mgf_engine.geometry.tetgen")
_POLL_SECONDS = 0.1
_BYTES = 1000.0  # of the process and its answer, per point (measured: 880 of tetgen, 104 of the answer)

Points = NDArray[np.float64]
Tetrahedra = NDArray[np.int32]


@contextlib.contextmanager
def background_delaunay(
    points: Points, around: Points | None = None
) -> Iterator[Callable[[Callable[[], None]], Tetrahedra]]:
    """Begin the tetrahedra of points beside what is done inside; gives a function that waits for them, [T, 4].

    Args:
        points: distinct, [M, 3].
        around: points to whose box they are scaled before: parts that are to fit together must be scaled alike, for
            it rounds their coordinates. The points themselves when None.

    That function takes a check that is called while it waits, and may raise to cancel. Leaving ends the process. Where
    memory is short (:func:`mgf_engine.system.memory.fits_beside`) the work begins when its result is asked for.

    Raises:
        BadInput: fewer than four points, or all in one plane; from the function: tetgen gave up, or the user's limit of
            memory leaves no room.
    """
    check_volume(points)
    points = scaled(points, points if around is None else around)
    with contextlib.ExitStack() as ending:
        early = ending.enter_context(_started(points)) if fits_beside(_BYTES * len(points)) else None

        def result(check: Callable[[], None]) -> Tetrahedra:
            if early is not None:
                return early(check)
            require(
                _BYTES * len(points), f"The tetrahedra of {len(points):,} points", "lower max_gaussians or resolution"
            )
            return ending.enter_context(_started(points))(check)

        yield result


@contextlib.contextmanager
def _started(points: Points) -> Iterator[Callable[[Callable[[], None]], Tetrahedra]]:
    pipe = subprocess.PIPE
    with (
        ThreadPoolExecutor(2, "mgf-delaunay") as beside,
        worker([*COMMAND, str(len(points))], stdin=pipe, stdout=pipe, stderr=pipe) as process,
    ):
        assert process.stderr
        answer: list[bytes] = []  # taken out by whoever waits for it: no second reference keeps it in memory
        talk = beside.submit(_talk, process, points, answer)
        errors = beside.submit(process.stderr.read)  # a full pipe would stop the process

        def result(check: Callable[[], None]) -> Tetrahedra:
            check()
            while not wait([talk], _POLL_SECONDS).done:
                check()
            talk.result()
            said, code = errors.result(), process.wait()
            if code != 0:
                check()  # what ends the job may have ended the process, too
                raise BadInput(_why(code, said.decode(errors="replace")))
            return np.frombuffer(answer.pop(), np.int32).reshape(-1, 4)

        try:
            yield result
        finally:
            process.kill()


def _talk(process: subprocess.Popen[bytes], points: Points, answer: list[bytes]) -> None:
    """Hand the points over, and add what the process then writes to stdout to ``answer``."""
    assert process.stdin and process.stdout
    with contextlib.suppress(OSError):  # it is gone already: its code says why
        process.stdin.write(np.ascontiguousarray(points).data)
        process.stdin.flush()
    answer.append(process.stdout.read())


def tetrahedralize(points: Points) -> Tetrahedra:
    """Return Delaunay tetrahedra [T, 4] of distinct points [M, 3] between 0 and 1, all of one sense.

    Raises:
        BadInput: tetgen is not installed, or gives up.
    """
    if "tetgen" not in globals():
        raise BadInput("libigl is not installed; run 'pip install libigl'.")
    try:
        result = tetgen.tetrahedralize(points, flags="Q")
    except RuntimeError as error:
        raise BadInput(f"The tetrahedra of the field could not be made ({error}); train longer.") from error
    if len(result[0]) != len(points):
        raise RuntimeError("tetgen changed the points")
    return result[1].astype(np.int32)


def main(count: int) -> int:
    """Read points from stdin, write tetrahedra to stdout; returns 0, or EXIT_BAD_INPUT and writes a sentence."""
    answer = os.dup(1)
    os.dup2(2, 1)  # what tetgen prints goes elsewhere
    points = np.frombuffer(sys.stdin.buffer.read(3 * 8 * count)).reshape(-1, 3)
    threading.Thread(target=end_with_the_job, daemon=True).start()
    try:
        found = tetrahedralize(points)  # `background_delaunay` has looked at the points
    except BadInput as error:
        print(error, file=sys.stderr)
        return EXIT_BAD_INPUT
    with os.fdopen(answer, "wb") as stdout:
        stdout.write(found.astype(np.int32).tobytes())
    return 0


def _why(code: int, said: str) -> str:
    if code == EXIT_BAD_INPUT and said.strip():
        return said.strip().splitlines()[-1]
    return (
        f"The tetrahedra of the field could not be made (tetgen ended with code {code}); "
        "if memory ran out, lower max_gaussians."
    )


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1])))
