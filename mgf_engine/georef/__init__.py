# SPDX-License-Identifier: GPL-3.0-or-later
"""Where on Earth a job's scene is: from GPS, control points, scale bars or walls to metres, up, north and a CRS."""
