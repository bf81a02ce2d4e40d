# SPDX-License-Identifier: GPL-3.0-or-later
"""Second stage: which pixels and which sparse points are the building (section 3.1 of the paper).

``build`` runs the stage:

1. ``prompts`` reads the clicks; ``user_masks`` reads masks that the user gives instead.
2. ``propagation`` labels the superpixels of all photos from the clicks, with the coarse ``geometry`` of the building as
   evidence; ``segmenters`` draw the masks.
3. ``refinement`` corrects the masks pixel by pixel; ``validation`` leaves out those that contradict the others.
4. ``points`` votes on the sparse points by the masks; ``elements`` and ``parts`` find windows and doors.
5. ``store`` writes the label maps.
"""
