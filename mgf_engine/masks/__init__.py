# SPDX-License-Identifier: GPL-3.0-or-later
"""Second stage: which pixels and which sparse points are the building (section 3.1 of the paper)."""
