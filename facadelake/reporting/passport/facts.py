"""Facts of the passport: value, meaning, limit and assessment of each quantity of the georeferencing."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
import pyarrow as pa

from facadelake.core.arrays import Float64N
from facadelake.core.geodesy import SITE_AXES
from schemas.vocabulary import ControlKind, PoseSource

Row = Mapping[str, Any]

# One sigma per axis of a point surveyed on a facade with a total station.
_SURVEY_SIGMA_M = 0.01
# Limits of a good georeferencing. The mean residual of control points is limited to three sigmas of the survey.
_MAX_CONTROL_RESIDUAL_M = 0.03
_MAX_DOMING_M = 0.02
_MAX_MODEL_DISTANCE_M = 0.10
_MAX_SIGMA_RATIO = 3.0
_MAX_TIE_SIGMA_PX = 1.0

_CONTROL_TEXTS: Mapping[str, tuple[str, str]] = {
    ControlKind.GCP: ("control points", "distance of the adjusted control points from their surveyed positions"),
    ControlKind.CAMPAIGN: (
        "shared points",
        "distance of points shared with the reference campaign from their positions there",
    ),
    ControlKind.MODEL: (
        "walls of the model",
        "distance of tie points from the walls of the model; includes relief that the model lacks",
    ),
    ControlKind.GPS: ("GPS positions", "distance of the adjusted cameras from the GPS positions of their photographs"),
    ControlKind.IMPORTED: (
        "imported poses",
        "poses of another program, used without adjustment; residuals are not known",
    ),
}


class FactStatus(StrEnum):
    """Assessment of a fact: within its limit, to be checked, insufficient; ``NONE``: not assessed."""

    GOOD = "good"
    CHECK = "check"
    POOR = "poor"
    NONE = ""


@dataclass(frozen=True, kw_only=True)
class Fact:
    """One line of the passport; ``limit`` is empty where the fact is not assessed."""

    name: str
    value: str
    meaning: str
    limit: str = ""
    status: FactStatus = FactStatus.NONE


def format_length(metres: float) -> str:
    """A length in millimetres below 0.1 m, else in metres."""
    return f"{1000 * metres:.0f} mm" if abs(metres) < 0.1 else f"{metres:.2f} m"


def list_passport_facts(row: Row, poses: pa.Table, *, placement_sigma_max_m: float) -> tuple[Fact, ...]:
    """Facts of a campaign, the most important first.

    ``row``: its row of table ``georeference``. ``poses``: its rows of table ``poses``. ``placement_sigma_max_m``:
    largest permitted standard deviation of the campaign's position, metres.
    """
    return (
        _report_sigma(row, placement_sigma_max_m),
        _report_check_points(row),
        _report_control_residuals(row),
        _report_weakest_direction(row),
        _report_doming(row),
        *_report_other_facts(row, poses),
    )


def summarise_passport(row: Row, facts: tuple[Fact, ...]) -> tuple[FactStatus, str]:
    """Overall assessment, and a sentence with the method, the accuracy and the facts to be checked."""
    worst = int(np.argmax(_get_sigmas(row)))
    sigma = f"largest standard deviation {format_length(_get_sigmas(row)[worst])} ({SITE_AXES[worst]})"
    description = f"georeferenced by {row['method']}, {sigma}"
    flagged = {status: [fact.name for fact in facts if fact.status is status] for status in FactStatus}
    if flagged[FactStatus.POOR]:
        return FactStatus.POOR, f"Accuracy below requirement: {description}"
    if flagged[FactStatus.CHECK]:
        return FactStatus.CHECK, f"Usable, check {', '.join(flagged[FactStatus.CHECK])}: {description}"
    return FactStatus.GOOD, f"Good: {description}"


def _get_sigmas(row: Row) -> list[float]:
    return [row[f"sigma_{axis}_m"] for axis in SITE_AXES]


def _format_by_axis(values: list[float]) -> str:
    return ", ".join(f"{format_length(value)} {axis}" for value, axis in zip(values, SITE_AXES, strict=True))


def _report_sigma(row: Row, limit_m: float) -> Fact:
    waived = row["control"] == ControlKind.GPS
    return Fact(
        name="standard deviation",
        value=_format_by_axis(_get_sigmas(row)),
        meaning="uncertainty of the campaign's position at the centroid of the cameras; 95 % of errors are within "
        "twice this value; each defect has its own standard deviation, smaller near control points",
        limit=format_length(limit_m) + (" (waived: GPS only)" if waived else ""),
        status=FactStatus.GOOD if max(_get_sigmas(row)) <= limit_m else FactStatus.POOR,
    )


def _report_check_points(row: Row) -> Fact:
    name, count = "independent points", row["check_points"]
    if not count:
        return Fact(
            name=name,
            value="none",
            meaning="no surveyed point outside the adjustment tests the georeferencing; add check points",
            limit="at least 1",
            status=FactStatus.CHECK,
        )
    limit_m = 3 * float(np.sqrt(sum(sigma**2 for sigma in _get_sigmas(row)) + 3 * _SURVEY_SIGMA_M**2))
    mean_m, largest_m = row["check_residual_mean_m"], row["check_residual_max_m"]
    return Fact(
        name=name,
        value=f"{count}: mean {format_length(mean_m)}, maximum {format_length(largest_m)}",
        meaning="error at check points and held-out control points, which did not take part in the adjustment",
        limit=f"{format_length(limit_m)}: three standard deviations",
        status=FactStatus.GOOD if largest_m <= limit_m else FactStatus.CHECK,
    )


def _report_control_residuals(row: Row) -> Fact:
    name, meaning = _CONTROL_TEXTS[row["control"]]
    if row["residual_mean_m"] is None:
        return Fact(name=name, value=f"{row['points_used']} of {row['points_total']} used", meaning=meaning)
    value = (
        f"mean {format_length(row['residual_mean_m'])}, maximum {format_length(row['residual_max_m'])} "
        f"({row['points_used']} of {row['points_total']} used)"
    )
    if row["control"] not in (ControlKind.GCP, ControlKind.CAMPAIGN):
        return Fact(name=name, value=value, meaning=meaning)
    is_good = row["residual_mean_m"] <= _MAX_CONTROL_RESIDUAL_M
    if row["control"] == ControlKind.GCP:
        is_good = is_good and row["points_used"] == row["points_total"]
    limit = f"mean {format_length(_MAX_CONTROL_RESIDUAL_M)}" + (
        ", all used" if row["control"] == ControlKind.GCP else ""
    )
    status = FactStatus.GOOD if is_good else FactStatus.CHECK
    return Fact(name=name, value=value, meaning=meaning, limit=limit, status=status)


def _report_weakest_direction(row: Row) -> Fact:
    sigmas = _get_sigmas(row)
    worst, ratio = int(np.argmax(sigmas)), max(sigmas) / max(min(sigmas), 1e-9)
    return Fact(
        name="weakest direction",
        value=f"{SITE_AXES[worst]}, {ratio:.1f} times the smallest standard deviation",
        meaning="axis that photographs and control determine least",
        limit=f"{_MAX_SIGMA_RATIO:g} times",
        status=FactStatus.GOOD if ratio <= _MAX_SIGMA_RATIO else FactStatus.CHECK,
    )


def _report_doming(row: Row) -> Fact:
    name = "doming"
    meaning = "bending of the block, as the height of its centre over its rim, measured against the model's walls"
    if row["control"] == ControlKind.MODEL:
        meaning += "; not an independent test, because the model is the control"
    doming_m, sigma_m = row["doming_m"], row["doming_sigma_m"]
    if doming_m is None or sigma_m is None:
        return Fact(name=name, value="not tested", meaning=f"{meaning}; too few tie points on walls")
    is_good = abs(doming_m) <= max(_MAX_DOMING_M, 2 * sigma_m)
    return Fact(
        name=name,
        value=f"{round(1000 * doming_m):+d} mm ± {1000 * sigma_m:.0f} mm",
        meaning=meaning,
        limit=f"{format_length(_MAX_DOMING_M)} or two standard deviations",
        status=FactStatus.GOOD if is_good else FactStatus.CHECK,
    )


def _format_accuracy(accuracy_m: float | None) -> str:
    """Stated accuracy of a coordinate operation in words."""
    return "accuracy unknown" if accuracy_m is None else f"accuracy {accuracy_m:g} m"


def _report_other_facts(row: Row, poses: pa.Table) -> Iterator[Fact]:
    """Further facts, most of them without assessment; those that were not measured are omitted."""
    if row["control"] != ControlKind.GPS and row["gps_offset_east_m"] is not None:
        parts = [row[f"gps_offset_{axis}_m"] for axis in SITE_AXES]
        sigma_m = row["gps_offset_sigma_m"]
        yield Fact(
            name="GPS offset",
            value=", ".join(
                "unknown" if part is None else f"{part:+.2f} m {axis}"
                for part, axis in zip(parts, SITE_AXES, strict=True)
            )
            + ("" if sigma_m is None else f" (± {format_length(sigma_m)})"),
            meaning="common offset of the photographs' GPS positions from the adjusted cameras",
        )
    if row["model_residual_m"] is not None:
        yield Fact(
            name="distance to the model",
            value=f"median {format_length(row['model_residual_m'])}",
            meaning="distance of tie points from the model's surface: relief, and deviations of the building from it",
            limit=format_length(_MAX_MODEL_DISTANCE_M),
            status=FactStatus.GOOD if row["model_residual_m"] <= _MAX_MODEL_DISTANCE_M else FactStatus.CHECK,
        )
    if row["edge_score"] is not None:
        runner_up = row["edge_score_runner_up"]
        features = row["edge_features"]
        yield Fact(
            name="edges of the model",
            value=("" if features is None else f"{features} matched; ")
            + f"score {row['edge_score']:.2f}"
            + ("" if runner_up is None else f", {runner_up:.2f} at the best competing shift"),
            meaning="sills, storey lines and corners matched in photographs; repeated windows may match one bay off",
            limit="higher than at any other shift",
            status=FactStatus.GOOD if runner_up is None or row["edge_score"] > runner_up else FactStatus.CHECK,
        )
    if row["crs_operation"] is not None:
        yield Fact(
            name="longitude and latitude",
            value=f"{row['crs_operation']}, {_format_accuracy(row['crs_operation_accuracy_m'])}",
            meaning="PROJ's operation from the model's CRS; its accuracy is not in the standard deviations",
        )
    if row["control_operation"] is not None and row["control_operation_accuracy_m"] != 0.0:
        yield Fact(
            name="datum of the control",
            value=f"{row['control_operation']}, {_format_accuracy(row['control_operation_accuracy_m'])}; "
            f"in the standard deviations: {format_length(row['control_operation_sigma_m'])}",
            meaning="PROJ's operation from the CRS of the control to that of the model",
        )
    sigmas = _collect_camera_sigmas(poses)
    if len(sigmas):
        yield Fact(
            name="camera positions",
            value="standard deviation: "
            f"median {format_length(float(np.median(sigmas)))}, maximum {format_length(float(sigmas.max()))}",
            meaning="uncertainty of a camera's position along its weakest axis",
        )
    if row["tie_sigma_px"] is not None:
        yield Fact(
            name="tie points",
            value=f"{row['tie_sigma_px']:.2f} px, variance factor {row['tie_variance_factor']:.1f}",
            meaning="standard deviation of an image point; the factor accounts for correlated errors of neighbours",
            limit=f"{_MAX_TIE_SIGMA_PX:g} px",
            status=FactStatus.GOOD if row["tie_sigma_px"] <= _MAX_TIE_SIGMA_PX else FactStatus.CHECK,
        )
    if row["reference_campaign"] is not None:
        yield Fact(
            name="reference",
            value=f"campaign {row['reference_campaign']}",
            meaning="earlier campaign that controls this one, so that defects can be compared",
        )
    yield Fact(
        name="CRS and heights",
        value=f"{row['map_crs']}, heights {row['vertical_datum']}; model: LoGeoRef {row['georeference_level']}",
        meaning="CRS of map coordinates, vertical datum, and level of georeference of the building model",
    )


def _collect_camera_sigmas(poses: pa.Table) -> Float64N:
    """One sigma (n,) of the localised cameras' positions along their weakest axes of site, metres."""
    names = [f"sigma_{axis}_m" for axis in SITE_AXES]
    rows = [row for row in poses.select(["pose_source", *names]).to_pylist() if row["pose_source"] != PoseSource.PRIOR]
    sigmas = [max(row[name] for name in names) for row in rows if row[names[0]] is not None]
    return np.array(sigmas, dtype=np.float64)
