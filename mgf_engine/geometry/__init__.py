# SPDX-License-Identifier: GPL-3.0-or-later
"""Triangle meshes as such: rasterized, cleaned, tetrahedralized, read and written; no field, no photo."""
