"""Positions checked against one another and against the building."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facadelake.core.geodesy import SiteOrigin
from facadelake.photos.plausibility import TimedPrior, check_priors
from facadelake.photos.position_prior import PositionPrior
from facadelake.photos.position_sigma import PositionSigma
from schemas.vocabulary import PositionSource

LON, LAT = 8.4, 48.94
ORIGIN = SiteOrigin(lon_deg=LON, lat_deg=LAT, height_ellipsoidal_m=180.0)


def flown(count: int = 8, step_m: float = 5.0, **changed: dict[int, dict[str, float]]) -> list[TimedPrior]:
    """A flight to the east with a photograph every 2 s, by an independent path to degrees; some values changed."""
    xyz = np.column_stack([step_m * np.arange(count), np.zeros(count), np.full(count, 10.0)])
    out = []
    for k, (lon, lat, height) in enumerate(ORIGIN.geo_from_site(xyz)):
        values = {"lon_deg": lon, "lat_deg": lat, "height_m": height} | changed.get("at", {}).get(k, {})
        prior = PositionPrior(
            source=PositionSource.XMP, sigma=PositionSigma(horizontal_m=3.0, vertical_m=5.0), **values
        )
        out.append(TimedPrior(prior=prior, flight=1, time_s=1e9 + 2.0 * k))
    return out


def distance_to_origin(lon_lat_deg: np.ndarray) -> np.ndarray:
    """Horizontal distance to the building, which is a point here."""
    geo = np.column_stack([lon_lat_deg, np.full(len(lon_lat_deg), 180.0)])
    return np.hypot(*ORIGIN.site_from_geo(geo)[:, :2].T)


def dropped(priors: list[PositionPrior]) -> list[int]:
    """Numbers of those that were set to NONE."""
    return [k for k, prior in enumerate(priors) if prior.source is PositionSource.NONE]


def test_a_good_flight_passes_as_it_is() -> None:
    timed = flown()
    assert check_priors(timed, distance_to_origin) == [one.prior for one in timed]
    assert check_priors(timed) == [one.prior for one in timed]
    assert check_priors([]) == []


@pytest.mark.parametrize("model", [None, distance_to_origin])
@pytest.mark.parametrize(
    ("wrong", "suggestion"),
    [
        ({"lon_deg": LAT, "lat_deg": LON}, "with latitude and longitude swapped it would be"),
        ({"lon_deg": -LON}, "with the sign of the longitude (E/W) changed it would be"),
        ({"lat_deg": -LAT}, "with the sign of the latitude (N/S) changed it would be"),
        ({"lon_deg": -LON, "lat_deg": -LAT}, "with both signs changed it would be"),
        ({"lon_deg": 12.0}, " km from "),
    ],
)
def test_an_error_of_writing_is_discarded_with_a_hint(wrong: dict[str, float], suggestion: str, model: object) -> None:
    priors = check_priors(flown(at={2: wrong}), model)  # type: ignore[arg-type]
    assert dropped(priors) == [2]
    assert suggestion in priors[2].reason
    assert priors[2].warnings == (priors[2].reason,)
    assert math.isnan(priors[2].lon_deg)
    assert ("the building" if model else "the other photographs") in priors[2].reason


def test_an_error_in_all_photographs_is_left_to_the_pose_stage_with_a_warning() -> None:
    timed = [replace(one, prior=replace(one.prior, lat_deg=LON, lon_deg=LAT)) for one in flown(step_m=0.0)]
    priors = check_priors([replace(one, time_s=math.nan) for one in timed], distance_to_origin)
    assert dropped(priors) == []
    assert all("with latitude and longitude swapped it would be 0 m away" in p.warnings[0] for p in priors)


@pytest.mark.parametrize("k", [0, 3, 7])
def test_an_outlier_is_discarded_alone_wherever_it_is(k: int) -> None:
    lon, lat, _ = ORIGIN.geo_from_site(np.array([[0.0, 400.0, 10.0]]))[0]
    priors = check_priors(flown(at={k: {"lon_deg": lon, "lat_deg": lat}}))
    assert dropped(priors) == [k]
    apart_m = float(priors[k].reason.split(" m from that")[0].split()[-1])
    assert apart_m == pytest.approx(math.hypot(400, 5 * abs(k - 1 if k == 0 else 1) + 5 * (k - 1)), rel=0, abs=5)  # m


def test_the_fastest_flight_is_no_jump_and_a_faster_one_has_no_majority() -> None:
    assert dropped(check_priors(flown(step_m=44.0))) == []  # 22 m/s; clock steps and GPS noise allow somewhat more
    assert dropped(check_priors(flown(step_m=400.0))) == []


def test_two_places_in_turn_are_no_majority_and_a_gap_in_time_is_no_jump() -> None:
    lon, lat, _ = ORIGIN.geo_from_site(np.array([[0.0, 400.0, 10.0]]))[0]
    there = {"lon_deg": lon, "lat_deg": lat}
    assert dropped(check_priors(flown(at={1: there, 3: there, 5: there, 7: there}))) == []
    timed = flown(at=dict.fromkeys(range(4, 8), there))
    later = [replace(one, time_s=one.time_s + (60 if k > 3 else 0)) for k, one in enumerate(timed)]
    assert dropped(check_priors(later)) == []


def test_another_flight_is_judged_by_itself() -> None:
    first = flown()
    far = [replace(one, flight=2) for one in flown(at={k: {"lat_deg": LAT + 0.01} for k in range(8)})]
    assert dropped(check_priors([*first, *far])) == []


@pytest.mark.parametrize(
    ("height", "warning"),
    [(12000.0, "is out of range (-500 to 9000 m)"), (390.0, "is inconsistent with those before and after")],
)
def test_an_impossible_height_is_not_used_and_the_position_kept(height: float, warning: str) -> None:
    priors = check_priors(flown(at={4: {"height_m": height}}))
    assert dropped(priors) == []
    assert [k for k, prior in enumerate(priors) if math.isnan(prior.height_m)] == [4]
    assert warning in priors[4].warnings[0]
    assert priors[4].lon_deg == pytest.approx(LON, rel=0, abs=1e-3)  # deg


def test_the_sigma_of_a_frozen_receiver_is_the_distance_flown_meanwhile() -> None:
    same = {"lon_deg": flown(12, 20.0)[3].prior.lon_deg, "lat_deg": flown(12, 20.0)[3].prior.lat_deg}
    priors = check_priors(flown(12, 20.0, at=dict.fromkeys((3, 4, 5, 6), same)))
    assert dropped(priors) == []
    marked = [k for k, prior in enumerate(priors) if prior.warnings]
    assert marked == [3, 4, 5, 6]
    # the next different position is 80 m on
    assert {round(priors[k].sigma.horizontal_m) for k in marked} == {80}
    assert priors[3].warnings == ("4 consecutive photographs have the same position",)
    assert priors[2].sigma == PositionSigma(horizontal_m=3.0, vertical_m=5.0)


def test_cameras_triggered_together_may_share_a_position() -> None:
    timed = flown(at={1: {"lon_deg": LON}, 2: {"lon_deg": LON}})  # wide, tele and thermal in one second
    together = [replace(one, time_s=1e9 if k < 3 else one.time_s) for k, one in enumerate(timed)]
    assert all(prior.warnings == () for prior in check_priors(together))


def test_one_position_in_all_photographs_is_no_position() -> None:
    priors = check_priors(flown(step_m=0.0))
    assert dropped(priors) == list(range(8))
    assert priors[0].reason == "all 8 photographs have the same position: it was not measured, or is truncated"


def test_a_person_who_stands_still_beside_a_flight_keeps_the_position() -> None:
    flight = flown()
    standing = [replace(one, flight=2) for one in flown(5, 0.0)]
    priors = check_priors([*flight, *standing])
    assert dropped(priors) == []
    # five photographs in 8 s, at 3 m/s
    assert {prior.sigma for prior in priors[8:]} == {PositionSigma(horizontal_m=24.0, vertical_m=24.0)}


def test_a_climb_with_a_frozen_place_keeps_its_heights_sigma() -> None:
    same = {"lon_deg": LON, "lat_deg": LAT}
    priors = check_priors(flown(at={k: same | {"height_m": 190.0 + 2 * k} for k in range(4)}))
    assert {prior.sigma.vertical_m for prior in priors} == {5.0}
    assert priors[2].sigma.horizontal_m == pytest.approx(20.0, rel=0, abs=0.1)  # m


@settings(max_examples=60, deadline=None)
@given(
    st.lists(
        st.tuples(
            st.floats(-180, 180), st.floats(-90, 90), st.floats(-1000, 20000) | st.just(math.nan),
            st.floats(0, 100) | st.just(math.nan), st.integers(1, 2),
        ),
        max_size=12,
    )
)  # fmt: skip
def test_a_prior_is_kept_widened_or_discarded_with_a_reason(
    values: list[tuple[float, float, float, float, int]],
) -> None:
    timed = [
        TimedPrior(
            prior=PositionPrior(source=PositionSource.EXIF, lon_deg=lon, lat_deg=lat, height_m=height),
            flight=flight,
            time_s=time,
        )
        for lon, lat, height, time, flight in values
    ]
    for before, after in zip(timed, check_priors(timed), strict=True):
        if after.source is PositionSource.NONE:
            assert after.reason in after.warnings
            assert math.isnan(after.lon_deg)
        else:
            assert (after.lon_deg, after.lat_deg) == (before.prior.lon_deg, before.prior.lat_deg)
            assert after.sigma.horizontal_m >= before.prior.sigma.horizontal_m
            assert after.sigma.vertical_m >= before.prior.sigma.vertical_m
