# SPDX-License-Identifier: GPL-3.0-or-later
"""How good the result is: picture metrics, geometry metrics, and the report people read.

``images`` and ``lpips`` compare renders with photos, ``geometry`` and ``scan`` a mesh with a true mesh or a laser scan,
``evenness`` a mesh with its own planes; ``report`` writes the page, ``command`` is ``mgf evaluate``.
"""
