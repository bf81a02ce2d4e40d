# SPDX-License-Identifier: GPL-3.0-or-later
"""Data classes that stages hand to each other: scene, masks, Gaussians and mesh. They sit below everything else."""
