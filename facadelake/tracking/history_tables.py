"""The tables of a building's history: tracks with permanent ids, and what became of each in every campaign."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from facadelake.core.arrays import RowIndices
from facadelake.core.geodesy import SiteOrigin
from facadelake.core.tables import Row, list_rows, table_from_rows
from facadelake.tracking.campaign_defects import CLASSES
from facadelake.tracking.chain import CampaignLink
from facadelake.tracking.frame_offsets import FrameOffset
from facadelake.tracking.identity import Chains, KnownTracks, assign_track_numbers, format_track_id, read_track_number
from facadelake.tracking.linked import YEAR, Change, LinkedHistory
from facadelake.tracking.looks import Look
from facadelake.tracking.states import StateInCampaign, TrackEvidence, decide_states
from facadelake.tracking.track_trends import describe_trends
from schemas.tables import HISTORY_TABLES
from schemas.vocabulary import DefectClass, OffsetOutcome, TrackState, TrendQuantity

_REACH_MIN_M = 0.3  # from a track's place, within which the same defect lies when its campaign is inspected anew
_SAME_DAY_YEARS = 1 / 365.25
_GEO = ("lon_deg", "lat_deg", "height_ellipsoidal_m")
_CHANGES = {
    TrendQuantity.LENGTH: ("length_change_m", "length_change_sigma_m"),
    TrendQuantity.AREA: ("area_change_m2", "area_change_sigma_m2"),
    TrendQuantity.CRACK_WIDTH: ("crack_width_change_mm", "crack_width_change_sigma_mm"),
}
_LOG_ODDS_MIN = -12.0  # candidates that are less likely are not kept


@dataclass(frozen=True, kw_only=True)
class KnownHistory:
    """The building's rows of tables ``tracks``, ``track_states`` and ``track_reviews`` in the lake."""

    tracks: pa.Table
    states: pa.Table
    reviews: pa.Table


@dataclass(frozen=True, kw_only=True, eq=False)
class HistoryTables:
    """Tables of the history by name, and pictures of the looks (JPEG) by file name."""

    tables: Mapping[str, pa.Table]
    pictures: Mapping[str, bytes]


def build_history_tables(
    building_id: str,
    history: LinkedHistory,
    looks: Mapping[tuple[str, str, str], Look],
    known: KnownHistory,
    *,
    origin: SiteOrigin,
    rule_file: Path,
) -> HistoryTables:
    """The tables of all campaigns of a building.

    Args:
        building_id: the building.
        history: its campaigns, linked.
        looks: the looks by key, for ``list_look_requests``.
        known: what the lake knows of the building's tracks: their ids stay.
        origin: origin of the site frame.
        rule_file: the rule pack, of which the next limit is told.
    """
    numbers = _assign_numbers(history, known, origin)
    ids = [format_track_id(building_id, int(number)) for number in numbers]
    builder = _Builder(
        building_id=building_id,
        history=history,
        looks=looks,
        ids=ids,
        reviews=_read_reviews(known),
        defects=[list_rows(one.defect_table) for one in history.campaigns],
    )
    states = [builder.decide(chain) for chain in range(len(ids))]
    trends = describe_trends(history, rule_file)
    looked = builder.list_looks()
    rows = {
        "tracks": [
            *(builder.build_track(chain, states[chain], trends[chain]) for chain in range(len(ids))),
            *_withdraw(known.tracks, set(ids)),
        ],
        "track_states": [row for chain in range(len(ids)) for row in builder.build_states(chain, states[chain])],
        "track_relations": builder.build_relations(),
        "track_candidates": builder.build_candidates(),
        "looks": [row for row, _ in looked],
        "frame_offsets": [row for link in history.links for row in builder.build_offsets(link)],
    }
    tables = {
        name: table_from_rows(name, found).sort_by([(key, "ascending") for key in HISTORY_TABLES[name].key])
        for name, found in rows.items()
    }
    pictures = {name_picture(row): look.picture for row, look in looked if look.picture is not None}
    return HistoryTables(tables=tables, pictures=pictures)


def name_picture(look: Mapping[str, Any]) -> str:
    """File name of the picture of a row of table ``looks``."""
    return f"{look['track_id']}_{look['compared_campaign']}_{look['campaign_id']}.jpg"


@dataclass(frozen=True, kw_only=True, eq=False)
class _Builder:
    """Rows of the tables; ``ids`` of the chains, ``reviews``: states by track and campaign, with the reviewer.

    ``defects``: rows of table ``defects`` by number of the campaign.
    """

    building_id: str
    history: LinkedHistory
    looks: Mapping[tuple[str, str, str], Look]
    ids: list[str]
    reviews: Mapping[str, Mapping[str, tuple[TrackState, str]]]
    defects: list[list[Row]]

    def decide(self, chain: int) -> list[StateInCampaign]:
        """The states of a chain in every campaign."""
        names = [one.campaign_id for one in self.history.campaigns]
        reviews = {campaign: state for campaign, (state, _) in self.reviews.get(self.ids[chain], {}).items()}
        evidence = TrackEvidence(
            sightings={names[k]: self._name_change(k, chain)[0] for k in self.history.sightings[chain]},
            looks={names[k]: look.verdict for k, look in self._list_looks_of(chain)},
            parts=frozenset(names[k] for k in self.history.parts[chain]),
            reviews=reviews,
        )
        return decide_states(names, evidence)

    def _name_change(self, campaign: int, chain: int) -> tuple[int, TrendQuantity | None]:
        """1 grown, -1 shrunk, 0 neither, and the quantity that says so most clearly."""
        row = self.history.sightings[chain][campaign].row
        changes = {q: c for q, c in self.history.changes.get((campaign, row), {}).items() if c.significant}
        if not changes:
            return 0, None
        quantity = max(changes, key=lambda q: abs(changes[q].log_change) / changes[q].sigma)
        return (1 if changes[quantity].log_change > 0 else -1), quantity

    def _list_looks_of(self, chain: int) -> list[tuple[int, Look]]:
        """The looks of a chain, by number of the campaign."""
        sightings = self.history.sightings[chain]
        known = sorted(sightings)
        found = []
        for campaign, records in enumerate(self.history.campaigns):
            if campaign not in sightings:
                seen = max((k for k in known if k < campaign), default=known[0])
                defects = self.history.campaigns[seen]
                defect_id = str(defects.tracked.defects.defect_id[sightings[seen].row])
                found.append((campaign, self.looks[defects.campaign_id, defect_id, records.campaign_id]))
        return found

    def _key(self, campaign: int) -> Row:
        records = self.history.campaigns[campaign]
        return {"building_id": self.building_id, "campaign_id": records.campaign_id, "run_id": records.run_id}

    def build_track(self, chain: int, states: list[StateInCampaign], trend: Row) -> Row:
        """The row of table ``tracks``."""
        sightings, campaigns = self.history.sightings[chain], self.history.campaigns
        detected = max(sightings)
        defect = self.defects[detected][sightings[detected].row]
        columns = {column.name for column in HISTORY_TABLES["tracks"].columns}
        numbers = {records.campaign_id: k for k, records in enumerate(campaigns)}
        present = [numbers[state.campaign_id] for state in states if state.present]
        first, last = (present[0], present[-1]) if present else (min(sightings), detected)
        return {
            **{name: value for name, value in defect.items() if name in columns},
            **trend,
            **self._key(len(campaigns) - 1),
            "track_id": self.ids[chain],
            "track_state": states[-1].state,
            "withdrawn": False,
            "first_campaign": campaigns[first].campaign_id,
            "last_campaign": campaigns[last].campaign_id,
            "detected_campaign": campaigns[detected].campaign_id,
            "first_seen_at": campaigns[first].tracked.captured_at,
            "last_seen_at": campaigns[last].tracked.captured_at,
            "detected_count": len(sightings),
        }

    def build_states(self, chain: int, states: list[StateInCampaign]) -> list[Row]:
        """The rows of table ``track_states``."""
        sightings = self.history.sightings[chain]
        numbers = {records.campaign_id: k for k, records in enumerate(self.history.campaigns)}
        looks = dict(self._list_looks_of(chain))
        known = sorted(sightings)
        rows = []
        for state in states:
            campaign = numbers[state.campaign_id]
            near = max((k for k in known if k <= campaign), default=known[0])
            defect = self.defects[near][sightings[near].row]
            review = self.reviews.get(self.ids[chain], {}).get(state.campaign_id)
            row = {
                **self._key(campaign),
                "track_id": self.ids[chain],
                "track_state": state.state,
                "state_evidence": state.evidence,
                "defect_class": defect["defect_class"],
                "geometry": defect["geometry"],
                "reviewer": review[1] if review else None,
            }
            if campaign in sightings:
                row |= self._describe_sighting(chain, campaign, defect)
            elif campaign in looks:
                row["state_remark"] = looks[campaign].remark
            rows.append(row)
        return rows

    def _describe_sighting(self, chain: int, campaign: int, defect: Row) -> Row:
        """Columns of a state that a detection has: its defect, the match, the change since the detection before."""
        one = self.history.sightings[chain][campaign]
        columns: Row = {"defect_id": defect["defect_id"], "match_probability": one.probability}
        if one.previous is None:
            return columns
        before = self.history.campaigns[one.previous[0]]
        years = (self.history.campaigns[campaign].tracked.captured_at - before.tracked.captured_at) / YEAR
        columns |= {"previous_campaign": before.campaign_id, "years_since_previous": years}
        if years < _SAME_DAY_YEARS:
            columns["state_remark"] = "less than a day after the detection before: a rate would say nothing"
        for quantity, change in self.history.changes.get((campaign, one.row), {}).items():
            size = float(np.exp(before.sizes[quantity].log_size[one.previous[1]]))
            columns |= dict(zip(_CHANGES[quantity], _convert_change(size, change), strict=True))
        columns["changed_quantity"] = self._name_change(campaign, chain)[1]
        return columns

    def build_relations(self) -> list[Row]:
        """The rows of table ``track_relations``."""
        return [
            {
                **self._key(one.campaign),
                "track_id": self.ids[one.chain],
                "track_relation": one.kind,
                "other_track_id": None if one.other is None else self.ids[one.other],
                "detail": one.detail,
            }
            for one in self.history.relations
        ]

    def build_candidates(self) -> list[Row]:
        """The rows of table ``track_candidates``."""
        rows = []
        for campaign, records in enumerate(self.history.campaigns):
            found = self.history.find_link(campaign).candidates
            for k in np.flatnonzero(found.matched | (found.log_odds >= _LOG_ODDS_MIN)).tolist():
                rows.append(
                    {
                        **self._key(campaign),
                        "track_id": self.ids[int(found.chain[k])],
                        "defect_id": str(records.tracked.defects.defect_id[found.defect[k]]),
                        "displacement_m": float(found.displacement_m[k]),
                        "mahalanobis_distance": float(found.mahalanobis[k]),
                        "log_odds": float(found.log_odds[k]),
                        "match_probability": float(min(found.probability[k], 1.0)),
                        "matched": bool(found.matched[k]),
                    }
                )
        return rows

    def list_looks(self) -> list[tuple[Row, Look]]:
        """The rows of table ``looks``, each with its look."""
        return [
            (self._describe_look(chain, campaign, look), look)
            for chain in range(len(self.ids))
            for campaign, look in self._list_looks_of(chain)
        ]

    def _describe_look(self, chain: int, campaign: int, look: Look) -> Row:
        found = look.comparison
        row: Row = {
            **self._key(campaign),
            "track_id": self.ids[chain],
            "compared_campaign": look.key[0],
            "defect_id": look.key[1],
            "look_verdict": look.verdict,
            "look_count": look.photo_counts[1],
            "compared_count": look.photo_counts[0],
            "look_photo_id": look.photo_ids[1],
            "compared_photo_id": look.photo_ids[0],
        }
        if found is None:
            return row
        return {
            **row,
            "look_similarity": _drop_nan(found.at_defect),
            "surroundings_similarity": _drop_nan(found.around),
            "fading_extent": found.fading.extent,
            "fading_sigmas": found.fading.sigmas,
            "darkening_extent": found.fading.opposite_extent,
            "contrast_difference": found.difference,
            "contrast_left": found.left,
            "look_cell_mm": 1000 * found.cell_m,
        }

    def build_offsets(self, link: CampaignLink) -> list[Row]:
        """The rows of table ``frame_offsets`` of a campaign."""
        run_ids = {records.campaign_id: records.run_id for records in self.history.refused}
        run_ids |= {records.campaign_id: records.run_id for records in self.history.campaigns}
        return [
            {
                "building_id": self.building_id,
                "campaign_id": link.campaign_id,
                "run_id": run_ids[link.campaign_id],
                "facade": offset.facade,
                "offset_outcome": offset.outcome,
                **_describe_offset(offset),
                "offset_count": offset.pairs,
                "found_again_share": None if np.isnan(link.found_again) else link.found_again,
                "detail": _explain_offset(offset, link.campaign_id, self.history.time_remarks.get(link.campaign_id)),
            }
            for offset in link.offsets
        ]


def _describe_offset(offset: FrameOffset) -> Row:
    if offset.outcome not in (OffsetOutcome.ESTIMATED, OffsetOutcome.REFUSED):
        return {}
    sigma = np.sqrt(np.diag(offset.covariance_m2))
    names = ("east", "north", "up")
    return {
        **{f"offset_{name}_m": float(value) for name, value in zip(names, offset.xyz_m, strict=True)},
        **{f"offset_sigma_{name}_m": float(value) for name, value in zip(names, sigma, strict=True)},
    }


def _explain_offset(offset: FrameOffset, campaign_id: str, time_remark: str | None) -> str:
    words = {
        OffsetOutcome.FIRST: "the first campaign: the others are compared with its frame",
        OffsetOutcome.TOO_FEW: "too few defects agree on an offset; none is taken off",
        OffsetOutcome.ESTIMATED: f"{offset.pairs} defects agree on it; it is taken off before defects are matched",
        OffsetOutcome.REFUSED: (
            f"{offset.pairs} defects agree that the positions of {campaign_id} are "
            f"{np.linalg.norm(offset.xyz_m):.2f} m off those of the campaigns before; the georeferencing of both "
            f"admits {offset.limit_m or 0:.2f} m. Its defects are not matched: inspect that campaign, or the one "
            "before, with other control"
        ),
    }[offset.outcome]
    return f"{words}; {time_remark}" if time_remark else words


def _drop_nan(value: float) -> float | None:
    return None if np.isnan(value) else value


def _convert_change(size: float, change: Change) -> tuple[float, float]:
    """A change and one sigma in the unit of ``size``, the size before."""
    return size * (float(np.exp(change.log_change)) - 1), size * float(np.exp(change.log_change)) * change.sigma


def _read_reviews(known: KnownHistory) -> dict[str, dict[str, tuple[TrackState, str]]]:
    """State and reviewer by track and campaign; the latest review counts."""
    found: dict[str, dict[str, tuple[TrackState, str]]] = {}
    for row in sorted(list_rows(known.reviews), key=lambda r: (r["reviewed_at"], r["review_id"])):
        found.setdefault(row["track_id"], {})[row["campaign_id"]] = (TrackState(row["track_state"]), row["reviewer"])
    return found


def _withdraw(tracks: pa.Table, current: set[str]) -> list[Row]:
    """Rows of known tracks that no campaign has any more."""
    return [
        {**row, "track_state": None, "withdrawn": True} for row in list_rows(tracks) if row["track_id"] not in current
    ]


def _assign_numbers(history: LinkedHistory, known: KnownHistory, origin: SiteOrigin) -> RowIndices:
    """Numbers of the chains' ids."""
    rows = list_rows(known.tracks)
    of_track = {row["track_id"]: k for k, row in enumerate(rows)}
    sightings = {
        (row["campaign_id"], row["run_id"], row["defect_id"]): of_track[row["track_id"]]
        for row in list_rows(known.states.select(["campaign_id", "run_id", "defect_id", "track_id"]))
        if row["defect_id"] is not None and row["track_id"] in of_track
    }
    geo = np.array([[row[name] for name in _GEO] for row in rows]).reshape(-1, 3)
    tracks = KnownTracks(
        number=np.array([read_track_number(row["track_id"]) for row in rows], dtype=np.int64),
        xyz_site_m=origin.site_from_geo(geo) if len(rows) else geo,
        reach_m=np.array([max(_REACH_MIN_M, np.hypot(row["width_m"], row["height_m"]) / 2) for row in rows]),
        defect_class=np.array([CLASSES.index(DefectClass(row["defect_class"])) for row in rows], dtype=np.int64),
        sightings=sightings,
    )
    places, classes, lists = [], [], []
    links = [history.find_link(k) for k in range(len(history.campaigns))]
    for one in history.sightings:
        last = max(one)
        defects = history.campaigns[last].tracked.defects
        places.append(defects.xyz_site_m[one[last].row] - links[last].offset_m[one[last].row])
        classes.append(int(defects.defect_class[one[last].row]))
        lists.append(
            [
                (
                    history.campaigns[k].campaign_id,
                    history.campaigns[k].run_id,
                    str(history.campaigns[k].tracked.defects.defect_id[sighting.row]),
                )
                for k, sighting in one.items()
            ]
        )
    chains = Chains(
        xyz_site_m=np.array(places).reshape(-1, 3), defect_class=np.array(classes, dtype=np.int64), sightings=lists
    )
    return assign_track_numbers(tracks, chains)
