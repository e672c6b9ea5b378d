"""The remedy for a position that is too uncertain fits what makes it so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from facadelake.core.errors import GeoreferenceError
from facadelake.core.proj.operations import MissingOperation
from facadelake.georeferencing.accuracy_remedies import suggest_accuracy_remedy, suggest_shift_remedy
from facadelake.georeferencing.datum_shift import find_datum_shift
from facadelake.georeferencing.gps.priors import GpsPriors
from facadelake.georeferencing.initial_placement import InitialPlacement
from facadelake.georeferencing.site_frame import SiteFrame
from schemas.vocabulary import ControlKind
from tests.synthetic.test_georeference import ORIGIN, SITE_FROM_SFM, Scene, build_ring

FRAME = SiteFrame(
    origin=ORIGIN,
    map_crs="EPSG:25832",
    vertical_datum="ellipsoidal",
    georeference_level="50",
    accepted_operation_accuracy_m=50.0,
)
POINTS = "give control points (gcp_list.txt, 3 or more around the building)"
METRES = "or accept an accuracy of metres with --georeference gps"


def build_priors(count: int, *, datum_unknown: bool = False) -> GpsPriors:
    unknown = np.full(count, np.nan)
    return GpsPriors(
        photo=np.arange(count), xyz_site_m=np.zeros((count, 3)), sigma_m=np.ones((count, 3)),
        datum_unknown=datum_unknown, site_from_cam_rotation=np.full((count, 3, 3), np.nan), sigma_yaw_deg=unknown,
        sigma_tilt_deg=unknown, flight=np.zeros(count, dtype=np.int64), height_relative_m=unknown,
    )  # fmt: skip


def place(kind: ControlKind, **given: object) -> InitialPlacement:
    return InitialPlacement(
        kind=kind, method=str(kind), site_from_sfm=SITE_FROM_SFM, gps_used=np.zeros(0, dtype=bool), points_used=3,
        points_total=3, compute_residual_m=lambda adjusted: np.zeros(0), **given,
    )  # type: ignore[arg-type]  # fmt: skip


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        (ControlKind.GCP, "give more control points, farther apart and at different heights"),
        (ControlKind.MODEL, f"{POINTS}, photographs from more sides or a model with openings, {METRES}"),
        (ControlKind.GPS, f"{POINTS}, photographs with RTK or PPK positions"),
        (ControlKind.CAMPAIGN, f"{POINTS}, or photographs that overlap more"),
    ],
)
def test_each_control_has_its_own_remedy(kind: ControlKind, said: str) -> None:
    assert said in suggest_accuracy_remedy(place(kind), np.array([0.7, 0.2, 0.3]), build_priors(4))


def test_photographs_without_gps_cannot_be_placed_by_gps() -> None:
    remedy = suggest_accuracy_remedy(place(ControlKind.MODEL), np.array([0.7, 0.2, 0.3]), build_priors(0))
    assert "--georeference gps" not in remedy


def test_heights_of_gps_without_a_datum_are_named() -> None:
    priors = build_priors(4, datum_unknown=True)
    remedy = suggest_accuracy_remedy(place(ControlKind.GPS), np.array([3.0, 3.0, 50.0]), priors)
    assert remedy.startswith("the heights of GPS have no stated datum (50 m are assumed): state it with a positions ")


def test_an_earlier_campaign_that_is_uncertain_itself_is_named() -> None:
    placement = place(ControlKind.CAMPAIGN, reference_campaign="2026-04", frame_covariance_m2=np.eye(3) * 0.36)
    remedy = suggest_accuracy_remedy(placement, np.array([0.62, 0.61, 0.62]), build_priors(4))
    assert remedy.startswith("campaign 2026-04, which it is placed by, is itself known to 0.60 m: give control points")


def test_a_shift_between_datums_is_not_mended_by_more_control() -> None:
    """Once "give control points" was said to people who had given them, in ED50."""
    shift = find_datum_shift("EPSG:23032", FRAME)
    sigma_m = shift.sigma_m * 1.01
    remedy = suggest_accuracy_remedy(place(ControlKind.GCP, datum_shift=shift), sigma_m, build_priors(4))
    assert remedy == "give control in ETRS89 / UTM zone 32N; more control in ED50 / UTM zone 32N changes nothing"
    better = MissingOperation(name="ED50 to ETRS89 (15)", accuracy_m=0.15, grids=("grid.tif",))
    lacking = replace(shift, operation=replace(shift.operation, better_missing=better))
    assert suggest_shift_remedy(lacking, sigma_m).startswith(
        "install it (pyproj sync --file grid.tif) for ED50 to ETRS89 (15) (0.15 m), which the portfolio does without "
        "(crs.accept_operation_accuracy_m), or give control in ETRS89 / UTM zone 32N; more control in "
    )
    assert suggest_shift_remedy(shift, shift.sigma_m * 3) == ""


def test_a_campaign_by_gps_is_told_what_its_position_lacks() -> None:
    with pytest.raises(GeoreferenceError) as caught:
        Scene(build_ring()).georeference(None)
    assert "the heights of GPS have no stated datum (50 m are assumed)" in str(caught.value)
