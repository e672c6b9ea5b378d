"""The text beside published files: what they are, in which CRS and datum, how well placed, and each column."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pyarrow as pa

from facadelake.publish.columns import order_columns
from schemas.tables import TABLES

_FILES = """defects.parquet       defects as points, GeoParquet 1.1, EPSG:4979 (longitude, latitude, ellipsoidal
                      height); second geometry column 'patch': the outline on the surface
defects_2d.parquet    the same without heights in the geometries, EPSG:4326, for programs that know no 3D CRS
defects.gpkg          GeoPackage: layer 'defects' as defects_2d.parquet, 'defects_3d' as defects.parquet; where outlines
                      were measured 'defects_patches' and 'defects_patches_3d', joined by defect_id; and for each
                      facade 'facade_N', 'facade_NE', ...: its defects' outlines (a box where none was measured) in the
                      facade's plane, u metres to the right as seen from outside, v metres up, from the site's origin
                      ('facade_level': from above); a list of numbers is JSON text
observations.parquet  every detection on its way to the surface; its outcome says what became of it, EPSG:4979"""


def format_readme(tables: Mapping[str, pa.Table], *, version: int) -> str:
    """The text for one campaign's tables (buildings, georeference, runs, defects; lake form)."""
    building, place, run = (_read_first_row(tables[name]) for name in ("buildings", "georeference", "runs"))
    return f"""{building["building_name"]} ({building["building_id"]}), campaign {building["campaign_id"]}
{len(tables["defects"])} defects; version {version} of the lake.
Run {run["run_id"]}, finished {run["finished_at"]:%Y-%m-%d %H:%M} UTC.
These files never change: a later run of the same campaign makes another version beside them.

FILES
{_FILES}

WHERE IT IS
geometry, lon_deg, lat_deg, height_ellipsoidal_m   EPSG:4979, height above the WGS 84 ellipsoid, not above sea level
east_map_m, north_map_m, height_map_m              {building["map_crs"]}; heights: {building["vertical_datum"]}
x_site_m, y_site_m, z_site_m                       metres east, north and up from {building["origin_lon_deg"]:.9f}, \
{building["origin_lat_deg"]:.9f}, {building["origin_height_ellipsoidal_m"]:.3f} (EPSG:4979)
{_format_residuals(place)}
{_format_uncertainty(place)}
{place["remarks"]}

COLUMNS of defects
{_describe_columns(tables["defects"])}

HOW IT WAS MADE
Facadelake {run["facadelake_version"]}, code {run["code_sha256"]}
inputs {run["inputs_sha256"]}
building model {building["model_sha256"]}
detector or detections {run["detector_sha256"]}
A severity is a proposal by the rule pack named in severity_rule (data/severity/ of the code), unless graded_by names
a person. These are graded by: {_list_graders(tables["defects"])}.
"""


def _format_residuals(place: Mapping[str, Any]) -> str:
    """By what the campaign was placed, and what is left there; imported poses leave nothing to be told."""
    used = f"placed by {place['method']}: {place['points_used']} of {place['points_total']}"
    if place["residual_mean_m"] is None:
        return f"{used} poses"
    return (
        f"{used} points, residuals mean {place['residual_mean_m']:.3f} m, RMS {place['residual_rmse_m']:.3f} m, "
        f"largest {place['residual_max_m']:.3f} m"
    )


def _format_uncertainty(place: Mapping[str, Any]) -> str:
    """How well the campaign's place is known: its own sigma, what held-out points say, and the earlier frame."""
    lines = [
        f"known to {place['sigma_east_m']:.3f} m east, "
        f"{place['sigma_north_m']:.3f} m north, {place['sigma_up_m']:.3f} m up (one sigma)"
    ]
    if place["check_points"]:
        lines.append(
            f"{place['check_points']} held-out points: mean {place['check_residual_mean_m']:.3f} m, "
            f"largest {place['check_residual_max_m']:.3f} m from their survey"
        )
    else:
        lines.append("no held-out point tested it")
    if place["reference_campaign"] is not None:
        lines.append(f"in the frame of campaign {place['reference_campaign']}")
    return "\n".join(lines)


def _list_graders(defects: pa.Table) -> str:
    found = {(row["severity_rule"], row["graded_by"] or "rules") for row in defects.to_pylist()}
    return ", ".join(f"{rule} ({by})" for rule, by in sorted(found)) or "none"


def _read_first_row(table: pa.Table) -> dict[str, Any]:
    row: dict[str, Any] = table.slice(0, 1).to_pylist()[0]
    return row


def _describe_columns(table: pa.Table) -> str:
    columns = {column.name: column for column in TABLES["defects"].columns}
    lines = []
    for name in order_columns(table).column_names:
        column = columns[name]
        unit = f" [{column.unit}]" if column.unit else ""
        lines.append(f"{name:<24}{column.meaning}{unit}")
    return "\n".join(lines)
