# SPDX-License-Identifier: GPL-3.0-or-later
"""Native code: the C and CUDA kernels, how they are compiled and loaded, and the threads that run them.

Kernels lie by subject in ``csrc`` (raster, mesh, stereo, image). ``build`` compiles them, ``library`` loads the best
variant for this processor, ``parallel`` runs Python functions on threads.
"""
