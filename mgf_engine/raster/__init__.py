# SPDX-License-Identifier: GPL-3.0-or-later
"""The rasterizer: kernels that project, sort, blend and differentiate Gaussians, and a plain reference of each.

``api`` renders on a backend: ``cpu`` calls the C kernels, ``cuda`` those of a GPU, ``reference`` is float64 torch.
``loss`` computes the terms of the training loss and their gradients, ``adam`` the step.
"""
