# SPDX-License-Identifier: GPL-3.0-or-later
"""MGF in Blender: photos of a building in, the building as a mesh in the scene out."""
