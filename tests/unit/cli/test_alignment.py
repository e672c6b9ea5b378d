"""The georeference in the terminal's summary."""

from __future__ import annotations

from typing import Any

from cli.terminal.inspection import format_georeference

PASSPORT: dict[str, Any] = {
    "control": "gcp", "method": "control points", "points_used": 5, "points_total": 6, "residual_mean_m": 0.0052,
    "residual_max_m": 0.0103, "check_points": 6, "check_residual_mean_m": 0.0191, "check_residual_max_m": 0.0401,
    "sigma_east_m": 0.0088, "sigma_north_m": 0.0096, "sigma_up_m": 0.0091, "gps_offset_east_m": 1.248,
    "gps_offset_north_m": -0.842, "gps_offset_up_m": 1.952, "map_crs": "EPSG:25832", "vertical_datum": "ellipsoidal",
    "reference_campaign": "2026-04",
}  # fmt: skip


def test_the_georeference_takes_three_lines() -> None:
    assert format_georeference(PASSPORT) == [
        "gcp (control points): 5 of 6 points used, residual mean 0.005 m, max 0.010 m; 6 held out: mean 0.019 m, "
        "max 0.040 m",
        "sigma 0.009 / 0.010 / 0.009 m east / north / up; EPSG:25832, heights ellipsoidal, in the frame of campaign "
        "2026-04",
        "GPS offset +1.25 / -0.84 / +1.95 m east / north / up",
    ]


def test_what_is_unknown_is_left_out() -> None:
    none = {f"gps_offset_{axis}_m": None for axis in ("east", "north", "up")}
    lines = format_georeference(PASSPORT | none | {"check_points": 0, "reference_campaign": None})
    assert len(lines) == 2
    assert lines[0].endswith("no held-out points")
    assert "campaign" not in lines[1]
    # By GPS alone there is nothing to tell its offset from.
    assert len(format_georeference(PASSPORT | {"control": "gps"})) == 2
