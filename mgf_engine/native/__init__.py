# SPDX-License-Identifier: GPL-3.0-or-later
"""Native code: the C and CUDA kernels, how they are compiled and loaded, and the threads that run them."""
