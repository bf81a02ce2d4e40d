# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes with ground truth, suites of runs over them, and the charts made from the figures."""
