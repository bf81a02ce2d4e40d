# SPDX-License-Identifier: GPL-3.0-or-later
"""Close holes of a mesh: small ones that no photo looks through, and the bottom if the user asks for it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mgf_engine.geometry.clean import edge_keys, open_edges
from mgf_engine.model.mesh import Mesh

_EARS = 40  # candidates, those with the best angle, that are tested for points inside


def boundary_loops(mesh: Mesh) -> list[NDArray[np.int32]]:
    """Walk the closed loops of vertices along open edges, each in the direction of its faces."""
    start, end = open_edges(mesh)
    following: dict[int, list[int]] = {}
    for a, b in zip(start.tolist(), end.tolist(), strict=True):
        following.setdefault(a, []).append(b)
    loops: list[NDArray[np.int32]] = []
    for first in sorted(following):
        while following.get(first):
            loop, here = [first], following[first].pop()
            while here != first and following.get(here):
                loop.append(here)
                here = following[here].pop()
            if here == first and len(loop) >= 3:
                loops.append(np.array(loop, np.int32))
    return loops


def fill_holes(
    mesh: Mesh,
    longest: float | NDArray[np.floating[Any]],
    is_free: Callable[[NDArray[np.float64]], NDArray[np.bool_]] = lambda points: np.zeros(len(points), bool),
) -> Mesh:
    """Close small holes by a fan around their middle, unless the photos look through them.

    Args:
        longest: rim up to which a hole is small, in the mesh's units, [N] (the median over the rim counts) or one for
            all.
        is_free: points [P, 3] -> bool [P], where views see that nothing is; a hole half of whose patch is free is a
            real opening and stays.
    """
    limit = np.broadcast_to(np.asarray(longest, np.float64), len(mesh.vertices))
    loops = [loop for loop in boundary_loops(mesh) if rim_length(mesh, loop) <= np.median(limit[loop])]
    if not loops:
        return mesh
    middles = np.stack([mesh.vertices[loop].mean(0) for loop in loops])
    spokes = [0.5 * (mesh.vertices[loop] + middle) for loop, middle in zip(loops, middles, strict=True)]
    owner = np.r_[np.arange(len(loops)), np.repeat(np.arange(len(loops)), [len(loop) for loop in loops])]
    free = is_free(np.concatenate([middles, *spokes]))
    opening = np.bincount(owner, weights=free) > 0.5 * np.bincount(owner)
    return _add_fans(mesh, [loop for loop, kept_open in zip(loops, opening, strict=True) if not kept_open])


def rim_length(mesh: Mesh, loop: NDArray[np.int32]) -> float:
    """Measure a closed loop of vertices [L], in the mesh's units."""
    rim = mesh.vertices[loop]
    return float(np.linalg.norm(rim - np.roll(rim, -1, axis=0), axis=1).sum())


def _add_fans(mesh: Mesh, loops: list[NDArray[np.int32]]) -> Mesh:
    """Return the mesh with each loop closed; three vertices by one face, more by a fan around a new vertex."""
    fans = [loop for loop in loops if len(loop) > 3]
    faces: list[NDArray[Any]] = [mesh.faces]
    origin: list[NDArray[Any]] = [np.arange(len(mesh.vertices))]
    for loop in loops:
        if len(loop) == 3:
            faces.append(loop[None, ::-1])
    for number, loop in enumerate(fans, start=len(mesh.vertices)):
        faces.append(np.column_stack([np.roll(loop, -1), loop, np.full(len(loop), number)]).astype(np.int32))
        origin.append(loop[:1])  # further values of the middle are those of a vertex on the rim
    whole = mesh.gather(np.concatenate(origin), np.concatenate(faces))
    for number, loop in enumerate(fans, start=len(mesh.vertices)):
        whole.vertices[number] = mesh.vertices[loop].mean(0)
        whole.colors[number] = mesh.colors[loop].mean(0).astype(np.uint8)
    return whole


def cap_rims(mesh: Mesh) -> Mesh:
    """Close every loop of open edges by triangles between its vertices (ear clipping): the bottom of a building."""
    known = set(np.unique(edge_keys(mesh.faces)[0]).tolist())
    caps = [_clip_ears(mesh.vertices[loop], loop, known) for loop in boundary_loops(mesh)]
    return replace(mesh, faces=np.concatenate([mesh.faces, *caps]).astype(np.int32))


def _clip_ears(rim: NDArray[np.float64], loop: NDArray[np.int32], known: set[int]) -> NDArray[np.int32]:
    """Return triangles over a rim [n, 3], facing away from the faces that border it; ears with the best angle go first.

    Args:
        known: keys of the edges the mesh has (:func:`mgf_engine.geometry.clean.edge_keys`): a chord along one of
            them would give it a third face. Chords that are made are added.
    """
    following = np.roll(rim, -1, axis=0)
    normal = -np.cross(rim, following).sum(0)  # the cap runs against the direction of the rim
    if not np.any(normal):
        return np.zeros((0, 3), np.int32)
    normal /= np.linalg.norm(normal)
    first = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    first /= np.linalg.norm(first)
    flat = (rim @ np.stack([first, np.cross(normal, first)], 1))[::-1]  # now counter-clockwise about the normal
    names, left, faces = loop[::-1], list(range(len(loop))), []
    while len(left) > 3:
        p = flat[left]
        before, after = np.roll(p, 1, axis=0), np.roll(p, -1, axis=0)
        turn = _cross2(p - before, after - p)
        length = np.linalg.norm(p - before, axis=1) * np.linalg.norm(after - p, axis=1)
        best = np.argsort(-turn / np.maximum(length, 1e-30), kind="stable")
        ends = names[np.roll(left, 1)].astype(np.int64), names[np.roll(left, -1)].astype(np.int64)
        chord = (np.minimum(*ends) << 32 | np.maximum(*ends)).tolist()
        new = [i for i in best.tolist() if chord[i] not in known] or best.tolist()
        ear = next((i for i in new[:_EARS] if turn[i] > 0 and not _contains_any(before[i], p[i], after[i], p)), new[0])
        known.add(chord[ear])
        faces.append([left[ear - 1], left[ear], left[(ear + 1) % len(left)]])
        del left[ear]
    return names[np.array([*faces, left])].astype(np.int32)


def _contains_any(
    a: NDArray[np.float64], b: NDArray[np.float64], c: NDArray[np.float64], p: NDArray[np.float64]
) -> bool:
    """Tell whether a point of p [n, 2] lies inside the counter-clockwise triangle."""
    inside = (_cross2(b - a, p - a) > 0) & (_cross2(c - b, p - b) > 0) & (_cross2(a - c, p - c) > 0)
    return bool(inside.any())


def _cross2(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])
