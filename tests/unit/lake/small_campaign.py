"""A small campaign with every table filled, made by hand."""

import json
import math
import sys
import textwrap
from collections.abc import Mapping
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pyarrow as pa
import shapely

from facadelake.core.tables import add_run_keys, table_from_rows
from facadelake.lake.commit import CommitResult, commit_campaign
from schemas.tables import HISTORY_TABLES, TABLES

REPOSITORY = Path(__file__).resolve().parents[3]
BUILDING, CAMPAIGN = "tower", "2026-04"
INPUTS = "i" * 64
START = datetime(2026, 4, 1, 8, 0, tzinfo=UTC)
LON, LAT, HEIGHT = 9.5, 48.25, 312.5


def _position(index: int) -> dict[str, Any]:
    x, z = 0.5 * index, 3.0 + 0.25 * index
    return {
        "x_site_m": x, "y_site_m": 0.0, "z_site_m": z,
        "lon_deg": LON + 1e-6 * index, "lat_deg": LAT, "height_ellipsoidal_m": HEIGHT + z,
        "east_map_m": 500000.0 + x, "north_map_m": 5300000.0, "height_map_m": HEIGHT + z,
        "normal_x": 0.0, "normal_y": -1.0, "normal_z": 0.0,
        "geometry": shapely.to_wkb(shapely.Point(LON + 1e-6 * index, LAT, HEIGHT + z)),
    }  # fmt: skip


def _patch(index: int) -> dict[str, Any]:
    """What is known of a place: a hexagon on the south wall, 40 x 20 cm, and a covariance of 1, 2 and 3 cm."""
    place = _position(index)
    lon, lat, height = place["lon_deg"], place["lat_deg"], place["height_ellipsoidal_m"]
    east_deg = 0.1 / (111_320 * math.cos(math.radians(lat)))  # of 10 cm; to 0.3 % here
    corners = [(-2, 0), (-1, -1), (1, -1), (2, 0), (1, 1), (-1, 1)]
    ring = [(lon + east * east_deg, lat, height + 0.1 * up) for east, up in corners]
    return {
        "sigma_east_m": 0.01, "sigma_north_m": 0.02, "sigma_up_m": 0.03,
        "covariance_site": [1e-4, 0.0, 1e-5, 0.0, 4e-4, 0.0, 1e-5, 0.0, 9e-4],
        "length_m": 0.4, "patch": shapely.to_wkb(shapely.Polygon(ring)),
    }  # fmt: skip


def _covariance() -> list[float]:
    """6 x 6 row by row: centre of 1, 2 and 3 cm, of which east and up hang together, and attitude."""
    numbers = [[0.0] * 6 for _ in range(6)]
    for place, variance in enumerate([1e-4, 4e-4, 9e-4, 1e-8, 1e-8, 1e-8]):
        numbers[place][place] = variance
    numbers[0][2] = numbers[2][0] = 1e-4
    return [number for row in numbers for number in row]


def _cell(
    column: int, place: Mapping[str, Any], *, imaged: int, found: float | None, searched: int = 1
) -> dict[str, Any]:
    """A cell of the south wall, 0.25 m wide and 1 m2 large, with the smallest crack width found there, mm."""
    low, high, z = 0.25 * column, 0.25 * (column + 1), HEIGHT + 3.0
    ring = [(LON + 1e-6 * column, LAT, z), (LON + 1e-6 * (column + 1), LAT, z), (LON + 1e-6 * column, LAT, z + 0.25)]
    view = {"best_photo_id": "closerange/p0.jpg", "gsd_mm": 1.5, "incidence_deg": 20.0, "blur_px": 0.9}
    return {
        **place, "facade_azimuth_deg": 180.0, "cell_column": column, "cell_row": 12, "cell_layer": 0,
        "coverage_outcome": "imaged" if imaged else "not_in_view", "u_min_m": low, "u_max_m": high, "v_min_m": 3.0,
        "v_max_m": 3.25, "area_m2": 1.0, "x_site_m": (low + high) / 2, "y_site_m": 0.0, "z_site_m": 3.125,
        "normal_x": 0.0, "normal_y": -1.0, "normal_z": 0.0, "imaged_count": imaged, "searched_count": searched,
        "hidden_share": 0.0 if imaged else None, **(view if imaged else {}), "found_crack_width_mm": found,
        "found_patch_mm": None if found is None else 20 * found, "geometry": shapely.to_wkb(shapely.Polygon(ring)),
    }  # fmt: skip


def rows(
    defects: int = 3, sightings: int = 2, inputs: str = INPUTS, note: str = "a", start: datetime | None = START
) -> dict[str, list[dict]]:
    """Rows of each table: ``defects`` defects seen ``sightings`` times each, one detection a photograph off target."""
    began = start or START  # a campaign without capture times has a run, too
    photos = [f"closerange/p{i}.jpg" for i in range(sightings)]
    found = [(d, s, f"{photos[s]}#{d}") for d in range(defects) for s in range(sightings)]
    classes = ["crack", "spalling", "moisture"]
    outcome = {"observation_outcome": "registered", "incidence_deg": 20.0, "distance_m": 6.0, "gsd_mm": 1.5}
    place = {"element_guid": "3vB2YO$MX4xv5uCqZZG05x", "storey": "Level 1", "facade": "S"}
    size = {"width_m": 0.4, "height_m": 0.2, "area_m2": 0.08}
    box = {"box_x_px": 10.0, "box_y_px": 20.0, "box_width_px": 300.0, "box_height_px": 150.0}
    origin = {"detector": "coco:boxes.json", "detector_sha256": "d" * 64}
    return {
        "buildings": [
            {"building_name": "Tower", "model_uri": "tower.ifc", "model_sha256": "m" * 64, "map_crs": "EPSG:25832",
             "vertical_datum": "ellipsoidal", "georeference_level": "LoGeoRef 50", "origin_lon_deg": LON,
             "origin_lat_deg": LAT, "origin_height_ellipsoidal_m": HEIGHT}
        ],
        "campaigns": [
            {"photographs_uri": "photos", "photos_total": sightings + 1, "photos_localised": sightings,
             "detections_total": len(found) + 1, "defects_total": defects, "captured_from": start,
             "captured_to": start and start + timedelta(hours=1)}
        ],
        "runs": [
            {"started_at": began, "finished_at": began + timedelta(minutes=5), "inputs_sha256": inputs,
             "code_sha256": "c" * 64, "detector_sha256": "d" * 64, "facadelake_version": "0.1.0",
             "configuration": json.dumps({"note": note}), "stage_seconds": json.dumps({"ingest": 1.5}),
             "stage_peak_mib": json.dumps({"ingest": 200}), "stage_keys": json.dumps({"ingest": "k" * 24})}
        ],
        "photos": [
            *({"photo_id": photo, "sha256": f"{i:064d}", "bytes": 1000, "role": "closerange",
               "photo_outcome": "accepted", "image_width_px": 1600, "image_height_px": 1200, "taken_at": start,
               "prior_source": "xmp", "prior_lon_deg": LON, "prior_lat_deg": LAT, "prior_height_m": HEIGHT + 10,
               "prior_height_datum": "unknown", "prior_warnings": None if i else "the XMP packet is damaged"}
              for i, photo in enumerate(photos)),
            {"photo_id": "closerange/broken.jpg", "sha256": "b" * 64, "bytes": 0, "photo_outcome": "unreadable",
             "reason": "0 bytes", "prior_source": "none", "prior_height_datum": "unknown"},
        ],
        "poses": [
            {"photo_id": photo, "pose_source": "sfm", "x_site_m": 1.0, "y_site_m": -6.0, "z_site_m": 4.0,
             "lon_deg": LON, "lat_deg": LAT, "height_ellipsoidal_m": HEIGHT + 4, "qw": 1.0, "qx": 0.0, "qy": 0.0,
             "qz": 0.0, "image_width_px": 1600, "image_height_px": 1200, "fx_px": 1500.0, "fy_px": 1500.0,
             "cx_px": 800.0, "cy_px": 600.0, "k1": 0.0, "k2": 0.0, "p1": 0.0, "p2": 0.0,
             "reprojection_error_px": 0.4, "tie_points": 500, "sigma_east_m": 0.01, "sigma_north_m": 0.02,
             "sigma_up_m": 0.03, "sigma_attitude_deg": 0.01, "covariance": _covariance(),
             "geometry": shapely.to_wkb(shapely.Point(LON, LAT, HEIGHT + 4))} for photo in photos
        ],
        "georeference": [
            {"control": "gps", "method": "GPS", "map_crs": "EPSG:25832", "vertical_datum": "ellipsoidal",
             "georeference_level": "LoGeoRef 50", "points_used": sightings, "points_total": sightings, "scale": 1.0,
             "residual_mean_m": 0.5, "residual_rmse_m": 0.6, "residual_max_m": 0.9, "check_points": 1,
             "check_residual_mean_m": 0.05, "check_residual_max_m": 0.05, "sigma_east_m": 0.2, "sigma_north_m": 0.2,
             "sigma_up_m": 0.4, "tie_sigma_px": 0.5, "tie_variance_factor": 1.5, "remarks": "synthetic"}
        ],
        "georeference_points": [
            {"point_name": "C1", "point_kind": "check", "x_site_m": 2.0, "y_site_m": 0.0, "z_site_m": 5.0,
             "lon_deg": LON, "lat_deg": LAT, "height_ellipsoidal_m": HEIGHT + 5, "residual_east_m": 0.03,
             "residual_north_m": -0.04, "residual_up_m": 0.0, "point_used": False,
             "geometry": shapely.to_wkb(shapely.Point(LON, LAT, HEIGHT + 5))}
        ],
        "placement_checks": [
            {"statement": "gps_height", "placement_check_outcome": "agrees", "deviation": 1.5, "deviation_sigma": 5.0,
             "deviation_limit": 17.5, "deviation_unit": "m", "detail": "GPS of 4 photographs deviates by 1.5 m"}
        ],
        "elements": [
            {"element_guid": place["element_guid"], "ifc_class": "IfcWall", "element_name": "Wall S",
             "storey": "Level 1", "material": "brick", "is_external": True, "facade": "S", "surface_area_m2": 60.0,
             "triangles": 2, "geometry": shapely.to_wkb(shapely.box(LON, LAT, LON + 1e-4, LAT + 1e-6))}
        ],
        "detections": [
            *({"detection_id": key, "photo_id": photos[s], "detection_outcome": "accepted",
               "defect_class": classes[d % 3], "source_class": classes[d % 3], "score": 0.9, **box, **origin}
              for d, s, key in found),
            {"detection_id": "stranger", "photo_id": photos[0], "detection_outcome": "unknown_class",
             "reason": "class 'graffiti' is not in the crosswalk", "source_class": "graffiti", "score": 0.5,
             **box, **origin},
        ],
        "observations": [
            {"detection_id": key, "photo_id": photos[s], "defect_class": classes[d % 3], "defect_id": f"defect-{d:04d}",
             **_position(d), **_patch(d), **size, "target_share": 1.0, **place, **outcome} for d, s, key in found
        ],
        "defects": [
            {"defect_id": f"defect-{d:04d}", "defect_class": classes[d % 3], "severity": "minor",
             "severity_rule": "extent_v1", **_position(d), **_patch(d), **size, "spread_m": 0.02,
             "position_method": "triangulated" if sightings > 1 else "surface",
             **({"deviation_from_model_m": 0.02 - 0.05 * d, "deviation_sigma_m": 0.008} if sightings > 1 else {}),
             "photo_count": sightings, "score": 0.9, "best_photo_id": photos[0], "ifc_class": "IfcWall",
             "material": "brick", "facade_azimuth_deg": 180.0, **place}
            for d in range(defects)
        ],
        "merges": [
            {"detection_id": found[0][2], "other_detection_id": found[1][2], "defect_id": "defect-0000",
             "other_defect_id": "defect-0000", "merge_decision": "joined", "merge_reason": "geography",
             "separation_m": 0.01, "mahalanobis_distance": 0.5}
        ] if len(found) > 1 else [],
        "integrity_views": [
            {"photo_id": photo, "integrity_outcome": "compared", "ssim": 0.9, "compared_share": 0.8,
             "depth_difference_median_m": 0.01, "depth_difference_p95_m": 0.05} for photo in photos
        ],
        "coverage": [
            _cell(0, place, imaged=sightings, found=0.9), _cell(1, place, imaged=sightings, found=2.5),
            _cell(2, place, imaged=1, found=None), _cell(3, place, imaged=1, searched=0, found=None),
            _cell(4, place, imaged=0, searched=0, found=None),
        ],
        "checks": [
            {"table_name": "defects", "expectation": "expect_column_values_to_not_be_null",
             "column_name": "defect_id", "passed": True, "unexpected": 0, "detail": "{}"}
        ],
    }  # fmt: skip


def stage_tables(**settings: Any) -> dict[str, pa.Table]:
    """The small campaign as stage tables; settings as of ``rows``."""
    made = rows(**settings)
    return {name: table_from_rows(name, made[name]) for name in TABLES}


def history_rows(
    *, building_id: str = BUILDING, campaign_id: str = CAMPAIGN, run_id: str = "run-1", **settings: Any
) -> dict[str, list[dict]]:
    """The history of the small campaign as a building's first one: every defect begins a track."""
    key = {"building_id": building_id, "campaign_id": campaign_id, "run_id": run_id}
    tracks, states = [], []
    names = {column.name for column in HISTORY_TABLES["tracks"].columns}
    for number, defect in enumerate(rows(**settings)["defects"], start=1):
        track = {**key, "track_id": f"{building_id}-{number:04d}", "track_state": "first_seen"}
        shared = {name: value for name, value in defect.items() if name in names}
        seen = {"first_campaign": campaign_id, "last_campaign": campaign_id, "detected_campaign": campaign_id}
        tracks.append({**shared, **track, **seen, "withdrawn": False, "detected_count": 1})
        own = {name: defect[name] for name in ("defect_id", "defect_class", "geometry")}
        states.append({**track, **own, "state_evidence": "detected"})
    offset = {**key, "facade": "", "offset_outcome": "first", "offset_count": 0, "detail": "the first campaign"}
    made = {"tracks": tracks, "track_states": states, "frame_offsets": [offset]}
    return {name: made.get(name, []) for name in HISTORY_TABLES}


def history_tables(**settings: Any) -> dict[str, pa.Table]:
    """The same as tables; settings as of ``history_rows``."""
    return {name: table_from_rows(name, found) for name, found in history_rows(**settings).items()}


def lake_tables(
    *, building_id: str = BUILDING, campaign_id: str = CAMPAIGN, run_id: str = "run-1", **settings: Any
) -> Mapping[str, pa.Table]:
    """The small campaign with its run keys."""
    keys = {"building_id": building_id, "campaign_id": campaign_id, "run_id": run_id}
    return {name: add_run_keys(name, table, **keys) for name, table in stage_tables(**settings).items()}


def commit(
    lake: Path, *, run_id: str = "run-1", campaign_id: str = CAMPAIGN, inputs: str = INPUTS, **settings: Any
) -> CommitResult:
    """Commit the small campaign; settings as of ``rows``."""
    tables = lake_tables(run_id=run_id, campaign_id=campaign_id, inputs=inputs, **settings)
    return commit_campaign(
        lake, building_id=BUILDING, campaign_id=campaign_id, run_id=run_id, tables=tables, inputs_sha256=inputs
    )


def in_process(code: str, *, head: str = "") -> list[str]:
    """Command of a fresh interpreter in the repository that knows Path, ``commit`` and its module."""
    setup = f"import sys; sys.path.insert(0, {str(REPOSITORY)!r})\n{head}\nfrom pathlib import Path\n"
    setup += "from facadelake.lake import commit as commit_module\n"
    setup += "from tests.unit.lake.small_campaign import commit\n"
    return [sys.executable, "-c", setup + textwrap.dedent(code)]
