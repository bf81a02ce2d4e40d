# SPDX-License-Identifier: GPL-3.0-or-later
"""Openings of walls (windows, doors, niches): found by their depth, and located in the photos.

``detection`` finds them in a depth map of a wall. ``locate`` puts them where photos have them: their edges
(``photo_edges``), and their heads, which are level or arched (``arches``). All work in the coordinates of a wall
(``wall_frame``). The mesh stage cuts them into the mesh
(:mod:`mgf_engine.mesh.cut_openings`), drawings draw them.
"""
