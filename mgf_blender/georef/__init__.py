# SPDX-License-Identifier: GPL-3.0-or-later
"""True coordinates: control points marked in photos, the run that uses them, and the scene where it truly is."""
