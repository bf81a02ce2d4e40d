# SPDX-License-Identifier: GPL-3.0-or-later
"""Import of what ``mgf town`` made: a collection per building, with few faces at first, and the terrain."""
