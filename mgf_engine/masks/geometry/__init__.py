# SPDX-License-Identifier: GPL-3.0-or-later
"""Coarse geometry of the building from sparse points: ground plane, extent, surface and visual hull."""
