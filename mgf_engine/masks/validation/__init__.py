# SPDX-License-Identifier: GPL-3.0-or-later
"""Check masks: which are left out (``mask_flags``), and what to warn of.

``cross_view_consistency`` and ``mask_coverage`` check masks that the user gave; ``building_size`` and ``low_texture``
look at how well the photos show the building.
"""
