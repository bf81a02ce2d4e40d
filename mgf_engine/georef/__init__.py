# SPDX-License-Identifier: GPL-3.0-or-later
"""Where on Earth a job's scene is: from GPS, control points, scale bars or walls to metres, up, north and a CRS.

``find`` takes the best that there is: ``control``, ``gps`` and ``bars`` read it, ``fit_control`` and ``fit_gps`` lay
the scene onto it. ``adjust`` lets control points shape the scene while it is made, ``apply`` gives a job its
georeference, ``export`` writes the mesh in true coordinates; ``command`` is ``mgf georef``.
"""
