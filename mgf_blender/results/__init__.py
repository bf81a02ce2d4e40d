# SPDX-License-Identifier: GPL-3.0-or-later
"""Results of a job in Blender: mesh, renders, field, figures."""
