# SPDX-License-Identifier: GPL-3.0-or-later
"""Clicks on root photos: the list of photos, the point tool, drawing, files, and the mask preview."""
