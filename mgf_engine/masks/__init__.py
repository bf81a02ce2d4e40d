# SPDX-License-Identifier: GPL-3.0-or-later
"""Second stage: which pixels and which sparse points are the building (section 3.1 of the paper).

``build`` runs it. ``prompts`` reads the clicks, ``propagation`` takes them to all photos, with the coarse ``geometry``
of the building as evidence, ``segmenters`` draw the masks, ``refinement`` corrects them, ``points`` lets them vote on
the sparse points, ``parts`` finds windows and doors, ``store`` writes them. Masks that the user gives come in by
``user_masks`` and are checked by ``validation``.
"""
