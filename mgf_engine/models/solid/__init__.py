# SPDX-License-Identifier: GPL-3.0-or-later
"""A closed polyhedron of roof, walls and ground (level of detail 2) from the planes of a mesh.

``evidence`` reads heights, roof planes and wall lines off the mesh; ``cells`` cuts the ground plan into cells along
those lines; ``labels`` gives each cell a roof plane or leaves it outside; ``polyhedron`` makes the faces; ``build``
does all of it and measures the result.
"""
