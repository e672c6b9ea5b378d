"""Table ``coverage`` of a wall whose visible parts, GSD and incidence follow from similar triangles."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest
import shapely

from facadelake.building.surface import Surface
from facadelake.core.camera import PosedCamera
from facadelake.core.tables import table_from_rows
from facadelake.coverage import CampaignPhotographs, DetectorReach, measure_coverage
from facadelake.measurement import TYPICAL_BLUR
from schemas.vocabulary import CoverageOutcome, SurfaceKind
from tests.unit.coverage.facade_scene import (
    CAMERA,
    FOCAL_PX,
    HEIGHT_M,
    WALL,
    WIDTH_M,
    look_north,
    make_box,
    make_building,
    make_model,
    write_photograph,
)

CELL_M = 0.25
REACH = DetectorReach(searched=frozenset({"a.png"}), crack_width_px=3.0, patch_px=20.0)


def measure(
    root: Path,
    posed: dict[str, PosedCamera],
    *,
    building=None,
    reach: DetectorReach = REACH,
    **others,
) -> pd.DataFrame:
    for name in posed:
        if not (root / name).exists():
            write_photograph(root / name)
    photographs = CampaignPhotographs(posed=posed, root=root, masks=others.pop("masks", {}))
    table = measure_coverage(
        building or make_building({"wall": WALL}), photographs, reach, grazing_above_deg=80.0, **others
    )
    return table.to_pandas()


def count_samples_inside(cells: pd.DataFrame, left: float, right: float, low: float, high: float) -> np.ndarray:
    """How many of the four sample points of each whole cell are strictly inside a rectangle of the wall."""
    total = np.zeros(len(cells), dtype=int)
    for du in (0.0625, 0.1875):
        for dv in (0.0625, 0.1875):
            u, v = cells.cell_column * CELL_M + du, cells.cell_row * CELL_M + dv
            total += ((u > left) & (u < right) & (v > low) & (v < high)).to_numpy()
    return total


def test_a_square_view_shows_what_similar_triangles_say(tmp_path: Path) -> None:
    cells = measure(tmp_path, {"a.png": look_north(4.0, 6.0, 2.0)})
    assert len(cells) == (WIDTH_M / CELL_M) * (HEIGHT_M / CELL_M)
    assert cells.area_m2.sum() == pytest.approx(WIDTH_M * HEIGHT_M, abs=1e-6)  # m2
    expected = count_samples_inside(cells, 1.0, 7.0, 0.2, 3.8) >= 2
    assert (cells.imaged_count.to_numpy() == expected).all()
    assert set(cells.coverage_outcome[~expected]) == {CoverageOutcome.NOT_IN_VIEW}
    seen = cells[expected]
    assert np.allclose(seen.gsd_mm, 1000 * 6.0 / FOCAL_PX, rtol=0, atol=1e-6)  # mm: square-on, everywhere alike
    beside = np.hypot(seen.cell_column * CELL_M + 0.125 - 4.0, seen.cell_row * CELL_M + 0.125 - 2.0)
    assert np.allclose(seen.incidence_deg, np.degrees(np.arctan2(beside, 6.0)), rtol=0, atol=1e-4)  # deg
    assert set(seen.best_photo_id) == {"a.png"}
    assert cells.hidden_share.isna().all()  # nothing tells what stands before the wall


def test_the_frame_is_that_of_the_facade(tmp_path: Path) -> None:
    """u to the right as seen from outside is east at a wall that faces south; the outline is on the globe there."""
    building = make_building({"wall": WALL})
    cells = measure(tmp_path, {"a.png": look_north(4.0, 6.0, 2.0)}, building=building)
    assert np.allclose(cells.u_min_m, cells.x_site_m - 0.125, rtol=0, atol=1e-6)  # m
    assert np.allclose(cells.v_max_m, cells.z_site_m + 0.125, rtol=0, atol=1e-6)  # m
    assert set(cells.facade) == {"S"}
    one = cells[(cells.cell_column == 8) & (cells.cell_row == 3)].iloc[0]
    corners = np.array(shapely.from_wkb(one.geometry).exterior.coords)[:4]
    site = building.origin.site_from_geo(corners)
    wanted = [(2.0, 0.0, 0.75), (2.25, 0.0, 0.75), (2.25, 0.0, 1.0), (2.0, 0.0, 1.0)]
    assert np.allclose(site, wanted, rtol=0, atol=1e-5)  # m


def test_no_pose_shows_nothing(tmp_path: Path) -> None:
    cells = measure(tmp_path, {})
    assert len(cells) == 512
    assert set(cells.coverage_outcome) == {CoverageOutcome.NOT_IN_VIEW}
    assert cells.gsd_mm.isna().all()
    assert cells.found_crack_width_mm.isna().all()


def test_the_best_photograph_and_the_searched_one_may_differ(tmp_path: Path) -> None:
    """b.png is twice as near, but the detector did not process it: its GSD is told, and the defect found is a.png's."""
    cells = measure(tmp_path, {"a.png": look_north(4.0, 6.0, 2.0), "b.png": look_north(4.0, 3.0, 2.0)})
    both = count_samples_inside(cells, 2.5, 5.5, 1.1, 2.9) == 4
    inner = cells[both]
    assert (inner.imaged_count == 2).all()
    assert (inner.searched_count == 1).all()
    assert set(inner.best_photo_id) == {"b.png"}
    assert np.allclose(inner.gsd_mm, 3.0, rtol=0, atol=1e-6)  # mm
    centre = inner[(inner.cell_column == 15) & (inner.cell_row == 7)].iloc[0]
    cosine = 6.0 / np.sqrt(6.0**2 + 2 * 0.125**2)
    assert centre.found_crack_width_mm == pytest.approx(3.0 * 6.0 / cosine, abs=0.01)  # mm, the photograph is sharp
    assert centre.found_patch_mm == pytest.approx(20.0 * 6.0 / np.sqrt(cosine), abs=0.05)  # mm


def test_without_a_declared_recall_the_smallest_defect_is_unknown(tmp_path: Path) -> None:
    reach = DetectorReach(searched=frozenset({"a.png"}))
    cells = measure(tmp_path, {"a.png": look_north(4.0, 6.0, 2.0)}, reach=reach)
    assert (cells.searched_count == cells.imaged_count).all()
    assert cells.found_crack_width_mm.isna().all()
    assert cells.found_patch_mm.isna().all()


def test_a_detector_with_an_input_of_its_own_scale_gains_nothing_from_finer_pixels(tmp_path: Path) -> None:
    reach = DetectorReach(searched=frozenset({"a.png"}), crack_width_px=3.0, input_gsd_mm=10.0)
    cells = measure(tmp_path, {"a.png": look_north(4.0, 6.0, 2.0)}, reach=reach)
    centre = cells[(cells.cell_column == 15) & (cells.cell_row == 7)].iloc[0]
    assert centre.found_crack_width_mm == pytest.approx(30.0, abs=0.01)  # mm


def test_a_blurred_part_of_a_photograph_finds_less(tmp_path: Path) -> None:
    """The right half is spread by 2.5 px: known here, measured in the picture by the product."""
    write_photograph(tmp_path / "a.png", blur_px=2.5, blurred_from_x=500)
    cells = measure(tmp_path, {"a.png": look_north(4.0, 6.0, 2.0)})
    seen = cells[cells.imaged_count > 0]
    sharp, soft = seen[seen.x_site_m < 2.4], seen[seen.x_site_m > 5.6]
    assert np.median(sharp.blur_px) < 1.0  # px
    assert 2.1 < np.median(soft.blur_px) < 3.4  # px
    ratio = np.median(soft.found_crack_width_mm) / np.median(sharp.found_crack_width_mm)
    assert ratio == pytest.approx(np.median(soft.blur_px) / TYPICAL_BLUR.sigma_px, rel=0.05)


def test_a_photograph_without_edges_has_no_blur(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), np.full((600, 1000), 128, dtype=np.uint8))
    cells = measure(tmp_path, {"a.png": look_north(4.0, 6.0, 2.0)})
    assert cells.blur_px.isna().all()
    assert (cells.found_crack_width_mm.notna() == (cells.imaged_count > 0)).all()


def test_an_unreadable_photograph_shows_nothing(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "a.png").write_bytes(b"not a picture")
    cells = measure(tmp_path, {"a.png": look_north(4.0, 6.0, 2.0)})
    assert not cells.imaged_count.any()
    assert "a.png cannot be read" in caplog.text


def test_what_the_model_has_before_the_wall_hides_it(tmp_path: Path) -> None:
    """A plate of 1 x 1 m, 2 m before the wall: from 6 m away its shadow is 1.5 times as large."""
    plate = ((3.5, -2.05, 1.5), (4.5, -2.0, 2.5))
    building = make_building({"wall": WALL, "plate": plate}, classes={"plate": "IfcFurniture"})
    cells = measure(tmp_path, {"a.png": look_north(4.0, 6.0, 2.0)}, building=building)
    assert set(cells.element_guid) == {"wall"}  # furniture is no part of the building
    near = 6.0 / (6.0 - 2.05)
    hidden = count_samples_inside(cells, 4 - 0.5 * near, 4 + 0.5 * near, 2 - 0.5 * near, 2 + 0.5 * near) > 2
    assert set(cells.coverage_outcome[hidden]) == {CoverageOutcome.HIDDEN_BY_MODEL}
    assert 30 < hidden.sum() < 40
    inside = count_samples_inside(cells, 1.0, 7.0, 0.2, 3.8) >= 2
    assert set(cells.coverage_outcome[inside & ~hidden]) == {CoverageOutcome.IMAGED}


def make_as_built(*boxes) -> Surface:
    """The wall's front as tie points show it, and the fronts of boxes before it."""
    vertices, triangles = [], []
    for (x0, y, z0), (x1, _, z1) in ((*WALL,), *boxes):
        x, z = np.meshgrid(np.arange(x0, x1 + 0.01, 0.5), np.arange(z0, z1 + 0.01, 0.5))
        start = sum(map(len, vertices))
        vertices.append(np.column_stack([x.ravel(), np.full(x.size, y), z.ravel()]))
        index = np.arange(x.size).reshape(x.shape) + start
        a, b, c, d = index[:-1, :-1].ravel(), index[:-1, 1:].ravel(), index[1:, 1:].ravel(), index[1:, :-1].ravel()
        triangles += [np.column_stack([a, b, c]), np.column_stack([a, c, d])]
    return Surface.from_mesh(np.vstack(vertices), np.vstack(triangles))


def test_what_stands_before_the_wall_and_not_in_the_model_hides_it(tmp_path: Path) -> None:
    as_built = make_as_built(((3.5, -2.0, 1.5), (4.5, -2.0, 2.5)))
    cells = measure(tmp_path, {"a.png": look_north(4.0, 6.0, 2.0)}, as_built=as_built, placement_sigma_m=0.01)
    inside = count_samples_inside(cells, 3.25, 4.75, 1.25, 2.75)
    shadow = inside > 2
    assert shadow.sum() == 36
    assert set(cells.coverage_outcome[shadow]) == {CoverageOutcome.OBSTRUCTED}
    # The edges of an object reach farther than its tie points: the cells around count as not imaged.
    around = count_samples_inside(cells, 3.0, 5.0, 1.0, 3.0) == 4
    assert set(cells.coverage_outcome[around]) == {CoverageOutcome.OBSTRUCTED}
    assert cells.imaged_count[(count_samples_inside(cells, 1.0, 7.0, 0.2, 3.8) == 4) & ~around].all()
    looked = count_samples_inside(cells, 1.0, 7.0, 0.2, 3.8) == 4
    assert np.allclose(cells.hidden_share[looked], inside[looked] / 4, rtol=0, atol=1e-9)
    assert cells.hidden_share[count_samples_inside(cells, 1.0, 7.0, 0.2, 3.8) == 0].isna().all()


def test_a_second_photograph_looks_past_the_obstacle(tmp_path: Path) -> None:
    as_built = make_as_built(((3.5, -2.0, 1.5), (4.5, -2.0, 2.5)))
    posed = {"a.png": look_north(4.0, 6.0, 2.0), "b.png": look_north(1.4, 6.0, 2.0)}
    cells = measure(tmp_path, posed, as_built=as_built, placement_sigma_m=0.01)
    # From x = 1.4 the shadow is at x 4.55 to 6.05, outside that photograph's frame, which ends at 4.4 m.
    shown = count_samples_inside(cells, 3.25, 4.3, 1.25, 2.75) == 4
    assert (cells.imaged_count[shown] == 1).all()
    assert set(cells.best_photo_id[shown]) == {"b.png"}
    assert np.allclose(cells.hidden_share[shown], 0.5, rtol=0, atol=1e-9)
    assert cells.searched_count[shown].eq(0).all()  # the detector did not process b.png
    assert cells.found_crack_width_mm[shown].isna().all()


def test_a_grazing_photograph_does_not_count(tmp_path: Path) -> None:
    """From 0.3 m before the wall's plane, looking along it: the incidence beyond 2 m is more than 80 degrees."""
    eastward = np.column_stack([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
    beside = look_north(0.0, 0.3, 2.0)
    posed = PosedCamera(camera=CAMERA, site_from_cam=type(beside.site_from_cam)(
        rotation=eastward, translation=np.array([0.0, -0.3, 2.0])))  # fmt: skip
    cells = measure(tmp_path, {"a.png": posed})
    far = (cells.x_site_m > 2.2) & (cells.z_site_m - 2.0).abs().lt(0.2)
    assert set(cells.coverage_outcome[far]) == {CoverageOutcome.GRAZING}
    assert (cells.incidence_deg.dropna() <= 80).all()


def test_an_exclusion_mask_covers_cells(tmp_path: Path) -> None:
    mask = np.full((600, 1000), 255, dtype=np.uint8)
    mask[:, 500:] = 0
    cv2.imwrite(str(tmp_path / "a_mask.png"), mask)
    cells = measure(tmp_path, {"a.png": look_north(4.0, 6.0, 2.0)}, masks={"a.png": tmp_path / "a_mask.png"})
    right = cells.x_site_m > 4.0
    assert not cells.imaged_count[right].any()
    assert CoverageOutcome.OBSTRUCTED in set(cells.coverage_outcome[right])
    assert cells.imaged_count[~right].any()


def test_elements_divide_cells_and_their_areas(tmp_path: Path) -> None:
    """A joint at x = 4.1 m, inside column 16: two rows there, whose areas add up to that of the cell."""
    building = make_building({"left": ((0, 0, 0), (4.1, 0.3, 4)), "right": ((4.1, 0, 0), (8, 0.3, 4))})
    cells = measure(tmp_path, {"a.png": look_north(4.0, 6.0, 2.0)}, building=building)
    joint = cells[(cells.cell_column == 16) & (cells.cell_row == 5)]
    assert sorted(joint.element_guid) == ["left", "right"]
    assert joint.area_m2.sum() == pytest.approx(CELL_M**2, abs=1e-9)  # m2
    assert cells.area_m2.sum() == pytest.approx(32.0, abs=1e-6)  # m2


def test_a_wall_behind_another_has_cells_of_its_own(tmp_path: Path) -> None:
    """Two walls face south, 5 m apart, as in a courtyard; a cladding 10 cm before a wall covers it."""
    building = make_building(
        {"front": ((0, 0, 0), (8, 0.3, 2)), "rear": ((0, 5, 0), (8, 5.3, 4)), "cladding": ((0, 4.85, 2), (4, 4.9, 4))}
    )
    cells = measure(tmp_path, {"a.png": look_north(4.0, 6.0, 3.0)}, building=building)
    area = cells.groupby("element_guid").area_m2.sum()
    assert area["front"] == pytest.approx(16.0, abs=1e-6)  # m2
    assert area["cladding"] == pytest.approx(8.0, abs=1e-6)  # m2
    assert area["rear"] == pytest.approx(24.0, abs=1e-6)  # m2: without what the cladding covers
    keys = cells[["facade", "cell_column", "cell_row", "element_guid", "cell_layer"]]
    assert not keys.duplicated().any()


def test_one_element_with_two_walls_has_two_layers(tmp_path: Path) -> None:
    front, front_triangles = make_box(((0, 0, 0), (8, 0.3, 4)))
    rear, rear_triangles = make_box(((0, 5, 0), (8, 5.3, 4)))
    elements = make_building({"both": WALL}).elements
    building = make_model(
        np.vstack([front, rear]), np.vstack([front_triangles, rear_triangles + 8]), np.zeros(24, dtype=int), elements,
        SurfaceKind.IFC,
    )  # fmt: skip
    cells = measure(tmp_path, {"a.png": look_north(4.0, 6.0, 2.0)}, building=building)
    assert sorted(cells.cell_layer.unique()) == [0, 1]
    assert np.allclose(cells.y_site_m[cells.cell_layer == 1], 5.0, rtol=0, atol=1e-6)  # m


def test_a_round_wall_is_measured_unrolled(tmp_path: Path) -> None:
    """An upright cylinder of 3 m radius: the cells of all facades add up to what the photographs' sides of it hold."""
    angle = np.linspace(0, 2 * np.pi, 181)[:-1]
    ring = 3.0 * np.column_stack([np.cos(angle), np.sin(angle)])
    low, high = (np.column_stack([ring, np.full(180, z)]) for z in (0.0, 4.0))
    here, after = np.arange(180), (np.arange(180) + 1) % 180
    triangles = np.vstack(
        [np.column_stack([here, after, after + 180]), np.column_stack([here, after + 180, here + 180])]
    )
    row = {
        "element_guid": "tower", "ifc_class": "IfcWall", "is_external": True, "facade": "around",
        "surface_area_m2": 75.0, "triangles": 360, "geometry": shapely.to_wkb(shapely.box(8, 48, 8.1, 48.1)),
    }  # fmt: skip
    building = make_model(
        np.vstack([low, high]), triangles, np.zeros(360, dtype=int), table_from_rows("elements", [row]),
        SurfaceKind.IFC,
    )  # fmt: skip
    posed = {"a.png": look_north(0.0, 15.0, 2.0)}
    cells = measure(tmp_path, posed, building=building)
    # A wall counts to a facade where a photograph shows it at 80 degrees at most: by the law of sines in the triangle
    # of the cylinder's axis, its surface and the camera.
    limit = np.radians(80.0)
    shown_m2 = 2 * (limit - np.arcsin(3.0 / 15.0 * np.sin(limit))) * 3.0 * 4.0
    assert cells.area_m2.sum() == pytest.approx(shown_m2, rel=0.05)
    assert {"S", "SE", "SW"} <= set(cells.facade)
    plane_m2 = (cells.u_max_m - cells.u_min_m) * (cells.v_max_m - cells.v_min_m)
    assert cells.area_m2.sum() > 1.02 * plane_m2.sum()


def test_an_as_built_surface_is_its_own_witness(tmp_path: Path) -> None:
    """What no photograph shows is not in such a surface: it has no cells, and nothing tells what hides it."""
    building = make_building({"facade-S-1": WALL}, SurfaceKind.AS_BUILT)
    cells = measure(tmp_path, {"a.png": look_north(4.0, 6.0, 2.0)}, building=building)
    assert cells.imaged_count.sum() > 300
    assert cells.hidden_share.isna().all()
