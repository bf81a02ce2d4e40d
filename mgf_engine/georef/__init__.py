# SPDX-License-Identifier: GPL-3.0-or-later
"""Georeferencing: metres, up, north and a CRS for a job's scene, from GPS, control points, scale bars or walls.

``find`` takes the best that there is: ``control_points``, ``gps`` and ``scale_bars`` read it, ``fit_control`` and
``fit_gps`` lay the scene onto it. ``adjust`` lets control points shape the scene while it is made, ``apply`` gives a
job its georeference, ``export`` writes the mesh in true coordinates; ``command`` is ``mgf georef``.
"""
