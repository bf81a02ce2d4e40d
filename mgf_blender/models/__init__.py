# SPDX-License-Identifier: GPL-3.0-or-later
"""Models of a finished job: what to make, and its levels of detail as one object in the scene."""
