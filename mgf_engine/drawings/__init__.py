# SPDX-License-Identifier: GPL-3.0-or-later
"""Drawings of a finished job: facade orthophotos, plans, elevations, sections, sheets and quantities.

Everything is drawn in the job's local frame (metres, z up; :mod:`mgf_engine.georef`) onto a :class:`model.Frame`.
``load`` reads the job folder, ``facades`` finds the planes to draw on, ``project`` looks at the mesh along parallel
rays, ``orthophoto`` paints what it sees from the photos, ``geotiff`` writes it; ``command`` is ``mgf drawings``.
"""
