# SPDX-License-Identifier: GPL-3.0-or-later
"""Openings of walls (windows, doors, niches): rectangles that are found by their depth and located in the photos.

``detection`` finds them in a depth map of a wall, ``photo_edges`` moves their edges to where photos have them; both
work in the coordinates of a wall (``wall_frame``). The mesh stage cuts them into the mesh
(:mod:`mgf_engine.mesh.cut_openings`), drawings draw them.
"""
