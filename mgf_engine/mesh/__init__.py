# SPDX-License-Identifier: GPL-3.0-or-later
"""Fourth stage: from the trained field to a clean triangle mesh (section 3.3 of the paper).

``extract`` runs the steps in order:

1. ``screening`` selects the Gaussians inside the masks; ``tetrahedra`` makes points of them and joins these.
2. ``depth_maps`` renders a depth map of each photo, refines it by patch matching (``photometric``), chooses between
   field and starting surface (``prior``) and smooths it (``depth_smoothing``).
3. ``tsdf`` fuses the depth maps into a signed distance (``surface=fused``); ``opacity`` evaluates the opacity of the
   Gaussians instead (``surface=opacity``).
4. ``level_set`` extracts the isosurface by marching tetrahedra (``isosurface``), and ``level_set_cleaning`` cleans it.
5. ``refine`` moves vertices to where the photos agree, ``planar`` projects walls onto planes, ``extend_planes`` extends
   these planes, and ``border_smoothing`` trims open borders.
6. ``colors`` colours the vertices from the photos, ``decimate`` simplifies the mesh, and ``low_confidence_fill`` fills
   unconfirmed dents.

Most distances are in ground pixels (``ground_pixels``): what a pixel of the nearest photo covers on the surface.
"""
