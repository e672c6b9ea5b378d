"""The control available for a campaign besides GPS: surveyed points, earlier campaigns, the building model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from facadelake.core.arrays import UInt8Array
from facadelake.georeferencing.campaign.reference import ReferencePoints
from facadelake.georeferencing.gcp.control_points import SurveyedPoints
from facadelake.georeferencing.model.control import ModelControl
from schemas.vocabulary import ControlKind


@dataclass(frozen=True, kw_only=True, eq=False)
class Control:
    """The control available for a campaign.

    ``kind``: the control requested; None for the best available, in the order control points, earlier campaign, model,
    GPS. ``references``: points of earlier campaigns, the preferred one first, each with the descriptors of this block's
    tie points. ``placement_sigma_max_m``: largest sigma of the campaign's position; not applied to GPS that was
    requested by name.
    """

    kind: ControlKind | None = None
    points: SurveyedPoints | None = None
    check_points: SurveyedPoints | None = None
    model: ModelControl | None = None
    references: Sequence[tuple[ReferencePoints, UInt8Array]] = ()
    placement_sigma_max_m: float = 0.5
