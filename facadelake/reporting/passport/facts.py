"""What the passport says, fact by fact in plain words: the number, what it means, its limit and the verdict."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
import pyarrow as pa

from schemas.vocabulary import ControlKind, PoseSource

Row = Mapping[str, Any]
AXES = ("east", "north", "up")

# What a tachymeter leaves on a facade, each axis, and what three of its sigmas allow as a mean.
_SURVEY_SIGMA_M = 0.01
_MAX_CONTROL_RESIDUAL_M = 0.03
_MAX_DOMING_M = 0.02
_MAX_MODEL_DISTANCE_M = 0.10
_MAX_SIGMA_RATIO = 3.0
_MAX_TIE_SIGMA_PX = 1.0

_CONTROL_WORDS: Mapping[str, tuple[str, str]] = {
    ControlKind.GCP: ("control points", "how far the adjusted control points lie from their survey"),
    ControlKind.CAMPAIGN: (
        "shared points",
        "how far points shared with the earlier campaign lie from where that one has them",
    ),
    ControlKind.MODEL: (
        "the model's walls",
        "how far tie points lie from the walls that hold them; relief that the model does not show is in it",
    ),
    ControlKind.GPS: ("GPS positions", "how far the cameras lie from the positions that their photographs state"),
    ControlKind.IMPORTED: ("imported poses", "taken as another program found them: what is left there is not known"),
}


class FactStatus(StrEnum):
    """What a person should do about a fact; ``NONE``: it is told, not judged."""

    GOOD = "good"
    CHECK = "look"
    POOR = "poor"
    NONE = ""


@dataclass(frozen=True, kw_only=True)
class Fact:
    """One line of the passport."""

    name: str
    value: str
    meaning: str
    limit: str = ""
    status: FactStatus = FactStatus.NONE


def format_length(metres: float) -> str:
    """Millimetres below 0.1 m, else metres."""
    return f"{1000 * metres:.0f} mm" if abs(metres) < 0.1 else f"{metres:.2f} m"


def list_passport_facts(row: Row, poses: pa.Table, *, placement_sigma_max_m: float) -> tuple[Fact, ...]:
    """The facts of a row of table ``georeference`` and its table ``poses``, the weightiest first."""
    return (
        _report_sigma(row, placement_sigma_max_m),
        _report_check_points(row),
        _report_control_residuals(row),
        _report_weakest_direction(row),
        _report_doming(row),
        *_report_other_facts(row, poses),
    )


def summarise_passport(row: Row, facts: tuple[Fact, ...]) -> tuple[FactStatus, str]:
    """The verdict on the whole, and in a sentence how the campaign was placed, how well, and what to look at."""
    worst = int(np.argmax(_get_sigmas(row)))
    known = f"known to {format_length(_get_sigmas(row)[worst])} in its weakest direction ({AXES[worst]}, one sigma)"
    said = f"placed by {row['method']}, {known}"
    flagged = {verdict: [fact.name for fact in facts if fact.status is verdict] for verdict in FactStatus}
    if flagged[FactStatus.POOR]:
        return FactStatus.POOR, f"Metres only: {said}"
    if flagged[FactStatus.CHECK]:
        return FactStatus.CHECK, f"Usable, but look at {', '.join(flagged[FactStatus.CHECK])}: {said}"
    return FactStatus.GOOD, f"Good: {said}"


def _get_sigmas(row: Row) -> list[float]:
    return [row[f"sigma_{axis}_m"] for axis in AXES]


def _format_by_axis(values: list[float]) -> str:
    return ", ".join(f"{format_length(value)} {axis}" for value, axis in zip(values, AXES, strict=True))


def _report_sigma(row: Row, limit_m: float) -> Fact:
    waived = row["control"] == ControlKind.GPS
    return Fact(
        name="known to (one sigma)",
        value=_format_by_axis(_get_sigmas(row)),
        meaning="how far the cameras' middle may lie off its place, by its own account; twice this holds 95 % of "
        "cases; walls near control points are known better: each defect has its own",
        limit=format_length(limit_m) + (" (waived: GPS alone)" if waived else ""),
        status=FactStatus.GOOD if max(_get_sigmas(row)) <= limit_m else FactStatus.POOR,
    )


def _report_check_points(row: Row) -> Fact:
    name, count = "held-out points", row["check_points"]
    if not count:
        return Fact(
            name=name,
            value="none",
            meaning="no surveyed point outside the adjustment tests the placement; bring check points",
            limit="1 or more",
            status=FactStatus.CHECK,
        )
    limit_m = 3 * float(np.sqrt(sum(sigma**2 for sigma in _get_sigmas(row)) + 3 * _SURVEY_SIGMA_M**2))
    mean_m, largest_m = row["check_residual_mean_m"], row["check_residual_max_m"]
    return Fact(
        name=name,
        value=f"{count}: mean {format_length(mean_m)}, largest {format_length(largest_m)}",
        meaning="how far surveyed points lie off that did not hold the block: the error to expect",
        limit=f"{format_length(limit_m)}: three of the stated sigmas",
        status=FactStatus.GOOD if largest_m <= limit_m else FactStatus.CHECK,
    )


def _report_control_residuals(row: Row) -> Fact:
    name, meaning = _CONTROL_WORDS[row["control"]]
    if row["residual_mean_m"] is None:
        return Fact(name=name, value=f"{row['points_used']} of {row['points_total']} used", meaning=meaning)
    value = (
        f"mean {format_length(row['residual_mean_m'])}, largest {format_length(row['residual_max_m'])} "
        f"({row['points_used']} of {row['points_total']} used)"
    )
    if row["control"] not in (ControlKind.GCP, ControlKind.CAMPAIGN):
        return Fact(name=name, value=value, meaning=meaning)
    good = row["residual_mean_m"] <= _MAX_CONTROL_RESIDUAL_M
    if row["control"] == ControlKind.GCP:
        good = good and row["points_used"] == row["points_total"]
    limit = f"mean {format_length(_MAX_CONTROL_RESIDUAL_M)}" + (
        ", all used" if row["control"] == ControlKind.GCP else ""
    )
    verdict = FactStatus.GOOD if good else FactStatus.CHECK
    return Fact(name=name, value=value, meaning=meaning, limit=limit, status=verdict)


def _report_weakest_direction(row: Row) -> Fact:
    sigmas = _get_sigmas(row)
    worst, times = int(np.argmax(sigmas)), max(sigmas) / max(min(sigmas), 1e-9)
    return Fact(
        name="weakest direction",
        value=f"{AXES[worst]}, {times:.1f} times the best known one",
        meaning="what the photographs and the control observe least",
        limit=f"{_MAX_SIGMA_RATIO:g} times",
        status=FactStatus.GOOD if times <= _MAX_SIGMA_RATIO else FactStatus.CHECK,
    )


def _report_doming(row: Row) -> Fact:
    name = "bend of the block"
    meaning = "how far its middle bulges out of its rim against the model's walls (doming)"
    if row["control"] == ControlKind.MODEL:
        meaning += "; the model held the block, so this is no independent test"
    bend_m, sigma_m = row["doming_m"], row["doming_sigma_m"]
    if bend_m is None or sigma_m is None:
        return Fact(name=name, value="not tested", meaning=f"{meaning}; too few tie points lie on walls")
    good = abs(bend_m) <= max(_MAX_DOMING_M, 2 * sigma_m)
    return Fact(
        name=name,
        value=f"{1000 * bend_m:+.0f} mm ± {1000 * sigma_m:.0f} mm",
        meaning=meaning,
        limit=f"{format_length(_MAX_DOMING_M)}, or two sigmas",
        status=FactStatus.GOOD if good else FactStatus.CHECK,
    )


def _report_other_facts(row: Row, poses: pa.Table) -> Iterator[Fact]:
    """What is there to be known; little of it is judged."""
    if row["control"] != ControlKind.GPS and row["gps_offset_east_m"] is not None:
        parts = [row[f"gps_offset_{axis}_m"] for axis in AXES]
        sigma_m = row["gps_offset_sigma_m"]
        yield Fact(
            name="GPS found off by",
            value=", ".join(
                "unknown" if part is None else f"{part:+.2f} m {axis}" for part, axis in zip(parts, AXES, strict=True)
            )
            + ("" if sigma_m is None else f" (± {format_length(sigma_m)})"),
            meaning="what the photographs' GPS has in common as an error, against the adjusted cameras",
        )
    if row["model_residual_m"] is not None:
        yield Fact(
            name="distance to the model",
            value=f"median {format_length(row['model_residual_m'])}",
            meaning="of tie points from the model's faces: the relief and the building's deviation from its design",
            limit=format_length(_MAX_MODEL_DISTANCE_M),
            status=FactStatus.GOOD if row["model_residual_m"] <= _MAX_MODEL_DISTANCE_M else FactStatus.CHECK,
        )
    if row["edge_score"] is not None:
        rival = row["edge_score_runner_up"]
        features = row["edge_features"]
        yield Fact(
            name="edges of the model",
            value=("" if features is None else f"{features} met; ")
            + f"score {row['edge_score']:.2f} here"
            + ("" if rival is None else f", {rival:.2f} at the best other place"),
            meaning="sills, storey lines and corners found in the photographs; alike windows could hold it a bay aside",
            limit="better than any other place",
            status=FactStatus.GOOD if rival is None or row["edge_score"] > rival else FactStatus.CHECK,
        )
    sigmas = _collect_camera_sigmas(poses)
    if len(sigmas):
        yield Fact(
            name="cameras known to",
            value=f"median {format_length(float(np.median(sigmas)))}, worst {format_length(float(sigmas.max()))}",
            meaning="one sigma of a camera's place along its worst axis",
        )
    if row["tie_sigma_px"] is not None:
        yield Fact(
            name="tie points",
            value=f"{row['tie_sigma_px']:.2f} px, variance raised {row['tie_variance_factor']:.1f} times",
            meaning="one sigma of a point in a photograph; raised because neighbouring points err together",
            limit=f"{_MAX_TIE_SIGMA_PX:g} px",
            status=FactStatus.GOOD if row["tie_sigma_px"] <= _MAX_TIE_SIGMA_PX else FactStatus.CHECK,
        )
    if row["reference_campaign"] is not None:
        yield Fact(
            name="in the frame of",
            value=f"campaign {row['reference_campaign']}",
            meaning="the earlier campaign whose points hold this one, so that defects can be compared",
        )
    yield Fact(
        name="CRS and heights",
        value=f"{row['map_crs']}, heights {row['vertical_datum']}; model: LoGeoRef {row['georeference_level']}",
        meaning="map coordinates and the datum of heights; how the building model states its own place",
    )


def _collect_camera_sigmas(poses: pa.Table) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """One sigma (n,) of the localised cameras' places along their worst axes of site."""
    names = [f"sigma_{axis}_m" for axis in AXES]
    rows = [row for row in poses.select(["pose_source", *names]).to_pylist() if row["pose_source"] != PoseSource.PRIOR]
    known = [max(row[name] for name in names) for row in rows if row[names[0]] is not None]
    return np.array(known, dtype=np.float64)
