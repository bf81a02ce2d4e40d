# SPDX-License-Identifier: GPL-3.0-or-later
"""MGF engine: photos of a building in, a clean mesh of that building out.

Data flows one way, scene -> masks -> field -> mesh -> deliver; every stage reads what the one before
left in the job folder. Nothing in this package imports ``bpy``.
"""

__version__ = "0.1.0"
