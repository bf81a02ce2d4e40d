# SPDX-License-Identifier: GPL-3.0-or-later
"""Delaunay tetrahedralization of points (kernel ``mgf_delaunay``), on one thread in the background.

They are those of :mod:`mgf_engine.geometry.tetgen`, in an order of their own, and take a quarter of the memory: the
kernel numbers points and neighbours with 32 bits, and nothing is copied from process to process.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait

import numpy as np
from numpy.typing import NDArray

from mgf_engine.errors import BadInput
from mgf_engine.geometry.morton import along_curve
from mgf_engine.native.library import call
from mgf_engine.system.memory import fits_beside, require

_POLL_SECONDS = 0.1
_BYTES = 250.0  # of the work, per point (measured: 6.3 tetrahedra of 33 bytes each, and 36 of the points)
_FIRST_CAPACITY = 8  # tetrahedra per point that arrays are allocated for at first
_MOST = (2**31 - 1) // 4  # tetrahedra whose corners int32 can number
_ROUND = 3  # of one round of points 2^3 times as many as of the one before are inserted
_ROUNDS = 7
_GRID = 2.0**53  # the kernel's coordinates are whole numbers of 1 / _GRID
_MORE, _FLAT, _STOPPED = -1, -2, -3  # what the kernel returns

Points = NDArray[np.float64]
Tetrahedra = NDArray[np.int32]
#: Waits for the tetrahedra, [T, 4]; the check is called meanwhile, and may raise to cancel.
Waiting = Callable[[Callable[[], None]], Tetrahedra]


@contextlib.contextmanager
def background_delaunay(points: Points, around: Points | None = None) -> Iterator[Waiting]:
    """Begin :func:`delaunay` of points beside what is done inside; gives a function that waits for the result.

    Args:
        points: distinct, [M, 3].
        around: points to whose box they are scaled before: parts that are to fit together must be scaled alike, for
            it rounds their coordinates. The points themselves when None.

    Leaving stops the work. Where memory is short (:func:`mgf_engine.system.memory.fits_beside`) it begins when its
    result is asked for.

    Raises:
        BadInput: as :func:`delaunay`, here or from the function; or the user's limit of memory leaves no room for them.
    """
    check_volume(points)
    stop = np.zeros(1, np.int32)

    def work() -> Tetrahedra:
        return _made(scaled(points, points if around is None else around), stop)

    with ThreadPoolExecutor(1, "mgf-delaunay") as beside:
        early = beside.submit(work) if fits_beside(_BYTES * len(points)) else None

        def result(check: Callable[[], None]) -> Tetrahedra:
            nonlocal early
            check()
            if early is None:
                what = f"The tetrahedra of {len(points):,} points"
                require(_BYTES * len(points), what, "lower max_gaussians or resolution")
                early = beside.submit(work)
            while not wait([early], _POLL_SECONDS).done:
                check()
            found, early = early.result(), None  # whoever asked holds it: no second reference keeps it in memory
            return found

        try:
            yield result
        finally:
            stop[0] = 1


def delaunay(points: Points) -> Tetrahedra:
    """Return Delaunay tetrahedra [T, 4] of distinct points [M, 3], all of positive volume.

    Each begins with its corner of the lowest number, the next one follows, and they are sorted by their corners. Of
    five points on one sphere their numbers decide, so that the tetrahedra do not depend on how they are made.

    Raises:
        BadInput: fewer than four points, or all in one plane.
    """
    check_volume(points)
    return _made(scaled(points, points), np.zeros(1, np.int32))


def check_volume(points: Points) -> None:
    """Refuse points [M, 3] that there are no tetrahedra between.

    Raises:
        BadInput: they are in one plane.
    """
    if not spans_volume(points):
        raise _no_volume()


def spans_volume(points: Points) -> bool:
    """Tell whether points [M, 3] are more than a plane, so that there are tetrahedra between them."""
    if len(points) < 4:
        return False
    centred = points - points.mean(0)
    spread = np.linalg.svd(centred.T @ centred, compute_uv=False)
    return bool(spread[2] > 1e-14 * spread[0])


def scaled(points: Points, around: Points) -> Points:
    """Return points scaled so that the longest side of the box around others is 0..1."""
    low, size = around.min(0), float(np.ptp(around, axis=0).max())
    return np.ascontiguousarray((points - low) / size)


def _no_volume() -> BadInput:
    return BadInput("The field is a point, a line or a plane, and no surface can be made of it; train longer.")


def _made(points: Points, stop: NDArray[np.int32]) -> Tetrahedra:
    """Make the tetrahedra of scaled points [M, 3], which are rounded in place; none where ``stop`` is set meanwhile.

    Raises:
        BadInput: all points are in one plane.
        MemoryError: there is not enough.
    """
    points *= _GRID
    np.rint(points, out=points)
    points /= _GRID
    order, capacity = _insertion_order(points), min(_FIRST_CAPACITY * len(points) + 64, _MOST)
    while True:
        # Pages that nothing is written to take no memory: spare capacity costs nothing.
        corner, beyond = (np.empty((capacity, 4), np.int32) for _ in range(2))
        known = np.zeros(capacity, np.uint8)
        count = call("mgf_delaunay", len(points), points, order, capacity, corner, beyond, known, stop)
        if count != _MORE or capacity == _MOST:
            break
        capacity = min(2 * capacity, _MOST)
    if count == _STOPPED:
        return np.zeros((0, 4), np.int32)
    if count == _FLAT:
        raise _no_volume()
    if count < 0:
        raise MemoryError(f"The tetrahedra of {len(points):,} points do not fit.")
    del known, order
    first = np.empty(len(points) + 1, np.int64)
    return beyond[: call("mgf_sort_tetrahedra", count, corner, len(points), first, beyond)]


def _insertion_order(points: Points) -> NDArray[np.int32]:
    """Order points [M, 3] along a curve in rounds of ever more of them (Amenta et al. 2003): each lies near the one
    before, and none of the early ones stands for a region of its own."""
    along = along_curve(points)
    drawn, round_of = np.random.default_rng(0).integers(0, 1 << 30, len(points)), np.zeros(len(points), np.int8)
    for number in range(1, _ROUNDS + 1):
        round_of[drawn % (1 << _ROUND * number) == 0] = number
    return along[np.argsort(-round_of[along], kind="stable")].astype(np.int32)
