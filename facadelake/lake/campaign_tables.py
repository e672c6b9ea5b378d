"""The rows of a campaign in tables buildings, campaigns and runs, and all its tables with the run keys."""

from __future__ import annotations

from collections.abc import Mapping
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
        **stage_tables,
    }


def build_lake_tables(tables: Mapping[str, pa.Table], run: RunRecord) -> dict[str, pa.Table]:
    """The tables with building_id, campaign_id and run_id as first columns, as in the lake."""
    keys = {"building_id": run.building_id, "campaign_id": run.campaign_id, "run_id": run.run_id}
    return {name: add_run_keys(name, table, **keys) for name, table in tables.items()}
