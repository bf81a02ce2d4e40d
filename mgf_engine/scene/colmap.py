# SPDX-License-Identifier: GPL-3.0-or-later
"""Find the COLMAP model and the photos in the user's folder, and read the model.

The files are parsed here rather than by pycolmap: pycolmap ends the process or asks for terabytes when a file is
damaged, and takes minutes to hand over large tracks. The tests hold both readers against each other.
"""

from __future__ import annotations

import os
import unicodedata
from pathlib import Path, PurePosixPath, PureWindowsPath

from mgf_engine.errors import BadInput
from mgf_engine.scene import colmap_binary, colmap_text
from mgf_engine.scene.sparse import SparseModel, check_model

#: Where models are looked for below the given folder: COLMAP's own places, those of other tools, any folder. The add-on
#: looks in the same (``mgf_blender/scene_import/locate.py``), for its cameras must be the ones the mesh is made with.
PLACES = (("", "sparse", "sparse/*"), ("*/sparse", "*/sparse/*", "*/*/sparse", "*/*/sparse/*"), ("*",))
PHOTO_KINDS = {".jpg", ".jpeg", ".png", ".tif", ".tiff", ".webp", ".bmp", ".ppm", ".pgm"}
#: What phones and cameras write besides, which is not read.
UNREAD_KINDS = {".heic", ".heif", ".avif", ".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".orf", ".rw2"}
MIN_SFM_PHOTOS = 3  # photos that structure from motion needs
_PARTS = ("cameras", "images", "points3D")


def find_model(source: Path, exclude: Path | None = None) -> Path | None:
    """Find the folder of the COLMAP model, or None when there is none.

    Of several the one in the most usual place (:data:`PLACES`), there the one with the most registered photos, and
    of equals the first.

    Args:
        source: the folder the user gave: a scene, its ``sparse`` folder, or the model itself.
        exclude: a folder whose models are not looked at (the job's own); other jobs' folders never are.

    Raises:
        BadInput: the only model found lacks one of its three files, or the folder of models cannot be read.
    """
    refuse_locked([source, source / "sparse", *sorted((source / "sparse").glob("*"))])
    complete: list[tuple[tuple[bool, int, int], Path]] = []
    partial: list[Path] = []
    for rank, folder in _candidates(source, exclude):
        kind = _kind(folder)
        if kind:
            photos = _count_images(folder, kind)
            complete.append(((photos >= 0, -rank, photos), folder))
        elif _any_part(folder):
            partial.append(folder)
    if complete:
        return max(complete, key=lambda c: c[0])[1]  # max keeps the first of equals
    if partial:
        missing = [p for p in _PARTS if not _has(partial[0], p)] or ["all three in one form, .bin or .txt"]
        raise BadInput(
            f"The COLMAP model '{partial[0]}' is not complete (missing: {', '.join(missing)}); copy all its files."
        )
    return None


def read_model(folder: Path) -> SparseModel:
    """Read and check the model in a folder (``.bin`` wins over ``.txt``, as in COLMAP).

    Raises:
        BadInput: a file is missing, unreadable, damaged, or inconsistent with the others.
    """
    kind = _kind(folder)
    if not kind:
        raise BadInput(f"'{folder}' holds no COLMAP model; it needs cameras, images and points3D as .bin or .txt.")
    reader = colmap_binary if kind == ".bin" else colmap_text
    paths = {part: folder / (part + kind) for part in (*_PARTS, "rigs", "frames")}
    try:
        cameras = reader.read_cameras(paths["cameras"])
        images = reader.read_images(paths["images"])
        points = reader.read_points(paths["points3D"])
        both = paths["rigs"].exists() and paths["frames"].exists()
        rigs = reader.read_rigs(paths["rigs"], paths["frames"]) if both else None
    except OSError as error:
        raise BadInput(f"Cannot read the COLMAP model '{folder}' ({error.strerror}); check the files.") from error
    by_id = {camera.id: camera for camera in cameras}
    if len(by_id) != len(cameras):
        raise BadInput(f"The COLMAP model '{folder}' lists a camera twice; export it again.")
    model = SparseModel(folder, by_id, tuple(sorted(images, key=lambda image: image.name)), points, rigs)
    check_model(model)
    return model


def model_files(folder: Path) -> list[Path]:
    """Return the files that :func:`read_model` reads."""
    paths = [folder / (part + _kind(folder)) for part in (*_PARTS, "rigs", "frames")]
    return [path for path in paths if path.is_file()]


def photo_names(folder: Path) -> list[str]:
    """Return the photos of the model in a folder, sorted, without reading more than their names.

    Raises:
        BadInput: the file is damaged.
    """
    kind = _kind(folder)
    return sorted((colmap_binary if kind == ".bin" else colmap_text).read_names(folder / ("images" + kind)))


def find_photos(
    names: list[str], model: Path, source: Path, exclude: Path | None = None, most_missing: float = 1.0
) -> list[Path]:
    """Find the photo file of each name in the model.

    Tried in turn: the usual folders around the model, then any file below ``source`` whose path ends like the name.

    Args:
        names: of the photos in the model.
        model: folder of the model.
        source: folder that the user gave.
        exclude: folder that is not searched, such as the job's.
        most_missing: share of the photos that may not be there, 0..1.

    Returns:
        A path for each name; of a photo that is not there, where it was expected: it is then left out as one that
        cannot be read (:mod:`mgf_engine.scene.unreadable`).

    Raises:
        BadInput: fewer than three photos are there, more than may are missing, two files fit one name equally well, or
            their folder cannot be read.
    """
    found: dict[str, Path] = {}
    expected = source / "images"
    for place in _photo_places(model, source):
        here = {name: path for name in names if os.path.isfile(path := place / plain_name(name))}
        if len(here) > len(found):
            found, expected = here, place
        if len(found) == len(names):
            break
    missing = [name for name in names if name not in found]
    doubtful = False
    if missing:
        index = _index(source, exclude)
        for name in list(missing):
            fits = _best_fits(plain_name(name), index)
            doubtful |= len(fits) > 1
            if len(fits) == 1:
                found[name] = fits[0]
                missing.remove(name)
    if missing:
        refuse_locked([place for place in _photo_places(model, source) if place.name == "images"])
    if missing and (doubtful or too_many_lost(len(missing), len(names), most_missing)):
        raise BadInput(
            f"{len(missing)} of {len(names)} photos of the COLMAP model are not there (first: '{missing[0]}'); "
            f"put the photos into '{source / 'images'}', or take them out of the model (colmap image_deleter)."
        )
    return [found[name] if name in found else expected / plain_name(name) for name in names]


def too_many_lost(lost: int, count: int, largest_share: float) -> bool:
    """Tell whether too many of ``count`` photos are missing or damaged for the rest to give a whole building: more
    than a share (0..1), or all but two."""
    return lost > 0 and (lost > largest_share * count or count - lost < MIN_SFM_PHOTOS)


def list_photos(source: Path, exclude: Path | None = None) -> tuple[Path, list[str]]:
    """List the folder that photos without a model lie in, and their paths relative to it, sorted.

    ``images`` (or ``photos``, ``input``) below the source is taken where it has photos, else the source with all its
    subfolders.

    Raises:
        BadInput: one of these folders cannot be read.
    """
    for name in ("images", "photos", "input", ""):
        root = source / name if name else source
        refuse_locked([root])
        photos = [p for p in _walk(root, exclude) if p.suffix.lower() in PHOTO_KINDS] if root.is_dir() else []
        if photos:
            return root, sorted(p.relative_to(root).as_posix() for p in photos)
    return source, []


def too_few_photos(root: Path, count: int, fewest: int, exclude: Path | None = None) -> BadInput:
    """Say why a folder without a model cannot be used: it holds photos of kinds that are not read, or too few.

    Args:
        root: the folder.
        count: photos in it.
        fewest: photos that are needed.
        exclude: the job's own folder.
    """
    unread = sorted(p for p in _walk(root, exclude) if p.suffix.lower() in UNREAD_KINDS)
    if unread:
        return BadInput(
            f"{len(unread)} photos in '{root}' are of a kind that is not read (first: '{unread[0].name}'); export them "
            "as JPEG, PNG, TIFF, WebP or BMP."
        )
    return BadInput(
        f"'{root}' holds no COLMAP model and too few photos ({count}); give a COLMAP scene or at least {fewest} photos."
    )


def refuse_locked(folders: list[Path]) -> None:
    """Refuse folders that one may not look into: what they hold must not count as missing.

    Raises:
        BadInput: there is one.
    """
    for folder in folders:
        if os.path.isdir(folder) and not os.access(folder, os.R_OK | os.X_OK):
            raise BadInput(f"No permission for '{folder}'; change its permissions or give another folder.")


def _candidates(source: Path, exclude: Path | None) -> list[tuple[int, Path]]:
    """Return folders that may hold a model, with the number of their group of places."""
    found: dict[Path, int] = {}
    for rank, places in enumerate(PLACES):
        for place in places:
            for folder in sorted(source.glob(place)) if place else [source]:
                inside = [p for p in (folder, *folder.parents) if source in p.parents]
                if folder.is_dir() and not any(_of_a_job(p, exclude) for p in inside):
                    found.setdefault(folder, rank)
    return [(rank, folder) for folder, rank in found.items()]


def _has(folder: Path, part: str) -> bool:
    return any(os.path.isfile(folder / (part + kind)) for kind in (".bin", ".txt"))


def _any_part(folder: Path) -> bool:
    return _has(folder, "points3D") or (_has(folder, "cameras") and _has(folder, "images")) or (
        _has(folder, "images") and folder.name.isdigit()
    )  # fmt: skip


def _kind(folder: Path) -> str:
    for kind in (".bin", ".txt"):
        if all(os.path.isfile(folder / (part + kind)) for part in _PARTS):
            return kind
    return ""


def _count_images(folder: Path, kind: str) -> int:
    path = folder / ("images" + kind)
    try:
        count = (colmap_binary if kind == ".bin" else colmap_text).count_images(path)
        return count if count * 8 <= path.stat().st_size else -1  # a damaged count must not win over a sound model
    except OSError:
        return -1


def _photo_places(model: Path, source: Path) -> list[Path]:
    around = [model, *model.parents[:3], source, *source.parents[:1]]
    around = [p for p in around if p == source or source in p.parents or p in source.parents[:2]]
    places = [p / "images" for p in around] + around
    places += [p for p in sorted(source.iterdir()) if p.is_dir() and not _of_a_job(p)] if source.is_dir() else []
    return [p for i, p in enumerate(places) if p.is_dir() and p not in places[:i]]


def plain_name(name: str, windows: bool = os.sep == "\\") -> str:
    """Return a photo's name as a path below a folder, with slashes: names from Windows hold backslashes, and a foreign
    model may hold a drive or a server, which Windows would log in at when asked for the file."""
    path = PureWindowsPath(name) if windows else PurePosixPath(name.replace("\\", "/"))
    return path.relative_to(path.anchor).as_posix()


def _index(source: Path, exclude: Path | None) -> list[tuple[list[str], Path]]:
    """Return every photo below the source with the parts of its path, last first, in comparable form."""
    files = sorted(_walk(source, exclude))
    return [(_comparable(p.relative_to(source).as_posix()), p) for p in files if p.suffix.lower() in PHOTO_KINDS]


def _best_fits(name: str, index: list[tuple[list[str], Path]]) -> list[Path]:
    """Return the photos that share the longest end of the path with ``name``."""
    wanted = _comparable(name)
    shared = [(_common(wanted, parts), path) for parts, path in index]
    longest = max((n for n, _ in shared), default=0)
    return [path for n, path in shared if n == longest and n > 0]


def _comparable(path: str) -> list[str]:
    # macOS stores accents decomposed, and Windows ignores case.
    return [unicodedata.normalize("NFC", part).casefold() for part in reversed(path.split("/"))]


def _common(a: list[str], b: list[str]) -> int:
    count = 0
    for x, y in zip(a, b, strict=False):
        if x != y:
            break
        count += 1
    return count


def _of_a_job(folder: Path, own: Path | None = None) -> bool:
    """Tell whether a folder is a job's: its pictures are results, not photos.

    Here as all through this file ``os.path.isfile``, not ``Path.is_file``: the latter raises at folders that one may
    not look into, such as those that Windows and macOS keep at the root of a drive.
    """
    return folder == own or os.path.isfile(folder / "job.json")


def _walk(root: Path, exclude: Path | None) -> list[Path]:
    files: list[Path] = []
    for folder, subfolders, names in os.walk(root):
        here = Path(folder)
        subfolders[:] = [s for s in subfolders if not s.startswith(".") and not _of_a_job(here / s, exclude)]
        files += [here / name for name in names if not name.startswith(".")]
    return files
