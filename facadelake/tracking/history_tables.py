"""The tables of a building's history: tracks with permanent ids, and what became of each in every campaign."""

from __future__ import annotations

from bisect import bisect
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from facadelake.core.geodesy import SiteOrigin
from facadelake.core.tables import Row, list_rows, table_from_rows
from facadelake.tracking.chain_numbers import assign_chain_numbers
from facadelake.tracking.identity import format_track_id
from facadelake.tracking.linked import YEAR, LinkedHistory
from facadelake.tracking.offset_rows import build_offset_rows
from facadelake.tracking.second_look.look import Look
from facadelake.tracking.size_pairs import judge_growth
from facadelake.tracking.states import StateInCampaign, TrackEvidence, decide_states
from facadelake.tracking.track_trends import describe_trends
from schemas.tables import HISTORY_TABLES
from schemas.vocabulary import TrackState, TrendQuantity

_SAME_DAY_YEARS = 1 / 365.25
_CHANGES = {
    TrendQuantity.LENGTH: ("length_change_m", "length_change_sigma_m"),
    TrendQuantity.AREA: ("area_change_m2", "area_change_sigma_m2"),
    TrendQuantity.CRACK_WIDTH: ("crack_width_change_mm", "crack_width_change_sigma_mm"),
}
_ROWS_AT_A_TIME = 10_000
_STATE_COLUMNS = ["defect_id", "defect_class", "element_guid", "geometry"]
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
    numbers = assign_chain_numbers(history, known.tracks, known.states, origin)
    ids = [format_track_id(building_id, int(number)) for number in numbers]
    builder = _Builder(
        building_id=building_id,
        history=history,
        looks=looks,
        ids=ids,
        reviews=_read_reviews(known),
        defects=[list_rows(one.defect_table.select(_STATE_COLUMNS)) for one in history.campaigns],
        last_detected=_read_last_detected(history),
    )
    states = [builder.decide(chain) for chain in range(len(ids))]
    trends = describe_trends(history, rule_file)
    rows: dict[str, Iterable[Row]] = {
        "tracks": chain.from_iterable(
            (
                (builder.build_track(number, states[number], trends[number]) for number in range(len(ids))),
                _withdraw(known.tracks, set(ids)),
            )
        ),
        "track_states": (row for number in range(len(ids)) for row in builder.build_states(number, states[number])),
        "track_relations": builder.build_relations(),
        "track_candidates": builder.build_candidates(),
        "looks": builder.build_look_rows(),
        "frame_offsets": build_offset_rows(building_id, history),
    }
    tables = {name: _make_table(name, found) for name, found in rows.items()}
    pictures = dict(builder.list_pictures())
    return HistoryTables(tables=tables, pictures=pictures)


def _read_last_detected(history: LinkedHistory) -> list[Row]:
    """The row of table ``defects`` of each chain's last detection."""
    found: list[Row] = [{} for _ in history.sightings]
    for campaign, records in enumerate(history.campaigns):
        chains = [number for number, one in enumerate(history.sightings) if max(one) == campaign]
        rows = records.defect_table.take(pa.array([history.sightings[n][campaign].row for n in chains], pa.int64()))
        for number, row in zip(chains, list_rows(rows), strict=True):
            found[number] = row
    return found


def _make_table(name: str, rows: Iterable[Row]) -> pa.Table:
    """A table of many rows, some thousand of which are in memory as Python objects at a time."""
    parts = [table_from_rows(name, [])]
    remaining = iter(rows)
    while part := list(islice(remaining, _ROWS_AT_A_TIME)):
        parts.append(table_from_rows(name, part))
    return pa.concat_tables(parts).sort_by([(key, "ascending") for key in HISTORY_TABLES[name].key])


def name_picture(look: Mapping[str, Any]) -> str:
    """File name of the picture of a row of table ``looks``."""
    return f"{look['track_id']}_{look['compared_campaign']}_{look['campaign_id']}.jpg"


@dataclass(frozen=True, kw_only=True, eq=False)
class _Builder:
    """Rows of the tables; ``ids`` of the chains, ``reviews``: states by track and campaign, with the reviewer.

    ``defects``: columns of table ``defects`` that states have, by number of the campaign; ``last_detected``: the whole
    row of each chain's last detection.
    """

    building_id: str
    history: LinkedHistory
    looks: Mapping[tuple[str, str, str], Look]
    ids: list[str]
    reviews: Mapping[str, Mapping[str, tuple[TrackState, str]]]
    defects: list[list[Row]]
    last_detected: list[Row]

    def decide(self, chain: int) -> list[StateInCampaign]:
        """The states of a chain in every campaign."""
        names = [one.campaign_id for one in self.history.campaigns]
        reviews = {campaign: state for campaign, (state, _) in self.reviews.get(self.ids[chain], {}).items()}
        evidence = TrackEvidence(
            sightings={names[k]: self._name_change(k, chain)[0] for k in self.history.sightings[chain]},
            looks={names[k]: look.verdict for k, look in self._map_look_by_campaign(chain)},
            parts=frozenset(names[k] for k in self.history.parts[chain]),
            reviews=reviews,
        )
        return decide_states(names, evidence)

    def _name_change(self, campaign: int, chain: int) -> tuple[int, TrendQuantity | None]:
        """1 grown, -1 shrunk, 0 neither, and the quantity that says so most clearly."""
        row = self.history.sightings[chain][campaign].row
        return judge_growth(self.history.changes.get((campaign, row), {}))

    def _map_look_by_campaign(self, chain: int) -> list[tuple[int, Look]]:
        """The looks of a chain, by number of the campaign."""
        sightings = self.history.sightings[chain]
        known = sorted(sightings)
        found = []
        for campaign, records in enumerate(self.history.campaigns):
            if campaign not in sightings:
                seen = known[max(bisect(known, campaign) - 1, 0)]
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
        defect = self.last_detected[chain]
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
        looks = dict(self._map_look_by_campaign(chain))
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
                row |= self._describe_detection(chain, campaign, defect)
            elif campaign in looks:
                row["state_remark"] = looks[campaign].remark
            rows.append(row)
        return rows

    def _describe_detection(self, chain: int, campaign: int, defect: Row) -> Row:
        """Columns of a state that a detection has: its defect, the match, the change since the detection before."""
        one = self.history.sightings[chain][campaign]
        columns: Row = {"defect_id": defect["defect_id"], "match_probability": one.probability}
        if one.previous is None:
            return columns
        before = self.history.campaigns[one.previous[0]]
        years = (self.history.campaigns[campaign].tracked.captured_at - before.tracked.captured_at) / YEAR
        columns |= {"previous_campaign": before.campaign_id, "years_since_previous": years}
        remarks = []
        if years < _SAME_DAY_YEARS:
            remarks.append("less than a day after the detection before: a rate would say nothing")
        element = self.defects[one.previous[0]][one.previous[1]]["element_guid"]
        if element != defect["element_guid"]:
            remarks.append(f"attributed to element {defect['element_guid']}, in {before.campaign_id} to {element}")
        columns["state_remark"] = "; ".join(remarks) or None
        for quantity, change in self.history.changes.get((campaign, one.row), {}).items():
            columns |= dict(zip(_CHANGES[quantity], (change.change, change.sigma), strict=True))
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

    def build_candidates(self) -> Iterator[Row]:
        """The rows of table ``track_candidates``."""
        for campaign, records in enumerate(self.history.campaigns):
            found = self.history.find_link(campaign).candidates
            for k in np.flatnonzero(found.matched | (found.log_odds >= _LOG_ODDS_MIN)).tolist():
                yield {
                    **self._key(campaign),
                    "track_id": self.ids[int(found.chain[k])],
                    "defect_id": str(records.tracked.defects.defect_id[found.defect[k]]),
                    "displacement_m": float(found.displacement_m[k]),
                    "mahalanobis_distance": float(found.mahalanobis[k]),
                    "log_odds": float(found.log_odds[k]),
                    "match_probability": float(min(found.probability[k], 1.0)),
                    "matched": bool(found.matched[k]),
                }

    def build_look_rows(self) -> Iterator[Row]:
        """The rows of table ``looks``."""
        for number in range(len(self.ids)):
            for campaign, look in self._map_look_by_campaign(number):
                yield self._describe_look(number, campaign, look)

    def list_pictures(self) -> Iterator[tuple[str, bytes]]:
        """The pictures of looks, with their file names."""
        for number in range(len(self.ids)):
            for campaign, look in self._map_look_by_campaign(number):
                if look.picture is not None:
                    yield name_picture(self._describe_look(number, campaign, look)), look.picture

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


def _drop_nan(value: float) -> float | None:
    return None if np.isnan(value) else value


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
