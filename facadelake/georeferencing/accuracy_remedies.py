"""What to do about a campaign whose position is too uncertain, by what makes it uncertain."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from facadelake.core.arrays import Float64x3
from facadelake.core.proj.grids import describe_grid_installation
from facadelake.georeferencing.datum_shift import DatumShift
from facadelake.georeferencing.gps.priors import DATUM_SIGMA_M, GpsPriors
from facadelake.georeferencing.initial_placement import InitialPlacement
from schemas.vocabulary import ControlKind

_CONTROL_POINTS = "give control points (gcp_list.txt, 3 or more around the building)"
_BY_CONTROL = {
    ControlKind.GCP: "give more control points, farther apart and at different heights, and mark each in more "
    "photographs",
    ControlKind.MODEL: f"{_CONTROL_POINTS}, photographs from more sides or a model with openings",
    ControlKind.GPS: f"{_CONTROL_POINTS}, photographs with RTK or PPK positions (key 'positions'), or place them by "
    "the building model",
    ControlKind.CAMPAIGN: f"{_CONTROL_POINTS}, or photographs that overlap more with those of the earlier campaign",
}


def suggest_accuracy_remedy(placement: InitialPlacement, sigma_m: Float64x3, priors: GpsPriors) -> str:
    """What makes a campaign's position uncertain, in words: the datums of its control, or the control itself.

    Args:
        placement: the placement, with its control.
        sigma_m: one sigma (3,) of the campaign's position.
        priors: the GPS priors.

    Returns:
        the remedy, for the message of a refusal.
    """
    by_shift = suggest_shift_remedy(placement.datum_shift, sigma_m)
    if by_shift:
        return by_shift
    metres = "or accept an accuracy of metres with --georeference gps" if len(priors.photo) else ""
    if placement.kind is ControlKind.GPS and int(np.argmax(sigma_m)) == 2 and priors.datum_unknown:
        return _join(
            f"the heights of GPS have no stated datum ({DATUM_SIGMA_M:g} m are assumed): state it with a positions "
            "file (positions: {file, vertical}), or " + _CONTROL_POINTS,
            metres,
        )
    frame_m2 = float(placement.frame_covariance_m2.diagonal().max())
    if placement.kind is ControlKind.CAMPAIGN and 2 * frame_m2 > float(sigma_m.max()) ** 2:
        return _join(
            f"campaign {placement.reference_campaign}, which it is placed by, is itself known to "
            f"{np.sqrt(frame_m2):.2f} m: {_CONTROL_POINTS} of this campaign, or of that one and inspect it again",
            metres,
        )
    return _join(_BY_CONTROL[placement.kind], metres)


def suggest_shift_remedy(shift: DatumShift | None, sigma_m: Float64x3) -> str:
    """The remedy where the shift between two datums is uncertain: the grid that is missing, or control in the CRS of
    the model. Empty where it is less than half of the largest variance of a position, whose sigma is ``sigma_m`` (3,).
    """
    worst = int(np.argmax(sigma_m))
    if shift is None or 2 * shift.sigma_m[worst] ** 2 <= sigma_m[worst] ** 2:
        return ""
    operation, better = shift.operation, shift.operation.better_missing
    remedies: Sequence[str] = [f"give control in {operation.target}"]
    if better is not None and better.accuracy_m is not None and better.accuracy_m < operation.sigma_m:
        remedies = [
            f"{describe_grid_installation(better.grids)} for {better.name} ({better.accuracy_m:g} m), which the "
            "portfolio does without (crs.accept_operation_accuracy_m)",
            *remedies,
        ]
    return f"{', or '.join(remedies)}; more control in {operation.source} changes nothing"


def _join(remedy: str, metres: str) -> str:
    return ", ".join(filter(None, [remedy, metres]))
