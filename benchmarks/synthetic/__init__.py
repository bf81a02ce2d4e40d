# SPDX-License-Identifier: GPL-3.0-or-later
"""Small scenes computed in seconds without Blender, for tests and measurements."""
