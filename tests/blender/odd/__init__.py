# SPDX-License-Identifier: GPL-3.0-or-later
"""Odd states of Blender's data and of files, for :mod:`odd_states`: a function makes each, and names it."""
