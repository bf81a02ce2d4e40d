# SPDX-License-Identifier: GPL-3.0-or-later
"""The starting surface: a closed surface of the building from edges, planes, stereo and masks, before any field.

Plain walls give stereo nothing to match, but their edges are sharp, planes through edges are accurate, and rays to what
photos show keep the space before it free. In the order of the work: ``views``, ``segments`` (edges in photos),
``lines`` (in space), ``dense`` (stereo where there is texture), ``planes``, ``snapping`` (points onto planes),
``evidence`` (points of all kinds), ``cut`` (inside or outside, by an s-t cut over tetrahedra), ``samples`` (points that
the field starts from). ``surface`` runs them.
"""
