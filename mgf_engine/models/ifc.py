# SPDX-License-Identifier: GPL-3.0-or-later
"""The solid as IFC4: the building's closed body, and each wall, roof face and the ground as a surface of its own.

Walls have no thickness, since photos from outside show none: the body is a faceted B-rep of the building, the elements
are face sets. Where the job has a CRS, IfcMapConversion leads from local to projected coordinates.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from mgf_engine import __version__
from mgf_engine.drawings.model import Survey
from mgf_engine.models.solid.model import DOOR, GROUND, ROOF, WALL, WINDOW, Solid, SolidFace

FILE = "building.ifc"
CLASSES = {WALL: "IfcWall", ROOF: "IfcRoof", GROUND: "IfcSlab", WINDOW: "IfcWindow", DOOR: "IfcDoor"}
NAMES = {WALL: "Wall", ROOF: "Roof face", GROUND: "Ground", WINDOW: "Window", DOOR: "Door"}


def write_ifc(path: Path, solid: Solid, survey: Survey, name: str) -> None:
    """Write the solid in the local frame, metres.

    Args:
        path: of the file.
        solid: local frame.
        survey: tells the CRS and where the local frame lies.
        name: of the building.
    """
    import ifcopenshell
    import ifcopenshell.api.root
    import ifcopenshell.api.unit

    model = ifcopenshell.file(schema="IFC4")
    model.header.file_name.originating_system = f"mgf {__version__}"
    project = ifcopenshell.api.root.create_entity(model, ifc_class="IfcProject", name=name)
    metre = ifcopenshell.api.unit.add_si_unit(model, unit_type="LENGTHUNIT")
    square = ifcopenshell.api.unit.add_si_unit(model, unit_type="AREAUNIT")
    cubic = ifcopenshell.api.unit.add_si_unit(model, unit_type="VOLUMEUNIT")
    ifcopenshell.api.unit.assign_unit(model, units=[metre, square, cubic])
    body = _body_context(model)
    building, storey = _places(model, project, name)
    _place_on_map(model, survey)
    points = [model.create_entity("IfcCartesianPoint", [float(v) for v in p]) for p in solid.vertices]
    shell = model.create_entity("IfcClosedShell", [_face(model, points, face) for face in solid.faces])
    _show(model, building, body, "Brep", model.create_entity("IfcFacetedBrep", shell))
    _add_quantities(model, building, solid)
    _elements(model, storey, body, points, solid)
    model.write(str(path))


def _body_context(model: Any) -> Any:
    import ifcopenshell.api.context

    add = ifcopenshell.api.context.add_context
    whole = add(model, context_type="Model")
    return add(model, context_type="Model", context_identifier="Body", target_view="MODEL_VIEW", parent=whole)


def _places(model: Any, project: Any, name: str) -> tuple[Any, Any]:
    """Return building and storey, below a site; each in the one before."""
    import ifcopenshell.api.aggregate
    import ifcopenshell.api.geometry
    import ifcopenshell.api.root

    parent, made = project, []
    for kind, title in (("IfcSite", "Site"), ("IfcBuilding", name), ("IfcBuildingStorey", "Building as seen")):
        entity = ifcopenshell.api.root.create_entity(model, ifc_class=kind, name=title)
        ifcopenshell.api.aggregate.assign_object(model, products=[entity], relating_object=parent)
        ifcopenshell.api.geometry.edit_object_placement(model, product=entity)
        made.append(entity)
        parent = entity
    return made[1], made[2]


def _place_on_map(model: Any, survey: Survey) -> None:
    """Add IfcMapConversion from the local frame to the CRS, where the job has one."""
    import ifcopenshell.api.georeference

    georeference = survey.georeference
    if georeference.crs is None:
        return
    east, north, height = georeference.offset
    ifcopenshell.api.georeference.add_georeferencing(model)
    ifcopenshell.api.georeference.edit_georeferencing(
        model, projected_crs={"Name": georeference.crs},
        coordinate_operation={
            "Eastings": east, "Northings": north, "OrthogonalHeight": height, "XAxisAbscissa": 1.0,
            "XAxisOrdinate": 0.0, "Scale": 1.0,
        },
    )  # fmt: skip


def _face(model: Any, points: list[Any], face: SolidFace) -> Any:
    bounds = []
    for number, ring in enumerate(face.rings):
        loop = model.create_entity("IfcPolyLoop", [points[row] for row in ring])
        bounds.append(model.create_entity("IfcFaceBound" if number else "IfcFaceOuterBound", loop, True))
    return model.create_entity("IfcFace", bounds)


def _show(model: Any, product: Any, context: Any, kind: str, item: Any) -> None:
    import ifcopenshell.api.geometry

    shape = model.create_entity("IfcShapeRepresentation", context, "Body", kind, [item])
    ifcopenshell.api.geometry.assign_representation(model, product=product, representation=shape)


def _elements(model: Any, storey: Any, body: Any, points: list[Any], solid: Solid) -> None:
    """Add each face as a wall, roof or slab, with its area."""
    import ifcopenshell.api.geometry
    import ifcopenshell.api.pset
    import ifcopenshell.api.root
    import ifcopenshell.api.spatial

    products = []
    for number, face in enumerate(solid.faces):
        product = ifcopenshell.api.root.create_entity(
            model, ifc_class=CLASSES[face.kind], name=f"{NAMES[face.kind]} {number + 1}"
        )
        if face.kind == GROUND:
            product.PredefinedType = "BASESLAB"
        if face.kind in (WINDOW, DOOR):
            x, y, z = np.ptp(solid.vertices[list(face.rings[0])], axis=0).tolist()
            product.OverallWidth, product.OverallHeight = float(np.hypot(x, y)), z
        ifcopenshell.api.geometry.edit_object_placement(model, product=product)
        faces = model.create_entity("IfcConnectedFaceSet", [_face(model, points, face)])
        _show(model, product, body, "SurfaceModel", model.create_entity("IfcFaceBasedSurfaceModel", [faces]))
        pset = ifcopenshell.api.pset.add_pset(model, product=product, name="MGF_Surface")
        ifcopenshell.api.pset.edit_pset(model, pset=pset, properties={"Area": round(solid.area(face), 3)})
        products.append(product)
    ifcopenshell.api.spatial.assign_container(model, products=products, relating_structure=storey)


def _add_quantities(model: Any, building: Any, solid: Solid) -> None:
    """Add how the solid was made and how far the mesh lies from it."""
    import ifcopenshell.api.pset

    facts: dict[str, Any] = {
        "LevelOfDetail": solid.level, "Volume": round(solid.volume, 3), "Detail": round(solid.detail, 4),
        "GroundFrom": solid.ground_from, **{f"Unseen{kind.title()}": share for kind, share in solid.unseen.items()},
    }  # fmt: skip
    if solid.deviation is not None:
        facts |= {"DeviationRMS": round(solid.deviation.rms, 4), "Deviation90": round(solid.deviation.p90, 4)}
    pset = ifcopenshell.api.pset.add_pset(model, product=building, name="MGF_Solid")
    ifcopenshell.api.pset.edit_pset(model, pset=pset, properties=facts)
