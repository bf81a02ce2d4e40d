# SPDX-License-Identifier: GPL-3.0-or-later
"""Evaluation of the result: image metrics, geometry metrics, and the report.

``images`` and ``lpips`` compare renders with photos, ``geometry`` and ``scan`` a mesh with a true mesh or a laser scan,
``evenness`` a mesh with its own planes; ``report`` writes the page, ``command`` is ``mgf evaluate``.
"""
