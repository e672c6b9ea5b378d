"""Every column of every table, once: name, type, unit, meaning, allowed values."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

import pyarrow as pa

from schemas.vocabulary import (
    ControlKind,
    DefectClass,
    DetectionOutcome,
    HeightDatum,
    IntegrityOutcome,
    MergeDecision,
    MergeReason,
    ObservationOutcome,
    PhotoOutcome,
    PhotoRole,
    PointKind,
    PoseSource,
    PositionFrom,
    PositionSource,
    SurfaceKind,
)

GEO_CRS = "EPSG:4979"


class Kind(StrEnum):
    """A column's type; geometry is WKB whose CRS is ``GEO_CRS`` (lon, lat, ellipsoidal height)."""

    TEXT = "text"
    INTEGER = "integer"
    REAL = "real"
    BOOLEAN = "boolean"
    TIME = "time"
    GEOMETRY = "geometry"
    REALS = "reals"

    @property
    def arrow(self) -> pa.DataType:
        """The Arrow type."""
        return {
            Kind.TEXT: pa.string(),
            Kind.INTEGER: pa.int64(),
            Kind.REAL: pa.float64(),
            Kind.BOOLEAN: pa.bool_(),
            Kind.TIME: pa.timestamp("us", tz="UTC"),
            Kind.GEOMETRY: pa.binary(),
            Kind.REALS: pa.list_(pa.float64()),
        }[self]

    @property
    def sql(self) -> str:
        """The type in the lake."""
        return {
            Kind.TEXT: "VARCHAR",
            Kind.INTEGER: "BIGINT",
            Kind.REAL: "DOUBLE",
            Kind.BOOLEAN: "BOOLEAN",
            Kind.TIME: "TIMESTAMP WITH TIME ZONE",
            Kind.GEOMETRY: "GEOMETRY",  # DuckLake 1.0 forgets a CRS in the type; the column's comment keeps it
            Kind.REALS: "DOUBLE[]",
        }[self]


@dataclass(frozen=True, kw_only=True)
class Column:
    """One column; ``minimum`` and ``maximum`` are inclusive."""

    name: str
    kind: Kind
    meaning: str
    unit: str = ""
    allowed: tuple[str, ...] = ()
    minimum: float | None = None
    maximum: float | None = None


def _text(name: str, meaning: str, allowed: Iterable[str] = ()) -> Column:
    return Column(name=name, kind=Kind.TEXT, meaning=meaning, allowed=tuple(str(word) for word in allowed))


def _real(name: str, unit: str, meaning: str, low: float | None = None, high: float | None = None) -> Column:
    return Column(name=name, kind=Kind.REAL, unit=unit, meaning=meaning, minimum=low, maximum=high)


def _count(name: str, meaning: str, low: float = 0) -> Column:
    return Column(name=name, kind=Kind.INTEGER, meaning=meaning, minimum=low)


def _time(name: str, meaning: str) -> Column:
    return Column(name=name, kind=Kind.TIME, meaning=meaning, unit="UTC")


def _flag(name: str, meaning: str) -> Column:
    return Column(name=name, kind=Kind.BOOLEAN, meaning=meaning)


_ALL = [
    # keys
    _text("building_id", "the building, as in the registry"),
    _text("campaign_id", "one inspection of the building, such as 2026-04"),
    _text("run_id", "the run that made the row"),
    _text("photo_id", "path of the photograph below the campaign's folder, with forward slashes"),
    _text("detection_id", "one box or mask in one photograph"),
    _text("defect_id", "one real defect in one campaign"),
    _text("element_guid", "GlobalId of the IFC element; without an IFC the name of a facade plane, such as facade-S-1"),
    # building, campaign, run
    _text("building_name", "name for people"),
    _text("model_uri", "where the building model was read from; 'as-built' where there is none"),
    _text("model_sha256", "hash of the model file, or of the campaign's own surface where there is none"),
    _text("map_crs", "projected CRS of the model, which east_map_m and north_map_m are in"),
    _text("vertical_datum", "what the model's heights refer to, as stated by the model or the registry"),
    _text(
        "georeference_level", "how the model is georeferenced: its LoGeoRef level (50: map conversion), or 'registry'"
    ),
    _text("surface_kind", "what the building's surface was made of", SurfaceKind),
    _text("georeference_remarks", "what had to be assumed to place the model, in words"),
    _real("origin_lon_deg", "deg", "longitude of the site frame's origin (EPSG:4979)", -180, 180),
    _real("origin_lat_deg", "deg", "latitude of the site frame's origin (EPSG:4979)", -90, 90),
    _real(
        "origin_height_ellipsoidal_m", "m", "ellipsoidal height of the site frame's origin (EPSG:4979)", -1000, 10000
    ),
    _text("photographs_uri", "where the photographs were read from"),
    _count("photos_total", "files found in the photographs' folder"),
    _count("photos_localised", "photographs with a pose"),
    _count("detections_total", "detections read or made"),
    _count("defects_total", "defects after merging"),
    _time("captured_from", "time of the first photograph"),
    _time("captured_to", "time of the last photograph"),
    _time("started_at", "when the run began"),
    _time("finished_at", "when its stages were done and the commit began"),
    _text("inputs_sha256", "hash over photographs, model, detections, control points and settings"),
    _text("code_sha256", "hash of the domain's source"),
    _text("facadelake_version", "version of Facadelake"),
    _text("configuration", "the run's settings, as JSON"),
    _text("stage_seconds", "wall time of each stage in seconds, as JSON; stages answered from the cache are left out"),
    _text("stage_peak_mib", "peak memory of each stage (the process and its children) in MiB, as JSON"),
    # photographs
    _text("sha256", "hash of the file"),
    Column(name="bytes", kind=Kind.INTEGER, unit="B", meaning="size of the file", minimum=0),
    _text("role", "what the photograph is for", PhotoRole),
    _text("photo_outcome", "what became of the file", PhotoOutcome),
    _text("reason", "why, in words, where the outcome is not the good one"),
    Column(name="image_width_px", kind=Kind.INTEGER, unit="px", meaning="width of the photograph", minimum=1),
    Column(name="image_height_px", kind=Kind.INTEGER, unit="px", meaning="height of the photograph", minimum=1),
    _text("camera_make", "maker of the camera, from EXIF"),
    _text("camera_model", "model of the camera, from EXIF"),
    _real("focal_length_mm", "mm", "focal length, from EXIF", 0),
    _real("focal_length_35mm_mm", "mm", "35 mm equivalent focal length by the diagonal, from XMP or EXIF", 0),
    _time("taken_at", "when the photograph was taken, from EXIF (camera clock; UTC assumed where no offset is given)"),
    _text("prior_source", "where the position prior was read from", PositionSource),
    _real("prior_lon_deg", "deg", "longitude of the position prior (WGS 84)", -180, 180),
    _real("prior_lat_deg", "deg", "latitude of the position prior (WGS 84)", -90, 90),
    _real("prior_height_m", "m", "height of the position prior; prior_height_datum says what it refers to"),
    _text("prior_height_datum", "what the prior height refers to", HeightDatum),
    _real("prior_sigma_horizontal_m", "m", "one sigma of the prior position, each horizontal axis", 0),
    _real("prior_sigma_vertical_m", "m", "one sigma of the prior height", 0),
    _real("prior_height_relative_m", "m", "height above take-off (barometer), from XMP"),
    _real("prior_yaw_deg", "deg", "yaw of the camera, clockwise from north (gimbal, else compass)"),
    _real("prior_pitch_deg", "deg", "pitch of the camera above the horizon (gimbal)"),
    _real("prior_roll_deg", "deg", "roll of the camera, clockwise (gimbal)"),
    _real(
        "prior_sigma_yaw_deg",
        "deg",
        "one sigma of the prior yaw; it grows towards nadir, where yaw is undefined",
        0,
        180,
    ),
    _real(
        "prior_sigma_tilt_deg",
        "deg",
        "one sigma of the plumb line in the camera (pitch, and roll away from nadir)",
        0,
        180,
    ),
    _text("prior_evidence", "what position, height and attitude priors and their sigmas rest on"),
    _real("prior_focal_px", "px", "focal length as the photograph states it, for its stored size", 0),
    _real("prior_sigma_focal_px", "px", "one sigma of the prior focal length", 0),
    _text("prior_focal_evidence", "what the prior focal length and its sigma rest on"),
    _text("prior_calibration", "the maker's calibration for the stored size: fx, fy, cx, cy in px, k1, k2, p1, p2, k3"),
    _text("prior_warnings", "what is implausible about the photograph's own statements, and what was done about it"),
    _text("camera_serial", "serial number of the camera body or the drone, from XMP or EXIF"),
    _text("lens_model", "model of the lens, from EXIF"),
    _count("flight", "number of the flight (one body, one take-off, no long gap) within the campaign, from 1", 1),
    Column(
        name="rtk_flag", kind=Kind.INTEGER, meaning="RtkFlag of the XMP: 50 fixed, 32 to 49 float, 16 single, 0 none"
    ),
    # poses
    _text("pose_source", "how the pose was found", PoseSource),
    _real("qw", "", "site_from_cam as a unit quaternion, real part", -1, 1),
    _real("qx", "", "site_from_cam as a unit quaternion, i", -1, 1),
    _real("qy", "", "site_from_cam as a unit quaternion, j", -1, 1),
    _real("qz", "", "site_from_cam as a unit quaternion, k", -1, 1),
    _real("fx_px", "px", "focal length along x", 0),
    _real("fy_px", "px", "focal length along y", 0),
    _real("cx_px", "px", "principal point x; (0.5, 0.5) is the centre of the top left pixel"),
    _real("cy_px", "px", "principal point y"),
    _real("k1", "", "radial distortion, second order (OPENCV model)"),
    _real("k2", "", "radial distortion, fourth order"),
    _real("p1", "", "tangential distortion"),
    _real("p2", "", "tangential distortion"),
    _real("reprojection_error_px", "px", "mean reprojection error of the photograph's tie points", 0),
    _count("tie_points", "tie points seen in the photograph"),
    Column(
        name="covariance",
        kind=Kind.REALS,
        meaning="covariance of centre (m, site) and attitude (rad, about the camera's x, y, z), 6 x 6 row by row",
    ),
    _real("sigma_east_m", "m", "one sigma of the position, east", 0),
    _real("sigma_north_m", "m", "one sigma of the position, north", 0),
    _real("sigma_up_m", "m", "one sigma of the position, up", 0),
    _real("sigma_attitude_deg", "deg", "one sigma of the attitude, about its worst axis", 0),
    # georeference
    _text("control", "what placed the campaign on the globe", ControlKind),
    _count("points_used", "photographs or control points the transform was fitted to"),
    _count("points_total", "photographs or control points offered"),
    _real("scale", "", "metres per unit of the reconstruction", 0),
    _real("residual_mean_m", "m", "mean distance left at the points used", 0),
    _real("residual_rmse_m", "m", "root mean square distance left at the points used", 0),
    _real("residual_max_m", "m", "largest distance left at the points used", 0),
    _text("method", "how the campaign was placed, in words"),
    _count("check_points", "points held out of the adjustment: given ones, and control points left out in turn"),
    _real("check_residual_mean_m", "m", "mean distance of the held-out points from where they were surveyed", 0),
    _real("check_residual_max_m", "m", "largest of these distances", 0),
    _real("tie_sigma_px", "px", "one sigma of a tie point's coordinate in a photograph", 0),
    _real("tie_inflation", "", "factor by which the tie points' variance was raised: their errors hang together", 1),
    _real("model_residual_m", "m", "median distance of tie points from the model's surface that they were seen on", 0),
    _real("doming_m", "m", "sagitta of the block against the model: how far its middle bulges out of its rim"),
    _real("doming_sigma_m", "m", "one sigma of the sagitta", 0),
    _count("edge_features", "features of the model (sills, storey lines, corners) met in the photographs"),
    _real("shift_score", "", "how well the model's edges meet the photographs at the shift that was chosen"),
    _real("competing_score", "", "the same at the best other shift"),
    _text("reference_campaign", "the earlier campaign into whose frame this one was adjusted"),
    _text("point_name", "name of the point, or the photograph"),
    _text("point_kind", "what the point is to the adjustment", PointKind),
    _real("residual_east_m", "m", "given minus adjusted, east"),
    _real("residual_north_m", "m", "given minus adjusted, north"),
    _real("residual_up_m", "m", "given minus adjusted, up"),
    _flag("point_used", "whether the point held the adjustment"),
    _real("gps_offset_sigma_m", "m", "one sigma of the GPS offset, its largest axis", 0),
    _real("gps_offset_east_m", "m", "median of GPS prior minus adjusted camera centre, east"),
    _real("gps_offset_north_m", "m", "the same, north"),
    _real("gps_offset_up_m", "m", "the same, up"),
    _text("remarks", "what was observable and what was assumed, in words"),
    # elements
    _text("ifc_class", "class of the IFC element; 'Surface' for a facade plane of a building without IFC"),
    _text("element_name", "name of the IFC element"),
    _text("storey", "storey, by containment, else by elevation"),
    _text("material", "materials, outermost first, separated by '; '"),
    _text("predefined_type", "PredefinedType of the IFC element, or ObjectType where that is USERDEFINED"),
    _text("ifc_building", "IfcBuilding that the element lies in, by name; a file may hold neighbours too"),
    _text("host_guid", "GlobalId of the element it fills (a window's wall) or is a part of (a plate's curtain wall)"),
    _text("material_layers", "layers, outermost first, as JSON: material and thickness_m"),
    _text("properties", "values of the element's and its type's property sets, as JSON"),
    _text("storey_source", "where the storey was read from: 'containment', 'host' or 'elevation'"),
    _real("facade_azimuth_deg", "deg", "outward direction of the element's facade, clockwise from north", 0, 360),
    _text("detail_level", "how much the element's body shows: 'box', 'body' or 'detailed'"),
    _flag("is_external", "whether the model calls the element external"),
    _text(
        "facade",
        "outward side, one name a cluster of directions: N, NE, ..., with degrees (N-350) where two have one name; "
        "'level' up or down, 'inside' under no sky, 'around' where an element faces several",
    ),
    _real("surface_area_m2", "m2", "area of the element's triangles", 0),
    _count("triangles", "triangles of the element's surface"),
    # detections
    _text("source_annotation", "id of the annotation in the file the detection came from"),
    _text("detection_outcome", "whether the detection can be registered", DetectionOutcome),
    _text("defect_class", "what the defect is", DefectClass),
    _text("source_class", "the detector's own class name"),
    _real("score", "", "the detector's confidence; 1 for a person's box", 0, 1),
    _real("box_x_px", "px", "left edge of the box"),
    _real("box_y_px", "px", "top edge of the box"),
    _real("box_width_px", "px", "width of the box"),
    _real("box_height_px", "px", "height of the box"),
    _text("mask", "outline of the detection's mask in pixels, as WKT (POLYGON or MULTIPOLYGON); empty for a box"),
    _real("crack_width_px", "px", "mean width of the crack in the photograph, measured across it", 0),
    _text("detector", "the detector: 'coco:<file>' or 'onnx:<model>'"),
    _text("detector_sha256", "hash of the detections file or the model"),
    # observations, defects
    _text("observation_outcome", "what became of the detection", ObservationOutcome),
    _real("x_site_m", "m", "east in the site frame"),
    _real("y_site_m", "m", "north in the site frame"),
    _real("z_site_m", "m", "up in the site frame"),
    _real("lon_deg", "deg", "longitude (EPSG:4979)", -180, 180),
    _real("lat_deg", "deg", "latitude (EPSG:4979)", -90, 90),
    _real("height_ellipsoidal_m", "m", "ellipsoidal height (EPSG:4979)", -1000, 10000),
    _real("east_map_m", "m", "east in map_crs"),
    _real("north_map_m", "m", "north in map_crs"),
    _real("height_map_m", "m", "height in the model's vertical datum"),
    _real("normal_x", "", "outward normal of the surface, east part", -1, 1),
    _real("normal_y", "", "outward normal of the surface, north part", -1, 1),
    _real("normal_z", "", "outward normal of the surface, up part", -1, 1),
    _real("incidence_deg", "deg", "angle between the ray and the surface's normal", 0, 90),
    _real("distance_m", "m", "from the camera to the surface", 0),
    _real("gsd_mm", "mm", "size of a pixel on the surface, square-on", 0),
    _real("width_m", "m", "horizontal extent on the surface", 0),
    _real("height_m", "m", "extent on the surface across the width", 0),
    _real("area_m2", "m2", "area of the patch on the surface", 0),
    _real("target_share", "", "share of the detection's rays that meet the building", 0, 1),
    _real("length_m", "m", "longest extent on the surface, in any direction", 0),
    _real("crack_width_mm", "mm", "mean width of the crack on the surface, where it was measured", 0),
    Column(name="patch", kind=Kind.GEOMETRY, unit=GEO_CRS, meaning="outline on the surface (3D polygon)"),
    Column(name="covariance_site", kind=Kind.REALS, meaning="covariance of the position (m2, site), 3 x 3 row by row"),
    _real(
        "occluder_gap_m",
        "m",
        "how far before the model's surface the photographs found another, along the ray; empty where none",
    ),
    _text("position_from", "what the position rests on", PositionFrom),
    _real(
        "deviation_from_model_m",
        "m",
        "how far the triangulated place stands before (+) or behind (-) the model's surface, along its normal",
    ),
    _real("deviation_sigma_m", "m", "one sigma of that", 0),
    _text("graded_by", "who graded: 'rules' (a proposal), or a person's name"),
    _text("other_detection_id", "the second detection of the pair"),
    _text("other_defect_id", "the defect of the second detection"),
    _text("merge_decision", "whether the two are one defect", MergeDecision),
    _text("merge_reason", "why", MergeReason),
    _real("apart_m", "m", "distance between the two sightings' positions", 0),
    _real("apart_sigma", "", "the same in sigmas (Mahalanobis, both covariances and the building's relief)", 0),
    _real("overlap_share", "", "area both patches share over the smaller one's area, along the surface", 0, 1),
    _real("appearance_score", "", "correlation of both patches at one scale; empty where not compared", -1, 1),
    _count("sightings", "photographs that show the defect", 1),
    _real("spread_m", "m", "largest distance of a sighting from the defect's position", 0),
    _text("best_photo_id", "photograph that shows the defect best (smallest GSD over incidence)"),
    _text("severity", "grade by severity_rule; a proposal, not a person's judgement"),
    _text("severity_rule", "rule pack and version that graded"),
    Column(name="geometry", kind=Kind.GEOMETRY, meaning="position (point) or footprint (polygon)", unit=GEO_CRS),
    # integrity
    _text("integrity_outcome", "whether the view could be compared", IntegrityOutcome),
    _real("ssim", "", "structural similarity of as-built and model depth (paper's Eq. 12, corrected)", -1, 1),
    _real("compared_share", "", "share of the model's pixels that the as-built surface covers too", 0, 1),
    _real("depth_difference_median_m", "m", "median of as-built minus model depth"),
    _real("depth_difference_p95_m", "m", "95th percentile of its absolute value", 0),
    # checks
    _text("table_name", "table the check looked at"),
    _text("expectation", "the expectation, as Great Expectations names it"),
    _text("column_name", "column the check looked at; empty for the whole table"),
    _flag("passed", "whether the expectation was met"),
    _count("unexpected", "rows that did not meet it"),
    _text("detail", "what was expected and found, as JSON"),
]

COLUMNS: dict[str, Column] = {column.name: column for column in _ALL}
