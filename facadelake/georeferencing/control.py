"""What there is to place a campaign by: control points, earlier campaigns, the building model, GPS."""

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
    """What there is to place a campaign by.

    ``kind`` None: the best there is, in the order control points, earlier campaign, model, GPS. ``references``: of
    earlier campaigns, the preferred one first, with the descriptors of this block's points. ``placement_sigma_max_m``:
    what the campaign must be known to; GPS that was asked for by name is excused.
    """

    kind: ControlKind | None = None
    points: SurveyedPoints | None = None
    check_points: SurveyedPoints | None = None
    model: ModelControl | None = None
    references: Sequence[tuple[ReferencePoints, UInt8Array]] = ()
    placement_sigma_max_m: float = 0.5
