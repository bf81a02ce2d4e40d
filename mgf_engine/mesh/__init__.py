# SPDX-License-Identifier: GPL-3.0-or-later
"""Fourth stage: from the trained field to a clean triangle mesh (section 3.3 of the paper).

``extract`` runs it: ``screening`` and ``tetrahedra`` span points, ``depth_maps`` (rendered, matched by ``photometric``,
smoothed) are fused by ``tsdf``, or ``opacity`` asks the field itself; ``level_set`` takes the surface between solid and
free; ``refine`` moves it by the photos, ``planar`` flattens walls, ``extend_planes`` fills
dents and sharpens edges, ``colors`` paints it, ``decimate`` reduces it.
"""
