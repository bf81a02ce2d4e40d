# SPDX-License-Identifier: GPL-3.0-or-later
"""How good the result is: picture metrics, geometry metrics, and the report people read."""
