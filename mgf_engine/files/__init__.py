# SPDX-License-Identifier: GPL-3.0-or-later
"""Read and write files safely: images, arrays, whole files or none."""
