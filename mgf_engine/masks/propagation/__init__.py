# SPDX-License-Identifier: GPL-3.0-or-later
"""Propagate clicks to all photos by random walks over superpixels and sparse points (:mod:`propagate`)."""
