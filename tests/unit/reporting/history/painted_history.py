"""Tables of the history of the painted wall (tests/unit/reporting/painted_wall.py), made by hand."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

import numpy as np
import pyarrow as pa

from facadelake.core.geodesy import SiteOrigin
from schemas.tables import LAKE_TABLES
from tests.unit.reporting.painted_wall import make_defect_row

BUILDING = "wall"
ORIGIN = SiteOrigin(lon_deg=8.4, lat_deg=48.9, height_ellipsoidal_m=180.0)  # as of the painted wall
TIMES = {
    "2024": datetime(2024, 4, 1, tzinfo=UTC),
    "2025": datetime(2025, 4, 1, tzinfo=UTC),
    "2026": datetime(2026, 10, 1, tzinfo=UTC),
}
# Of one size: the error of their median is the one that a campaign shares, 2 % of a length, 3 % of an area.
SIGHTINGS = 8
Rows = dict[str, list[dict[str, Any]]]


def make_table(name: str, rows: list[dict[str, Any]]) -> pa.Table:
    """A table of the lake; columns that are left out are null."""
    schema = LAKE_TABLES[name].arrow
    return pa.Table.from_pylist([dict.fromkeys(schema.names) | row for row in rows], schema)


def make_wall_defect(defect_id: str, place: tuple[float, float], **columns: Any) -> dict[str, Any]:
    """A row of ``defects`` at a place (m along the wall and up), with its position on the globe."""
    geo = ORIGIN.geo_from_site(np.array([[place[0], 0.0, place[1]]]))[0].tolist()
    names = ("lon_deg", "lat_deg", "height_ellipsoidal_m")
    return make_defect_row(defect_id, *place, **dict(zip(names, geo, strict=True)), **columns)


class History:
    """Rows of the tables of one building, added track by track."""

    def __init__(self, campaigns: tuple[str, ...] = ("2024", "2025", "2026")) -> None:
        self.campaigns = campaigns
        names = ("tracks", "track_states", "track_relations", "track_candidates", "track_reviews", "looks", "defects")
        self.rows: Rows = {name: [] for name in (*names, "observations")}
        self.rows["campaigns"] = [
            {"building_id": BUILDING, "campaign_id": name, "run_id": name, "captured_from": TIMES[name]}
            for name in campaigns
        ]
        self.rows["frame_offsets"] = [
            self._key(name)
            | {"facade": "", "offset_outcome": "estimated" if k else "first", "offset_count": 9 if k else 0}
            | (self.make_offset(0.01 * k, 0.002) if k else {})
            | {"detail": "nine defects agree" if k else "the first campaign"}
            for k, name in enumerate(campaigns)
        ]

    @staticmethod
    def _key(campaign: str) -> dict[str, Any]:
        return {"building_id": BUILDING, "campaign_id": campaign, "run_id": campaign}

    @staticmethod
    def make_offset(east_m: float, sigma_m: float) -> dict[str, float]:
        """Offset columns of ``frame_offsets``: east as given, none north and up."""
        xyz = dict(zip(("east", "north", "up"), (east_m, 0.0, 0.0), strict=True))
        return {f"offset_{axis}_m": value for axis, value in xyz.items()} | {
            f"offset_sigma_{axis}_m": sigma_m for axis in xyz
        }

    def add(
        self, track_id: str, states: dict[str, str], place: tuple[float, float] = (3.0, 2.0), **defect: Any
    ) -> None:
        """A track with ``state evidence`` by campaign; where the evidence is ``detected``, a defect at the place."""
        for campaign, told in states.items():
            state, evidence = told.split()
            defect_id = None
            if evidence == "detected":
                defect_id = f"{track_id}-in-{campaign}"
                row = make_wall_defect(defect_id, place, **({"length_m": 0.4} | defect))
                self.rows["defects"].append(row | self._key(campaign))
                self._sight(row, campaign)
            self.rows["track_states"].append(
                self._key(campaign)
                | {"track_id": track_id, "track_state": state, "state_evidence": evidence, "defect_id": defect_id}
                | {"defect_class": defect.get("defect_class", "crack"), "geometry": b""}
            )
        last = self.rows["defects"][-1]
        self.rows["tracks"].append(
            self._key(self.campaigns[-1])
            | {name: last[name] for name in LAKE_TABLES["tracks"].arrow.names if name in last and name != "campaign_id"}
            | {"track_id": track_id, "track_state": told.split()[0], "withdrawn": False, "detected_count": 1}
            | {
                "first_campaign": next(iter(states)),
                "last_campaign": campaign,
                "detected_campaign": last["campaign_id"],
            }
            | {"run_id": self.campaigns[-1]}
        )

    def _sight(self, defect: dict[str, Any], campaign: str) -> None:
        """Sightings of a defect, each of its size."""
        for k in range(SIGHTINGS):
            self.rows["observations"].append(
                self._key(campaign)
                | {"observation_id": f"{defect['defect_id']}-{k}", "defect_id": defect["defect_id"]}
                | {"length_m": defect["length_m"], "area_m2": defect["area_m2"]}
                | {"width_m": defect["width_m"], "height_m": defect["height_m"], "gsd_mm": 3.0, "distance_m": 10.0}
                | {"incidence_deg": 45.0, "normal_x": 0.0, "normal_y": -1.0, "normal_z": 0.0}
            )

    def resize(self, track_id: str, campaign: str, *, merged: bool = True, **columns: Any) -> None:
        """Set columns of a detection and of its sightings; those of the sightings alone unless ``merged``."""
        defect_id = f"{track_id}-in-{campaign}"
        for table in ("defects", "observations") if merged else ("observations",):
            own = {name: value for name, value in columns.items() if name in LAKE_TABLES[table].arrow.names}
            for row in self.rows[table]:
                if row["defect_id"] == defect_id:
                    row.update(own)

    def change(self, track_id: str, campaign: str, **columns: Any) -> None:
        """Set columns of a row of ``track_states``."""
        for row in self.rows["track_states"]:
            if (row["track_id"], row["campaign_id"]) == (track_id, campaign):
                row.update(columns)

    def look(self, track_id: str, campaign: str, compared: str, verdict: str, **columns: Any) -> None:
        """A row of ``looks``."""
        self.rows["looks"].append(
            self._key(campaign)
            | {"track_id": track_id, "compared_campaign": compared, "defect_id": f"{track_id}-in-{compared}"}
            | {"look_verdict": verdict, "look_count": 1, "compared_count": 1, "look_photo_id": "b.png"}
            | {"compared_photo_id": "a.png", "look_similarity": 0.07, "surroundings_similarity": 0.83}
            | columns
        )

    @property
    def tables(self) -> dict[str, pa.Table]:
        """The tables."""
        return {name: make_table(name, rows) for name, rows in self.rows.items()}
