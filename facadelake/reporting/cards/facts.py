"""Facts of a defect's card: size, element, position, photographs and merging as text."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa

from facadelake.core.frames import facade_from_site
from facadelake.core.geodesy import SITE_AXES
from facadelake.reporting.inspection import Inspection
from facadelake.severity import describe_severity
from schemas.vocabulary import CrackWidthOutcome, MergeDecision, PositionMethod

_SITE = ("x_site_m", "y_site_m", "z_site_m")
CardFact = tuple[str, str]
Row = Mapping[str, Any]


def list_card_facts(row: Row, inspection: Inspection, merges: Sequence[Row]) -> list[CardFact]:
    """Facts (name, value) of a defect; facts that were not measured are omitted.

    ``row``: row of table ``defects``. ``merges``: the rows of table ``merges`` that name the defect.
    """
    facts = [
        (
            "severity",
            f"{describe_severity(row)}, rule pack {row['severity_rule']}, graded by {row['graded_by'] or 'rules'}",
        ),
        ("size", _format_size(row)),
    ]
    width = format_crack_width(row)
    if width is not None:
        facts.append(("crack width", width))
    facts.append(("element", _format_element(row)))
    facts.append(("GlobalId", row["element_guid"]))
    facts.append(("storey, facade", f"{row['storey'] or 'no storey'}, {row['facade']}"))
    facts += _list_position_facts(row, inspection)
    facts.append(("visible in", _format_photographs(row)))
    facts.append(("detected by", f"{inspection.detectors}, score {row['score']:.2f}"))
    facts += _list_merge_facts(row["defect_id"], merges)
    return facts


def format_crack_width(row: Row) -> str | None:
    """Mean width of a crack with one sigma, or its upper bound; None where neither is known."""
    outcome, width, sigma = row["crack_width_outcome"], row["crack_width_mm"], row["crack_width_sigma_mm"]
    if width is not None:
        text = f"{width:.2f} mm" if sigma is None else f"{width:.1f} ± {sigma:.1f} mm"
        if row["crack_width_max_mm"] is not None:
            text += f", maximum {row['crack_width_max_mm']:.1f} mm"
        if row["crack_width_blur_mm"] is not None:
            text += f"; may be overstated by about {row['crack_width_blur_mm']:.0f} mm (unknown blur)"
        return f"{text} (stated)" if outcome == CrackWidthOutcome.STATED else text
    limit = row["crack_width_limit_mm"]
    return None if outcome != CrackWidthOutcome.BELOW_LIMIT or limit is None else f"< {limit:.1f} mm"


def format_geo_position(row: Row) -> str:
    """Longitude and latitude in degrees, and ellipsoidal height in metres, in the order of EPSG:4979 in all tables."""
    return f"{row['lon_deg']:.8f}, {row['lat_deg']:.8f}, {row['height_ellipsoidal_m']:.3f}"


def group_merges(merges: pa.Table) -> dict[str, list[Row]]:
    """Rows of table ``merges`` by the defects that they name."""
    groups: dict[str, list[Row]] = {}
    for row in merges.to_pylist():
        for defect_id in {row["defect_id"], row["other_defect_id"]} - {None}:
            groups.setdefault(defect_id, []).append(row)
    return groups


def _format_size(row: Row) -> str:
    text = f"width {_format_length(row['width_m'])}, height {_format_length(row['height_m'])}"
    if row["length_m"] is not None:
        text += f", longest extent {_format_length(row['length_m'])}"
    if row["crack_length_m"] is not None:
        text += f", crack length {_format_length(row['crack_length_m'])}"
    return f"{text}, area {row['area_m2']:.3f} m²"


def _format_length(metres: float) -> str:
    return f"{metres:.2f} m" if metres >= 1 else f"{100 * metres:.1f} cm"


def _format_element(row: Row) -> str:
    text = row["ifc_class"] if row["element_name"] is None else f"{row['element_name']} ({row['ifc_class']})"
    return f"{text}, {row['material']}" if row["material"] else str(text)


def _list_position_facts(row: Row, inspection: Inspection) -> list[CardFact]:
    site = ", ".join(f"{row[axis]:.3f}" for axis in _SITE)
    sigmas = [row[f"sigma_{axis}_m"] for axis in SITE_AXES]
    building = inspection.building
    facts = [
        ("site E, N, U (m)", site),
        ("lon, lat, height", f"{format_geo_position(row)} m (EPSG:4979)"),
        (building.map_crs, f"{row['east_map_m']:.3f}, {row['north_map_m']:.3f}, {row['height_map_m']:.3f} m"),
    ]
    if row["facade_azimuth_deg"] is not None:
        u_m, v_m, _ = facade_from_site(np.array([row[axis] for axis in _SITE])[None], row["facade_azimuth_deg"])[0]
        facts.append(("facade u, v (m)", f"{u_m:.3f}, {v_m:.3f}"))
    if None not in sigmas:
        text = ", ".join(f"{1000 * sigma:.1f} mm {axis}" for sigma, axis in zip(sigmas, SITE_AXES, strict=True))
        facts.append(("one sigma", text))
    if row["position_method"] is not None:
        facts.append(
            (
                "position method",
                "surface of the model"
                if row["position_method"] == PositionMethod.SURFACE
                else "triangulated from its observations",
            )
        )
    if row["deviation_from_model_m"] is not None:
        side = "in front of" if row["deviation_from_model_m"] >= 0 else "behind"
        text = f"{1000 * abs(row['deviation_from_model_m']):.0f} mm {side} the model surface"
        if row["deviation_sigma_m"] is not None:
            text += f" (± {1000 * row['deviation_sigma_m']:.0f} mm)"
        facts.append(("deviation", text))
    return facts


def _format_photographs(row: Row) -> str:
    text = f"{row['photo_count']} photograph{'' if row['photo_count'] == 1 else 's'}"
    if row["spread_m"] is not None and row["photo_count"] > 1:
        text += f"; observations up to {100 * row['spread_m']:.1f} cm from the position"
    return text


def _list_merge_facts(defect_id: str, merges: Sequence[Row]) -> list[CardFact]:
    """How its observations were merged, and the nearest defect that it was not merged with."""
    joined = [row for row in merges if row["merge_decision"] == MergeDecision.JOINED]
    facts: list[CardFact] = []
    if joined:
        reasons = Counter(row["merge_reason"].replace("_", " ") for row in joined)
        text = ", ".join(
            f"{count} pair{'' if count == 1 else 's'} ({reason})" for reason, count in reasons.most_common()
        )
        text += f"; Mahalanobis distance up to {max(row['mahalanobis_distance'] for row in joined):.1f}"
        scores = [row["appearance_score"] for row in joined if row["appearance_score"] is not None]
        if scores:
            text += f", similarity {min(scores):.2f} to {max(scores):.2f}"
        facts.append(("merged", text))
    apart = [
        row
        for row in merges
        if row["merge_decision"] == MergeDecision.APART and row["defect_id"] != row["other_defect_id"]
    ]
    if apart:
        nearest = min(apart, key=lambda row: row["separation_m"])
        other = nearest["other_defect_id"] if nearest["defect_id"] == defect_id else nearest["defect_id"]
        reason = nearest["merge_reason"].replace("_", " ")
        facts.append(("not merged", f"with {other}, {100 * nearest['separation_m']:.0f} cm away: {reason}"))
    return facts
