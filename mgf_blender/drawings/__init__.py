# SPDX-License-Identifier: GPL-3.0-or-later
"""Drawings of a finished job: what to draw, where to cut, and a look at what came."""
