# SPDX-License-Identifier: GPL-3.0-or-later
"""Algorithms on triangle meshes and points alone: z-buffer, cleaning, Delaunay tetrahedra, reading and writing."""
