# SPDX-License-Identifier: GPL-3.0-or-later
"""CUDA on the GPU that torch uses: driver calls, run-time compiler, launcher, and the list of checked GPUs."""
