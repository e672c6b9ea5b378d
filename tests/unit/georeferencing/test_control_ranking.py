"""Which kinds of control are tried, and in which order earlier campaigns are."""

from __future__ import annotations

import numpy as np

from facadelake.core.geodesy import SiteOrigin
from facadelake.georeferencing.campaign.reference import ReferencePoints
from facadelake.georeferencing.control_ranking import order_references


def build_reference(campaign_id: str, *, frame_sigma_m: tuple[float, float, float]) -> ReferencePoints:
    """The reference of a campaign whose position as a whole is known to ``frame_sigma_m`` east, north and up."""
    return ReferencePoints(
        building_id="house",
        campaign_id=campaign_id,
        origin=SiteOrigin(lon_deg=9.1, lat_deg=48.7, height_ellipsoidal_m=480.0),
        xyz_site_m=np.zeros((1, 3)),
        covariance_m2=np.eye(3)[None] * 1e-6,
        descriptors=np.zeros((1, 128), dtype=np.uint8),
        direction_site=np.array([[0.0, -1.0, 0.0]]),
        gsd_m=np.array([0.008]),
        photographs=np.array([3]),
        frame_covariance_m2=np.diag(frame_sigma_m) ** 2,
    )


def list_order(*references: ReferencePoints) -> list[str]:
    descriptors = np.zeros((1, 128), dtype=np.uint8)
    return [one.campaign_id for one, _ in order_references([(reference, descriptors) for reference in references])]


def test_a_campaign_placed_to_centimetres_goes_before_an_earlier_one_that_is_not() -> None:
    """The first by the model, 3.5 cm in height; the third by control points: its frame is that of the fourth."""
    by_model = build_reference("2025-04", frame_sigma_m=(0.006, 0.012, 0.035))
    beside_it = build_reference("2025-10", frame_sigma_m=(0.008, 0.014, 0.036))
    surveyed = build_reference("2026-04", frame_sigma_m=(0.005, 0.005, 0.005))
    assert list_order(by_model, beside_it, surveyed) == ["2026-04", "2025-04", "2025-10"]


def test_campaigns_placed_alike_keep_their_order() -> None:
    first = build_reference("2025-04", frame_sigma_m=(0.02, 0.02, 0.02))
    second = build_reference("2026-04", frame_sigma_m=(0.005, 0.005, 0.005))
    assert list_order(first, second) == ["2025-04", "2026-04"]
    assert list_order() == []
