# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes of flat sheets: walls, boxes, and what noise makes of them."""

import numpy as np

from mgf_engine.geometry.clean import weld
from mgf_engine.model.mesh import Mesh

NOISE = 0.2  # ground pixels, which are 1 here


def sheet(u, v, place):
    """A grid over ``u`` and ``v`` at ``place(u, v)``, facing along the cross product of its axes."""
    grid = np.stack(np.meshgrid(u, v, indexing="ij"), -1).reshape(-1, 2)
    at = np.arange(len(grid)).reshape(len(u), len(v))
    a, b, c, d = (part.ravel() for part in (at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]))
    return np.asarray(place(*grid.T), float).T, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])


def joined(*sheets):
    """Sheets with one vertex where they meet."""
    sizes = np.cumsum([0, *(len(points) for points, _ in sheets)])
    faces = np.concatenate([faces + start for (_, faces), start in zip(sheets, sizes[:-1], strict=True)])
    points = np.concatenate([points for points, _ in sheets])
    return weld(Mesh(np.round(points, 6), faces.astype(np.int32), np.zeros((len(points), 3), np.uint8)))


def box(x, y, z, step=1.5):
    """A closed box from the origin, its faces outward."""
    size = np.array([x, y, z], float)
    sides = []
    for axis in range(3):
        first, second = (axis + 1) % 3, (axis + 2) % 3
        for at, (i, j) in ((size[axis], (first, second)), (0.0, (second, first))):

            def place(u, v, at=at, i=i, j=j, axis=axis):
                points = np.empty((3, len(u)))
                points[axis], points[i], points[j] = at, u, v
                return points

            sides.append(sheet(*(np.linspace(0, size[k], round(size[k] / step) + 1) for k in (i, j)), place))
    return joined(*sides)


def noisy(mesh, noise=NOISE, seed=0):
    moved = mesh.vertices + np.random.default_rng(seed).normal(0, noise, mesh.vertices.shape)
    return Mesh(moved, mesh.faces, mesh.colors)
