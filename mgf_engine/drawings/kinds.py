# SPDX-License-Identifier: GPL-3.0-or-later
"""The kinds of drawings."""

#: What ``--draw`` takes.
KINDS = ("orthophotos", "elevations", "sections", "sheets", "quantities")
