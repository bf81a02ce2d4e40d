# SPDX-License-Identifier: GPL-3.0-or-later
"""A town out of ``mgf town``: a collection for each building, light at first, and the terrain between them."""
