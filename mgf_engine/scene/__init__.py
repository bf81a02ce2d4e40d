# SPDX-License-Identifier: GPL-3.0-or-later
"""First stage: photos and cameras from COLMAP (or SfM), undistorted, resized, in a normalised frame."""
