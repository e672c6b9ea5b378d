"""The control available for a campaign besides GPS: surveyed points, earlier campaigns, the building model."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

from facadelake.core.arrays import UInt8Array
from facadelake.georeferencing.campaign.reference import ReferencePoints
from facadelake.georeferencing.gcp.control_points import SurveyedPoints, match_marks
from facadelake.georeferencing.model.control import ModelControl
from facadelake.registry import AcceptedStatement
from schemas.vocabulary import ControlKind


@dataclass(frozen=True, kw_only=True, eq=False)
class Control:
    """The control available for a campaign.

    ``kind``: the control requested; None for the best available, in the order control points, earlier campaign, model,
    GPS. ``references``: points of earlier campaigns, the preferred one first, each with the descriptors of this block's
    tie points. ``placement_sigma_max_m``: largest sigma of the campaign's position; not applied to GPS that was
    requested by name. ``accepted``: statements that may contradict the placement.
    """

    kind: ControlKind | None = None
    points: SurveyedPoints | None = None
    check_points: SurveyedPoints | None = None
    model: ModelControl | None = None
    references: Sequence[tuple[ReferencePoints, UInt8Array]] = ()
    placement_sigma_max_m: float = 0.5
    accepted: Sequence[AcceptedStatement] = ()

    def match_marks(self, photo_ids: Collection[str]) -> Control:
        """The same control, with marks that name a ``photo_id`` of the campaign's photographs."""
        points, check_points = (
            None if file is None else match_marks(file, photo_ids) for file in (self.points, self.check_points)
        )
        return replace(self, points=points, check_points=check_points)
