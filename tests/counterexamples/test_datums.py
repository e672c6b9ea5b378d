"""Control in another datum, unit or height than the model's: what is converted, refused or told."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from facadelake.core.errors import GeoreferenceError
from facadelake.core.geodesy import SiteOrigin, transform
from facadelake.core.proj.crs import GEO, check_area_of_use
from facadelake.georeferencing import Control, SiteFrame, georeference_reconstruction
from facadelake.georeferencing.gcp.control_points import (
    SurveyedPoint,
    SurveyedPoints,
    compute_height_factor,
    read_surveyed_points,
    transform_to_site,
)
from facadelake.georeferencing.georeferenced_campaign import GeoreferencedCampaign
from facadelake.georeferencing.gps.priors import collect_gps_priors
from facadelake.georeferencing.imported.world import North, PoseWorld
from schemas.vocabulary import ControlKind, HeightDatum
from tests.synthetic.test_georeference import ORIGIN, Scene, build_ring

SCENE = Scene(poses=build_ring())
CONTROL = SCENE.build_control()
FRAME = SiteFrame(origin=ORIGIN, map_crs="EPSG:25832", vertical_datum="ellipsoidal", georeference_level="50")
US_FOOT_M = 1200 / 3937
CASES = Path("../shared/data/cases/gcp")


def georeference(points: SurveyedPoints, frame: SiteFrame = FRAME, limit_m: float = 60.0) -> GeoreferencedCampaign:
    return georeference_reconstruction(
        SCENE.build_reconstruction(),
        SCENE.build_photos(),
        site_frame=frame,
        control=Control(kind=ControlKind.GCP, points=points, placement_sigma_max_m=limit_m),
    )


def convert(crs: str) -> SurveyedPoints:
    """The control points in another CRS, as a surveyor's program writes them."""
    xyz = transform(np.array([[point.x, point.y, point.z] for point in CONTROL.points]), CONTROL.crs, crs)
    points = [replace(p, x=x, y=y, z=z) for p, (x, y, z) in zip(CONTROL.points, xyz.tolist(), strict=True)]
    return replace(CONTROL, crs=crs, points=tuple(points))


def compute_camera_errors_m(found: GeoreferencedCampaign) -> np.ndarray:
    truth = {name: centre for name, (centre, _) in zip(SCENE.list_ids(), SCENE.poses, strict=True)}
    return np.array([np.linalg.norm(posed.centre_site_m - truth[name]) for name, posed in found.cameras.items()])


def test_heights_are_in_the_feet_of_a_crs_that_says_nothing_of_heights() -> None:
    """A header in US survey feet: a point at 1584.31 is 482.90 m high, not 1584 m."""
    feet = [replace(p, x=p.x / US_FOOT_M, y=p.y / US_FOOT_M, z=p.z / US_FOOT_M) for p in CONTROL.points]
    in_feet = replace(CONTROL, crs="+proj=utm +zone=32 +datum=WGS84 +units=us-ft +no_defs", points=tuple(feet))
    np.testing.assert_allclose(
        transform_to_site(in_feet, FRAME), transform_to_site(CONTROL, FRAME), rtol=0, atol=0.001
    )  # m
    found = georeference(in_feet)
    assert compute_camera_errors_m(found).max() < 0.1  # m
    assert (
        "the control points' heights have no stated datum: taken in the model's (ellipsoidal) and in the unit of east "
        "and north (0.3048006 m)"
    ) in found.row["remarks"]
    # Where the CRS states the unit of heights, PROJ converts it.
    stated = replace(in_feet, crs="+proj=utm +zone=32 +datum=WGS84 +units=us-ft +vunits=m +no_defs")
    metres = replace(stated, points=tuple(replace(p, z=p.z * US_FOOT_M) for p in stated.points))
    np.testing.assert_allclose(
        transform_to_site(metres, FRAME), transform_to_site(CONTROL, FRAME), rtol=0, atol=0.001
    )  # m


def test_heights_go_to_the_unit_of_the_vertical_crs() -> None:
    """NAVD88 in US survey feet beside a map in metres, and the reverse; a CRS with heights says its unit itself."""
    assert compute_height_factor("EPSG:6423", "EPSG:6423+6360") == pytest.approx(1 / US_FOOT_M)
    assert compute_height_factor("EPSG:2229", "EPSG:2229+5703") == pytest.approx(US_FOOT_M)
    assert compute_height_factor("EPSG:2229", "EPSG:2229+6360") == pytest.approx(1.0)
    assert compute_height_factor("EPSG:2229+6360", "EPSG:2229+6360") == 1.0
    assert compute_height_factor("EPSG:4326", "EPSG:4326+5773") == 1.0


def test_poses_in_feet_have_heights_in_feet() -> None:
    crs = "+proj=utm +zone=32 +datum=WGS84 +units=us-ft +no_defs"
    xyz = np.array([[p.x, p.y, p.z] for p in CONTROL.points])
    rotations = np.broadcast_to(np.eye(3), (len(xyz), 3, 3))
    in_feet, _ = PoseWorld(crs=crs, north=North.TRUE).transform_to_site(xyz / US_FOOT_M, rotations, FRAME)
    np.testing.assert_allclose(in_feet, transform_to_site(CONTROL, FRAME), rtol=0, atol=0.001)  # m


def test_control_in_the_datum_of_the_model_has_no_error_of_the_datum() -> None:
    found = georeference(convert("EPSG:4258"))
    assert (found.row["control_operation_accuracy_m"], found.row["control_operation_sigma_m"]) == (0.0, 0.0)
    assert (
        found.row["crs_operation"] == "Inverse of ETRS89 to WGS 84 (1)"
        or "ETRS89 to WGS 84" in found.row["crs_operation"]
    )
    assert found.row["crs_operation_accuracy_m"] == 1.0
    assert max(found.row[f"sigma_{axis}_m"] for axis in ("east", "north", "up")) < 0.02
    assert compute_camera_errors_m(found).max() < 0.1  # m


def test_control_in_an_older_datum_has_the_accuracy_of_the_operation_in_its_covariance() -> None:
    """ED50 in southern Germany: a shift by three parameters, whose metres are the same for every point."""
    frame = replace(FRAME, accepted_operation_accuracy_m=20.0)
    in_ed50 = convert("EPSG:23032")
    found = georeference(in_ed50, frame)
    accuracy_m = found.row["control_operation_accuracy_m"]
    assert 1.0 < accuracy_m <= 20.0
    assert found.row["control_operation_sigma_m"] >= accuracy_m
    for axis in ("east", "north", "up"):
        assert accuracy_m <= found.row[f"sigma_{axis}_m"] < 1.01 * found.row["control_operation_sigma_m"]
    for covariance in found.covariance.values():
        assert covariance[0, 0] >= accuracy_m**2
    sigma_m = {axis: found.row[f"sigma_{axis}_m"] for axis in ("east", "north", "up")}
    worst = max(sigma_m, key=lambda axis: sigma_m[axis])
    refusal = (
        f"placed by gcp, the campaign's position is known to {sigma_m[worst]:.2f} m {worst} (one sigma), the limit is "
        f"0.5 m (tolerances.placement_sigma_max_m); the position's sigma of {sigma_m[worst]:.2g} m is mostly that of "
        f"the transformation from ED50 / UTM zone 32N to ETRS89 / UTM zone 32N by {found.row['control_operation']} "
        f"(accuracy {accuracy_m:g} m); control in the CRS of the model has none; "
    )
    _, remark = refusal.split("; ", 1)
    assert remark in found.row["remarks"]
    with pytest.raises(GeoreferenceError) as raised:
        georeference(in_ed50, frame, limit_m=0.5)
    assert str(raised.value) == (
        refusal + "give control in ETRS89 / UTM zone 32N; more control in ED50 / UTM zone 32N changes nothing"
    )


def test_control_in_wgs_84_is_taken_as_etrs89_and_told() -> None:
    found = georeference(convert("EPSG:32632"))
    assert (found.row["control_operation_accuracy_m"], found.row["control_operation_sigma_m"]) == (1.0, 0.0)
    assert (
        "positions in WGS 84 / UTM zone 32N are taken as ETRS89 / UTM zone 32N without a shift (Inverse of ETRS89 to "
        "WGS 84 (1), accuracy 1 m, not in the sigmas): right if they were computed from it or corrected by its "
        "service, else name the CRS that they were observed in"
    ) in found.row["remarks"]


def test_one_point_outside_the_area_of_use_is_left_out() -> None:
    first: SurveyedPoint = CONTROL.points[0]
    found = georeference(replace(CONTROL, points=(replace(first, x=first.y, y=first.x), *CONTROL.points[1:])))
    assert (found.row["points_used"], found.row["points_total"]) == (5, 6)
    assert "control points left out, outside the area of use of their CRS: G1" in found.row["remarks"]
    with pytest.raises(GeoreferenceError, match="exchanged"):
        check_area_of_use(np.array([[first.y, first.x]]), CONTROL.crs)


def test_a_missing_grid_ends_the_run_unless_the_operation_is_accepted() -> None:
    in_dhdn = convert("EPSG:31467")
    with pytest.raises(GeoreferenceError, match=r"grid de_lgl_bw_BWTA2017\.tif, which is not installed: install"):
        georeference(in_dhdn)
    accepted = replace(FRAME, accepted_operation_accuracy_m=3.0)
    assert georeference(in_dhdn, accepted).row["control_operation_sigma_m"] >= 1.0


def build_photos(unknown: int, sigma_m: tuple[float, float] = (0.02, 0.03)) -> pa.Table:
    """Table ``photos`` of positions as of RTK, with the heights of the first few of unknown datum."""
    rows = SCENE.build_photos().to_pylist()
    for k, row in enumerate(rows):
        row |= {"prior_sigma_horizontal_m": sigma_m[0], "prior_sigma_vertical_m": sigma_m[1]}
        row["prior_height_datum"] = HeightDatum.UNKNOWN if k < unknown else HeightDatum.ELLIPSOIDAL
    return pa.Table.from_pylist(rows, schema=SCENE.build_photos().schema)


def test_one_height_of_unknown_datum_does_not_condemn_the_others() -> None:
    reconstruction = SCENE.build_reconstruction()
    priors = collect_gps_priors(reconstruction, build_photos(1), FRAME)
    assert not priors.datum_unknown
    assert priors.unlike_heights == (reconstruction.photos[int(priors.photo[0])].photo_id,)
    assert priors.sigma_m[0, 2] == pytest.approx(50.0, abs=0.1)
    assert priors.sigma_m[1:, 2].max() < 0.1
    assert priors.common_sigma_m.max() <= 1.0  # RTK; WGS 84 is ETRS89 by convention to 1 m
    none_stated = collect_gps_priors(reconstruction, build_photos(len(priors.photo)), FRAME)
    assert none_stated.datum_unknown
    assert none_stated.unlike_heights == ()
    found = georeference_reconstruction(
        reconstruction,
        build_photos(1, (0.4, 0.7)),  # m: the noise that the scene's positions have
        site_frame=FRAME,
        control=Control(kind=ControlKind.GPS, placement_sigma_max_m=60.0),
    )
    assert (
        "the GPS heights of 1 of 24 photographs are not stated as ellipsoidal and count with a sigma of 50 m: p00.jpg"
    ) in found.row["remarks"].split("; ")


def test_positions_in_a_named_datum() -> None:
    """crs.gnss: ETRS89 leaves the coordinates, and takes the convention away."""
    reconstruction, photos = SCENE.build_reconstruction(), build_photos(0)
    by_default = collect_gps_priors(reconstruction, photos, FRAME)
    named = collect_gps_priors(reconstruction, photos, replace(FRAME, gnss_crs="EPSG:4258"))
    np.testing.assert_allclose(named.xyz_site_m, by_default.xyz_site_m, rtol=0, atol=0.001)  # m
    assert (by_default.convention_m, named.convention_m) == (1.0, 0.0)
    assert FRAME.gnss_crs == GEO


def georeference_by_gps(frame: SiteFrame, photos: pa.Table, limit_m: float = 60.0) -> GeoreferencedCampaign:
    return georeference_reconstruction(
        SCENE.build_reconstruction(),
        photos,
        site_frame=frame,
        control=Control(kind=None, placement_sigma_max_m=limit_m),
    )


def test_positions_as_control_have_the_accuracy_of_a_null_transformation() -> None:
    """RTK in WGS 84, a map in ETRS89: 1 m by EPSG, unless crs.gnss names the datum of the corrections."""
    photos = build_photos(0, (0.4, 0.7))  # m: the noise that the scene's positions have
    named = georeference_by_gps(replace(FRAME, gnss_crs="EPSG:4258"), photos)
    observed = georeference_by_gps(FRAME, photos)
    for axis in ("east", "north", "up"):
        sigmas_m = [found.row[f"sigma_{axis}_m"] for found in (named, observed)]
        assert sigmas_m[1] == pytest.approx(np.hypot(sigmas_m[0], 1.0), rel=0, abs=0.001)
    assert (named.row["control_operation_sigma_m"], observed.row["control_operation_sigma_m"]) == (0.0, 1.0)
    photo_id = next(iter(named.covariance))
    added = observed.covariance[photo_id][:3, :3] - named.covariance[photo_id][:3, :3]
    np.testing.assert_allclose(np.diag(added), 1.0, rtol=0, atol=0.01)  # m2
    remedy = "where a service corrected the positions, name its datum with crs.gnss in the portfolio"
    assert remedy in observed.row["remarks"]
    assert remedy not in named.row["remarks"]


def test_flights_do_not_average_what_they_share() -> None:
    """The shift between two datums, and the height above an unknown surface, are the same for all flights."""
    rows = build_photos(0, (0.4, 0.7)).to_pylist()
    for k, row in enumerate(rows):
        row["flight"] = 1 + k % 4
    four = pa.Table.from_pylist(rows, schema=SCENE.build_photos().schema)
    assert georeference_by_gps(FRAME, four).row["sigma_east_m"] > 1.0
    unknown = build_photos(len(rows), (0.4, 0.7)).to_pylist()
    for k, row in enumerate(unknown):
        row["flight"] = 1 + k % 4
    above = pa.Table.from_pylist(unknown, schema=SCENE.build_photos().schema)
    assert georeference_by_gps(FRAME, above).row["sigma_up_m"] > 50.0


def test_rtk_of_an_unnamed_datum_is_refused_with_the_key_that_names_it() -> None:
    photos = build_photos(0, (0.4, 0.4))
    with pytest.raises(GeoreferenceError) as raised:
        georeference_by_gps(FRAME, photos, limit_m=0.5)
    assert "name its datum with crs.gnss in the portfolio" in str(raised.value)


@pytest.mark.skipif(not CASES.exists(), reason="needs the shared cases")
def test_three_points_in_feet_are_where_the_same_point_is_in_metres() -> None:
    """G1 of cases/gcp, in US survey feet and in metres; read as metres, its height was 1,101 m too great."""
    frame = replace(FRAME, origin=SiteOrigin(lon_deg=9.1056, lat_deg=48.7447, height_ellipsoidal_m=480.0))
    feet = transform_to_site(read_surveyed_points(CASES / "feet_flat_G1_G3_G5.txt"), frame)
    metres = transform_to_site(read_surveyed_points(CASES / "images_prefix.txt"), frame)
    np.testing.assert_allclose(feet[0], metres[0], rtol=0, atol=0.001)  # m
    assert np.abs(feet[:, 2]).max() < 30.0  # m
