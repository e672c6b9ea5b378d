"""What a defect's card says in words."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import pyarrow as pa

from facadelake.reporting.inspection import Inspection
from schemas.vocabulary import CrackWidthOutcome, MergeDecision, PositionMethod

CardFact = tuple[str, str]
Row = Mapping[str, Any]


def list_card_facts(row: Row, inspection: Inspection, merges: Sequence[Row]) -> list[CardFact]:
    """(what, value) lines of a row of ``defects``; what was not measured is left out. ``merges`` are its own pairs."""
    facts = [
        ("severity", f"{row['severity']} by {row['severity_rule']}, graded by {row['graded_by'] or 'rules'}"),
        ("size", _format_size(row)),
    ]
    width = format_crack_width(row)
    if width is not None:
        facts.append(("crack width", width))
    facts.append(("element", _format_element(row)))
    facts.append(("GlobalId", row["element_guid"]))
    facts.append(("storey, facade", f"{row['storey'] or 'no storey'}, {row['facade']}"))
    facts += _list_position_facts(row, inspection)
    facts.append(("seen", _format_photographs(row)))
    facts.append(("found by", f"{inspection.detectors}, score {row['score']:.2f}"))
    facts += _list_merge_facts(row["defect_id"], merges)
    return facts


def format_crack_width(row: Row) -> str | None:
    """A crack's mean width with one sigma, or the bound it lies below; None where neither is known."""
    outcome, width, sigma = row["crack_width_outcome"], row["crack_width_mm"], row["crack_width_sigma_mm"]
    if width is not None:
        text = f"{width:.2f} mm" if sigma is None else f"{width:.1f} ± {sigma:.1f} mm"
        if row["crack_width_max_mm"] is not None:
            text += f", {row['crack_width_max_mm']:.1f} mm at its widest"
        return f"{text} (stated)" if outcome == CrackWidthOutcome.STATED else text
    limit = row["crack_width_limit_mm"]
    return None if outcome != CrackWidthOutcome.BELOW_LIMIT or limit is None else f"< {limit:.1f} mm"


def group_merges(merges: pa.Table) -> dict[str, list[Row]]:
    """Rows of ``merges`` under each of the defects that they name."""
    found: dict[str, list[Row]] = {}
    for row in merges.to_pylist():
        for defect_id in {row["defect_id"], row["other_defect_id"]} - {None}:
            found.setdefault(defect_id, []).append(row)
    return found


def _format_size(row: Row) -> str:
    text = f"{_format_length(row['width_m'])} wide, {_format_length(row['height_m'])} high"
    if row["length_m"] is not None:
        text += f", {_format_length(row['length_m'])} at its longest"
    if row["crack_length_m"] is not None:
        text += f", {_format_length(row['crack_length_m'])} along the crack"
    return f"{text}; {row['area_m2']:.3f} m²"


def _format_length(metres: float) -> str:
    return f"{metres:.2f} m" if metres >= 1 else f"{100 * metres:.1f} cm"


def _format_element(row: Row) -> str:
    text = row["ifc_class"] if row["element_name"] is None else f"{row['element_name']} ({row['ifc_class']})"
    return f"{text}, {row['material']}" if row["material"] else str(text)


def _list_position_facts(row: Row, inspection: Inspection) -> list[CardFact]:
    site = ", ".join(f"{row[axis]:.3f}" for axis in ("x_site_m", "y_site_m", "z_site_m"))
    sigmas = [row[f"sigma_{axis}_m"] for axis in ("east", "north", "up")]
    building = inspection.building
    facts = [
        ("site e, n, u (m)", site),
        ("EPSG:4979", f"{row['lon_deg']:.8f}, {row['lat_deg']:.8f}, {row['height_ellipsoidal_m']:.3f} m"),
        (building.map_crs, f"{row['east_map_m']:.3f}, {row['north_map_m']:.3f}, {row['height_map_m']:.3f} m"),
    ]
    if None not in sigmas:
        facts.append(("one sigma", f"{', '.join(f'{1000 * sigma:.1f}' for sigma in sigmas)} mm (east, north, up)"))
    if row["position_method"] is not None:
        facts.append(
            (
                "position from",
                "the model's surface"
                if row["position_method"] == PositionMethod.SURFACE
                else "its sightings' rays (triangulated)",
            )
        )
    if row["deviation_from_model_m"] is not None:
        side = "before" if row["deviation_from_model_m"] >= 0 else "behind"
        text = f"{1000 * abs(row['deviation_from_model_m']):.0f} mm {side} the model's surface"
        if row["deviation_sigma_m"] is not None:
            text += f" (± {1000 * row['deviation_sigma_m']:.0f} mm)"
        facts.append(("deviation", text))
    return facts


def _format_photographs(row: Row) -> str:
    text = f"in {row['photo_count']} photograph{'' if row['photo_count'] == 1 else 's'}"
    if row["spread_m"] is not None and row["photo_count"] > 1:
        text += f", at most {100 * row['spread_m']:.1f} cm from the position"
    return text


def _list_merge_facts(defect_id: str, merges: Sequence[Row]) -> list[CardFact]:
    """What joined its sightings, and which neighbour was kept apart and why."""
    own = [row for row in merges if row["merge_decision"] == MergeDecision.JOINED]
    facts: list[CardFact] = []
    if own:
        reasons = Counter(row["merge_reason"].replace("_", " ") for row in own)
        text = ", ".join(f"{count} pair{'' if count == 1 else 's'} by {word}" for word, count in reasons.most_common())
        text += f"; at most {max(row['mahalanobis_distance'] for row in own):.1f} sigma apart"
        scores = [row["appearance_score"] for row in own if row["appearance_score"] is not None]
        if scores:
            text += f", likeness {min(scores):.2f} to {max(scores):.2f}"
        facts.append(("joined", text))
    apart = [
        row
        for row in merges
        if row["merge_decision"] == MergeDecision.APART and row["defect_id"] != row["other_defect_id"]
    ]
    if apart:
        nearest = min(apart, key=lambda row: row["separation_m"])
        other = nearest["other_defect_id"] if nearest["defect_id"] == defect_id else nearest["defect_id"]
        reason = nearest["merge_reason"].replace("_", " ")
        facts.append(("kept apart", f"from {other}, {100 * nearest['separation_m']:.0f} cm away: {reason}"))
    return facts
