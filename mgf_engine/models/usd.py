# SPDX-License-Identifier: GPL-3.0-or-later
"""The levels of detail as one USDZ package: a variant set ``lod`` of one building, textures inside."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mgf_engine.drawings.model import Survey
from mgf_engine.geometry.mesh_files import encode_jpeg
from mgf_engine.georef.export import comments
from mgf_engine.model.mesh import Mesh, Texture

FILE = "building.usdz"


def write_usd(path: Path, levels: Sequence[tuple[Mesh, Texture | None]], survey: Survey) -> None:
    """Write the levels, the finest first, z up, in metres (or the scene's units), local frame.

    Raises:
        RuntimeError: the file cannot be written.
    """
    from pxr import Sdf, Usd, UsdGeom

    with tempfile.TemporaryDirectory(prefix=".usd-", dir=path.parent) as folder:
        stage = Usd.Stage.CreateNew(str(Path(folder) / "building.usdc"))
        UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
        UsdGeom.SetStageMetersPerUnit(stage, 1.0)
        stage.GetRootLayer().comment = "; ".join(comments(survey.georeference))
        building = UsdGeom.Xform.Define(stage, "/Building")
        stage.SetDefaultPrim(building.GetPrim())
        Usd.ModelAPI(building).SetKind("component")
        variants = building.GetPrim().GetVariantSets().AddVariantSet("lod")
        for number, (mesh, texture) in enumerate(levels):
            variants.AddVariant(f"lod{number}")
            variants.SetVariantSelection(f"lod{number}")
            with variants.GetVariantEditContext():
                _add_mesh(stage, mesh, texture)
                if texture is not None:
                    name = f"lod{number}.jpg"
                    (Path(folder) / name).write_bytes(encode_jpeg(texture))
                    _add_material(stage, name)
        variants.SetVariantSelection("lod0")
        stage.GetRootLayer().Save()
        package = Sdf.ZipFileWriter.CreateNew(str(path))  # the first file is the one that opens
        for file in sorted(Path(folder).iterdir(), key=lambda each: each.suffix != ".usdc"):
            package.AddFile(str(file), file.name)
        if not package.Save():
            raise RuntimeError(f"could not write {path.name}")


def _add_mesh(stage: Any, mesh: Mesh, texture: Texture | None) -> None:
    """Add a mesh to the stage, with texture coordinates, or with colours where it has no texture."""
    from pxr import Sdf, UsdGeom, Vt

    found = UsdGeom.Mesh.Define(stage, "/Building/Mesh")
    points = mesh.vertices.astype(np.float32)
    found.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points))
    found.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(mesh.faces), 3, np.int32)))
    found.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(np.ascontiguousarray(mesh.faces).ravel()))
    found.CreateExtentAttr(Vt.Vec3fArray.FromNumpy(np.stack([points.min(0), points.max(0)])))
    found.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    values = UsdGeom.PrimvarsAPI(found)
    if texture is None:
        color = values.CreatePrimvar("displayColor", Sdf.ValueTypeNames.Color3fArray, UsdGeom.Tokens.vertex)
        color.Set(Vt.Vec3fArray.FromNumpy((mesh.colors / 255.0).astype(np.float32)))
    else:
        place = values.CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.faceVarying)
        place.Set(Vt.Vec2fArray.FromNumpy(np.ascontiguousarray(texture.uv.reshape(-1, 2))))


def _add_material(stage: Any, picture: str) -> None:
    """Bind a preview material with a picture of the package to the mesh."""
    from pxr import Sdf, UsdShade

    material = UsdShade.Material.Define(stage, "/Building/Material")
    place = UsdShade.Shader.Define(stage, "/Building/Material/Place")
    place.CreateIdAttr("UsdPrimvarReader_float2")
    place.CreateInput("varname", Sdf.ValueTypeNames.String).Set("st")
    image = UsdShade.Shader.Define(stage, "/Building/Material/Picture")
    image.CreateIdAttr("UsdUVTexture")
    image.CreateInput("file", Sdf.ValueTypeNames.Asset).Set(picture)
    image.CreateInput("sourceColorSpace", Sdf.ValueTypeNames.Token).Set("sRGB")
    read = place.CreateOutput("result", Sdf.ValueTypeNames.Float2)
    image.CreateInput("st", Sdf.ValueTypeNames.Float2).ConnectToSource(read)
    surface = UsdShade.Shader.Define(stage, "/Building/Material/Surface")
    surface.CreateIdAttr("UsdPreviewSurface")
    color = image.CreateOutput("rgb", Sdf.ValueTypeNames.Float3)
    surface.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).ConnectToSource(color)
    surface.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(1.0)
    material.CreateSurfaceOutput().ConnectToSource(surface.CreateOutput("surface", Sdf.ValueTypeNames.Token))
    prim = stage.GetPrimAtPath("/Building/Mesh")
    UsdShade.MaterialBindingAPI.Apply(prim).Bind(material)
