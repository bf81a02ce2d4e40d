# SPDX-License-Identifier: GPL-3.0-or-later
"""COLMAP scenes in Blender: exact cameras with their photos, and the sparse points."""
