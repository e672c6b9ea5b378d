"""The tables: each with its grain, its key and its columns (a trailing ``?`` marks a column that may be null).

Type, unit, meaning and limits of a column are in ``columns.py``, its allowed words in ``vocabulary.py``.
"""

from __future__ import annotations

from dataclasses import dataclass

import pyarrow as pa

from schemas.column_type import Column, Kind
from schemas.columns import COLUMNS

SCHEMA_VERSION = 5
RUN_KEYS = ("building_id", "campaign_id", "run_id")


@dataclass(frozen=True, kw_only=True)
class Table:
    """One table of the lake."""

    name: str
    grain: str
    meaning: str
    key: tuple[str, ...]
    columns: tuple[Column, ...]
    optional: frozenset[str]
    may_be_empty: bool = False
    filled_at_commit: tuple[str, ...] = RUN_KEYS

    @property
    def stage_columns(self) -> tuple[Column, ...]:
        """The columns of the table as a stage makes it, without those that the commit fills."""
        return tuple(column for column in self.columns if column.name not in self.filled_at_commit)

    @property
    def arrow(self) -> pa.Schema:
        """The Arrow schema, in the table's column order."""
        return pa.schema([pa.field(c.name, c.kind.arrow, nullable=c.name in self.optional) for c in self.columns])

    @property
    def geometry_columns(self) -> tuple[str, ...]:
        """Names of the WKB columns."""
        return tuple(c.name for c in self.columns if c.kind is Kind.GEOMETRY)


def _table(
    name: str,
    grain: str,
    meaning: str,
    key: str,
    columns: str,
    *,
    may_be_empty: bool = False,
    filled_at_commit: tuple[str, ...] = RUN_KEYS,
) -> Table:
    words = [*RUN_KEYS, *columns.split()]
    return Table(
        name=name,
        grain=grain,
        meaning=meaning,
        key=tuple(key.split()),
        columns=tuple(COLUMNS[word.rstrip("?")] for word in words),
        optional=frozenset(word.rstrip("?") for word in words if word.endswith("?")),
        may_be_empty=may_be_empty,
        filled_at_commit=filled_at_commit,
    )


_SITE = "x_site_m y_site_m z_site_m"
_GEO = "lon_deg lat_deg height_ellipsoidal_m"
_MAP = "east_map_m north_map_m height_map_m"
_NORMAL = "normal_x normal_y normal_z"
_POSITION = f"{_SITE} {_GEO} {_MAP} {_NORMAL}"


def _optional(words: str) -> str:
    return " ".join(f"{word}?" for word in words.split())


_LIST = [
    _table(
        "buildings",
        "building in a campaign",
        "the portfolio's entry and the model's georeference, as used for the campaign",
        "building_id campaign_id",
        "building_name model_uri model_sha256 surface_kind? map_crs vertical_datum georeference_level "
        "georeference_remarks? origin_lon_deg origin_lat_deg "
        "origin_height_ellipsoidal_m",
    ),
    _table(
        "campaigns",
        "campaign",
        "one inspection of one building",
        "building_id campaign_id",
        "photographs_uri photos_total photos_localised detections_total defects_total captured_from? captured_to?",
    ),
    _table(
        "runs",
        "run",
        "provenance of the rows: hashes of inputs and code, settings, times",
        "run_id",
        "started_at finished_at inputs_sha256 code_sha256 detector_sha256 facadelake_version configuration "
        "stage_seconds stage_peak_mib stage_keys?",
    ),
    _table(
        "photos",
        "file in the photographs' folder",
        "metadata of a photograph, and whether it is used",
        "building_id campaign_id photo_id",
        "photo_id sha256 bytes role? photo_outcome reason? image_width_px? image_height_px? camera_make? camera_model? "
        "focal_length_mm? focal_length_35mm_mm? taken_at? prior_source prior_lon_deg? prior_lat_deg? prior_height_m? "
        "prior_height_datum prior_height_relative_m? prior_sigma_horizontal_m? prior_sigma_vertical_m? prior_yaw_deg? "
        "prior_pitch_deg? prior_roll_deg? prior_sigma_yaw_deg? prior_sigma_tilt_deg? prior_evidence? "
        "prior_focal_px? prior_sigma_focal_px? prior_focal_evidence? prior_calibration? prior_warnings? "
        "camera_serial? lens_model? flight? rtk_flag? image_source? digital_zoom? exif_focal_length_35mm_mm? "
        "exif_orientation? utc_offset?",
    ),
    _table(
        "poses",
        "accepted photograph",
        "position, attitude and intrinsics of the camera",
        "building_id campaign_id photo_id",
        f"photo_id pose_source reason? {_optional(_SITE)} {_optional(_GEO)} qw? qx? qy? qz? "
        "image_width_px image_height_px "
        "fx_px? fy_px? cx_px? cy_px? k1? k2? p1? p2? reprojection_error_px? tie_points "
        "sigma_east_m? sigma_north_m? sigma_up_m? sigma_attitude_deg? covariance? geometry?",
    ),
    _table(
        "georeference",
        "campaign",
        "the passport: how the campaign was georeferenced, and how accurately",
        "building_id campaign_id",
        "control method map_crs vertical_datum georeference_level reference_campaign? points_used points_total scale "
        "residual_mean_m? residual_rmse_m? residual_max_m? check_points check_residual_mean_m? check_residual_max_m? "
        "sigma_east_m sigma_north_m sigma_up_m gps_offset_east_m? gps_offset_north_m? gps_offset_up_m? "
        "gps_offset_sigma_m? tie_sigma_px? tie_variance_factor? model_residual_m? doming_m? doming_sigma_m? "
        "edge_features? edge_score? edge_score_runner_up? remarks crs_operation? crs_operation_accuracy_m? "
        "control_operation? control_operation_accuracy_m? control_operation_sigma_m?",
    ),
    _table(
        "georeference_points",
        "control point, held-out point or GPS prior",
        "the points of the passport with their residuals",
        "building_id campaign_id point_kind point_name",
        f"point_name point_kind {_SITE} {_GEO} residual_east_m residual_north_m residual_up_m point_used geometry",
        may_be_empty=True,
    ),
    _table(
        "placement_checks",
        "statement about the campaign's place",
        "what GPS, surveyed points and the model say about the placement, compared in proportion to their sigmas",
        "building_id campaign_id statement",
        "statement placement_check_outcome deviation? deviation_sigma? deviation_limit? deviation_unit detail",
    ),
    _table(
        "elements",
        "IFC element with a surface, or facade plane",
        "components of the building",
        "building_id campaign_id element_guid",
        "element_guid ifc_class predefined_type? element_name? host_guid? ifc_building? storey? storey_source? "
        "material? material_layers? is_external? properties? detail_level? facade facade_azimuth_deg? "
        "surface_area_m2 triangles geometry?",
    ),
    _table(
        "detections",
        "box in a photograph",
        "what the detector, or a person, found",
        "building_id campaign_id detection_id",
        "detection_id photo_id source_annotation? detection_outcome reason? defect_class? source_class score "
        "box_x_px? box_y_px? "
        "box_width_px? box_height_px? mask? crack_width_px? crack_width_max_px? crack_width_sigma_px? "
        "crack_width_limit_px? crack_length_px? crack_line? crack_width_outcome? detector detector_sha256",
        may_be_empty=True,
    ),
    _table(
        "observations",
        "accepted detection",
        "the detection on the building's surface",
        "building_id campaign_id detection_id",
        f"detection_id photo_id observation_outcome reason? defect_class defect_id? {_optional(_POSITION)} "
        "sigma_east_m? sigma_north_m? sigma_up_m? covariance_site? incidence_deg? distance_m? "
        "gsd_mm? width_m? height_m? length_m? area_m2? crack_width_mm? crack_width_max_mm? crack_width_sigma_mm? "
        "crack_width_limit_mm? crack_length_m? crack_width_outcome? target_share occluder_gap_m? element_guid? "
        "storey? facade? patch? geometry? captured_at?",
        may_be_empty=True,
    ),
    _table(
        "defects",
        "defect in a campaign",
        "each physical defect once",
        "building_id campaign_id defect_id",
        f"defect_id defect_class severity severity_rule graded_by? {_POSITION} sigma_east_m? sigma_north_m? "
        "sigma_up_m? covariance_site? position_method? deviation_from_model_m? deviation_sigma_m? "
        "width_m height_m length_m? area_m2 crack_width_mm? crack_width_max_mm? crack_width_sigma_mm? "
        "crack_width_limit_mm? crack_length_m? crack_width_outcome? spread_m photo_count score best_photo_id "
        "element_guid ifc_class element_name? material? storey? facade patch? geometry facade_azimuth_deg? "
        "captured_from? captured_to? best_photo_uri? severity_low? severity_high? crack_width_blur_mm?",
        may_be_empty=True,
    ),
    _table(
        "merges",
        "pair of neighbouring observations",
        "why two observations are one defect, or are not",
        "building_id campaign_id detection_id other_detection_id",
        "detection_id other_detection_id defect_id other_defect_id merge_decision merge_reason separation_m "
        "mahalanobis_distance overlap_share? appearance_score?",
        may_be_empty=True,
    ),
    _table(
        "integrity_views",
        "localised photograph",
        "structural similarity of the as-built depth to the model's",
        "building_id campaign_id photo_id",
        "photo_id integrity_outcome reason? ssim? compared_share depth_difference_median_m? depth_difference_p95_m?",
        may_be_empty=True,
    ),
    _table(
        "coverage",
        "cell of 0.25 m of a facade on an element",
        "which parts of the facades the photographs show, and how small a defect there would have been found",
        "building_id campaign_id facade cell_column cell_row element_guid cell_layer",
        "facade facade_azimuth_deg cell_column cell_row element_guid cell_layer storey? coverage_outcome u_min_m "
        f"u_max_m v_min_m v_max_m area_m2 {_SITE} {_NORMAL} imaged_count searched_count hidden_share? best_photo_id? "
        "gsd_mm? incidence_deg? blur_px? found_crack_width_mm? found_patch_mm? geometry",
        may_be_empty=True,
    ),
    _table(
        "checks",
        "expectation of a table",
        "results of the checks before the commit",
        "building_id campaign_id table_name expectation column_name",
        "table_name expectation column_name passed unexpected detail",
    ),
]

_OFFSET = "offset_east_m offset_north_m offset_up_m offset_sigma_east_m offset_sigma_north_m offset_sigma_up_m"
# Their rows are of several campaigns, so that they are made with all their columns.
_HISTORY = [
    _table(
        "tracks",
        "defect of a building for life",
        "its permanent id, its current state (of campaign_id, the building's latest campaign), and its trend",
        "building_id track_id",
        f"track_id defect_class track_state? withdrawn first_campaign? last_campaign? detected_campaign defect_id "
        f"first_seen_at? last_seen_at? detected_count severity severity_rule {_POSITION} sigma_east_m? sigma_north_m? "
        "sigma_up_m? width_m height_m length_m? area_m2 crack_width_mm? element_guid ifc_class element_name? material? "
        "storey? facade facade_azimuth_deg? best_photo_id best_photo_uri? patch? geometry trend_quantity? "
        "trend_per_year? trend_low_per_year? trend_high_per_year? trend_count? next_limit? next_severity? "
        "next_limit_from? next_limit_at? next_limit_to? trend_remark?",
        may_be_empty=True,
        filled_at_commit=(),
    ),
    _table(
        "track_states",
        "track in a campaign",
        "what became of the defect, on which evidence, and its change since it was detected before",
        "building_id campaign_id track_id",
        "track_id track_state state_evidence defect_id? defect_class state_remark? match_probability? "
        "previous_campaign? years_since_previous? length_change_m? length_change_sigma_m? area_change_m2? "
        "area_change_sigma_m2? crack_width_change_mm? crack_width_change_sigma_mm? changed_quantity? reviewer? "
        "geometry",
        may_be_empty=True,
        filled_at_commit=(),
    ),
    _table(
        "track_relations",
        "relation of a track in a campaign",
        "defects found in two parts or as one, and changes of class",
        "building_id campaign_id track_id track_relation",
        "track_id track_relation other_track_id? detail",
        may_be_empty=True,
        filled_at_commit=(),
    ),
    _table(
        "track_candidates",
        "known defect and defect of a campaign that may be the same",
        "how the defects of a campaign were matched to those known before",
        "building_id campaign_id track_id defect_id",
        "track_id defect_id displacement_m mahalanobis_distance log_odds match_probability matched",
        may_be_empty=True,
        filled_at_commit=(),
    ),
    _table(
        "looks",
        "look at the place of a track in a campaign that did not detect it",
        "comparison of the photographs of two campaigns at the place of a defect",
        "building_id campaign_id track_id",
        "track_id compared_campaign defect_id look_verdict look_count compared_count look_photo_id? "
        "compared_photo_id? look_similarity? surroundings_similarity? fading_extent? fading_sigmas? "
        "darkening_extent? contrast_difference? contrast_left? look_cell_mm?",
        may_be_empty=True,
        filled_at_commit=(),
    ),
    _table(
        "frame_offsets",
        "facade in a campaign, or the whole building (facade empty)",
        "offset of the campaign's positions from those of the campaigns before, estimated at their defects",
        "building_id campaign_id facade",
        f"facade offset_outcome {_optional(_OFFSET)} offset_count found_again_share? detail",
        may_be_empty=True,
        filled_at_commit=(),
    ),
]

_BOX = "box_x_px? box_y_px? box_width_px? box_height_px?"
_REVIEWS = [
    _table(
        "reviews",
        "review of a place in a photograph",
        "whether detections are defects, and which defects were missed: box and class by the reviewer, beside those of "
        "the reviewed detection; the latest review of a subject counts",
        "building_id campaign_id review_id",
        f"review_id subject photo_id detection_id? defect_id? verdict defect_class? {_BOX} mask? reviewed_class? "
        f"{_BOX.replace('box_', 'reviewed_box_')} detector_sha256? reviewer reviewed_at note?",
        may_be_empty=True,
    ),
    _table(
        "track_reviews",
        "review of a track in a campaign",
        "the state that a person has given to a defect; the latest review of a track in a campaign counts",
        "building_id campaign_id review_id",
        "review_id track_id track_state reviewer reviewed_at note?",
        may_be_empty=True,
    ),
]

# What a run commits, in one transaction.
TABLES: dict[str, Table] = {table.name: table for table in _LIST}
# What tracking makes of all campaigns of a building: a commit of one campaign replaces the rows of the building.
HISTORY_TABLES: dict[str, Table] = {table.name: table for table in _HISTORY}
# What reviewers add: rows are appended and never changed, and no run replaces them.
REVIEW_TABLES: dict[str, Table] = {table.name: table for table in _REVIEWS}
LAKE_TABLES: dict[str, Table] = {**TABLES, **HISTORY_TABLES, **REVIEW_TABLES}
