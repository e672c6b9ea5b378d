"""Errors of known size, put into a made campaign, come back as the figures; matching is by annotation alone."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from facadelake.core.errors import InputDataError, SchemaError
from facadelake.core.geodesy import SiteOrigin
from facadelake.evaluation.campaigns.figures import CampaignFigures
from tests.unit.evaluation.campaigns.campaigns import (
    CRS,
    ORIGIN,
    Made,
    MadeObservation,
    evaluate_tables,
    pixel,
    tables,
    write_csv,
    write_truth,
)

CAMERAS = {f"near/{i}.jpg": np.array([-8.0 + 4 * i, -15.0, 3.0 + 0.5 * i]) for i in range(5)}
SHIFT = np.array([0.03, 0.0, 0.04])  # 5 cm
STATS = ["n", "mean", "median", "mae", "rmse", "p95", "iqr"]
OFFSETS = ["offset_east", "offset_north", "offset_up"]


def figures_of(made: Made, folder: Path, origin: SiteOrigin = ORIGIN) -> CampaignFigures:
    return evaluate_tables(**tables(made), truth=write_truth(folder / "truth", made), origin=origin, map_crs=CRS)


def campaign(seed: int = 3) -> Made:
    """60 check points, 5 photographs; normal 2 cm bias and 1 cm noise, horizontal 3 cm, vertical 0.5 cm noise."""
    rng = np.random.default_rng(seed)
    points = {f"C{i:02d}": np.array([rng.uniform(-9, 9), 0.0, rng.uniform(0, 8)]) for i in range(60)}
    made_observations, defects = [], {}
    for name, point in points.items():
        for photo, centre in CAMERAS.items():
            # East is horizontal, up is vertical and south is outward on this wall.
            error = np.array([rng.normal(0, 0.03), -rng.normal(0.02, 0.01), rng.normal(0, 0.005)])
            box = pixel(centre, point)
            made_observations.append(
                MadeObservation(photo=photo, shows=name, xyz_site_m=point + error, box_centre_px=box, defect=f"D{name}")
            )
        defects[f"D{name}"] = point + np.array([0.0, -0.02, 0.01])
    found = {name: centre + SHIFT for name, centre in CAMERAS.items()}
    return Made(
        centres_true_m=CAMERAS,
        centres_found_m=found,
        points_true_m=points,
        observations=made_observations,
        defects_m=defects,
    )


def test_injected_errors_come_back(tmp_path: Path) -> None:
    made = campaign()
    figures = figures_of(made, tmp_path)
    assert (figures.photographs_total, figures.photographs_localised) == (5, 5)
    camera = figures.camera_error
    assert camera.n == 5
    assert camera.mean == pytest.approx(0.05, rel=0, abs=1e-6)  # m
    assert camera.mean == camera.mae
    offset = [camera.offset_east, camera.offset_north, camera.offset_up]
    assert offset == pytest.approx(SHIFT, rel=0, abs=1e-6)  # m, found minus true

    # Rays of true pixels from shifted cameras are parallel to the true ones: the shift across the ray is left.
    across = []
    for one in made.observations:
        ray = made.points_true_m[one.shows or ""] - CAMERAS[one.photo]
        across.append(np.linalg.norm(np.cross(SHIFT, ray / np.linalg.norm(ray))))
    assert figures.ray_error.n == 300
    assert figures.ray_error.mean == pytest.approx(np.mean(across), rel=0, abs=1e-6)  # m
    assert figures.ray_error.p95 == pytest.approx(np.percentile(across, 95), rel=0, abs=1e-6)  # m

    found = figures.observation_error
    assert found.distance.n == found.normal.n == 300
    assert found.normal.mean == pytest.approx(0.02, rel=0, abs=0.002)  # m: outward is positive
    assert 0.0205 < (found.normal.rmse or 0) < 0.0242  # sqrt(2^2 + 1^2) cm = 2.24
    assert found.horizontal.mean == pytest.approx(0.0, rel=0, abs=0.006)  # m
    assert 0.027 < (found.horizontal.rmse or 0) < 0.033
    assert 0.0045 < (found.vertical.rmse or 0) < 0.0055
    assert found.horizontal.mae == pytest.approx(0.03 * np.sqrt(2 / np.pi), rel=0, abs=0.0025)  # m
    assert found.horizontal.p95 == pytest.approx(0.03 * 1.96, rel=0, abs=0.006)  # m
    assert found.horizontal.iqr == pytest.approx(0.03 * 1.349, rel=0, abs=0.006)  # m
    squares = [(part.rmse or 0) ** 2 for part in (found.normal, found.horizontal, found.vertical)]
    assert found.distance.rmse == pytest.approx(np.sqrt(sum(squares)), rel=0, abs=1e-9)  # m
    assert found.distance.mean == found.distance.mae

    assert figures.defect_error.distance.n == 60
    assert figures.defect_error.normal.mean == pytest.approx(0.02, rel=0, abs=1e-6)  # m
    assert figures.defect_error.vertical.mean == pytest.approx(0.01, rel=0, abs=1e-6)  # m
    assert figures.defect_error.horizontal.rmse == pytest.approx(0.0, rel=0, abs=1e-6)  # m
    merge = figures.merge
    assert (merge.precision, merge.recall, merge.f1, merge.clusters_exact) == (1.0, 1.0, 1.0, 1.0)
    assert (figures.element_correct_share, figures.registered_without_check_point, figures.coverage_2sigma) == (
        1.0,
        0,
        None,
    )


def test_the_round_trip_is_the_papers(tmp_path: Path) -> None:
    """A point registered right, whose box is 3 px right and 4 px down of it: 5 px, and at 5 mm a pixel 2.5 cm."""
    point = np.array([1.0, 0.0, 2.0])
    right = pixel(CAMERAS["near/1.jpg"], point)
    box = (right[0] + 3, right[1] + 4)
    made_one = MadeObservation(photo="near/1.jpg", shows="C1", xyz_site_m=point, box_centre_px=box)
    made = Made(centres_true_m=CAMERAS, centres_found_m=CAMERAS, points_true_m={"C1": point}, observations=[made_one])
    figures = figures_of(made, tmp_path)
    assert figures.roundtrip_px.mean == pytest.approx(5.0, rel=0, abs=1e-6)  # px
    assert figures.roundtrip_cm.mean == pytest.approx(2.5, rel=0, abs=1e-6)  # cm
    json_figures = figures.convert_to_json()
    assert json_figures["roundtrip_px"] == figures.roundtrip_px.mean
    behind = replace(made_one, xyz_site_m=np.array([0.0, -30.0, 2.0]))
    with pytest.raises(SchemaError, match=r"observation near/1.jpg#0 is registered behind the camera of near/1.jpg"):
        figures_of(replace(made, observations=[behind]), tmp_path)


def test_json_has_exactly_the_agreed_keys(tmp_path: Path) -> None:
    content = json.loads(json.dumps(figures_of(campaign(), tmp_path).convert_to_json()))
    assert list(content) == [
        "photographs", "camera_error_m", "ray_error_m", "observation_error_m", "defect_error_m", "roundtrip_px",
        "roundtrip_cm", "merge", "element_correct_share", "off_truth", "coverage_2sigma",
        "coverage_2sigma_observations", "coverage_2sigma_defects", "roundtrip_defects_px", "roundtrip_defects_cm",
        "element_correct_share_defects",
        "covariance_consistency", "check_points", "table2",
    ]  # fmt: skip
    assert list(content["photographs"]) == ["total", "localised"]
    assert list(content["ray_error_m"]) == STATS
    assert list(content["camera_error_m"]) == [*STATS, *OFFSETS]
    for key in ("observation_error_m", "defect_error_m"):
        assert list(content[key]) == [*STATS, "normal", "horizontal", "vertical"]
        assert all(list(content[key][axis]) == STATS for axis in ("normal", "horizontal", "vertical"))
    assert list(content["merge"]) == ["precision", "recall", "f1", "clusters_exact"]
    assert content["coverage_2sigma"] is None


def test_truth_is_matched_by_annotation_and_never_by_nearness(tmp_path: Path) -> None:
    """Two detections swapped on the wall: each lies on the other's check point, and is 4 m wrong all the same."""
    left, right = np.array([-2.0, 0.0, 3.0]), np.array([2.0, 0.0, 3.0])
    photo = "near/2.jpg"
    boxes = [pixel(CAMERAS[photo], point) for point in (left, right)]
    swapped = [
        MadeObservation(photo=photo, shows="L", xyz_site_m=right, box_centre_px=boxes[0]),
        MadeObservation(photo=photo, shows="R", xyz_site_m=left, box_centre_px=boxes[1]),
    ]
    points = {"L": left, "R": right}
    made = Made(centres_true_m=CAMERAS, centres_found_m=CAMERAS, points_true_m=points, observations=swapped)
    found = figures_of(made, tmp_path).observation_error
    assert found.distance.mean == pytest.approx(4.0, rel=0, abs=1e-6)  # m
    # Right as seen from outside (from the south) is east.
    assert found.horizontal.mean == pytest.approx(0.0, rel=0, abs=1e-6)  # m: +4 and -4
    assert found.horizontal.mae == pytest.approx(4.0, rel=0, abs=1e-6)  # m


def test_what_counts_and_what_does_not(tmp_path: Path) -> None:
    point, other = np.array([0.0, 0.0, 3.0]), np.array([3.0, 0.0, 3.0])
    far = np.array([1.5, 0.0, 5.0])

    def seen(photo: str, shows: str | None, xyz: np.ndarray, defect: str | None, **more: str) -> MadeObservation:
        box = pixel(CAMERAS[photo], point)
        return MadeObservation(photo=photo, shows=shows, xyz_site_m=xyz, box_centre_px=box, defect=defect, **more)

    made_observations = [
        # D1: two made_observations of A, one of B, one of nothing: A's.
        seen("near/0.jpg", "A", point, "D1"),
        seen("near/1.jpg", "A", point, "D1", element="column"),
        seen("near/2.jpg", "B", other, "D1"),
        seen("near/3.jpg", None, far, "D1"),
        # D2: one of B, two of nothing: no check point's.
        seen("near/0.jpg", "B", other, "D2"),
        seen("near/1.jpg", None, far, "D2"),
        seen("near/2.jpg", None, far, "D2"),
        # Not registered; not accepted; in a photograph without pose.
        seen("near/0.jpg", "A", point, None, outcome="grazing"),
        seen("near/0.jpg", "A", point, None, outcome="off_target", detection_outcome="bad_box"),
        seen("near/4.jpg", "A", point, None, outcome="unlocalised"),
    ]
    made = Made(
        centres_true_m=CAMERAS,
        centres_found_m=CAMERAS,
        points_true_m={"A": point, "B": other},
        observations=made_observations,
        defects_m={"D1": point + np.array([0.0, -0.1, 0.0]), "D2": far},
        unlocalised=["near/4.jpg"],
    )
    figures = figures_of(made, tmp_path)
    assert (figures.photographs_total, figures.photographs_localised) == (5, 4)
    assert figures.camera_error.n == 4
    assert figures.ray_error.n == 5  # four of A and B registered, and the grazing one
    assert figures.observation_error.distance.n == 4
    assert figures.registered_without_check_point == 3
    assert figures.defect_error.distance.n == 1
    assert figures.defect_error.normal.mean == pytest.approx(0.1, rel=0, abs=1e-6)  # m
    assert figures.element_correct_share == pytest.approx(3 / 4)
    # Pairs with truth: D1 holds A A B (3 pairs, 1 right), D2 holds B; true pairs A A and B B.
    assert figures.merge.precision == pytest.approx(1 / 3)
    assert figures.merge.recall == pytest.approx(1 / 2)
    assert figures.merge.f1 == pytest.approx(2 * 1 / (3 + 2))
    assert figures.merge.clusters_exact == 0.0


def test_detections_of_a_model_have_no_truth(tmp_path: Path) -> None:
    made = replace(campaign(), detector="onnx:crack")
    content = figures_of(made, tmp_path).convert_to_json()
    assert content["camera_error_m"]["n"] == 5  # type: ignore[index]
    assert content["ray_error_m"] == {"n": 0, **dict.fromkeys(STATS[1:])}
    assert content["defect_error_m"]["normal"]["n"] == 0  # type: ignore[index]
    assert content["merge"] == dict.fromkeys(["precision", "recall", "f1", "clusters_exact"])
    assert (content["element_correct_share"], content["off_truth"]) == (None, None)
    assert isinstance(content["roundtrip_px"], float)


def test_a_campaign_without_detections_or_poses_has_empty_figures(tmp_path: Path) -> None:
    made = Made(centres_true_m=CAMERAS, centres_found_m={}, points_true_m={}, unlocalised=list(CAMERAS))
    content = figures_of(made, tmp_path).convert_to_json()
    assert content["photographs"] == {"total": 5, "localised": 0}
    assert content["camera_error_m"] == {"n": 0, **dict.fromkeys([*STATS[1:], *OFFSETS])}
    assert content["roundtrip_px"] is None


def test_rows_have_all_columns(tmp_path: Path) -> None:
    rows = figures_of(campaign(), tmp_path).format_rows()
    assert {len(row) for row in rows} == {len(CampaignFigures.COLUMNS)} == {8}
    by_name = {row[0].strip(): row for row in rows}
    assert by_name["camera error (m)"][1:3] == ("5", "0.050")
    assert by_name["mean offset up"][2] == "0.040"
    assert by_name["merge F1"][2] == "1.000"
    assert by_name["cameras inside 2 sigma"][2] == "-"


def test_offsets_that_cancel_are_no_offset(tmp_path: Path) -> None:
    """Cameras 5 cm off, two one way and two the other: 5 cm of error, no offset but the fifth camera's."""
    signs = dict(zip(CAMERAS, (1, -1, 1, -1, 0), strict=True))
    found = {name: centre + signs[name] * SHIFT + [0.0, 0.01, 0.0] for name, centre in CAMERAS.items()}
    camera = figures_of(Made(centres_true_m=CAMERAS, centres_found_m=found, points_true_m={}), tmp_path).camera_error
    assert camera.mean == pytest.approx((4 * np.hypot(0.05, 0.01) + 0.01) / 5, rel=0, abs=1e-6)  # m
    offset = [camera.offset_east, camera.offset_north, camera.offset_up]
    assert offset == pytest.approx([0.0, 0.01, 0.0], rel=0, abs=1e-6)  # m


def test_a_file_that_truth_does_not_list_and_another_campaign_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputDataError, match=r"detections.csv, column file: no line for 'mine.json'.*boxes.json"):
        figures_of(replace(campaign(), detector="coco:mine.json"), tmp_path)
    made = campaign()
    truth = write_truth(tmp_path / "truth", made)
    write_csv(
        truth / "cameras.csv", ["image", "lon_deg", "lat_deg", "height_ellipsoidal_m"], [["other.jpg", 8.4, 48.9, 170]]
    )
    with pytest.raises(
        InputDataError, match=r"cameras.csv, column image: none of its 1 photographs is in the campaign"
    ):
        evaluate_tables(**tables(made), truth=truth, origin=ORIGIN, map_crs=CRS)


def test_tables_of_another_origin_are_refused(tmp_path: Path) -> None:
    elsewhere = SiteOrigin(lon_deg=8.4083, lat_deg=48.94091, height_ellipsoidal_m=171.5)
    with pytest.raises(SchemaError, match=r"positions in the site frame and in EPSG:25832 are 1.11\d m apart"):
        figures_of(campaign(), tmp_path, elsewhere)
