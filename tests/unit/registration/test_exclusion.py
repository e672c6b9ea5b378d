"""Exclusion: a board in front of a wall occludes it, masks, and elements that are not part of the building."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial import cKDTree

from facadelake.building.surface.raycasting import Surface
from facadelake.core.camera import PosedCamera
from facadelake.core.errors import InputDataError
from facadelake.core.frames import Similarity
from facadelake.core.tables import table_from_rows
from facadelake.registration.exclusion import ExclusionEvidence, ExclusionSettings, exclude_observations
from facadelake.registration.exclusion_mask import compute_masked_shares
from facadelake.registration.occlusion import OcclusionSettings
from facadelake.registration.tie_points import BlockImagePoints, triangulate_tie_points
from tests.unit.registration.wall_scene import look_at

CAMERAS = {f"p{i}": look_at([x, -12.0, 2.0], [0.0, 0.0, 2.5]) for i, x in enumerate((-3.0, 0.0, 3.0))}
BOARD_M = 2.0  # before the wall
NOISE_PX = 0.3


def tracks_of(points, cameras=CAMERAS, seed=7, noise_px=NOISE_PX):
    """Every camera shows every point, except wall points that the board at x -1..1, z 1..3 occludes."""
    rng = np.random.default_rng(seed)
    photo, point, xy = [], [], []
    for index, posed in enumerate(cameras.values()):
        centre = posed.centre_site_m
        at_board = centre + (points - centre) * ((-BOARD_M - centre[1]) / (points[:, 1] - centre[1]))[:, None]
        hidden = (points[:, 1] > -BOARD_M + 1e-9) & (np.abs(at_board[:, 0]) < 1) & (np.abs(at_board[:, 2] - 2) < 1)
        seen = np.flatnonzero(~hidden)
        pixels = posed.project_site(points[seen]) + rng.normal(scale=noise_px, size=(len(seen), 2))
        photo.append(np.full(len(seen), index))
        point.append(seen)
        xy.append(pixels)
    return BlockImagePoints(
        photo_ids=list(cameras), photo=np.concatenate(photo), point=np.concatenate(point), xy_img=np.vstack(xy)
    )


def grid(x, y, z):
    return np.array([[a, y, c] for a in x for c in z], dtype=float)


WALL = grid(np.arange(-8, 8.1, 0.25), 0.0, np.arange(0.25, 6, 0.25))
BOARD = grid(np.arange(-1, 1.01, 0.25), -BOARD_M, np.arange(1, 3.01, 0.25))


def box_at(posed, xyz, size_px=40.0):
    x, y = posed.project_site(np.array([xyz], dtype=float))[0]
    return (x - size_px / 2, y - size_px / 2, size_px, size_px)


def excluded(wall, made, evidence, cameras=CAMERAS):
    """Rows by detection_id, as if every box had been registered whose photograph has a pose."""
    observed = table_from_rows(
        "observations",
        [
            {
                "detection_id": row["detection_id"], "photo_id": row["photo_id"], "defect_class": "crack",
                "observation_outcome": "registered" if row["photo_id"] in cameras else "unlocalised",
                "target_share": 1.0, "element_guid": "low" if row["detection_id"] == "low" else "high",
            }
            for row in made.to_pylist()
        ],
    )  # fmt: skip
    rows = exclude_observations(
        observed, made, cameras, wall.elements, Surface(wall), evidence, ExclusionSettings()
    ).to_pylist()
    return {row["detection_id"]: row for row in rows}


def test_tie_points_have_their_positions_and_consistent_covariances():
    cameras = {f"p{i}": look_at([x, -12.0, 2.0], [0.0, 0.0, 2.5]) for i, x in enumerate((-6.0, -3, 0.0, 3, 6.0))}
    found = triangulate_tie_points(tracks_of(WALL, cameras, noise_px=0.6), cameras)
    error = found.xyz_site_m - WALL[cKDTree(WALL).query(found.xyz_site_m)[1]]  # a quarter of a metre lies between them
    normalised = np.einsum("ki,kij,kj->k", error, np.linalg.inv(found.covariance_site_m2), error) / 3
    assert 0.6 < np.mean(normalised) < 1.6  # of 1: two-sided, a covariance too wide is wrong too
    assert np.abs(error).max() < 0.1  # m


def test_a_wrong_match_is_no_tie_point():
    tracks = tracks_of(WALL)
    wrong = tracks.xy_img.copy()
    wrong[100] += [0, 25.0]  # px, across the epipolar lines
    found = triangulate_tie_points(
        BlockImagePoints(photo_ids=tracks.photo_ids, photo=tracks.photo, point=tracks.point, xy_img=wrong), CAMERAS
    )
    assert len(found.xyz_site_m) == len(triangulate_tie_points(tracks, CAMERAS).xyz_site_m) - 1


def test_a_detection_behind_the_board_is_occluded_with_its_gap(wall, detections_of):
    posed = CAMERAS["p1"]
    made = detections_of(
        ("behind", "p1", "crack", box_at(posed, [0.0, -BOARD_M, 2.0])),
        ("beside", "p1", "crack", box_at(posed, [2.5, 0.0, 2.0])),
        ("over the edge", "p1", "crack", box_at(posed, [1.2, -BOARD_M, 2.0], 60)),
    )
    evidence = ExclusionEvidence(tie_points=triangulate_tie_points(tracks_of(np.vstack([WALL, BOARD])), CAMERAS))
    rows = excluded(wall, made, evidence)
    assert rows["behind"]["observation_outcome"] == "occluded"
    np.testing.assert_allclose(rows["behind"]["occluder_gap_m"], BOARD_M, rtol=0, atol=0.1)  # m
    assert "in front of the model" in rows["behind"]["reason"]
    assert rows["beside"]["observation_outcome"] == rows["over the edge"]["observation_outcome"] == "registered"
    assert rows["beside"]["occluder_gap_m"] is None and rows["beside"]["reason"] is None


def test_the_board_alone_decides(wall, detections_of):
    """The same box, the same wall points: without the board's points it is registered."""
    made = detections_of(("behind", "p1", "crack", box_at(CAMERAS["p1"], [0.0, -BOARD_M, 2.0])))
    evidence = ExclusionEvidence(tie_points=triangulate_tie_points(tracks_of(WALL), CAMERAS))
    assert excluded(wall, made, evidence)["behind"]["observation_outcome"] == "registered"


@pytest.mark.parametrize("relief_m", [0.02, 0.06, 0.25])
def test_relief_occludes_nothing(wall, detections_of, relief_m):
    made = detections_of(("on it", "p1", "crack", box_at(CAMERAS["p1"], [0.0, -relief_m, 2.0])))
    relief = grid(np.arange(-1, 1.01, 0.25), -relief_m, np.arange(1, 3.01, 0.25))
    evidence = ExclusionEvidence(tie_points=triangulate_tie_points(tracks_of(np.vstack([WALL, relief])), CAMERAS))
    assert excluded(wall, made, evidence)["on it"]["observation_outcome"] == "registered"


def test_an_oblique_view_of_relief_is_no_gap(wall, detections_of):
    """At 78 deg a relief of 0.2 m is 1 m along the ray; it is still 0.2 m off the model."""
    cameras = {f"p{i}": look_at([-14.0, -2.9, z], [0.0, 0.0, 2.0]) for i, z in enumerate((1.0, 2.0, 3.0))}
    relief = grid(np.arange(-1, 1.01, 0.25), -0.2, np.arange(1, 3.01, 0.25))
    made = detections_of(("on it", "p1", "crack", box_at(cameras["p1"], [0.0, -0.2, 2.0], 10)))
    evidence = ExclusionEvidence(tie_points=triangulate_tie_points(tracks_of(relief, cameras), cameras))
    assert excluded(wall, made, evidence, cameras)["on it"]["observation_outcome"] == "registered"


def test_a_campaign_that_lies_metres_off_is_not_all_occluded(wall, detections_of):
    """With GPS alone the whole block is 1.5 m in front of the model: the offset of the facade increases the limit."""
    offset = np.array([0.3, -1.5, 0.4])
    moved = {
        name: PosedCamera(
            camera=posed.camera,
            site_from_cam=Similarity(
                rotation=posed.site_from_cam.rotation, translation=posed.site_from_cam.translation + offset
            ),
        )
        for name, posed in CAMERAS.items()
    }
    places = [[x, 0.0, z] for x in (-4.0, -2.0, 0.0, 2.0, 4.0) for z in (1.5, 2.5, 3.5)]
    made = detections_of(*[(f"d{i}", "p1", "crack", box_at(CAMERAS["p1"], place)) for i, place in enumerate(places)])
    evidence = ExclusionEvidence(tie_points=triangulate_tie_points(tracks_of(WALL), moved))
    assert {row["observation_outcome"] for row in excluded(wall, made, evidence, moved).values()} == {"registered"}
    stated = ExclusionEvidence(
        tie_points=triangulate_tie_points(tracks_of(np.vstack([WALL, BOARD])), CAMERAS), placement_sigma_m=1.0
    )
    behind = detections_of(("behind", "p1", "crack", box_at(CAMERAS["p1"], [0.0, -BOARD_M, 2.0])))
    assert excluded(wall, behind, stated)["behind"]["observation_outcome"] == "registered"


@pytest.mark.parametrize(("own", "outcome"), [(4, "occluded"), (2, "registered")])
def test_tie_points_of_other_photographs_occlude_where_the_photograph_confirms_them(wall, detections_of, own, outcome):
    """In p1 only ``own`` points of the board were matched: with too few, it may have been there at another time."""
    cameras = {f"p{i}": look_at([x, -12.0, 2.0], [0.0, 0.0, 2.5]) for i, x in enumerate((-3.0, 0.0, 3.0, 5.0, -5.0))}
    tracks = tracks_of(np.vstack([WALL, BOARD]), cameras)
    of_board = tracks.point >= len(WALL)
    of_photo = np.flatnonzero((tracks.photo == 1) & of_board)
    inner = of_photo[np.abs(BOARD[tracks.point[of_photo] - len(WALL)] - [0, -BOARD_M, 2]).max(axis=1) < 0.6]
    kept = np.ones(len(tracks.point), dtype=bool)
    kept[np.setdiff1d(of_photo, np.random.default_rng(3).choice(inner, own, replace=False))] = False
    tracks = replace(tracks, photo=tracks.photo[kept], point=tracks.point[kept], xy_img=tracks.xy_img[kept])
    made = detections_of(("behind", "p1", "crack", box_at(cameras["p1"], [0.1, -BOARD_M, 2.1])))
    rows = excluded(wall, made, ExclusionEvidence(tie_points=triangulate_tie_points(tracks, cameras)), cameras)
    assert rows["behind"]["observation_outcome"] == outcome


def test_tie_points_behind_or_beside_the_camera_occlude_nothing(wall, detections_of):
    """A drone between a tree and the wall: the tree is behind it, however strong the lens's distortion."""
    camera = replace(CAMERAS["p1"].camera, k1=-0.3, k2=0.05)
    cameras = {name: replace(posed, camera=camera) for name, posed in CAMERAS.items()}
    cameras["near"] = replace(look_at([0.0, -5.0, 2.0], [0.0, 0.0, 2.0]), camera=camera)
    tree = grid(np.arange(-1, 1.01, 0.25), -7.0, np.arange(1, 3.01, 0.25))
    beside = grid(np.arange(6, 9.01, 0.25), -2.0, np.arange(1, 3.01, 0.25))
    tracks = tracks_of(np.vstack([tree, beside]), {name: cameras[name] for name in ("p0", "p1", "p2")})
    photo, point = np.append(tracks.photo, [3] * 3), np.append(tracks.point, [len(tree) + 1] * 3)
    tracks = replace(
        tracks,
        photo_ids=[*tracks.photo_ids, "near"],
        photo=photo,
        point=point,
        xy_img=np.vstack([tracks.xy_img, cameras["near"].project_site(beside[1:2]).repeat(3, axis=0)]),
    )
    places = [[x, 0.0, z] for x in (-1.0, 0.0, 1.0) for z in (1.5, 2.0, 2.5)]
    made = detections_of(*[(f"d{i}", "near", "crack", box_at(cameras["near"], p)) for i, p in enumerate(places)])
    rows = excluded(wall, made, ExclusionEvidence(tie_points=triangulate_tie_points(tracks, cameras)), cameras)
    assert {row["observation_outcome"] for row in rows.values()} == {"registered"}


def test_sparse_tie_points_occlude_nothing(wall, detections_of):
    corners = grid([-1, 1], -BOARD_M, [1, 3])  # 2 m apart: the wall may be visible between them
    made = detections_of(("between", "p1", "crack", box_at(CAMERAS["p1"], [0.0, -BOARD_M, 2.0])))
    evidence = ExclusionEvidence(tie_points=triangulate_tie_points(tracks_of(np.vstack([WALL, corners])), CAMERAS))
    assert excluded(wall, made, evidence)["between"]["observation_outcome"] == "registered"


def test_black_in_the_mask_overrides_other_outcomes(wall, detections_of, tmp_path):
    mask = np.full((1500, 2000), 255, dtype=np.uint8)
    mask[:, :1000] = 0
    cv2.imwrite(str(tmp_path / "p1_mask.png"), mask)
    made = detections_of(
        ("black", "p1", "crack", (900, 700, 40, 40)),
        ("white", "p1", "crack", (1100, 700, 40, 40)),
        ("mostly white", "p1", "crack", (980, 700, 60, 40)),
        ("sky", "p1", "crack", (500, 10, 20, 20)),
        ("elsewhere", "nowhere", "crack", (500, 10, 20, 20)),
    )
    rows = excluded(wall, made, ExclusionEvidence(masks={"p1": tmp_path / "p1_mask.png"}))
    assert {name: row["observation_outcome"] for name, row in rows.items()} == {
        "black": "masked", "white": "registered", "mostly white": "registered", "sky": "masked",
        "elsewhere": "unlocalised",
    }  # fmt: skip
    assert rows["black"]["reason"] == "100% of the box is black in the mask p1_mask.png; the limit is 50%"


def test_masks_are_counted_by_pixels_and_checked_for_size(tmp_path):
    camera = CAMERAS["p0"].camera
    mask = np.full((1500, 2000), 255, dtype=np.uint8)
    mask[100:110, 200:230] = 0
    cv2.imwrite(str(tmp_path / "a.png"), mask)
    boxes = np.array([[200, 100, 60, 10], [205.5, 100, 10, 20], [-50, -50, 20, 20]], dtype=float)
    np.testing.assert_allclose(
        compute_masked_shares(tmp_path / "a.png", camera, boxes), [0.5, 0.5, 0], rtol=0, atol=1e-9
    )
    cv2.imwrite(str(tmp_path / "small.png"), mask[:100])
    with pytest.raises(InputDataError, match="2000x100 pixels, its photograph 2000x1500"):
        compute_masked_shares(tmp_path / "small.png", camera, boxes)
    with pytest.raises(InputDataError, match="cannot be decoded"):
        compute_masked_shares(tmp_path / "none.png", camera, boxes)


def test_a_mask_of_the_wrong_size_is_logged_and_not_used(wall, detections_of, tmp_path, caplog):
    cv2.imwrite(str(tmp_path / "m.png"), np.zeros((10, 10), dtype=np.uint8))
    made = detections_of(("a", "p1", "crack", (900, 700, 40, 40)))
    with caplog.at_level("WARNING"):
        rows = excluded(wall, made, ExclusionEvidence(masks={"p1": tmp_path / "m.png"}))
    assert rows["a"]["observation_outcome"] == "registered"
    assert "10x10" in caplog.text and "not used" in caplog.text


def test_on_a_bench_it_is_off_target(wall, detections_of):
    kinds = ("IfcFurniture", "IfcWall")
    rows = [{**row, "ifc_class": kind} for row, kind in zip(wall.elements.to_pylist(), kinds, strict=True)]
    made = detections_of(*[(name, "p1", "crack", (900, 700, 40, 40)) for name in ("low", "high")])
    found = excluded(replace(wall, elements=table_from_rows("elements", rows)), made, ExclusionEvidence())
    assert {name: row["observation_outcome"] for name, row in found.items()} == {
        "low": "off_target", "high": "registered",
    }  # fmt: skip
    assert found["low"]["reason"] == "it lies on IfcFurniture 'low wall', which is not part of the building"


def test_settings_out_of_range_are_refused():
    with pytest.raises(InputDataError, match="masked_share_min"):
        ExclusionSettings(masked_share_min=0.0)
    with pytest.raises(InputDataError, match="out of range"):
        OcclusionSettings(gap_min_m=-1.0)
