# SPDX-License-Identifier: GPL-3.0-or-later
"""Sentences of the engine that a job is likely to end with or to warn of, for the translations.

Written as :func:`~.engine_messages.in_panel_terms` returns them, with a name in place of each value. What is not listed
is shown in English.
"""

from __future__ import annotations

from ..common.text import N_

#: Why jobs end early.
FAILURES = (
    N_("Out of memory; lower Resolution or Max Gaussians and press Reconstruct Building."),
    N_("The GPU's memory is full; lower Resolution or Max Gaussians, or use Device cpu."),
    N_("The disk of '{folder}' is full; free some space and press Resume."),
    N_("No permission for '{path}'; change its permissions or give another folder."),
    N_("The job folder '{folder}' is in use by another process; wait or stop it."),
    N_(
        "'{folder}' holds no COLMAP model and too few photos ({count}); give a COLMAP scene or at least {fewest} "
        "photos."
    ),
    N_("The COLMAP model '{folder}' is not complete (missing: {files}); copy all its files."),
    N_("The COLMAP model '{folder}' has no points; triangulate it, the job starts from them."),
    N_(
        "{missing} of {count} photos of the COLMAP model are not there (first: '{photo}'); put the photos into "
        "'{folder}', or take them out of the model (colmap image_deleter)."
    ),
    N_("{lost} of {count} photos cannot be used, the first of them: {reason}"),
    N_("The photo '{path}' {state}; replace the file or export the photo again."),
    N_(
        "The photo '{path}' is {width} x {height} pixels but its camera {camera_width} x {camera_height}, as if it was "
        "turned since; use the photos the COLMAP model was made from."
    ),
    N_(
        "The photo '{path}' is {width} x {height} pixels but its camera {camera_width} x {camera_height}; use the "
        "photos the COLMAP model was made from."
    ),
    N_("No photo got a usable mask; click more points on the building and beside it, in more photos."),
    N_("No mask in '{folder}' fits a photo; name each like its photo, for example '{example}'."),
    N_("'{file}' has no click on the building in '{photo}'; click at least one point on it."),
    N_("Every mask in '{folder}' is empty; the building should be white, the rest black."),
    N_(
        "Only {count} points lie on the building, too few to start from; add clicks on the building, or photos that "
        "overlap more."
    ),
    N_("Masks and photos give no starting surface; check the masks and the cameras."),
    N_("The field has no surface inside the masks; train longer, or check the masks and the cameras."),
    N_("No surface lies in the crop box; enlarge it or move it over the building."),
)

#: Of the warnings, what only matters until the job is done.
PASSING = N_(
    "{found} of {count} photos could be registered at first; structure from motion runs again with "
    "affine-covariant features, which match photos taken farther apart."
)
#: What jobs warn of.
WARNINGS = (
    PASSING,
    N_(
        "{lost} of {count} photos are missing or cannot be read and are left out ({photos}); put the files back or "
        "export the photos again, and run again."
    ),
    N_(
        "{lost} of {count} photos could not be registered and are left out; photos taken closer together, with more "
        "overlap, would help."
    ),
    N_(
        "{lost} of {count} photos do not match the COLMAP model and are left out ({photos}); check whether they show "
        "another place."
    ),
    N_(
        "{lost} of {count} photos are much less sharp than the others and are left out ({photos}); sharp ones in their "
        "place would help."
    ),
    N_(
        "{found} of {count} photos are much less sharp than the others ({photos}): the mesh will lose detail; take "
        "them again."
    ),
    N_(
        "The photos are blurred by three pixels or more at working resolution; the mesh will lose detail. Take them "
        "again in focus, with a shorter exposure."
    ),
    N_(
        "There are only {count} photos, {angle} degrees apart seen from the building: expect holes and depth errors. "
        "Photos 5 to 15 degrees apart would help."
    ),
    N_("The photos cover only {angle} degrees around the building; the other sides will be missing or interpolated."),
    N_(
        "{share} of the sparse points have large reprojection errors and are left out; build the COLMAP model again "
        "for better ones."
    ),
    N_(
        "{lost} of {count} photos with clicks are not in the COLMAP model (first: '{photo}'); their clicks are ignored."
    ),
    N_(
        "The building is small, at most {length} pixels long in the working photos; Resolution {advised} would give it "
        "more detail (the photos have {original})."
    ),
    N_("{count} masks are weak and left out ({photos}); look at the contact sheet."),
    N_(
        "{count} photos show hardly any of the building and are left out ({photos}); click on it where the contact "
        "sheet shows more of it."
    ),
    N_(
        "The masks miss {missed} of the {count} clicks on the building. Check the contact sheet, then add clicks on "
        "the building and beside it in more photos."
    ),
    N_(
        "The clicks {clicks} in '{photo}' contradict the other photos and are ignored; if they are right, click the "
        "same spot in a second photo."
    ),
    N_(
        "The background clicks {clicks} in '{photo}' contradict the other photos. They are still used; delete them if "
        "they are mistakes."
    ),
    N_("The mask of '{photo}' misses the clicks {clicks}; add clicks around them, in this and in other photos."),
    N_(
        "{share} of the building has neither texture nor sparse points; the mesh is interpolated there. Closer photos, "
        "a higher Resolution or slanting light would help."
    ),
    N_(
        "A part of the mesh ({share} of it) is apart from everything that was clicked and was removed; if it belongs "
        "to the building, click it as well."
    ),
    N_(
        "The mesh has low confidence (mean {mean} of 1, {share} of it seen by no photo): do not measure on it. More, "
        "sharper and denser photos or better cameras would help."
    ),
    N_(
        "{lost} of {count} photos cannot be read any more (first: {reason}); the texture uses their smaller working "
        "copies. Put the photos back and run again for a sharper texture."
    ),
    N_(
        "Device: CPU. Found the GPU {name}: press Check GPU in the preferences (a minute) so that auto uses it, or use "
        "it unchecked by Device cuda."
    ),
    N_("The checkpoint of the field is damaged; training starts over."),
    N_(
        "The job has no true coordinates, so one unit of its scene counts as one metre; give Georeference control "
        "points or scale bars for true lengths."
    ),
)

#: Why a mask is left out.
REASONS = (
    N_("hardly any building in this photo"),
    N_("mask and points agree only to {share}"),
    N_("other photos contradict {share} of its points"),
    N_("the other photos' masks agree with it only to {share}"),
)

#: Parts that stand for a value in these sentences.
PARTS = (
    N_("does not exist"),
    N_("cannot be read as JPEG, PNG, TIFF, WebP or BMP"),
)
