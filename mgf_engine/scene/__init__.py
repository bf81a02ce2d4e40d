# SPDX-License-Identifier: GPL-3.0-or-later
"""First stage: photos and cameras from COLMAP (or SfM), undistorted, resized, in a normalised frame.

``load`` runs it, in this order: ``colmap`` finds and reads the model, or ``sfm`` makes one; ``adjust`` mends cameras
that contradict it; ``photos`` and ``cameras`` make the working photos; ``normalise`` sets the frame; ``validation``,
``quality`` and ``exposure`` check the photos; ``store`` writes the scene. Later stages come back for what needs photos
and cameras alone: ``gravity`` (up), ``stereo``, ``depths`` and ``patch_match`` (depth maps), ``neighbours``.
"""
