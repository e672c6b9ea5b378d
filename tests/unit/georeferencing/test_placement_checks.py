"""Placement checks: displaced blocks are contradicted, by the displacement; right ones are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pyarrow as pa
import pytest
import trimesh

from facadelake.building import BuildingModel
from facadelake.core.camera import Camera, PosedCamera
from facadelake.core.errors import GeoreferenceError
from facadelake.core.frames import Similarity
from facadelake.core.geodesy import SiteOrigin
from facadelake.georeferencing.model.control import build_model_control
from facadelake.georeferencing.model_checks import check_cameras, check_tie_points, search_model_shift
from facadelake.georeferencing.placement_checks import (
    PlacementCheck,
    build_checks_table,
    check_gps,
    check_surveyed_points,
    require_agreement,
)
from facadelake.georeferencing.probable_causes import suggest_causes
from schemas.vocabulary import ControlKind, PlacementCheckOutcome, PlacementStatement
from tests.unit.georeferencing.small_block import BoxSurface, rotation_from_target

BOX = BoxSurface(half_m=(10.0, 6.0), height_m=14.0, ground=False)
CAMERA = Camera(width_px=400, height_px=300, fx_px=290, fy_px=290, cx_px=200, cy_px=150)
AGREES, DISAGREES = PlacementCheckOutcome.AGREES, PlacementCheckOutcome.DISAGREES
SIGMA = np.array([0.01, 0.01, 0.01])
NO_SHIFT = np.zeros(3)


def build_cameras(shift: np.ndarray) -> list[PosedCamera]:
    cameras = []
    for angle in np.linspace(0, 2 * np.pi, 24, endpoint=False):
        centre = np.array([26 * np.cos(angle), 22 * np.sin(angle), 7.0])
        rotation = rotation_from_target(np.array([0, 0, 6.0]), centre)
        pose = Similarity(rotation=rotation, translation=centre + shift)
        cameras.append(PosedCamera(camera=CAMERA, site_from_cam=pose))
    return cameras


def draw_tie_points(shift: np.ndarray, count: int = 600) -> tuple[np.ndarray, np.ndarray]:
    """Points on the walls of the box with the centres of cameras before them, both displaced."""
    random = np.random.default_rng(3)
    u, v, side = random.uniform(-1, 1, count), random.uniform(0.2, 13.8, count), random.integers(0, 4, count)
    sign = np.where(side % 2 == 0, 1.0, -1.0)
    x = np.where(side < 2, u * 9.8, sign * 10.0)
    y = np.where(side < 2, sign * 6.0, u * 5.8)
    outward = np.column_stack([np.where(side < 2, 0.0, sign), np.where(side < 2, sign, 0.0), np.zeros(count)])
    xyz = np.column_stack([x, y, v])
    origin = xyz + 15 * outward + random.uniform(-2, 2, (count, 3))
    return xyz + shift, origin + shift


@pytest.mark.parametrize(
    "shift", [(0, 0, -48), (0, 0, 1101 - 1003), (2, 0, 0), (0, 3, 0), (0, 0, -6), (6, -4, 30)], ids=str
)
def test_a_displaced_block_is_contradicted_by_its_tie_points_and_the_shift_back_is_told(
    shift: tuple[float, ...],
) -> None:
    displaced = np.array(shift, dtype=float)
    xyz, origin = draw_tie_points(displaced)
    check = check_tie_points(xyz, origin, BOX, gps_shift_site_m=NO_SHIFT, sigma_m=SIGMA)
    assert check.outcome is DISAGREES
    assert check.shift_site_m is not None
    assert np.abs(check.shift_site_m + displaced).max() <= 0.5


@pytest.mark.parametrize("shift", [(0, 0, 0), (0.2, 0.1, 0.0), (0, -0.3, 0.2)], ids=str)
def test_a_block_on_the_model_agrees(shift: tuple[float, ...]) -> None:
    xyz, origin = draw_tie_points(np.array(shift, dtype=float))
    check = check_tie_points(xyz, origin, BOX, gps_shift_site_m=NO_SHIFT, sigma_m=SIGMA)
    assert check.outcome is AGREES


def test_a_displacement_within_the_sigma_of_the_campaign_agrees() -> None:
    xyz, origin = draw_tie_points(np.array([3.0, 0, 0]))
    gps = np.array([3.0, 3.0, 5.0])
    assert check_tie_points(xyz, origin, BOX, gps_shift_site_m=NO_SHIFT, sigma_m=gps).outcome is AGREES
    assert check_tie_points(xyz, origin, BOX, gps_shift_site_m=NO_SHIFT, sigma_m=SIGMA).outcome is DISAGREES


def test_the_search_finds_nothing_where_the_model_is_far() -> None:
    xyz, origin = draw_tie_points(np.array([400.0, 0, 0]))
    found = search_model_shift(xyz, origin, BOX, NO_SHIFT)
    assert (found.matched, found.matched_shifted) == (0, 0)
    assert check_tie_points(xyz, origin, BOX, gps_shift_site_m=NO_SHIFT, sigma_m=SIGMA).outcome is DISAGREES
    near_gps = search_model_shift(xyz, origin, BOX, np.array([-401.0, 1.0, 2.0]))
    assert np.abs(near_gps.shift_site_m - [-400, 0, 0]).max() <= 0.5


def test_too_few_tie_points_are_not_comparable() -> None:
    xyz, origin = draw_tie_points(NO_SHIFT, 20)
    check = check_tie_points(xyz, origin, BOX, gps_shift_site_m=NO_SHIFT, sigma_m=SIGMA)
    assert check.outcome is PlacementCheckOutcome.NOT_COMPARABLE


def outcomes(cameras: list[PosedCamera]) -> list[PlacementCheckOutcome]:
    return [check.outcome for check in check_cameras(cameras, BOX, 0.0, 14.0)]


def test_cameras_below_the_ground_far_above_or_looking_away_are_contradicted_by_the_model() -> None:
    assert outcomes(build_cameras(NO_SHIFT)) == [AGREES, AGREES]
    assert outcomes(build_cameras(np.array([0, 0, -48.0]))) == [DISAGREES, DISAGREES]
    assert outcomes(build_cameras(np.array([0, 0, 1101.0])))[0] is DISAGREES
    assert outcomes(build_cameras(np.array([250.0, 0, 0])))[1] is DISAGREES


def test_gps_is_compared_in_proportion_to_its_sigma_and_by_flight() -> None:
    count = 10
    flight = np.repeat([0, 1], count)
    sigma = np.repeat([[3.0, 3.0, 5.0], [0.02, 0.02, 0.04]], count, axis=0)
    residual = np.repeat([[4.0, 3.0, 6.0], [0.0, 0.0, 0.0]], count, axis=0)
    assert [check.outcome for check in check_gps(residual, sigma, flight, SIGMA, datum_unknown=False)] == [
        AGREES,
        AGREES,
    ]
    residual[flight == 1] = [0.3, 0.0, 0.0]  # no RTK fix is 30 cm off
    position, height = check_gps(residual, sigma, flight, SIGMA, datum_unknown=False)
    assert (position.outcome, height.outcome) == (DISAGREES, AGREES)
    assert position.deviation == pytest.approx(0.3)
    assert position.limit == pytest.approx(3.5 * np.hypot(0.02, 0.01))
    assert "flight 2" in position.detail
    position, _ = check_gps(residual, sigma, flight, SIGMA, 1.0, datum_unknown=False)  # WGS 84 taken as ETRS89
    assert position.outcome is AGREES
    residual[flight == 1] = [1.2, 0.0, 0.0]
    position, _ = check_gps(residual, sigma, flight, SIGMA, 1.0, datum_unknown=False)
    assert position.outcome is DISAGREES
    assert "of which 1 m for datums that are taken as one" in position.detail


def test_without_gps_nothing_is_compared() -> None:
    checks = check_gps(np.zeros((2, 3)), np.ones((2, 3)), np.zeros(2, dtype=np.int64), SIGMA, datum_unknown=False)
    assert {check.outcome for check in checks} == {PlacementCheckOutcome.NOT_COMPARABLE}


@pytest.mark.parametrize(
    ("up_m", "outcome"),
    [(10.0, AGREES), (48.0, PlacementCheckOutcome.NOT_COMPARABLE), (-130.3, DISAGREES)],
)
def test_heights_of_unknown_datum_decide_beyond_every_geoid_height_only(
    up_m: float, outcome: PlacementCheckOutcome
) -> None:
    residual, sigma = np.tile([0.5, 0.5, up_m], (12, 1)), np.tile([3.0, 3.0, 5.0], (12, 1))
    _, height = check_gps(residual, sigma, np.zeros(12, dtype=np.int64), SIGMA, datum_unknown=True)
    assert height.outcome is outcome
    assert "a geoid height of up to 106 m" in height.detail
    known = check_gps(residual, sigma, np.zeros(12, dtype=np.int64), SIGMA, datum_unknown=False)[1]
    assert known.outcome is (AGREES if abs(up_m) < 17.5 else DISAGREES)
    if outcome is PlacementCheckOutcome.NOT_COMPARABLE:
        assert require(height) == (f"undecided: {height.detail}",)


@pytest.mark.parametrize("statement", [PlacementStatement.HELD_OUT_POINTS, PlacementStatement.SURVEYED_POINTS])
def test_surveyed_points_are_compared_with_both_sigmas(statement: PlacementStatement) -> None:
    assert check_surveyed_points(statement, np.array([0.02, 0.03]), SIGMA, 0.01).outcome is AGREES
    assert check_surveyed_points(statement, np.array([0.2, 0.3]), SIGMA, 0.01).outcome is DISAGREES
    none = check_surveyed_points(statement, np.zeros(0), SIGMA, 0.01)
    assert none.outcome is PlacementCheckOutcome.NOT_COMPARABLE


def require(*checks: PlacementCheck, control: ControlKind = ControlKind.GCP) -> tuple[str, ...]:
    return require_agreement(
        checks, control=control, method="control points", placement_sigma_max_m=0.5, height_ellipsoidal_m=470.0
    )


def state(statement: PlacementStatement, outcome: PlacementCheckOutcome, deviation: float = 0.0) -> PlacementCheck:
    shift = np.array([0, 0, deviation]) if deviation else None
    return PlacementCheck(
        statement=statement, outcome=outcome, detail=f"{statement} {outcome}", deviation=deviation, shift_site_m=shift
    )


def test_the_model_always_counts_and_gps_where_the_model_does_not_decide() -> None:
    on_model = replace(state(PlacementStatement.TIE_POINTS, AGREES), decides=True)
    along_walls = state(PlacementStatement.TIE_POINTS, AGREES)  # they would lie on the walls where GPS says, too
    gps = state(PlacementStatement.GPS_HEIGHT, DISAGREES, 48.0)
    with pytest.raises(GeoreferenceError, match="geoid"):
        require(gps)
    assert require(gps, on_model) == ("disagreement: gps_height disagrees",)
    with pytest.raises(GeoreferenceError, match="gps_height"):  # tie points placed on the model are no third witness
        require(gps, on_model, control=ControlKind.MODEL)
    with pytest.raises(GeoreferenceError, match=r"tie_points disagrees.*agrees with: gps_position"):
        require(state(PlacementStatement.TIE_POINTS, DISAGREES, 48.0), state(PlacementStatement.GPS_POSITION, AGREES))
    with pytest.raises(GeoreferenceError, match="gps_height"):
        require(gps, along_walls)
    with pytest.raises(GeoreferenceError, match="gps_height"):  # held out of one file: they share its datum
        require(gps, state(PlacementStatement.HELD_OUT_POINTS, AGREES))
    checked = replace(state(PlacementStatement.SURVEYED_POINTS, AGREES), decides=True)
    assert require(gps, checked, control=ControlKind.IMPORTED)
    with pytest.raises(GeoreferenceError, match="gps_height"):  # of the control points' survey: they share its datum
        require(gps, checked)
    with pytest.raises(GeoreferenceError, match="surveyed_points"):
        require(state(PlacementStatement.SURVEYED_POINTS, DISAGREES, 48.0), on_model)
    small = state(PlacementStatement.GPS_HEIGHT, DISAGREES, 0.3)  # within the accuracy that a campaign must have
    assert require(small) == ("disagreement: gps_height disagrees",)


def test_a_shift_of_the_tie_points_that_gps_or_check_points_exclude_is_reported_only() -> None:
    """A garden wall before the facade, a like house beside it: the tie points fit elsewhere, and GPS says no."""
    elsewhere = replace(state(PlacementStatement.TIE_POINTS, DISAGREES, 3.0), shift_site_m=np.array([0.0, 3.0, 0.0]))
    rtk = replace(state(PlacementStatement.GPS_POSITION, AGREES), shift_site_m=np.array([0.01, 0.02, 0.0]), limit=1.07)
    drone = replace(rtk, limit=10.5)
    checked = replace(state(PlacementStatement.SURVEYED_POINTS, AGREES), decides=True, limit=0.05)
    assert require(elsewhere, rtk) == ("disagreement: tie_points disagrees",)
    imported = {"control": ControlKind.IMPORTED}
    assert require(elsewhere, drone, checked, **imported) == ("disagreement: tie_points disagrees",)
    with pytest.raises(GeoreferenceError, match="tie_points"):  # of the control points' survey
        require(elsewhere, drone, checked)
    with pytest.raises(GeoreferenceError, match="tie_points"):
        require(elsewhere, drone)


def test_tie_points_decide_where_they_would_leave_the_model_only() -> None:
    xyz, origin = draw_tie_points(NO_SHIFT)
    across = check_tie_points(xyz, origin, BOX, gps_shift_site_m=np.array([4.0, 0, 0]), sigma_m=SIGMA)
    along = check_tie_points(xyz, origin, BOX, gps_shift_site_m=np.array([0, 0, 0.6]), sigma_m=SIGMA)
    assert (across.outcome, across.decides) == (AGREES, True)
    assert (along.outcome, along.decides) == (AGREES, False)


def build_site_with_terrain(terrain_m: float) -> BuildingModel:
    """The box as a wall of an IFC, on a terrain model at a height."""
    box = trimesh.creation.box(bounds=[[-10, -6, 0], [10, 6, 14]])
    plate = trimesh.creation.box(bounds=[[-60, -60, terrain_m - 1], [60, 60, terrain_m]])
    return BuildingModel(
        origin=SiteOrigin(lon_deg=8.4, lat_deg=48.9, height_ellipsoidal_m=180.0),
        map_crs="EPSG:25832",
        vertical_datum="ellipsoidal",
        georeference_level="50",
        remarks="",
        vertices_site_m=np.vstack([box.vertices, plate.vertices]),
        triangles=np.vstack([box.faces, plate.faces + len(box.vertices)]).astype(np.int64),
        element_of_triangle=np.repeat([0, 1], [len(box.faces), len(plate.faces)]),
        elements=pa.table({"ifc_class": ["IfcWall", "IfcGeographicElement"]}),
    )


def test_a_coarse_terrain_model_is_no_evidence_about_the_building() -> None:
    """Photographs from above show more ground than walls; once the terrain, 1.5 m too low, refused the campaign."""
    model = build_model_control(build_site_with_terrain(-1.5), [], 0.03)
    walls, eyes = draw_tie_points(NO_SHIFT, 300)
    random = np.random.default_rng(2)
    ground = np.column_stack([random.uniform(-25, 25, (900, 2)), random.normal(0, 0.02, 900)])
    ground = ground[(np.abs(ground[:, :2]) > [11, 7]).any(axis=1)]
    xyz = np.vstack([walls, ground])
    origin = np.vstack([eyes, ground * [1.3, 1.3, 0] + [0, 0, 30.0]])
    assert model.building_surface is not None
    for moved_m, outcome in ((0.0, AGREES), (48.0, DISAGREES)):
        moved = np.array([0.0, 0.0, moved_m])
        found = check_tie_points(
            xyz + moved, origin + moved, model.building_surface, gps_shift_site_m=-moved, sigma_m=SIGMA
        )
        assert found.outcome is outcome
    with_terrain = check_tie_points(xyz, origin, model.surface, gps_shift_site_m=NO_SHIFT, sigma_m=SIGMA)
    assert with_terrain.outcome is DISAGREES


@pytest.mark.parametrize(("moved_m", "outcome"), [((0, 0, 0), AGREES), ((0, 0, 48), DISAGREES), ((0, 5, 0), DISAGREES)])
def test_half_of_the_tie_points_on_a_neighbour_that_is_not_in_the_model(
    moved_m: tuple[float, ...], outcome: PlacementCheckOutcome
) -> None:
    xyz, origin = draw_tie_points(NO_SHIFT)
    scale, offset = np.array([0.8, 1.15, 0.9]), np.array([45.0, 6.0, -1.0])
    xyz[::2], origin[::2] = scale * xyz[::2] + offset, scale * origin[::2] + offset
    moved = np.array(moved_m, dtype=float)
    found = check_tie_points(xyz + moved, origin + moved, BOX, gps_shift_site_m=-moved, sigma_m=SIGMA)
    assert found.outcome is outcome


@pytest.mark.parametrize(
    ("shift", "height", "cause"),
    [
        ((0, 0, 48.0), 430.0, "geoid"),
        ((0, 0, 478 - 478 / 0.3048), 478 / 0.3048, "feet read as metres"),
        ((0, 0, 478 - 478 * 0.3048), 478 * 0.3048, "metres read as feet"),
        ((120, 90, 0), 400.0, "datum"),
        ((4000, -2500, 0), 400.0, "exchanged"),
        ((1, 1, 1), 400.0, "another place"),
    ],
)
def test_probable_causes(shift: tuple[float, ...], height: float, cause: str) -> None:
    assert cause in suggest_causes([np.array(shift, dtype=float)], height)


def test_the_table_has_a_row_for_each_statement() -> None:
    table = build_checks_table([*check_cameras(build_cameras(NO_SHIFT), BOX, 0.0, 14.0)])
    assert table.column("statement").to_pylist() == ["camera_height", "model_in_view"]
    assert table.column("deviation").to_pylist() == [0.0, 1.0]
    assert table.column("deviation_sigma").to_pylist() == [None, None]
