"""README.txt of a release: files, CRS and vertical datum, accuracy, provenance and the meaning of each column."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import pyarrow as pa

from facadelake.publish.columns import order_columns
from schemas.tables import LAKE_TABLES
from schemas.vocabulary import TrackState

_FILES = """defects.parquet       defects as points, GeoParquet 1.1, EPSG:4979 (longitude, latitude, ellipsoidal
                      height); second geometry column 'patch': outline on the surface
defects_2d.parquet    the same with 2D geometries, EPSG:4326, for programs without support of 3D CRSs
defects.gpkg          GeoPackage. Layers: 'defects' (as defects_2d.parquet) and 'defects_3d' (as defects.parquet);
                      'defects_patches' and 'defects_patches_3d' (measured outlines, joined by defect_id);
                      'facade_N', 'facade_NE', ... (outlines, or boxes where no outline was measured, in the plane of
                      the facade: u in metres to the right as seen from outside, v in metres up, both from the site's
                      origin; 'facade_level': plan view); 'coverage_3d' and 'coverage_N', 'coverage_NE', ... (the cells
                      of coverage.parquet on the surface, and in the plane of the facade); where there is a history,
                      'tracks' and 'track_states' (as tracks.parquet without withdrawn tracks, and history.parquet),
                      both also in 3D ('_3d'), and 'tracks_N', 'tracks_NE', ... (outlines of the tracks in the plane
                      of the facade). QGIS draws tracks by state, and coverage as the report does, from table
                      'layer_styles'. Lists of numbers are JSON text.
observations.parquet  every detection with the outcome of its registration on the surface, EPSG:4979
coverage.parquet      cells of 0.25 m of the facades: which the photographs show and how well, EPSG:4979; missing where
                      coverage was not measured
tracks.parquet        the defects of the building for life, with their state in its latest campaign, EPSG:4979; place
                      and size are of the latest campaign that detected them
history.parquet       the state of each track in each campaign, what it rests on, and its change since the detection
                      before, EPSG:4979; sizes and severity are of that campaign, empty where it did not detect it.
                      Both have all campaigns of this version of the lake; they are missing where there is no history"""


def format_readme(tables: Mapping[str, pa.Table], states: pa.Table, *, version: int) -> str:
    """The text for one campaign's tables (buildings, georeference, runs, defects; columns as in the lake).

    ``states``: the states of the building's tracks, as published.
    """
    building, georeference, run = (_read_first_row(tables[name]) for name in ("buildings", "georeference", "runs"))
    return f"""{building["building_name"]} ({building["building_id"]}), campaign {building["campaign_id"]}
{len(tables["defects"])} defects; version {version} of the lake.
Run {run["run_id"]}, finished {run["finished_at"]:%Y-%m-%d %H:%M} UTC.
These files are read-only. A later run of the campaign is published as another version in a folder of its own.

FILES
{_FILES}

COORDINATES AND ACCURACY
geometry, lon_deg, lat_deg, height_ellipsoidal_m   EPSG:4979; height above the WGS 84 ellipsoid, not above sea level
east_map_m, north_map_m, height_map_m              {building["map_crs"]}; heights: {building["vertical_datum"]}
x_site_m, y_site_m, z_site_m                       metres east, north and up of {building["origin_lon_deg"]:.9f}, \
{building["origin_lat_deg"]:.9f}, {building["origin_height_ellipsoidal_m"]:.3f} (EPSG:4979)
{_format_residuals(georeference)}
{_format_uncertainty(georeference)}
{georeference["remarks"]}

HISTORY
{_describe_history(states)}

COLUMNS of defects
{_describe_columns(order_columns(tables["defects"]).column_names)}
{_describe_history_columns(tables["defects"], states)}
PROVENANCE
Facadelake {run["facadelake_version"]}, code {run["code_sha256"]}
inputs {run["inputs_sha256"]}
building model {building["model_sha256"]}
detector or detections {run["detector_sha256"]}
Severities are proposed by the rule pack in severity_rule (data/severity/ of the source code) unless graded_by names a
person. Graded by: {_list_graders(tables["defects"])}.
"""


def _format_residuals(georeference: Mapping[str, Any]) -> str:
    """Method of the georeferencing and its residuals; imported poses have none."""
    used = f"georeferenced by {georeference['method']}: {georeference['points_used']} of {georeference['points_total']}"
    if georeference["residual_mean_m"] is None:
        return f"{used} poses"
    return (
        f"{used} points used, residuals: mean {georeference['residual_mean_m']:.3f} m, "
        f"RMS {georeference['residual_rmse_m']:.3f} m, maximum {georeference['residual_max_m']:.3f} m"
    )


def _format_uncertainty(georeference: Mapping[str, Any]) -> str:
    """Standard deviation of the campaign's position, errors at independent points, and the reference campaign."""
    lines = [
        f"standard deviation of the position: {georeference['sigma_east_m']:.3f} m east, "
        f"{georeference['sigma_north_m']:.3f} m north, {georeference['sigma_up_m']:.3f} m up"
    ]
    if georeference["check_points"]:
        lines.append(
            f"check and held-out points: {georeference['check_points']}, error mean "
            f"{georeference['check_residual_mean_m']:.3f} m, maximum {georeference['check_residual_max_m']:.3f} m"
        )
    else:
        lines.append("not tested: no check or held-out points")
    if georeference["reference_campaign"] is not None:
        lines.append(f"in the frame of campaign {georeference['reference_campaign']}")
    return "\n".join(lines)


def _list_graders(defects: pa.Table) -> str:
    graders = {(row["severity_rule"], row["graded_by"] or "rules") for row in defects.to_pylist()}
    return ", ".join(f"{rule} ({grader})" for rule, grader in sorted(graders)) or "none"


def _read_first_row(table: pa.Table) -> dict[str, Any]:
    row: dict[str, Any] = table.slice(0, 1).to_pylist()[0]
    return row


def _describe_history(states: pa.Table) -> str:
    if not len(states):
        return (
            "none: the building's defects had not been followed over its campaigns in this version of the lake "
            "('facadelake track')"
        )
    campaigns = list(dict.fromkeys(states.sort_by("captured_from").column("campaign_id").to_pylist()))
    lines = []
    for campaign in campaigns:
        found = Counter(row["track_state"] for row in states.to_pylist() if row["campaign_id"] == campaign)
        lines.append(f"{campaign}: " + ", ".join(f"{found[state]} {state}" for state in TrackState if found[state]))
    return "\n".join(lines)


def _describe_history_columns(defects: pa.Table, states: pa.Table) -> str:
    if not len(states):
        return ""
    names = dict.fromkeys([*order_columns(states).column_names, *LAKE_TABLES["tracks"].arrow.names])
    own = _describe_columns([name for name in names if name not in defects.column_names])
    return f"\nCOLUMNS of tracks and history that defects do not have\n{own}\n"


def _describe_columns(names: Sequence[str]) -> str:
    columns = {column.name: column for kind in LAKE_TABLES.values() for column in kind.columns}
    lines = []
    for name in names:
        column = columns[name]
        unit = f" [{column.unit}]" if column.unit else ""
        lines.append(f"{name:<24}{column.meaning}{unit}")
    return "\n".join(lines)
