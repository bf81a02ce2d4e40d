# SPDX-License-Identifier: GPL-3.0-or-later
"""Fetch the weights of networks (EfficientSAM, and LPIPS for reports) once, find them again, and check them."""

from __future__ import annotations

import hashlib
import shutil
import urllib.error
import urllib.request
from dataclasses import dataclass
from pathlib import Path

from mgf_engine.errors import BadInput
from mgf_engine.files.atomic import atomic_path, put_in_place
from mgf_engine.messages import Reporter
from mgf_engine.system.machine import user_cache

#: Apache-2.0, exported to ONNX by the labelme project.
BASE_URL = "https://github.com/labelmeai/efficient-sam/releases/download/onnx-models-20231225"
CHUNK = 1 << 20
TIMEOUT = 30.0  # seconds without a byte


@dataclass(frozen=True)
class WeightFile:
    """One file of the release, or of another place: the address of its folder."""

    name: str
    size: int
    sha256: str
    place: str = ""


#: BSD-3-Clause, of the torchvision project; and BSD-2-Clause, of LPIPS's authors.
TORCHVISION = "https://download.pytorch.org/models"
LPIPS = "https://raw.githubusercontent.com/richzhang/PerceptualSimilarity/master/lpips/weights/v0.1"
#: Model -> encoder and decoder, or trunk and linear layers. "vits" is larger and more accurate than "vitt".
WEIGHTS: dict[str, tuple[WeightFile, WeightFile]] = {
    "vitt": (
        WeightFile("efficient_sam_vitt_encoder.onnx", 24799761,
                   "7a73ee65aa2c37237c89b4b18e73082f757ffb173899609c5d97a2bbd4ebb02d"),
        WeightFile("efficient_sam_vitt_decoder.onnx", 16565728,
                   "e1afe46232c3bfa3470a6a81c7d3181836a94ea89528aff4e0f2d2c611989efd"),
    ),
    "vits": (
        WeightFile("efficient_sam_vits_encoder.onnx", 89558337,
                   "4cacbb23c6903b1acf87f1d77ed806b840800c5fcd4ac8f650cbffed474b8896"),
        WeightFile("efficient_sam_vits_decoder.onnx", 16565728,
                   "4727baf23dacfb51d4c16795b2ac382c403505556d0284e84c6ff3d4e8e36f22"),
    ),
    "lpips-alex": (
        WeightFile("alexnet-owt-7be5be79.pth", 244408911,
                   "7be5be791159472b1fbf3c69796f7cb30dca7ad8466c2df70058c37116cdee02", TORCHVISION),
        WeightFile("alex.pth", 6009, "df73285e35b22355a2df87cdb6b70b343713b667eddbda73e1977e0c860835c0", LPIPS),
    ),
    "lpips-vgg": (
        WeightFile("vgg16-397923af.pth", 553433881,
                   "397923af8e79cdbb6a7127f12361acd7a2f83e06b05044ddf496e83de57a5bf0", TORCHVISION),
        WeightFile("vgg.pth", 7289, "a78928a0af1e5f0fcb1f3b9e8f8c3a2a5a3de244d830ad5c1feddc79b8432868", LPIPS),
    ),
}  # fmt: skip


def default_folder() -> Path:
    """Return the user's cache folder for weights."""
    return user_cache() / "weights"


def find_weights(folder: Path) -> tuple[str, Path, Path] | None:
    """Return model name, encoder and decoder of the best complete pair in a folder, or None.

    Raises:
        BadInput: a pair is there but a file is damaged or of another version.
    """
    for model in ("vits", "vitt"):
        files = WEIGHTS[model]
        if all((folder / f.name).is_file() for f in files):
            for file in files:
                check_file(folder / file.name, file, folder)
            return model, folder / files[0].name, folder / files[1].name
    return None


def missing_text(folder: Path) -> str:
    """Compose the message for missing weights."""
    names = " and ".join(f.name for f in WEIGHTS["vitt"])
    return (
        f"The EfficientSAM weights are not in '{folder}'; run 'mgf weights', or fetch {names} "
        f"from {BASE_URL} and run 'mgf weights --from FOLDER', or choose segmenter=random_walker, which needs none."
    )


def download_weights(model: str, folder: Path | None, reporter: Reporter, base_url: str = BASE_URL) -> Path:
    """Fetch the two files of a model, going on where a broken download stopped; returns their folder.

    Args:
        model: name of the model.
        folder: where to put them; None for the user's cache.
        reporter: for the progress and the request to cancel.
        base_url: where files lie that have no place of their own.

    Raises:
        BadInput: unknown model, no network, a full disk, or a file whose checksum is wrong.
    """
    if model not in WEIGHTS:
        raise BadInput(f"There are no weights called '{model}'; take one of {', '.join(WEIGHTS)}.")
    folder = folder or default_folder()
    files = WEIGHTS[model]
    total, done = sum(f.size for f in files), 0
    for file in files:
        target = folder / file.name
        if not (target.is_file() and _digest(target) == file.sha256):
            try:
                folder.mkdir(parents=True, exist_ok=True)
                _fetch(file, target, file.place or base_url, reporter, done, total)
            except urllib.error.URLError as error:
                raise BadInput(
                    f"Cannot download {file.name} ({error.reason}); check the network and run again (it goes on where "
                    f"it stopped), or put the file from {file.place or base_url} into '{folder}' by hand."
                ) from error
            except OSError as error:
                reason = error.strerror or str(error)
                raise BadInput(f"Cannot write {file.name} to '{folder}' ({reason}); choose another folder.") from error
        done += file.size
        reporter.progress(done / total)
    return folder


def copy_weights(source: Path, model: str | None, folder: Path | None) -> tuple[str, Path]:
    """Take the two files of a model from a folder, under whatever names, known by their SHA-256.

    Args:
        source: for example of a stick.
        model: a key of :data:`WEIGHTS`; None takes the more accurate one of EfficientSAM that is there.

    Returns:
        The model and the folder its files are in now.

    Raises:
        BadInput: the folder does not hold both files of a model unharmed, or they cannot be written.
    """
    if not source.is_dir():
        raise BadInput(f"'{source}' is not a folder; give the folder of the weights.")
    folder = folder or default_folder()
    wanted = (model,) if model else ("vits", "vitt")
    for name in wanted:
        found = [_find(source, file) for file in WEIGHTS[name]]
        if all(found):
            for path, file in zip(found, WEIGHTS[name], strict=True):
                _copy(path, folder / file.name)
            return name, folder
    names = " or ".join(f"{a.name} and {b.name}" for a, b in (WEIGHTS[name] for name in wanted))
    places = dict.fromkeys(file.place or BASE_URL for name in wanted for file in WEIGHTS[name])
    raise BadInput(
        f"'{source}' does not hold {names} whole (by SHA-256); fetch them again from {' and '.join(places)}."
    )


def _find(source: Path, file: WeightFile) -> Path | None:
    """Return the file in a folder that has this size and checksum, its own name first."""
    paths = sorted((p for p in source.iterdir() if p.is_file()), key=lambda p: (p.name != file.name, p.name))
    return next((p for p in paths if p.stat().st_size == file.size and _digest(p) == file.sha256), None)


def _copy(path: Path | None, target: Path) -> None:
    assert path is not None
    try:
        if not (target.exists() and target.samefile(path)):
            with atomic_path(target) as temporary:
                shutil.copyfile(path, temporary)
    except OSError as error:
        raise BadInput(f"Cannot copy '{path}' to '{target}' ({error.strerror}); choose another folder.") from error


def _fetch(file: WeightFile, target: Path, base_url: str, reporter: Reporter, done: int, total: int) -> None:
    partial = target.with_suffix(".part")
    have = partial.stat().st_size if partial.exists() else 0
    if have < file.size:
        request = urllib.request.Request(f"{base_url}/{file.name}", headers={"Range": f"bytes={have}-"} if have else {})
        with urllib.request.urlopen(request, timeout=TIMEOUT) as answer:
            # A server that ignores the range sends the whole file again.
            if answer.status != 206:
                have = 0
            with partial.open("ab" if have else "wb") as out:
                while chunk := answer.read(CHUNK):
                    out.write(chunk)
                    have += len(chunk)
                    reporter.progress(min(1.0, (done + have) / total), file=file.name)
    if have < file.size:
        raise urllib.error.URLError(f"the connection ended after {have} of {file.size} bytes")
    if _digest(partial) != file.sha256:
        partial.unlink()
        raise BadInput(f"{file.name} arrived damaged (wrong SHA-256) and was removed; download it again.")
    put_in_place(partial, target)


def check_file(path: Path, file: WeightFile, folder: Path) -> None:
    """Refuse a file that is damaged or of another version.

    Raises:
        BadInput: the file is damaged or of another version.
    """
    if path.stat().st_size != file.size or _digest(path) != file.sha256:
        raise BadInput(
            f"'{path}' is damaged or of another version (wrong size or SHA-256); delete it and run 'mgf weights "
            f"--folder {folder}' again."
        )


def _digest(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
