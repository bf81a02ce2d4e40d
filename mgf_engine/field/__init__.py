# SPDX-License-Identifier: GPL-3.0-or-later
"""Third stage: train the masked Gaussian field (section 3.2 of the paper).

``trainer`` is the loop: ``start`` places the first Gaussians, ``losses`` compares their renders with ``targets``,
``schedule`` and ``optimiser`` move them, ``density`` splits and prunes, ``filter3d`` keeps them from being too fine,
``checkpoint`` and ``export`` write them.
"""
