# SPDX-License-Identifier: GPL-3.0-or-later
"""Segmenters: draw the mask of one photo from clicks, sparse points and the probability of building."""
