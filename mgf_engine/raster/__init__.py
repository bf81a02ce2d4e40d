# SPDX-License-Identifier: GPL-3.0-or-later
"""The rasterizer: kernels that project, sort, blend and differentiate Gaussians, and their plain twins."""
