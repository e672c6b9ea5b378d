"""Which kinds of control can place a campaign, the best first."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from facadelake.core.arrays import UInt8Array
from facadelake.georeferencing.available_control import Control
from facadelake.georeferencing.campaign.reference import ReferencePoints
from facadelake.georeferencing.gcp.placement import MIN_CONTROL_POINTS, intersect_marks
from facadelake.sfm import Reconstruction
from schemas.vocabulary import ControlKind

# An earlier campaign with a frame of at most this sigma is preferred to control points.
_MAX_PREFERRED_FRAME_SIGMA_M = 0.03


def rank_controls(reconstruction: Reconstruction, control: Control) -> tuple[list[ControlKind], list[str]]:
    """The kinds of control to try, the best first, and remarks on those that cannot be tried.

    An earlier campaign that is itself placed to centimetres comes first, so that defects can be compared to the
    centimetre; control points are then check points. Usable control points are never skipped for the model or GPS:
    if they are wrong, the user has to correct them.
    """
    smallest_m = min((_compute_frame_sigma(reference) for reference, _ in control.references), default=np.inf)
    campaign = [ControlKind.CAMPAIGN]
    if control.points is not None:
        usable = sum(mark is not None for mark in intersect_marks(reconstruction, control.points))
        if usable >= MIN_CONTROL_POINTS:
            return [*(campaign if smallest_m <= _MAX_PREFERRED_FRAME_SIGMA_M else []), ControlKind.GCP], []
        remarks = [
            f"{usable} of {len(control.points.points)} control points of {control.points.source} can be used "
            f"({MIN_CONTROL_POINTS} are needed)"
        ]
    else:
        remarks = []
    kinds = campaign if smallest_m <= control.placement_sigma_max_m else []
    if control.model is not None:
        kinds = [*kinds, ControlKind.MODEL]
    return [*kinds, ControlKind.GPS], remarks


def order_references(
    references: Sequence[tuple[ReferencePoints, UInt8Array]],
) -> list[tuple[ReferencePoints, UInt8Array]]:
    """Earlier campaigns in the order in which they are tried: those placed to centimetres first, else as given.

    Otherwise a first campaign that the model placed to decimetres would pass its frame on to all later ones, beside a
    later campaign with control points.
    """
    return sorted(references, key=lambda one: _compute_frame_sigma(one[0]) > _MAX_PREFERRED_FRAME_SIGMA_M)


def _compute_frame_sigma(reference: ReferencePoints) -> float:
    """Largest sigma (m) of a reference's frame over all directions."""
    return float(np.sqrt(np.linalg.eigvalsh(reference.frame_covariance_m2)[-1]))
