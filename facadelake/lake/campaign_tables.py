"""The rows of a campaign in tables buildings, campaigns and runs, and all its tables with the run keys."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from importlib.metadata import version
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc

from facadelake.core.tables import add_run_keys, table_from_rows
from schemas.vocabulary import PhotoOutcome, PoseSource


@dataclass(frozen=True, kw_only=True)
class RunRecord:
    """Provenance of a run; ``configuration`` and the ``stage_*`` fields are JSON."""

    building_id: str
    campaign_id: str
    run_id: str
    started_at: datetime
    finished_at: datetime
    inputs_sha256: str
    code_sha256: str
    detector_sha256: str
    configuration: str
    stage_seconds: str
    stage_peak_mib: str
    stage_keys: str

    def build_row(self) -> dict[str, Any]:
        """The row of table ``runs``, without the run's keys."""
        return {
            "started_at": self.started_at,
            "finished_at": self.finished_at,
            "inputs_sha256": self.inputs_sha256,
            "code_sha256": self.code_sha256,
            "detector_sha256": self.detector_sha256,
            "facadelake_version": version("facadelake"),
            "configuration": self.configuration,
            "stage_seconds": self.stage_seconds,
            "stage_peak_mib": self.stage_peak_mib,
            "stage_keys": self.stage_keys,
        }


@dataclass(frozen=True, kw_only=True)
class BuildingRecord:
    """The building as used for the campaign; the origin is in EPSG:4979."""

    building_name: str
    model_uri: str
    model_sha256: str
    surface_kind: str
    map_crs: str
    vertical_datum: str
    georeference_level: str
    georeference_remarks: str | None
    origin_lon_deg: float
    origin_lat_deg: float
    origin_height_ellipsoidal_m: float

    def build_row(self) -> dict[str, Any]:
        """The row of table ``buildings``, without the run's keys."""
        return dict(vars(self))


def build_campaign_row(photographs_uri: str, tables: Mapping[str, pa.Table]) -> dict[str, Any]:
    """The row of table ``campaigns``: the counts of the stage tables."""
    photos, poses = tables["photos"], tables["poses"]
    accepted = photos.filter(pc.equal(photos["photo_outcome"], PhotoOutcome.ACCEPTED))
    times = pc.min_max(accepted["taken_at"]).as_py()
    return {
        "photographs_uri": photographs_uri,
        "photos_total": len(photos),
        "photos_localised": sum(PoseSource(source).measured for source in poses["pose_source"].to_pylist()),
        "detections_total": len(tables["detections"]),
        "defects_total": len(tables["defects"]),
        "captured_from": times["min"],
        "captured_to": times["max"],
    }


def add_capture_times(photographs_uri: str, tables: Mapping[str, pa.Table]) -> dict[str, pa.Table]:
    """The stage tables with the times of observations and defects, and the path of each defect's best photograph.

    A photograph without a time, or taken while the clock was not set, gives no time.

    Args:
        photographs_uri: folder of the photographs.
        tables: the tables that the stages made, by name.
    """
    taken_at = dict(zip(*(tables["photos"][name].to_pylist() for name in ("photo_id", "taken_at")), strict=True))
    observations, defects = tables["observations"], tables["defects"]
    captured_at = [taken_at.get(photo_id) for photo_id in observations["photo_id"].to_pylist()]
    times: dict[str | None, list[datetime]] = {}
    for defect_id, time in zip(observations["defect_id"].to_pylist(), captured_at, strict=True):
        if time is not None:
            times.setdefault(defect_id, []).append(time)
    of_defect = [times.get(defect_id, []) for defect_id in defects["defect_id"].to_pylist()]
    return {
        **tables,
        "observations": _set_columns(observations, {"captured_at": captured_at}),
        "defects": _set_columns(
            defects,
            {
                "captured_from": [min(found, default=None) for found in of_defect],
                "captured_to": [max(found, default=None) for found in of_defect],
                "best_photo_uri": [f"{photographs_uri}/{name}" for name in defects["best_photo_id"].to_pylist()],
            },
        ),
    }


def _set_columns(table: pa.Table, values: Mapping[str, Sequence[Any]]) -> pa.Table:
    """The table with the values of existing columns replaced."""
    for name, column in values.items():
        index = table.column_names.index(name)
        field = table.schema.field(name)
        table = table.set_column(index, field, pa.array(column, field.type))
    return table


def build_campaign_tables(
    run: RunRecord, building: BuildingRecord, photographs_uri: str, stage_tables: Mapping[str, pa.Table]
) -> dict[str, pa.Table]:
    """All tables of a campaign but ``checks``, without the run keys.

    Args:
        run: the row of table ``runs``.
        building: the row of table ``buildings``.
        photographs_uri: folder of the photographs.
        stage_tables: the tables that the stages made, by name.
    """
    return {
        "buildings": table_from_rows("buildings", [building.build_row()]),
        "campaigns": table_from_rows("campaigns", [build_campaign_row(photographs_uri, stage_tables)]),
        "runs": table_from_rows("runs", [run.build_row()]),
        **add_capture_times(photographs_uri, stage_tables),
    }


def build_lake_tables(tables: Mapping[str, pa.Table], run: RunRecord) -> dict[str, pa.Table]:
    """The tables with building_id, campaign_id and run_id as first columns, as in the lake."""
    keys = {"building_id": run.building_id, "campaign_id": run.campaign_id, "run_id": run.run_id}
    return {name: add_run_keys(name, table, **keys) for name, table in tables.items()}
