# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of algorithms with options; a line here makes a dataclass of options known to ``--set`` and the docs.

Like :mod:`mgf_engine.stages`, this module imports none of the algorithms: dataclasses are named as ``module:class`` and
imported when they are needed.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import MISSING, Field, dataclass, fields
from importlib import import_module
from typing import Any


@dataclass(frozen=True)
class Algorithm:
    """An algorithm with options.

    Attributes:
        section: name of the section for ``--set``.
        stage: the first stage whose result depends on its options (later ones that use them are redone with it), or
            the command (``drawings``).
        title: what it does, for the docs.
        options: its dataclass, as ``module:class`` inside the package.
        also: further commands that use it.
    """

    section: str
    stage: str
    title: str
    options: str
    also: tuple[str, ...] = ()

    def load(self) -> type:
        """Import the dataclass."""
        module, _, name = self.options.partition(":")
        found: type = getattr(import_module(f"mgf_engine.{module}"), name)
        return found

    def parameters(self) -> Iterator[Field[Any]]:
        """Iterate over the options of this section; fields that are dataclasses are sections of their own."""
        return (f for f in fields(self.load()) if f.default is not MISSING and "help" in f.metadata)


#: Commands with algorithms of their own, beside the stages, in the order of the docs.
COMMANDS = ("drawings", "models", "georef", "town")

# fmt: off
ALGORITHMS: tuple[Algorithm, ...] = (
    # scene
    Algorithm("structure_from_motion", "scene", "Cameras of photos without a COLMAP model", "scene.sfm:SfmOptions"),
    Algorithm("pose_adjustment", "scene", "Adjustment of cameras that disagree with the sparse points", "scene.adjust:AdjustOptions"),
    Algorithm("photo_quality", "scene", "Noise and sharpness of the photos", "scene.quality:QualityOptions"),
    Algorithm("exposure", "scene", "Exposure and white balance of the photos", "scene.exposure:ExposureOptions"),
    Algorithm("scene_checks", "scene", "Photos and points of another place", "scene.validation:ValidationOptions"),
    # masks
    Algorithm("neighbour_views", "masks", "Choice of the photos that are matched with each other", "scene.neighbours:NeighbourOptions"),
    Algorithm("stereo", "masks", "Depth of photos by semi-global matching", "scene.stereo:StereoOptions"),
    Algorithm("coarse_stereo", "masks", "Depth of reduced photos, where fine textures alias", "scene.coarse_stereo:CoarseStereoOptions"),
    Algorithm("mask_hull", "masks", "Visual hull of the masks that stands in for missing sparse points", "masks.geometry.visual_hull:MaskHullOptions"),
    Algorithm("random_walker", "masks", "Label propagation from clicks to all photos and points", "masks.propagation.random_walker_options:RandomWalkerOptions", also=("preview",)),
    Algorithm("sky", "masks", "Sky regions and the skyline", "masks.propagation.sky_regions:SkyOptions", also=("preview",)),
    Algorithm("sky_holes", "masks", "Sky that shows through the building", "masks.refinement.sky_holes:SkyHoleOptions"),
    Algorithm("ground_homography", "masks", "Ground that shows through the building", "masks.refinement.ground_homography:GroundHomographyOptions"),
    Algorithm("mirrored_ground", "masks", "Ground that panes mirror", "masks.refinement.mirrored_ground:MirroredGroundOptions"),
    Algorithm("mirrored_sky", "masks", "Sky that panes mirror", "masks.refinement.mirrored_sky:MirroredSkyOptions"),
    Algorithm("ignored_surface", "masks", "Surface of the building that all masks ignore", "masks.refinement.ignored_surface:IgnoredSurfaceOptions"),
    Algorithm("far_background", "masks", "Far background behind an open building", "masks.refinement.far_background:FarBackgroundOptions"),
    Algorithm("building_extent", "masks", "Extent of the building in the photos", "masks.geometry.building_extent:ExtentOptions", also=("preview",)),
    Algorithm("appearance", "masks", "Models of colour and texture of building and background", "masks.propagation.appearance:AppearanceOptions", also=("preview",)),
    Algorithm("ground_plan", "masks", "Ground plan of the building", "masks.geometry.ground_plan:GroundPlanOptions", also=("preview",)),
    Algorithm("superstructures", "masks", "Spires and chimneys that stand on the roof", "masks.geometry.superstructures:SuperstructureOptions", also=("preview",)),
    Algorithm("point_visibility", "masks", "Points that a photo should observe", "masks.geometry.point_visibility:PointVisibilityOptions", also=("preview",)),
    Algorithm("floaters", "masks", "Floaters: points that float before the sky", "masks.geometry.floaters:FloaterOptions", also=("preview",)),
    Algorithm("silhouettes", "masks", "Silhouettes of the other photos as evidence", "masks.geometry.silhouette_consistency:SilhouetteConsistencyOptions", also=("preview",)),
    Algorithm("superpixels", "masks", "Superpixels of each photo", "masks.propagation.superpixels:SuperpixelOptions", also=("preview",)),
    Algorithm("prompt_outliers", "masks", "Cross-validation of clicks", "masks.propagation.prompt_cross_validation:PromptOutlierOptions"),
    Algorithm("prompt_evidence", "masks", "Evidence against a click on the building", "masks.propagation.prompt_evidence:PromptEvidenceOptions"),
    Algorithm("prompt_agreement", "masks", "Clicks in several photos that confirm each other", "masks.propagation.prompt_agreement:PromptAgreementOptions"),
    Algorithm("transient_prompts", "masks", "Background clicks on what stands in one photo only", "masks.propagation.transient_prompts:TransientPromptOptions"),
    Algorithm("thin_structures", "masks", "Thin structures against the sky", "masks.refinement.thin_structures:ThinStructureOptions"),
    Algorithm("votes", "masks", "Vote of the masks on points and Gaussians", "masks.points:VoteOptions", also=("preview",)),
    Algorithm("propagation", "masks", "Drawing and checking of the masks", "masks.propagation.propagation_options:PropagationOptions", also=("preview",)),
    Algorithm("mask_drawing", "masks", "Masks from the probability of building", "masks.segmenters.random_walker:MaskDrawingOptions", also=("preview",)),
    Algorithm("homogeneous_regions", "masks", "Completion of homogeneous regions", "masks.refinement.homogeneous_regions:HomogeneousRegionOptions", also=("preview",)),
    Algorithm("mask_flags", "masks", "Masks that are left out", "masks.validation.mask_flags:FlagOptions"),
    Algorithm("densify_points", "masks", "Points by stereo where structure from motion found none", "masks.geometry.densify_points:DensifyOptions"),
    Algorithm("ground_plane", "masks", "Plane of the ground", "masks.geometry.ground_plane:GroundPlaneOptions", also=("preview",)),
    Algorithm("gravity", "masks", "Direction up by vertical edges, gravity tags or level cameras", "scene.gravity:GravityOptions", also=("georef", "drawings", "models", "preview")),
    Algorithm("point_features", "masks", "Neighbours, normals and groups of points", "masks.geometry.point_features:PointFeatureOptions", also=("preview",)),
    Algorithm("overhangs", "masks", "Eaves and cornices, which no column reaches the ground from", "masks.geometry.overhangs:OverhangOptions", also=("preview",)),
    Algorithm("point_surface", "masks", "Surface around the points of the building", "masks.geometry.point_surface:SurfaceOptions", also=("preview",)),
    Algorithm("foreground_leaves", "masks", "Leaves in front of the building", "masks.refinement.vegetation:LeafOptions"),
    Algorithm("sky_silhouette", "masks", "Silhouettes against the sky", "masks.refinement.sky_silhouette:SilhouetteOptions"),
    Algorithm("silhouette_hull", "masks", "Visual hull of silhouettes against the sky", "masks.refinement.silhouette_hull:SilhouetteHullOptions"),
    Algorithm("building_size", "masks", "Advice on buildings that are small in the photos", "masks.validation.building_size:BuildingSizeOptions"),
    Algorithm("low_texture", "masks", "Warning of surfaces without texture", "masks.validation.low_texture:LowTextureOptions"),
    Algorithm("mask_coverage", "masks", "Given masks against the points that the photos share", "masks.validation.mask_coverage:CoverageOptions"),
    Algorithm("cross_view", "masks", "Given masks that other photos contradict", "masks.validation.cross_view_consistency:CrossViewOptions"),
    Algorithm("parts", "masks", "Elements of the building: windows, doors, parts of walls", "masks.parts:PartOptions"),
    # field
    Algorithm("start_views", "field", "Photos and masks that the starting surface is made from", "start.options:ViewOptions"),
    Algorithm("start_outside", "field", "What the masks call outside of the building", "start.options:OutsideOptions"),
    Algorithm("start_lines", "field", "Edges in photos and lines in space", "start.options:SegmentOptions"),
    Algorithm("start_planes", "field", "Planes through lines", "start.options:PlaneOptions"),
    Algorithm("start_stereo", "field", "Points by stereo", "start.options:DenseOptions"),
    Algorithm("start_aliased", "field", "Points by stereo where fine textures alias", "start.options:AliasedPointOptions"),
    Algorithm("patch_match", "field", "Depth of photos by PatchMatch stereo", "scene.patch_match:PatchMatchOptions"),
    Algorithm("start_smoothing", "field", "Smoothing of points by stereo", "start.options:PointSmoothingOptions"),
    Algorithm("start_cut", "field", "Minimum cut that makes the starting surface", "start.options:MinimumCutOptions"),
    Algorithm("start_samples", "field", "Samples on the starting surface", "start.samples:SampleOptions"),
    Algorithm("start_points", "field", "Points that Gaussians start from", "field.start:StartPointOptions"),
    Algorithm("dense_points", "field", "Dense points by stereo without a starting surface", "field.dense:DensePointOptions"),
    Algorithm("initialisation", "field", "Shape and opacity of the first Gaussians", "field.initialise:InitialisationOptions"),
    Algorithm("targets", "field", "Margin and band around the mask, weights of masks", "field.targets:TargetOptions"),
    Algorithm("schedule", "field", "Schedule of the training", "field.schedule:ScheduleOptions"),
    Algorithm("filter_3d", "field", "Low-pass filter of the Gaussians (Mip-Splatting)", "field.filter3d:FilterOptions"),
    Algorithm("densification", "field", "Splitting and pruning of Gaussians", "field.density:DensificationOptions"),
    Algorithm("gradient_densification", "field", "Cloning, splitting and pruning of Gaussians where densify_by is a gradient", "field.gradient_density:GradientDensityOptions"),
    Algorithm("learning_rates", "field", "Step sizes of Adam", "field.schedule:LearningRates"),
    # mesh
    Algorithm("photometric", "mesh", "Refinement of depth maps by matching photos", "mesh.photometric:MatchOptions"),
    Algorithm("depth_smoothing", "mesh", "Smoothing of matched depth maps", "mesh.depth_smoothing:SmoothingOptions"),
    Algorithm("prior", "mesh", "Choice between the field and the starting surface", "mesh.prior:PriorOptions"),
    Algorithm("visual_hull", "mesh", "Visual hull that is carved from the mesh", "mesh.hull:HullOptions"),
    Algorithm("opacity", "mesh", "Surface by the opacity of the field (surface=opacity)", "mesh.opacity:OpacityOptions"),
    Algorithm("tsdf", "mesh", "Fusion of depth maps into a signed distance", "mesh.fusion_options:TsdfOptions"),
    Algorithm("mesh_refinement", "mesh", "Photometric refinement of the mesh", "mesh.refine:RefinementOptions"),
    Algorithm("planar", "mesh", "Projection of planar regions", "mesh.planar_options:PlanarOptions", also=("drawings", "models")),
    Algorithm("relief", "mesh", "Relief that is kept on planes", "mesh.relief:ReliefOptions"),
    Algorithm("patches", "mesh", "Comparison of patches between photos", "mesh.photo_consistency:PatchOptions"),
    Algorithm("plane_labels", "mesh", "Choice of the plane of each vertex", "mesh.plane_label_options:PlaneLabelOptions"),
    Algorithm("plane_extension", "mesh", "Planes over dents and worn edges", "mesh.extend_planes:PlaneExtensionOptions"),
    Algorithm("plane_borders", "mesh", "Blending of the borders of planes", "mesh.plane_borders:PlaneBorderOptions"),
    Algorithm("opening_walls", "mesh", "Walls of the mesh that openings are looked for in", "mesh.wall_openings:MeshOpeningOptions"),
    Algorithm("opening_detection", "mesh", "Detection of windows, doors and niches by their depth in a wall", "openings.detection:OpeningDetectionOptions", also=("drawings",)),
    Algorithm("opening_edges", "mesh", "Edges of windows and doors, from the photos", "openings.photo_edges:OpeningEdgeOptions", also=("drawings",)),
    Algorithm("opening_arches", "mesh", "Arched heads of windows and doors", "openings.arches:ArchOptions", also=("drawings",)),
    Algorithm("opening_cuts", "mesh", "Cutting of openings into the mesh", "mesh.cut_openings:OpeningCutOptions"),
    Algorithm("vertex_colors", "mesh", "Vertex colours from photos", "mesh.colors:ColorOptions"),
    Algorithm("planar_clustering", "mesh", "Merging of vertices in flat areas", "mesh.planar_clustering:PlanarClusteringOptions"),
    Algorithm("mask_votes", "mesh", "Vote of the masks on faces", "mesh.mask_votes:MaskVoteOptions"),
    Algorithm("confidence_warning", "mesh", "Warning of meshes that photos hardly confirm", "mesh.confidence_warning:ConfidenceWarningOptions"),
    Algorithm("low_confidence_fill", "mesh", "Membrane over dents that no photo confirms", "mesh.low_confidence_fill:LowConfidenceFillOptions"),
    Algorithm("unobserved_volumes", "mesh", "Removal of volumes that no photo shows", "mesh.unobserved_volumes:UnobservedVolumeOptions"),
    Algorithm("extraction", "mesh", "Mesh extraction as a whole", "mesh.options:ExtractionOptions"),
    Algorithm("tetrahedra", "mesh", "Points that the tetrahedra join", "mesh.tetrahedra:TetrahedraOptions"),
    Algorithm("mesh_parts", "mesh", "Vote of the photos on the parts of faces", "mesh.parts:FacePartOptions"),
    Algorithm("component_filter", "mesh", "Parts of the mesh that no click belongs to", "mesh.component_filter:ComponentFilterOptions"),
    Algorithm("mesh_border", "mesh", "Removal of what no photo shows along the border of the mesh", "mesh.border_smoothing:MeshBorderOptions"),
    # deliver
    Algorithm("texture_visibility", "deliver", "Photos that show a face", "texture.visibility:VisibilityOptions", also=("drawings", "models")),
    Algorithm("texture_views", "deliver", "Choice of the photo that paints a face", "texture.view_selection:ViewSelectionOptions", also=("drawings", "models")),
    Algorithm("texture_charts", "deliver", "Layout of the texture", "texture.charts:ChartOptions"),
    Algorithm("texture_blend", "deliver", "Mixing of both photos beside seams", "texture.blending:BlendOptions"),
    Algorithm("seams", "deliver", "Levelling of colours at seams", "texture.seams:SeamOptions", also=("drawings", "models")),
    # drawings
    Algorithm("facades", "drawings", "Facades of a building", "drawings.facades:FacadeOptions"),
    Algorithm("elevations", "drawings", "Lines of elevations and plans", "drawings.elevation:ElevationOptions"),
    Algorithm("regions", "drawings", "Planar regions that a drawing shows", "drawings.regions:RegionOptions", also=("models",)),
    Algorithm("region_merging", "drawings", "Regions of drawings whose border is none on the building", "drawings.merge_regions:RegionMergingOptions"),
    Algorithm("plane_lines", "drawings", "Lines of drawings that planes of the mesh give", "drawings.plane_lines:PlaneLineOptions"),
    Algorithm("outline_overhangs", "drawings", "Undersides of overhangs in outlines", "drawings.overhangs:OutlineOverhangOptions"),
    Algorithm("ground_level", "drawings", "Height of the ground around a building", "drawings.ground:GroundLevelOptions", also=("models",)),
    Algorithm("foot", "drawings", "Foot of buildings in elevations", "drawings.foot:FootOptions"),
    Algorithm("straightening", "drawings", "Straight lines of drawings", "drawings.straighten:StraightenOptions"),
    Algorithm("rectangles", "drawings", "Rectangles of openings in drawings", "drawings.rectangles:RectangleOptions"),
    Algorithm("elevation_walls", "drawings", "Walls of elevations that openings are looked for in", "drawings.openings:ElevationWallOptions"),
    Algorithm("photo_lines", "drawings", "Lines that are moved to where photos have the edges of planes", "drawings.photo_lines:PhotoLineOptions"),
    Algorithm("frayed_lines", "drawings", "Frayed borders that are drawn as one line", "drawings.fraying:FrayOptions"),
    Algorithm("section_cuts", "drawings", "Sections through the mesh", "drawings.section:SectionOptions"),
    Algorithm("part_outlines", "drawings", "Outlines of windows and other named parts", "drawings.parts:PartOutlineOptions", also=("models",)),
    Algorithm("quantities", "drawings", "Quantities of walls and roofs", "drawings.quantities:QuantityOptions"),
    Algorithm("drawing_frame", "drawings", "Direction up of a mesh without georeference", "drawings.load:UpOptions", also=("models",)),
    # models
    Algorithm("lod", "models", "Levels of detail", "models.lod:LodOptions"),
    Algorithm("lod_textures", "models", "Textures of levels of detail", "models.atlas:AtlasOptions"),
    Algorithm("solid", "models", "Solid of the building (CityJSON, IFC)", "models.solid.build:SolidOptions"),
    Algorithm("solid_evidence", "models", "Walls, roofs and footprint that a solid is made from", "models.solid.evidence_options:EvidenceOptions"),
    Algorithm("party_walls", "models", "Party walls of a row house that stands alone in its job", "models.solid.party_walls:PartyWallOptions"),
    Algorithm("solid_labels", "models", "Choice of a roof plane for each cell of the ground plan", "models.solid.labels:LabelOptions"),
    Algorithm("solid_faces", "models", "Corners and edges of the solid", "models.solid.polyhedron:PolyhedronOptions"),
    Algorithm("solid_openings", "models", "Windows and doors of the solid", "models.solid.openings:OpeningOptions"),
    # georef
    Algorithm("control_points", "georef", "Fit of the scene to control points", "georef.options:ControlPointOptions"),
    Algorithm("mark_triangulation", "georef", "Triangulation of marked points", "georef.options:MarkOptions"),
    Algorithm("gps_fit", "georef", "Fit of the cameras to the GPS of their photos", "georef.options:GpsFitOptions"),
    Algorithm("scale_bar_fit", "georef", "Scale from known distances", "georef.options:ScaleBarOptions"),
    Algorithm("control_adjustment", "georef", "Bundle adjustment with control points", "georef.options:ControlAdjustmentOptions"),
    # town
    Algorithm("town_plan", "town", "Buildings of a scene and their points", "town.plan:PlanOptions", also=("suggest-clicks",)),
    Algorithm("building_box", "town", "Crop box of each building", "town.crop:BuildingBoxOptions"),
    Algorithm("terrain", "town", "Terrain between the buildings", "town.terrain:TerrainOptions"),
    Algorithm("building_hulls", "town", "Ground and height of each building", "town.hulls:BuildingHullOptions", also=("suggest-clicks",)),
    Algorithm("building_search", "town", "Buildings in the sparse points alone", "town.find:OutlineOptions", also=("suggest-clicks",)),
    Algorithm("building_views", "town", "Choice of photos for each building", "town.view_selection:BuildingViewOptions", also=("suggest-clicks",)),
    Algorithm("suggested_clicks", "town", "Clicks from sparse points and hulls", "town.clicks:ClickOptions", also=("suggest-clicks",)),
)
# fmt: on
