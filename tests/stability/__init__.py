# SPDX-License-Identifier: GPL-3.0-or-later
"""Where things break: perturbed scenes, faults, repeatability."""
