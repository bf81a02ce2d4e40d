# SPDX-License-Identifier: GPL-3.0-or-later
"""Models of a finished job: levels of detail, 3D Tiles, a solid of roof, walls and ground, USD and points.

``command`` is ``mgf models``, ``make`` writes everything into one folder; ``lod`` and ``atlas`` make the levels of
detail, ``tiles`` puts them on the globe.
"""
