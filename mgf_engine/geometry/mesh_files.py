# SPDX-License-Identifier: GPL-3.0-or-later
"""Write and read meshes in the coordinates of the user's COLMAP model: PLY, OBJ and GLB.

Scale, axes and origin are the scene's own in all three. Coordinates far from the origin (such as UTM) do not hurt:
the PLY then has double coordinates, the OBJ as many digits as are needed, and the GLB, whose vertices must be
float32, holds them around the mesh's centre under a node that carries the translation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.errors import BadInput, reason
from mgf_engine.files.atomic import atomic_path
from mgf_engine.files.images import read_rgb
from mgf_engine.files.safe_npz import read_arrays
from mgf_engine.model.mesh import Mesh, Texture
from mgf_engine.model.scene import Similarity

#: Float32 coordinates are used where their rounding stays below this share of the mesh's size.
PRECISION = 1e-6
IMAGE, COORDINATES = "texture.jpg", "mesh_texture.npz"
QUALITY = 92  # of the texture as JPEG
_SCENE_FRAME = ("axes, scale and origin are those of the COLMAP model",)
_PLY_TYPES = {"u1": "uchar", "i4": "int", "f4": "float", "f8": "double"}


def in_scene(mesh: Mesh, to_normalised: Similarity) -> Mesh:
    """Return the mesh in the scene frame."""
    return replace(mesh, vertices=to_normalised.invert(mesh.vertices))


def write_ply(mesh: Mesh, path: Path, comments: Sequence[str] = _SCENE_FRAME) -> None:
    """Write binary PLY with vertex colours and values; coordinates are double where float would round too coarsely.

    Args:
        comments: lines of the header that say what the coordinates are, ASCII.
    """
    kind, name = ("<f8", "double") if needs_double(mesh.vertices) else ("<f4", "float")
    values = {name: value.astype(value.dtype.newbyteorder("<")) for name, value in mesh.values.items()}
    columns = [(f"_{name}", value.dtype.str) for name, value in values.items()]
    vertices = np.empty(len(mesh.vertices), [("xyz", kind, 3), ("rgb", "u1", 3), *columns])
    vertices["xyz"], vertices["rgb"] = mesh.vertices, mesh.colors
    for label, value in values.items():
        vertices[f"_{label}"] = value
    faces = np.empty(len(mesh.faces), [("count", "u1"), ("index", "<i4", 3)])
    faces["count"], faces["index"] = 3, mesh.faces
    header = [
        "ply", "format binary_little_endian 1.0", *(f"comment {text}" for text in comments),
        f"element vertex {len(vertices)}", *(f"property {name} {axis}" for axis in "xyz"),
        *(f"property uchar {channel}" for channel in ("red", "green", "blue")),
        *(f"property {_PLY_TYPES[value.dtype.str[1:]]} {name}" for name, value in values.items()),
        f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header",
    ]  # fmt: skip
    with atomic_path(path) as temporary, open(temporary, "wb") as file:
        file.write(("\n".join(header) + "\n").encode("ascii"))
        file.write(vertices.tobytes())
        file.write(faces.tobytes())


def read_ply(path: Path, values: Sequence[str] = ()) -> Mesh:
    """Read a triangle mesh; files from other programs work as well, colours are white where there are none.

    Args:
        path: the file.
        values: names of further vertex attributes; those that the file has are kept.

    Raises:
        BadInput: the file is missing, damaged, or holds no triangles.
    """
    import trimesh

    try:
        with path.open("rb") as file:
            loaded: Any = trimesh.load(file, file_type="ply", process=False, force="mesh")
        vertices, faces = np.asarray(loaded.vertices, np.float64), np.asarray(loaded.faces, np.int32)
    except Exception as error:  # the reader raises whatever its parsing meets
        raise BadInput(
            f"The mesh '{path}' is missing or damaged ({reason(error)}); give a PLY file with triangles."
        ) from error
    known = len(faces) > 0 and faces.min() >= 0 and faces.max() < len(vertices)
    if not known or not np.isfinite(vertices).all():
        raise BadInput(f"The mesh '{path}' holds no usable triangles; give a PLY file with triangles.")
    colors = np.full((len(vertices), 3), 255, np.uint8)
    if loaded.visual.kind == "vertex":
        colors = np.asarray(loaded.visual.vertex_colors, np.uint8)[:, :3].copy()
    return Mesh(vertices, faces, colors, _values(loaded.metadata["_ply_raw"]["vertex"]["data"], values))


def _values(data: Any, names: Sequence[str]) -> dict[str, NDArray[Any]]:
    """Return the columns of that name that a table of vertices has; binary files give an array, others a dict."""
    found = data if isinstance(data, dict) else data.dtype.names
    return {name: np.asarray(data[name]).reshape(-1) for name in names if name in found}


def write_texture(texture: Texture, folder: Path) -> None:
    """Write ``texture.jpg``, and ``mesh_texture.npz`` with the array ``uv`` in the order of ``mesh.ply``'s faces."""
    with atomic_path(folder / IMAGE) as temporary:
        temporary.write_bytes(encode_jpeg(texture))
    with atomic_path(folder / COORDINATES) as temporary, open(temporary, "wb") as file:
        np.savez(file, uv=texture.uv)


def read_texture(folder: Path) -> Texture:
    """Return what :func:`write_texture` wrote.

    Raises:
        BadInput: a file is missing or damaged.
    """
    image = read_rgb(folder / IMAGE)
    try:
        uv = read_arrays(folder / COORDINATES)["uv"]
    except (OSError, ValueError, KeyError) as error:
        raise BadInput(f"The texture in '{folder}' is missing or damaged; run 'mgf deliver' again.") from error
    if uv.dtype != np.float32 or uv.shape[1:] != (3, 2) or not np.isfinite(uv).all():
        raise BadInput(f"The texture in '{folder}' is damaged; run 'mgf deliver' again.")
    return Texture(uv, image)


def encode_jpeg(texture: Texture) -> bytes:
    """Return the texture's picture as a JPEG file.

    Raises:
        RuntimeError: OpenCV cannot encode the picture.
    """
    ok, data = cv2.imencode(".jpg", cv2.cvtColor(texture.image, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    if not ok:
        raise RuntimeError(f"could not encode a texture of {texture.image.shape}")
    return data.tobytes()


def write_obj(mesh: Mesh, path: Path, texture: Texture | None = None, comments: Sequence[str] = _SCENE_FRAME) -> None:
    """Write Wavefront OBJ with vertex colours (``v x y z r g b``), coordinates to the last digit that matters.

    With a texture, an MTL file beside it names the texture's picture, which lies in the same folder.

    Args:
        mesh: with vertex colours.
        path: of the OBJ file.
        texture: UV coordinates [F, 3, 2]; its picture is written elsewhere.
        comments: lines of the file's head.
    """
    digits = _digits(mesh.vertices)
    table = np.column_stack([mesh.vertices, mesh.colors / 255.0])
    with atomic_path(path) as temporary, open(temporary, "w", encoding="ascii") as file:
        file.writelines(f"# {text}\n" for text in comments)
        if texture is not None:
            file.write(f"mtllib {path.with_suffix('.mtl').name}\n")
        np.savetxt(file, table, fmt=f"v %.{digits}f %.{digits}f %.{digits}f %.4f %.4f %.4f")
        if texture is None:
            np.savetxt(file, mesh.faces + 1, fmt="f %d %d %d")
        else:
            uv, place = np.unique(texture.uv.reshape(-1, 2), axis=0, return_inverse=True)
            file.write("usemtl building\n")
            np.savetxt(file, uv, fmt="vt %.6f %.6f")
            corners = np.stack([mesh.faces + 1, place.reshape(-1, 3) + 1], 2).reshape(-1, 6)
            np.savetxt(file, corners, fmt="f %d/%d %d/%d %d/%d")
    if texture is not None:
        with atomic_path(path.with_suffix(".mtl")) as temporary:
            temporary.write_text(f"newmtl building\nKa 0 0 0\nKd 1 1 1\nKs 0 0 0\nmap_Kd {IMAGE}\n", encoding="ascii")


def write_glb(
    mesh: Mesh,
    path: Path,
    texture: Texture | None = None,
    turn: NDArray[np.float64] | None = None,
    extras: dict[str, Any] | None = None,
    picture: Path | None = None,
) -> None:
    """Write Binary glTF; vertices around the mesh's centre, the centre as the translation of the node.

    Args:
        mesh: any frame with z up, or as ``turn`` expects it.
        path: of the file.
        texture: places of the faces' corners, and their picture; None for vertex colours.
        turn: rotation [3, 3] that the node adds, such as from z up to glTF's y up; None keeps the axes.
        extras: kept in ``asset.extras``.
        picture: the texture's picture as JPEG (default: the one in the same folder).

    With a texture the file holds its picture; vertices are doubled where faces find them in several places of it, and
    have no colours of their own.
    """
    import trimesh

    centre = np.round(0.5 * (mesh.vertices.min(0) + mesh.vertices.max(0)), 3)
    if texture is None:
        rgba = np.column_stack([mesh.colors, np.full(len(mesh.colors), 255, np.uint8)])
        local = trimesh.Trimesh(mesh.vertices - centre, mesh.faces, vertex_colors=rgba, process=False)
    else:
        local = textured(replace(mesh, vertices=mesh.vertices - centre), texture, picture or path.parent / IMAGE)
    scene = trimesh.Scene()
    place = _translation(centre)
    if turn is not None:
        place[:3] = turn @ place[:3]
    scene.add_geometry(local, node_name="building", geom_name="building", transform=place)

    def add_extras(tree: dict[str, Any]) -> None:
        if extras is not None:
            tree["asset"]["extras"] = extras

    data = scene.export(file_type="glb", tree_postprocessor=add_extras)
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)


def textured(mesh: Mesh, texture: Texture, picture: Path) -> Any:
    """Make a textured mesh of trimesh; vertices that lie at several places of the picture are doubled."""
    import trimesh

    corner = np.column_stack([mesh.faces.ravel(), texture.uv.reshape(-1, 2)])
    split, faces = np.unique(corner, axis=0, return_inverse=True)
    material = trimesh.visual.material.PBRMaterial(
        name="building", baseColorTexture=_as_encoded(picture), metallicFactor=0.0, roughnessFactor=1.0
    )
    visual = trimesh.visual.TextureVisuals(uv=split[:, 1:], material=material)
    return trimesh.Trimesh(
        mesh.vertices[split[:, 0].astype(np.int64)], faces.reshape(-1, 3), visual=visual, process=False
    )


def _as_encoded(path: Path) -> Any:
    """Return a JPEG picture for trimesh that saves as the bytes of the file; Pillow would encode it again, and
    coarser."""
    import io

    from PIL.JpegImagePlugin import JpegImageFile

    class AsEncoded(JpegImageFile):
        def save(self, fp: Any, format: str | None = None, **params: Any) -> None:
            fp.write(data)

    data = path.read_bytes()
    return AsEncoded(io.BytesIO(data))


def needs_double(vertices: NDArray[np.float64]) -> bool:
    """Tell whether float32 would round coordinates by more than :data:`PRECISION` of the mesh's size."""
    if len(vertices) == 0:
        return False
    size = max(float(np.ptp(vertices, axis=0).max()), 1e-300)
    return bool(np.abs(vertices).max() * 2.0**-24 > PRECISION * size)


def _digits(vertices: NDArray[np.float64]) -> int:
    """Return decimals that resolve a ten-millionth of the mesh's size."""
    size = max(float(np.ptp(vertices, axis=0).max()), 1e-12) if len(vertices) else 1.0
    return int(np.clip(np.ceil(7 - np.log10(size)), 0, 15))


def _translation(offset: NDArray[np.float64]) -> NDArray[np.float64]:
    matrix = np.eye(4)
    matrix[:3, 3] = offset
    return matrix
