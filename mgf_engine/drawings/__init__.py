# SPDX-License-Identifier: GPL-3.0-or-later
"""Drawings of a finished job: facade orthophotos, plans, elevations, sections, sheets and quantities.

Everything is drawn in the job's local frame (metres, z up; :mod:`mgf_engine.georef`) onto the plane of a
:class:`model.DrawingFrame`. ``load`` reads the job folder, ``facades`` finds the planes to draw on, ``project`` renders
the mesh by parallel rays, ``orthophoto`` paints what they hit from the photos, ``geotiff`` writes it; ``command`` is
``mgf drawings``.
"""
