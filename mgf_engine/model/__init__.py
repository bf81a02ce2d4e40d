# SPDX-License-Identifier: GPL-3.0-or-later
"""Data classes that the stages exchange: scene, masks, Gaussians and mesh. They import no other package."""
