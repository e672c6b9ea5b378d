"""Georeference of a synthetic block: a box building, cameras around it, noise injected, two-sided bounds."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pyarrow as pa
import pytest
from scipy.spatial.transform import Rotation

from facadelake.core.camera import Camera
from facadelake.core.errors import GeoreferenceError
from facadelake.core.frames import Similarity
from facadelake.core.geodesy import SiteOrigin
from facadelake.core.tables import table_from_rows
from facadelake.georeferencing.available_control import Control
from facadelake.georeferencing.gcp.control_points import ImageMark, SurveyedPoint, SurveyedPoints
from facadelake.georeferencing.georeference import georeference_reconstruction
from facadelake.georeferencing.georeferenced_campaign import GeoreferencedCampaign
from facadelake.georeferencing.model.control import ModelControl
from facadelake.georeferencing.poses_table import build_poses_table
from facadelake.georeferencing.site_frame import SiteFrame
from facadelake.sfm.reconstruction import LocalisedPhoto, Reconstruction, UnlocalisedPhoto
from schemas.vocabulary import ControlKind
from tests.unit.georeferencing.small_block import BoxSurface, rotation_from_target

ORIGIN = SiteOrigin(lon_deg=8.4, lat_deg=48.9, height_ellipsoidal_m=180.0)
CAMERA = Camera(width_px=4000, height_px=3000, fx_px=2900, fy_px=2900, cx_px=2010, cy_px=1490, k1=-0.02)
SITE_FROM_SFM = Similarity(
    rotation=Rotation.from_euler("xyz", [100, -35, 60], degrees=True).as_matrix(),
    translation=np.array([4.0, -2.0, 7.0]),
    scale=5.1,
)
HALF = np.array([10.0, 6.0, 7.0])  # the building: a box of 20 x 12 x 14 m around (0, 0, 7)
BIAS = np.array([1.3, -0.8, 2.1])
NOISE = np.array([0.4, 0.4, 0.7])


def build_ring(count: int = 24) -> list[tuple[np.ndarray, np.ndarray]]:
    """Cameras around the building, at three heights."""
    out = []
    for k in range(count):
        angle = 2 * np.pi * k / count
        centre = np.array([26 * np.cos(angle), 22 * np.sin(angle), (3.0, 7.0, 11.0)[k % 3]])
        out.append((centre, rotation_from_target(np.array([0, 0, 6.0]), centre)))
    return out


def build_line(count: int = 16) -> list[tuple[np.ndarray, np.ndarray]]:
    """Cameras along one facade, all at one height, square-on."""
    centres = [np.array([x, -20.0, 6.0]) for x in np.linspace(-12, 12, count)]
    return [(centre, rotation_from_target(centre + np.array([0, 1.0, 0]), centre)) for centre in centres]


BOX = BoxSurface(half_m=(10.0, 6.0), height_m=14.0, ground=False)
BOX_ON_GROUND = BoxSurface(half_m=(10.0, 6.0), height_m=14.0)


def build_model(*, ground: bool = False) -> ModelControl:
    """The box as control, without photographs to look for its edges in; the building stands off it by centimetres."""
    return ModelControl(surface=BOX_ON_GROUND if ground else BOX, sigma_m=0.03, ground_site_m=0.0, highest_site_m=14.0)


@dataclass(frozen=True)
class Scene:
    """A block of known truth; everything random comes from ``seed``."""

    poses: Sequence[tuple[np.ndarray, np.ndarray]]
    seed: int = 1
    bias: np.ndarray = field(default_factory=lambda: BIAS)
    ground: bool = False
    attitude: bool = True
    tie_px: float = 0.5

    @property
    def surface(self) -> BoxSurface:
        """What hides what."""
        return BOX_ON_GROUND if self.ground else BOX

    def list_ids(self) -> list[str]:
        return [f"p{k:02}.jpg" for k in range(len(self.poses))]

    def draw_points(self) -> np.ndarray:
        """Points on the four walls, and on the ground."""
        rng = np.random.default_rng(self.seed)
        uv = rng.uniform(-1, 1, (480, 2))
        side = rng.integers(0, 4, 480)
        across = np.where(side < 2, uv[:, 0] * HALF[0], np.sign(side - 2.5) * HALF[0])
        along = np.where(side < 2, np.sign(side - 0.5) * HALF[1], uv[:, 0] * HALF[1])
        walls = np.column_stack([across, along, 7 + 0.97 * uv[:, 1] * HALF[2]])
        if not self.ground:
            return walls
        flat = rng.uniform(-20, 20, (220, 2))
        outside = (np.abs(flat) > HALF[:2] + 0.5).any(axis=1)
        return np.vstack([walls, np.column_stack([flat[outside], np.zeros(outside.sum())])])

    def build_reconstruction(self) -> Reconstruction:
        """The block in sfm: tie points with 1 cm of noise, seen within ``tie_px`` where they face the camera."""
        rng = np.random.default_rng(self.seed + 1)
        xyz = self.draw_points()
        sfm_from_site = SITE_FROM_SFM.invert()
        photos, track_photo, track_point, track_xy = [], [], [], []
        for k, (centre, rotation) in enumerate(self.poses):
            hits = self.surface.cast(np.broadcast_to(centre, xyz.shape), xyz - centre)
            cam = Similarity(rotation=rotation, translation=centre).invert().apply(xyz)
            xy = CAMERA.project(cam)
            seen = (np.abs(hits.distance_m - 1) < 1e-6) & np.isfinite(xy[:, 0])
            seen[seen] = CAMERA.is_inside(xy[seen])
            track_photo.append(np.full(seen.sum(), k))
            track_point.append(np.flatnonzero(seen))
            track_xy.append(xy[seen] + rng.normal(0, self.tie_px, (seen.sum(), 2)))
            photos.append(
                LocalisedPhoto(
                    photo_id=self.list_ids()[k],
                    camera=CAMERA,
                    sfm_from_cam=Similarity(
                        rotation=sfm_from_site.rotation @ rotation, translation=sfm_from_site.apply(centre)
                    ),
                    reprojection_error_px=0.5,
                    tie_points=int(seen.sum()),
                )
            )
        return Reconstruction(
            photos=tuple(photos),
            unlocalised=(UnlocalisedPhoto(photo_id="lost.jpg", reason="too little overlap"),),
            xyz_sfm=sfm_from_site.apply(xyz + rng.normal(0, 0.01, xyz.shape)),
            rgb=np.zeros((len(xyz), 3), np.uint8),
            image_point_photo=np.concatenate(track_photo),
            image_point_tie_point=np.concatenate(track_point),
            image_point_xy_img=np.concatenate(track_xy),
            mean_reprojection_error_px=0.5,
            costs=(),
        )

    def build_photos(self, moved: dict[int, np.ndarray] | None = None) -> pa.Table:
        """Table `photos`: GPS with bias and noise, gimbal attitude with 2 deg of yaw error."""
        rng = np.random.default_rng(self.seed + 2)
        rows = []
        for k, (centre, rotation) in enumerate(self.poses):
            prior = centre + self.bias + rng.normal(0, NOISE) + (moved or {}).get(k, np.zeros(3))
            lon, lat, height = ORIGIN.geo_from_site(prior[None])[0]
            z = rotation[:, 2]
            rows.append(
                {
                    "photo_id": self.list_ids()[k], "sha256": str(k), "bytes": 1, "role": "multiview",
                    "photo_outcome": "accepted", "image_width_px": 4000, "image_height_px": 3000,
                    "prior_source": "xmp", "prior_lon_deg": lon, "prior_lat_deg": lat, "prior_height_m": height,
                    "prior_height_datum": "unknown", "prior_sigma_horizontal_m": 3.0, "prior_sigma_vertical_m": 5.0,
                }
                | (
                    {
                        "prior_yaw_deg": float(np.degrees(np.arctan2(z[0], z[1]))) + 2.0,
                        "prior_pitch_deg": float(np.degrees(np.arcsin(z[2]))),
                        "prior_roll_deg": 0.0,
                    }
                    if self.attitude
                    else {}
                )
            )  # fmt: skip
        lost = {"photo_id": "lost.jpg", "sha256": "x", "bytes": 1, "role": "multiview", "photo_outcome": "accepted",
                "image_width_px": 4000, "image_height_px": 3000, "prior_source": "none",
                "prior_height_datum": "unknown"}  # fmt: skip
        return table_from_rows("photos", [*rows, lost])

    def build_control(self, count: int = 6, survey_m: float = 0.01, mark_px: float = 0.5) -> SurveyedPoints:
        """Control points on the walls, marked in up to five photographs each."""
        rng = np.random.default_rng(self.seed + 3)
        xyz = self.draw_points()[::80][:count]
        points = []
        for k, at in enumerate(xyz):
            marks = []
            for photo_id, (centre, rotation) in zip(self.list_ids(), self.poses, strict=True):
                hit = self.surface.cast(centre[None], (at - centre)[None])
                xy = CAMERA.project(Similarity(rotation=rotation, translation=centre).invert().apply(at[None]))
                if abs(hit.distance_m[0] - 1) < 1e-6 and CAMERA.is_inside(xy)[0]:
                    marked = xy[0] + rng.normal(0, mark_px, 2)
                    marks.append(ImageMark(photo_name=photo_id, x_px=marked[0], y_px=marked[1]))
            east, north, height = ORIGIN.map_from_site((at + rng.normal(0, survey_m, 3))[None], "EPSG:25832")[0]
            points.append(SurveyedPoint(name=f"G{k + 1}", x=east, y=north, z=height, marks=tuple(marks[:5])))
        return SurveyedPoints(source="gcp_list.txt", crs="EPSG:25832", points=tuple(points))

    def georeference(self, control: ControlKind | None, **given: object) -> GeoreferencedCampaign:
        """Georeference the block."""
        return georeference_reconstruction(
            self.build_reconstruction(),
            given.get("photos", self.build_photos()),  # type: ignore[arg-type]
            site_frame=SiteFrame(
                origin=ORIGIN, map_crs="EPSG:25832", vertical_datum="ellipsoidal", georeference_level="50"
            ),
            control=Control(
                kind=control,
                points=given.get("control_points"),  # type: ignore[arg-type]
                check_points=given.get("check_points"),  # type: ignore[arg-type]
                model=given.get("model"),  # type: ignore[arg-type]
                placement_sigma_max_m=given.get("limit_m", 0.5),  # type: ignore[arg-type]
                accepted=given.get("accepted", ()),  # type: ignore[arg-type]
            ),
        )

    def compute_error_m(self, found: GeoreferencedCampaign) -> np.ndarray:
        """Camera centres minus truth (n, 3)."""
        truth = np.array([centre for centre, _ in self.poses])
        return np.array([found.cameras[photo_id].centre_site_m for photo_id in self.list_ids()]) - truth


def test_gps_leaves_its_common_bias_and_averages_its_noise() -> None:
    scene = Scene(build_ring())
    found = scene.georeference(ControlKind.GPS)
    offset = scene.compute_error_m(found).mean(axis=0)
    # 24 photographs: noise of the mean 0.08, 0.08, 0.14 m; four sigma
    np.testing.assert_allclose(offset, BIAS, rtol=0, atol=0.6)  # m
    assert 0.005 < np.abs(offset - BIAS).max() < 0.6  # m, the noise is in there
    assert 0.5 < found.row["residual_rmse_m"] < 1.2  # m, sqrt(0.4^2 + 0.4^2 + 0.7^2) = 0.9
    assert abs(found.row["scale"] / 5.1 - 1) < 0.02
    assert found.row["points_used"] == found.row["points_total"] == 24
    sigma_m = [found.row[f"sigma_{axis}_m"] for axis in ("east", "north", "up")]
    # the priors' own sigmas, 3 and 5 m with a datum that nobody names: what is common to them stays
    np.testing.assert_allclose(sigma_m, [3.0, 3.0, 50.2], rtol=0, atol=0.2)  # m
    assert "have no stated datum" in found.row["remarks"]
    assert "common to all GPS positions" in found.row["remarks"]


def test_a_gross_gps_error_is_left_out_and_named() -> None:
    scene = Scene(build_ring(), bias=np.zeros(3))
    found = scene.georeference(
        ControlKind.GPS, photos=scene.build_photos({7: np.array([60.0, 0, 0]), 9: np.array([0, 0, -90.0])})
    )
    assert found.row["points_used"] == 22
    assert "gross errors: p07.jpg, p09.jpg" in found.row["remarks"]
    assert 0.02 < np.linalg.norm(scene.compute_error_m(found), axis=1).mean() < 0.7  # m


def test_control_points_place_the_block_to_a_centimetre() -> None:
    scene = Scene(build_ring())
    found = scene.georeference(None, control_points=scene.build_control())
    assert found.control is ControlKind.GCP
    error = np.linalg.norm(scene.compute_error_m(found), axis=1)
    assert 0.001 < error.mean() < 0.04  # m; 1 cm of survey noise on 6 points
    assert 0.003 < found.row["residual_rmse_m"] < 0.03  # m
    offset = [found.row[f"gps_offset_{axis}_m"] for axis in ("east", "north", "up")]
    np.testing.assert_allclose(offset, BIAS, rtol=0, atol=0.6)  # m
    assert 0.002 < max(found.row[f"sigma_{axis}_m"] for axis in ("east", "north", "up")) < 0.03  # m
    assert found.build_table().num_rows == 1
    kinds = found.build_points_table(ORIGIN).column("point_kind").to_pylist()
    assert [kinds.count(kind) for kind in ("control", "held_out", "gps")] == [6, 6, 24]
    assert 0.003 < found.row["check_residual_mean_m"] < 0.06  # m


def test_a_blunder_among_control_points_is_left_out_and_named() -> None:
    scene = Scene(build_ring())
    good = scene.build_control()
    wrong = good.points[2]
    moved = SurveyedPoint(name=wrong.name, x=wrong.x + 2.0, y=wrong.y, z=wrong.z, marks=wrong.marks)
    points = (*good.points[:2], moved, *good.points[3:])
    found = scene.georeference(ControlKind.GCP, control_points=SurveyedPoints(source="g", crs=good.crs, points=points))
    assert (found.row["points_used"], found.row["points_total"]) == (5, 6)
    assert "gross errors: G3" in found.row["remarks"]
    assert 0.001 < np.linalg.norm(scene.compute_error_m(found), axis=1).mean() < 0.06  # m


def test_check_points_tell_and_hold_nothing() -> None:
    scene = Scene(build_ring())
    every = scene.build_control()
    off = replace(every.points[5], z=every.points[5].z + 0.3)
    found = scene.georeference(
        ControlKind.GCP,
        control_points=replace(every, points=every.points[:4]),
        check_points=replace(every, points=(every.points[4], off)),
    )
    rows = {
        row["point_name"]: row for row in found.build_points_table(ORIGIN).to_pylist() if row["point_kind"] == "check"
    }
    assert sorted(rows) == ["G5", "G6"]
    left = {name: [row[f"residual_{axis}_m"] for axis in ("east", "north", "up")] for name, row in rows.items()}
    assert 0.002 < np.linalg.norm(left["G5"]) < 0.08  # m; 1 cm of survey an axis, here and at four control points
    np.testing.assert_allclose(left["G6"], [0, 0, 0.3], rtol=0, atol=0.08)  # m
    assert not any(row["point_used"] for row in rows.values())
    error = np.linalg.norm(scene.compute_error_m(found), axis=1)
    assert 0.001 < error.mean() < 0.08  # m


def test_control_points_of_another_block_are_refused() -> None:
    """Marks and coordinates that belong together by name alone: neither a majority nor GPS supports them."""
    scene = Scene(build_ring())
    good = scene.build_control()
    swapped = tuple(
        SurveyedPoint(name=p.name, x=q.x, y=q.y, z=q.z, marks=p.marks)
        for p, q in zip(good.points, [good.points[k] for k in (3, 5, 0, 1, 2, 4)], strict=True)
    )
    with pytest.raises(GeoreferenceError, match=r"agree with one another|agree on one placement|against its GPS"):
        scene.georeference(ControlKind.GCP, control_points=SurveyedPoints(source="g", crs=good.crs, points=swapped))


def test_too_few_control_points() -> None:
    scene = Scene(build_ring(12))
    two = scene.build_control(count=2)
    found = scene.georeference(None, control_points=two, limit_m=60.0)
    assert found.control is ControlKind.GPS
    with pytest.raises(GeoreferenceError, match=r"by gps, .* known to 50\.\d+ m up .* limit is 0\.5 m"):
        scene.georeference(None, control_points=two)
    assert "2 of 2 control points of gcp_list.txt can be used (3 are needed)" in found.row["remarks"]
    with pytest.raises(GeoreferenceError, match=r"2 of 2 control points .* 3 are needed"):
        scene.georeference(ControlKind.GCP, control_points=two)
    with pytest.raises(GeoreferenceError, match="none are given"):
        scene.georeference(ControlKind.GCP)


def test_walls_alone_fix_the_plan_and_leave_the_height_to_gps() -> None:
    scene = Scene(build_ring(16))
    found = scene.georeference(ControlKind.MODEL, model=build_model(), limit_m=60.0)
    offset = scene.compute_error_m(found).mean(axis=0)
    assert 1e-5 < np.linalg.norm(offset[:2]) < 0.03  # m; 1.5 m before
    assert 1.3 < offset[2] < 2.9  # m: the bias of 2.1 m is still there
    # Two opposite walls of 3 cm each; heights without a stated datum may be off by the geoid.
    np.testing.assert_allclose(found.row["sigma_east_m"], 0.021, rtol=0, atol=0.01)  # m
    np.testing.assert_allclose(found.row["sigma_up_m"], 50.0, rtol=0, atol=1.0)  # m
    assert "by GPS alone: height" in found.row["remarks"]
    assert abs(found.row["scale"] / 5.1 - 1) < 2e-3
    assert 0.003 < found.row["residual_rmse_m"] < 0.03  # m


def test_walls_and_ground_fix_the_height_too() -> None:
    scene = Scene(build_ring(16), ground=True)
    found = scene.georeference(ControlKind.MODEL, model=build_model(ground=True))
    assert 1e-5 < np.linalg.norm(scene.compute_error_m(found).mean(axis=0)) < 0.05  # m
    assert "not determined by the model" not in found.row["remarks"]
    assert found.row["gps_offset_up_m"] == pytest.approx(2.1, abs=0.7)  # m


def test_a_model_of_another_place_is_refused() -> None:
    scene = Scene(build_ring(), bias=np.array([300.0, 0, 0]))
    with pytest.raises(GeoreferenceError, match=r"tie points lie within 4.0 m of the model's visible surface"):
        scene.georeference(ControlKind.MODEL, model=build_model())
    with pytest.raises(GeoreferenceError, match="has no model surface"):
        scene.georeference(ControlKind.MODEL)


def test_cameras_on_a_line_need_attitudes() -> None:
    scene = Scene(build_line(), bias=np.zeros(3))
    found = scene.georeference(ControlKind.GPS)
    assert "nearly collinear" in found.row["remarks"]
    turned = [
        np.degrees(np.linalg.norm(Rotation.from_matrix(found.cameras[i].site_from_cam.rotation @ truth.T).as_rotvec()))
        for i, (_, truth) in zip(scene.list_ids(), scene.poses, strict=True)
    ]
    assert 0.05 < np.mean(turned) < 3.5  # deg; yaw was off by 2
    with pytest.raises(GeoreferenceError, match="have no gimbal attitude"):
        Scene(build_line(), attitude=False).georeference(ControlKind.GPS)


def test_without_gps_the_message_says_what_to_give() -> None:
    scene = Scene(build_ring())
    photos = scene.build_photos()
    column = pa.array(["none"] * len(photos))
    bare = photos.set_column(photos.schema.get_field_index("prior_source"), photos.schema.field("prior_source"), column)
    with pytest.raises(GeoreferenceError, match=r"0 localised photographs have a GPS position .* control points"):
        scene.georeference(ControlKind.GPS, photos=bare)


def test_poses_table_says_the_same_as_the_cameras() -> None:
    scene = Scene(build_ring(9))
    photos = scene.build_photos()
    found = scene.georeference(ControlKind.GPS, photos=photos)
    rows = {
        row["photo_id"]: row
        for row in build_poses_table(found, scene.build_reconstruction(), photos, origin=ORIGIN).to_pylist()
    }
    assert (rows["lost.jpg"]["pose_source"], rows["lost.jpg"]["reason"]) == ("unlocalised", "too little overlap")
    row, posed = rows["p05.jpg"], found.cameras["p05.jpg"]
    w, x, y, z = (row[name] for name in ("qw", "qx", "qy", "qz"))
    by_hand = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    np.testing.assert_allclose(by_hand, posed.site_from_cam.rotation, rtol=0, atol=1e-9)
    np.testing.assert_allclose(
        ORIGIN.site_from_geo(np.array([[row["lon_deg"], row["lat_deg"], row["height_ellipsoidal_m"]]]))[0],
        [row["x_site_m"], row["y_site_m"], row["z_site_m"]], rtol=0, atol=1e-5,
    )  # fmt: skip
