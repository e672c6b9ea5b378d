"""Placement checks: what GPS, surveyed points and the model state about a placed campaign, compared with its placement.

A placement with a small sigma can be wrong as a whole: control points with heights above another surface still fit one
another to a centimetre. Only evidence that took no part in it can contradict it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa

from facadelake.core.arrays import Float64N, Float64Nx3, Float64x3, Int64Array
from facadelake.core.errors import GeoreferenceError
from facadelake.core.tables import table_from_rows
from facadelake.georeferencing.probable_causes import GEOID_HEIGHT_MAX_M, suggest_causes
from schemas.vocabulary import ControlKind, PlacementCheckOutcome, PlacementStatement

# A deviation beyond this many sigmas is a disagreement: 1 in 2000 of normal errors, 1 in 450 in two dimensions.
LIMIT_SIGMAS = 3.5
_MIN_PRIORS = 3
_GPS_STATEMENTS = (PlacementStatement.GPS_POSITION, PlacementStatement.GPS_HEIGHT)
# What a kind of control cannot be confirmed by: it put the tie points there; check points and control points come from
# one survey in most cases, and share its datum, units and shift.
_ON_ITSELF = {
    (PlacementStatement.TIE_POINTS, ControlKind.MODEL),
    (PlacementStatement.SURVEYED_POINTS, ControlKind.GCP),
}
_AXES = {PlacementStatement.GPS_POSITION: [0, 1], PlacementStatement.GPS_HEIGHT: [2]}
_MODEL_STATEMENTS = (
    PlacementStatement.CAMERA_HEIGHT,
    PlacementStatement.MODEL_IN_VIEW,
    PlacementStatement.TIE_POINTS,
)


@dataclass(frozen=True, kw_only=True, eq=False)
class PlacementCheck:
    """One statement compared with the placement.

    ``deviation`` and ``limit`` in ``unit`` ("m", or "share" of photographs); NaN where not comparable. ``sigma``: that
    of the deviation, NaN where it has none. ``detail``: the comparison in words. ``shift_site_m`` (3,): the
    shift of the campaign by which the statement would agree; None where it gives none. ``decides``: it would contradict
    a campaign that agreed with GPS instead.
    """

    statement: PlacementStatement
    outcome: PlacementCheckOutcome
    detail: str
    deviation: float = np.nan
    sigma: float = np.nan
    limit: float = np.nan
    unit: str = "m"
    shift_site_m: Float64x3 | None = None
    decides: bool = False

    @property
    def disagrees(self) -> bool:
        """Whether the statement contradicts the placement."""
        return self.outcome is PlacementCheckOutcome.DISAGREES


def compare_deviation(deviation: float, limit: float) -> PlacementCheckOutcome:
    """``agrees`` up to the limit."""
    return PlacementCheckOutcome.AGREES if deviation <= limit else PlacementCheckOutcome.DISAGREES


def build_checks_table(checks: Sequence[PlacementCheck]) -> pa.Table:
    """Table ``placement_checks``."""
    rows: list[dict[str, Any]] = [
        {
            "statement": check.statement,
            "placement_check_outcome": check.outcome,
            "deviation": check.deviation if np.isfinite(check.deviation) else None,
            "deviation_sigma": check.sigma if np.isfinite(check.sigma) else None,
            "deviation_limit": check.limit if np.isfinite(check.limit) else None,
            "deviation_unit": check.unit,
            "detail": check.detail,
        }
        for check in checks
    ]
    return table_from_rows("placement_checks", rows)


def check_gps(
    residual_site_m: Float64Nx3,
    sigma_m: Float64Nx3,
    flight: Int64Array,
    placement_sigma_m: Float64x3,
    convention_m: float = 0.0,
    *,
    datum_unknown: bool,
) -> tuple[PlacementCheck, ...]:
    """Compare GPS with the placed cameras: the common offset of each flight against what its receiver can err.

    Args:
        residual_site_m: GPS position minus camera centre (n, 3).
        sigma_m: one sigma (n, 3) of each position, with the common error of its receiver.
        flight: flight (n,) of each position.
        placement_sigma_m: one sigma (3,) of the campaign's position.
        convention_m: largest shift between two datums that are taken as one (WGS 84 as ETRS89); it widens the limit.
        datum_unknown: the heights have no stated datum, so that a geoid height is no disagreement.

    Returns:
        the check of the horizontal position and that of the height, each of the flight that deviates most.
    """
    offsets = []
    for number in np.unique(flight):
        rows = flight == number
        if rows.sum() >= _MIN_PRIORS:
            offset = np.median(residual_site_m[rows], axis=0)
            sigma = np.hypot(np.median(sigma_m[rows], axis=0), placement_sigma_m)
            offsets.append((int(number), int(rows.sum()), offset, sigma))
    if not offsets:
        detail = f"no flight has {_MIN_PRIORS} localised photographs with a GPS position and height"
        return tuple(
            PlacementCheck(statement=statement, outcome=PlacementCheckOutcome.NOT_COMPARABLE, detail=detail)
            for statement in (PlacementStatement.GPS_POSITION, PlacementStatement.GPS_HEIGHT)
        )
    checks = []
    datums = f", of which {convention_m:g} m for datums that are taken as one" if convention_m else ""
    for statement, axes in _AXES.items():
        number, count, offset, sigma = max(
            offsets, key=lambda flown: float(np.linalg.norm(flown[2][axes]) / flown[3][axes].max())
        )
        deviation = float(np.linalg.norm(offset[axes]))
        limit = LIMIT_SIGMAS * float(sigma[axes].max()) + convention_m
        outcome = compare_deviation(deviation, limit)
        geoid = ""
        if datum_unknown and axes == [2]:
            geoid = f", and a geoid height of up to {GEOID_HEIGHT_MAX_M:g} m, as the height datum is unknown"
            if limit < deviation <= limit + GEOID_HEIGHT_MAX_M:
                outcome = PlacementCheckOutcome.NOT_COMPARABLE
        stated = (
            f"east {offset[0]:+.2f} m, north {offset[1]:+.2f} m" if axes == [0, 1] else f"{offset[2]:+.2f} m in height"
        )
        checks.append(
            PlacementCheck(
                statement=statement,
                outcome=outcome,
                deviation=deviation,
                sigma=float(sigma[axes].max()),
                limit=limit + GEOID_HEIGHT_MAX_M * bool(geoid),
                detail=f"GPS of {count} photographs (flight {number + 1}) deviates from the placed cameras by {stated} "
                f"(median, sigma {sigma[axes].max():.2f} m, limit {limit:.2f} m{datums}{geoid})",
                shift_site_m=np.where(np.isin(np.arange(3), axes), offset, 0.0),
            )
        )
    return tuple(checks)


def check_surveyed_points(
    statement: PlacementStatement, residual_m: Float64N, placement_sigma_m: Float64x3, survey_sigma_m: float
) -> PlacementCheck:
    """Compare surveyed points with the placement: their median residual (k,) against the sigmas.

    ``statement``: SURVEYED_POINTS for check points, which took no part in the placement, HELD_OUT_POINTS for control
    points left out one at a time. The latter share what is wrong with all of their file, so they decide nothing.
    """
    words = (
        "check points" if statement is PlacementStatement.SURVEYED_POINTS else "control points held out one at a time"
    )
    if not len(residual_m):
        return PlacementCheck(
            statement=statement, outcome=PlacementCheckOutcome.NOT_COMPARABLE, detail=f"there are no {words}"
        )
    sigma = float(np.hypot(placement_sigma_m.max(), survey_sigma_m))
    deviation, limit = float(np.median(residual_m)), LIMIT_SIGMAS * sigma
    return PlacementCheck(
        statement=statement,
        outcome=compare_deviation(deviation, limit),
        deviation=deviation,
        sigma=sigma,
        limit=limit,
        detail=f"{len(residual_m)} {words} deviate by {deviation:.3f} m "
        f"(median, sigma {sigma:.3f} m, limit {limit:.3f} m)",
        decides=statement is PlacementStatement.SURVEYED_POINTS,
    )


def require_agreement(
    checks: Sequence[PlacementCheck],
    *,
    control: ControlKind,
    method: str,
    placement_sigma_max_m: float,
    height_ellipsoidal_m: float,
) -> tuple[str, ...]:
    """Refuse a placement that independent evidence contradicts.

    The model's statements count, since defects are registered on it; tie points that would fit elsewhere are reported
    only where GPS or check points exclude that shift. Check points count beyond the accuracy that a campaign must have,
    and so does GPS, unless another statement decides against it: tie points on the model that would not lie there if
    the campaign agreed with GPS, or check points. Check points confirm no placement by control points, with which they
    share a survey.

    Args:
        checks: the comparisons.
        control: the control of the placement.
        method: the control in words.
        placement_sigma_max_m: accuracy that a campaign must have, metres.
        height_ellipsoidal_m: median height of the placed cameras, for the probable cause.

    Returns:
        remarks on the disagreements that do not refuse the placement.

    Raises:
        GeoreferenceError: the placement is contradicted. The message has every disagreement, with its value, its limit
            and probable causes.
    """
    disagreements = [check for check in checks if check.disagrees]
    outvoted = any(
        check.decides and check.outcome is PlacementCheckOutcome.AGREES and (check.statement, control) not in _ON_ITSELF
        for check in checks
    )
    refused = [
        check
        for check in disagreements
        if (check.statement in _MODEL_STATEMENTS and not _is_shift_excluded(check, checks, control))
        or (
            check.deviation > placement_sigma_max_m
            and (
                check.statement is PlacementStatement.SURVEYED_POINTS
                or (check.statement in _GPS_STATEMENTS and not outvoted)
            )
        )
    ]
    if not refused:
        undecided = [
            check
            for check in checks
            if check.outcome is PlacementCheckOutcome.NOT_COMPARABLE and np.isfinite(check.deviation)
        ]
        accepted = [check for check in checks if check.outcome is PlacementCheckOutcome.ACCEPTED]
        return tuple(
            [f"disagreement: {check.detail}" for check in disagreements]
            + [f"accepted disagreement: {check.detail}" for check in accepted]
            + [f"undecided: {check.detail}" for check in undecided]
        )
    agreeing = [check.detail for check in checks if check.outcome is PlacementCheckOutcome.AGREES]
    shifts = [check.shift_site_m for check in disagreements if check.shift_site_m is not None]
    causes = suggest_causes(shifts, height_ellipsoidal_m)
    raise GeoreferenceError(
        f"the placement by {method} is contradicted: {'; '.join(check.detail for check in disagreements)}"
        + (f". It agrees with: {'; '.join(agreeing)}" if agreeing else "")
        + f". {causes}. Correct the statement that is wrong, or choose another control with --georeference; where the "
        "placement is known to be right, accept the statement by its name and up to a limit (accept_placement in the "
        f"portfolio: {', '.join(check.statement for check in refused)})"
    )


def _is_shift_excluded(check: PlacementCheck, checks: Sequence[PlacementCheck], control: ControlKind) -> bool:
    """Whether GPS or check points agree with the placement, and would not after the shift of ``check``."""
    shift = check.shift_site_m
    if shift is None:
        return False
    for other in checks:
        if other.outcome is not PlacementCheckOutcome.AGREES or (other.statement, control) in _ON_ITSELF:
            continue
        if other.statement in _GPS_STATEMENTS and other.shift_site_m is not None:
            axes = _AXES[other.statement]
            if np.linalg.norm((other.shift_site_m - shift)[axes]) > other.limit:
                return True
        if other.statement is PlacementStatement.SURVEYED_POINTS and np.linalg.norm(shift) > 2 * other.limit:
            return True
    return False
