from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from facadelake.building.facades import collect_facades
from facadelake.building.surface.obstructions import Obstructions
from facadelake.building.surface.raycasting import Surface
from facadelake.core.arrays import Float64Array
from facadelake.core.tables import table_from_rows
from facadelake.reporting.elevations.elevation import draw_elevations, render_background
from facadelake.reporting.elevations.facades import Facade, find_facades
from facadelake.reporting.elevations.hidden_regions import find_hidden_regions
from facadelake.reporting.elevations.marks import assign_marks, create_marks, find_visible_marks
from facadelake.reporting.elevations.rectification import RectifiedElevation, rectify_elevations
from facadelake.reporting.elevations.relief import render_relief
from facadelake.reporting.elevations.storeys import find_storey_bases
from facadelake.reporting.inspection import PictureSettings
from schemas.vocabulary import SurfaceKind
from tests.unit.reporting.painted_wall import (
    PAINT_PX_PER_M,
    WALL_HEIGHT_M,
    WALL_WIDTH_M,
    PaintedWall,
    make_box,
    make_defect_row,
    make_inspection,
    point_camera,
    render_photograph,
)

SETTINGS = PictureSettings(cell_m=0.01, feather_m=0.2)


def find_front(painted: PaintedWall, settings: PictureSettings = SETTINGS) -> Facade:
    facades = find_facades(painted.building, painted.surface, painted.posed, {}, settings)
    assert [facade.name for facade in facades] == ["S"]
    return facades[0]


def rectify_front(painted: PaintedWall, settings: PictureSettings = SETTINGS) -> RectifiedElevation:
    relief = render_relief(find_front(painted, settings), painted.surface, settings.cell_m)
    files = {name: painted.root / name for name in painted.posed}
    return rectify_elevations([relief], painted.surface, painted.posed, files, settings)[0]


def resample_painting(result: RectifiedElevation, painted: PaintedWall) -> tuple[Float64Array, Float64Array]:
    """The painting under each cell, found from the cell's site coordinates, and which cells the wall's front fills."""
    facade, cell = result.relief.facade, result.relief.cell_m
    rows, columns = result.relief.shape
    x = facade.u_min_m + (np.arange(columns) + 0.5) * cell
    z = facade.v_max_m - (np.arange(rows) + 0.5) * cell
    at_x, at_y = np.meshgrid(x * PAINT_PX_PER_M - 0.5, (WALL_HEIGHT_M - z) * PAINT_PX_PER_M - 0.5)
    paint = cv2.remap(painted.paint, at_x.astype(np.float32), at_y.astype(np.float32), cv2.INTER_CUBIC)
    on_wall = (x > 0.1) & (x < WALL_WIDTH_M - 0.1), (z > 0.1) & (z < WALL_HEIGHT_M - 0.1)
    return np.asarray(paint), on_wall[1][:, None] & on_wall[0][None, :]


def test_a_surface_of_tie_points_gets_no_edges_that_would_look_like_cracks(painted: PaintedWall) -> None:
    result = rectify_front(painted)
    rough = replace(
        result,
        relief=replace(result.relief, w_m=result.relief.w_m - 0.1 * (np.arange(result.relief.shape[1]) % 50 < 25)),
    )
    as_built = replace(painted.building, surface_kind=SurfaceKind.AS_BUILT)
    smooth, drawn = render_background(rough, as_built), render_background(rough, painted.building)
    np.testing.assert_array_equal(smooth, render_background(result, as_built))  # steps of 10 cm leave no line
    changed = (smooth != drawn).any(axis=2).sum()
    height = round(WALL_HEIGHT_M / result.relief.cell_m)
    assert changed > 20 * height  # cells: of a wall of 800 cells, with a step every 25


def test_the_background_that_coverage_is_drawn_on_has_no_hatching(painted: PaintedWall) -> None:
    """Hatching means something else in a layer of coverage, whose legend does not name that of the elevation."""
    result = rectify_front(painted)
    hidden = replace(result, hidden=np.ones_like(result.hidden))
    np.testing.assert_array_equal(
        render_background(hidden, painted.building), render_background(result, painted.building)
    )


def test_a_painted_wall_rectifies_to_its_painting(painted: PaintedWall) -> None:
    result = rectify_front(painted)
    paint, on_wall = resample_painting(result, painted)
    use = on_wall & result.covered
    assert 0.5 < use.sum() / on_wall.sum() <= 1.0
    difference = np.abs(result.picture.astype(float) - paint)[use]
    assert np.median(difference) < 3.0  # grey levels: rounding and two resamplings
    gradient = np.abs(np.gradient(paint[..., 0], axis=1))[use]
    assert np.quantile(gradient, 0.99) > 6.0  # per cell, so a shift of one cell would show


def test_no_photograph_is_shifted_by_more_than_a_tenth_of_a_cell(painted: PaintedWall) -> None:
    result = rectify_front(painted)
    paint, on_wall = resample_painting(result, painted)
    ys, xs = np.nonzero(on_wall & result.covered)
    window = np.s_[ys.min() + 40 : ys.max() - 40, xs.min() + 200 : xs.max() - 200]
    assert (on_wall & result.covered)[window].all()
    got = cv2.cvtColor(result.picture, cv2.COLOR_RGB2GRAY)[window].astype(np.float32)
    want = cv2.cvtColor(paint.astype(np.float32), cv2.COLOR_RGB2GRAY)[window]
    (dx, dy), response = cv2.phaseCorrelate(got, want)
    assert response > 0.5
    np.testing.assert_allclose([dx, dy], [0.0, 0.0], rtol=0, atol=0.1)  # cells


def test_the_picture_is_not_mirrored(painted: PaintedWall) -> None:
    result = rectify_front(painted)
    paint, on_wall = resample_painting(result, painted)
    use = on_wall & result.covered & (on_wall & result.covered)[:, ::-1]
    right = np.corrcoef(result.picture[use].ravel(), paint[use].ravel())[0, 1]
    mirrored = np.corrcoef(result.picture[:, ::-1][use].ravel(), paint[use].ravel())[0, 1]
    assert right > 0.95
    assert mirrored < 0.5


@pytest.mark.parametrize(
    ("azimuth_deg", "right_site"), [(0, (-1, 0, 0)), (90, (0, 1, 0)), (180, (1, 0, 0)), (270, (0, -1, 0))]
)
def test_u_points_right_as_seen_from_outside(
    painted: PaintedWall, azimuth_deg: float, right_site: tuple[int, int, int]
) -> None:
    axes = replace(find_front(painted), azimuth_deg=azimuth_deg).axes_site
    np.testing.assert_allclose(axes[0], right_site, rtol=0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(axes), 1.0, rtol=0, atol=1e-12)


def test_cameras_decide_which_side_of_a_wall_is_outside(painted: PaintedWall) -> None:
    words = painted.building.elements.set_column(
        painted.building.elements.column_names.index("facade"),
        painted.building.elements.schema.field("facade"),
        [["N"]],
    )
    misled = replace(painted.building, elements=words)
    facades = find_facades(misled, painted.surface, painted.posed, {}, SETTINGS)
    assert [facade.name for facade in facades] == ["S"]
    alone = find_facades(misled, painted.surface, {}, {}, SETTINGS)
    assert [facade.name for facade in alone] == ["N"]


def test_a_round_wall_is_drawn_on_each_facade_that_it_faces(painted: PaintedWall) -> None:
    """Part of a cylinder that bulges south: its sides belong to the facades that the tables name for them."""
    turn = np.radians(np.linspace(-75, 75, 13))
    foot = np.column_stack([4 + 3 * np.sin(turn), 1 - 3 * np.cos(turn)])
    low, high = np.column_stack([foot, np.zeros(13)]), np.column_stack([foot, np.full(13, 4.0)])
    rows = np.arange(12)
    arc = np.vstack([np.column_stack([rows, rows + 1, rows + 14]), np.column_stack([rows, rows + 14, rows + 13])])
    element = {**painted.building.elements.to_pylist()[0], "facade": "around", "facade_azimuth_deg": None}
    building = replace(
        painted.building,
        vertices_site_m=np.vstack([low, high]),
        triangles=arc,
        element_of_triangle=np.zeros(len(arc), dtype=np.int64),
        elements=table_from_rows("elements", [element]),
    )
    camera = painted.posed["a.png"].camera
    posed = {
        str(x): point_camera(np.array([x, -9.0, 1.5]), np.array([4.0, 0.0, 2.0]), camera) for x in (-1.0, 4.0, 9.0)
    }
    found = find_facades(building, Surface(building), posed, {}, SETTINGS)
    assert {facade.code: facade.azimuth_deg for facade in found} == {
        "E": 90.0, "SE": 135.0, "S": 180.0, "SW": 225.0, "W": 270.0,
    }  # fmt: skip
    facade = next(facade for facade in found if facade.code == "S")
    reach = 3 * np.sin(np.radians(25)) + 0.5  # the arc's pieces turn by 12.5 deg: two each side face south
    np.testing.assert_allclose([facade.u_min_m, facade.u_max_m], [4 - reach, 4 + reach], rtol=0, atol=0.01)  # m
    # A defect on each piece is drawn on the facade of its column, and on no other.
    marks = []
    for piece in range(12):
        centre = (foot[piece] + foot[piece + 1]) / 2
        normal = np.array([centre[0] - 4, centre[1] - 1, 0.0]) / np.hypot(centre[0] - 4, centre[1] - 1)
        code = collect_facades(building.elements).assign_facade("around", normal)
        others = {"normal_x": normal[0], "normal_y": normal[1], "y_site_m": centre[1], "facade": code}
        marks.append(make_defect_row(f"D{piece:02d}", centre[0], 2.0, **others))
    drawn = create_marks(table_from_rows("defects", marks), building.origin)
    assigned, unassigned = assign_marks(found, drawn)
    assert unassigned == []
    assert [{mark.facade for mark in own} for own in assigned] == [{facade.code} for facade in found]
    assert sum(map(len, assigned)) == 12


def test_a_missing_photograph_is_not_used(painted: PaintedWall, caplog: pytest.LogCaptureFixture) -> None:
    whole = rectify_front(painted)
    relief = render_relief(find_front(painted), painted.surface, SETTINGS.cell_m)
    files = {"a.png": painted.root / "a.png", "b.png": painted.root / "gone.png"}
    result = rectify_elevations([relief], painted.surface, painted.posed, files, SETTINGS)[0]
    assert 0 < result.covered.sum() < whole.covered.sum()
    assert "gone.png cannot be decoded" in caplog.text


def test_a_hidden_wall_takes_no_colour_from_what_hides_it(painted: PaintedWall) -> None:
    screen, triangles = make_box(np.array([3.0, -2.0, 0.0]), np.array([4.0, -1.9, 4.0]))
    building = replace(
        painted.building,
        vertices_site_m=np.vstack([painted.building.vertices_site_m, screen]),
        triangles=np.vstack([painted.building.triangles, triangles + 8]),
        element_of_triangle=np.zeros(24, dtype=np.int64),
    )
    facade = find_front(painted)
    one = {"a.png": painted.posed["a.png"]}
    relief = render_relief(replace(facade, near_w_m=1.0), Surface(building), 0.02)  # looks past the screen
    result = rectify_elevations([relief], Surface(building), one, {"a.png": painted.root / "a.png"}, SETTINGS)[0]
    # From the camera at x = 2, y = -5.5 the screen at y = -1.9 hides the wall's front from x of 3.5 to about 5.
    u = facade.u_min_m + (np.arange(relief.shape[1]) + 0.5) * 0.02
    shadow = (u > 3.7) & (u < 4.9)
    lit = (u > 1.0) & (u < 3.2)
    centre = result.covered[relief.shape[0] // 2]
    assert not centre[shadow].any()
    assert centre[lit].all()


def test_marks_lie_on_the_facade_they_face_and_keep_their_size(painted: PaintedWall) -> None:
    inspection = make_inspection(
        painted,
        [
            make_defect_row("D007", 2.0, 1.0),
            make_defect_row("D012", 6.0, 3.0, normal_y=1.0, y_site_m=9.0, facade="N"),
        ],
        [],
    )
    facade = find_front(painted)
    marks = create_marks(inspection.defects, painted.building.origin)
    (shown,), nowhere = assign_marks([facade], marks)
    assert [mark.label for mark in shown] == ["7"]
    assert [mark.label for mark in nowhere] == ["12"]
    uvw = facade.uvw_from_site(shown[0].corners_site_m)
    np.testing.assert_allclose(np.ptp(uvw, axis=0), [0.4, 0.2, 0.0], rtol=0, atol=1e-9)  # m
    np.testing.assert_allclose(uvw.mean(axis=0), [2.0, 1.0, 0.0], rtol=0, atol=1e-9)  # m: u is east on a south wall


def test_an_object_in_front_of_the_wall_in_one_photograph_is_not_drawn(painted: PaintedWall, tmp_path: Path) -> None:
    camera = painted.posed["a.png"].camera
    posed = {
        f"{i}.png": point_camera(np.array([x, -5.5, 1.8]), np.array([4.0, 0.0, 2.0]), camera)
        for i, x in enumerate((4.0, 2.5, 5.5, 3.2))
    }
    for name, pose in posed.items():
        shot = np.clip(render_photograph(pose, painted.paint) + 0.5, 0, 255).astype(np.uint8)
        if name == "0.png":  # the squarest view has a red thing in its centre, about 1.5 m wide
            shot[240:460, 380:620] = (220, 20, 20)
        cv2.imwrite(str(tmp_path / name), shot[..., ::-1])
    relief = render_relief(find_front(painted), painted.surface, 0.02)

    def red_share(names: list[str]) -> float:
        some = {name: posed[name] for name in names}
        files = {name: tmp_path / name for name in names}
        result = rectify_elevations([relief], painted.surface, some, files, SETTINGS)[0]
        red = (result.picture[..., 0] > 190) & (result.picture[..., 1] < 50)
        return float(red.sum() / result.covered.sum())

    assert red_share(["0.png"]) > 0.05
    assert red_share(["0.png", "1.png", "2.png", "3.png"]) < 0.0005


def test_what_hides_the_wall_is_not_covered_by_photographs(painted: PaintedWall, tmp_path: Path) -> None:
    """A red container 1 m before the wall is in all photographs alike: only the as-built surface tells it."""
    vertices, triangles = make_box(np.array([3.2, -1.1, 0.8]), np.array([4.8, -0.9, 1.9]))
    container = Surface.from_mesh(vertices, triangles)
    camera = painted.posed["a.png"].camera
    posed = {f"{x}.png": point_camera(np.array([x, -6.0, 1.8]), np.array([4.0, 0.0, 1.8]), camera) for x in (3, 4, 5)}
    for name, pose in posed.items():
        shot = np.clip(render_photograph(pose, painted.paint) + 0.5, 0, 255).astype(np.uint8)
        grid = np.stack(np.meshgrid(np.arange(camera.width_px) + 0.5, np.arange(camera.height_px) + 0.5), axis=-1)
        hits = container.cast(*pose.rays_site_from_img(grid.reshape(-1, 2)))
        shot[hits.hit.reshape(shot.shape[:2])] = (220, 20, 20)
        cv2.imwrite(str(tmp_path / name), shot[..., ::-1])
    as_built = Surface.from_mesh(
        np.vstack([painted.building.vertices_site_m, vertices]), np.vstack([painted.building.triangles, triangles + 8])
    )
    relief = render_relief(find_front(painted), painted.surface, 0.02)
    files = {name: tmp_path / name for name in posed}
    known = Obstructions(as_built, painted.surface, 0.01)
    result = rectify_elevations([relief], painted.surface, posed, files, SETTINGS, known)[0]
    rows, columns = (index.ravel() for index in np.nonzero(relief.element >= 0))
    xyz = relief.site_from_cells(rows, columns)
    blocked = np.array(
        [container.cast(np.broadcast_to(p.centre_site_m, xyz.shape), xyz - p.centre_site_m).hit for p in posed.values()]
    )
    behind, free = blocked.all(axis=0), ~blocked.any(axis=0)
    hidden = result.hidden[rows, columns]
    assert behind.sum() * 0.02**2 > 0.8  # m2
    assert hidden[behind].mean() > 0.95
    assert hidden[free].mean() < 0.03
    red = (result.picture[..., 0] > 190) & (result.picture[..., 1] < 50)
    assert (red & ~result.hidden & result.covered).sum() * 0.02**2 < 0.05  # m2
    (region,) = find_hidden_regions(relief, result.hidden)
    u, v = xyz[behind, 0], xyz[behind, 2]
    assert region.u_min_m < u.min() + 0.1 < u.max() - 0.1 < region.u_max_m
    assert region.v_min_m < v.min() + 0.1 < v.max() - 0.1 < region.v_max_m
    blind = rectify_elevations([relief], painted.surface, posed, files, SETTINGS)[0]
    assert blind.hidden[rows, columns][behind].mean() < 0.5  # without it, photographs that agree are believed


def test_photographs_that_contradict_one_another_do_not_cover(painted: PaintedWall, tmp_path: Path) -> None:
    """One of two photographs shows a red thing: which of them shows the wall is not known."""
    camera = painted.posed["a.png"].camera
    posed = {f"{x}.png": point_camera(np.array([x, -5.5, 1.8]), np.array([4.0, 0.0, 2.0]), camera) for x in (3.5, 4.5)}
    for number, (name, pose) in enumerate(posed.items()):
        shot = np.clip(render_photograph(pose, painted.paint) + 0.5, 0, 255).astype(np.uint8)
        if number == 0:
            shot[240:460, 380:620] = (220, 20, 20)
        cv2.imwrite(str(tmp_path / name), shot[..., ::-1])
    relief = render_relief(find_front(painted), painted.surface, 0.02)
    files = {name: tmp_path / name for name in posed}
    result = rectify_elevations([relief], painted.surface, posed, files, SETTINGS)[0]
    (region,) = find_hidden_regions(relief, result.hidden)
    assert 1.0 < region.area_m2 < 2.6  # 220 x 240 px of 6 mm are 1.9 m2
    folder = tmp_path / "drawn"
    folder.mkdir()
    inspection = replace(make_inspection(painted, [], []), posed=posed, photographs_root=tmp_path)
    (elevation,) = draw_elevations(inspection, painted.surface, folder, SETTINGS)
    assert elevation.hidden_share > 0.02
    assert elevation.covered_share + elevation.hidden_share < 1.0
    assert not elevation.obstructions_known


def test_a_mark_of_another_facade_is_shown_where_it_can_be_seen(painted: PaintedWall) -> None:
    relief = render_relief(find_front(painted), painted.surface, 0.05)
    rows = [
        make_defect_row("D1", 2.0, 1.0),
        make_defect_row("D2", 4.0, 1.0),
        make_defect_row("D3", 5.0, 1.0, y_site_m=0.3, normal_y=1.0),  # on the wall's back
        make_defect_row("D4", 20.0, 1.0),  # beside the wall
    ]
    marks = create_marks(make_inspection(painted, rows, []).defects, painted.building.origin)
    seen = find_visible_marks(relief, marks, marks[:1])
    assert [mark.defect_id for mark in seen] == ["D2"]


def test_elevations_are_written_with_and_without_defects(painted: PaintedWall, tmp_path: Path) -> None:
    coarse = PictureSettings(cell_m=0.03)
    for number, defects in enumerate(([], [make_defect_row("D1", 2.0, 1.0), make_defect_row("D2", 2.1, 1.1)])):
        folder = tmp_path / str(number)
        folder.mkdir()
        elevations = draw_elevations(make_inspection(painted, defects, []), painted.surface, folder, coarse)
        assert [elevation.path.name for elevation in elevations] == ["elevation_S.png"]
        assert [len(elevation.marks) for elevation in elevations] == [len(defects)]
        assert 0.5 < elevations[0].covered_share < 1.0
        assert (folder / "thumbnail_elevation.jpg").is_file()
        picture = cv2.imread(str(elevations[0].path))
        assert picture.shape[1] > 800
        assert picture.std() > 20


def test_a_building_that_no_photograph_shows_is_drawn_grey(painted: PaintedWall, tmp_path: Path) -> None:
    inspection = replace(make_inspection(painted, [], []), posed={})
    (elevation,) = draw_elevations(inspection, painted.surface, tmp_path, PictureSettings(cell_m=0.03))
    assert elevation.covered_share == 0.0
    picture = cv2.imread(str(elevation.path))
    height, width = picture.shape[:2]
    centre = picture[height // 2 - 50 : height // 2 + 50, width // 2 - 50 : width // 2 + 50].reshape(-1, 3)
    assert 180 < np.median(centre) < 250  # light grey


def test_storeys_begin_at_their_walls_feet(painted: PaintedWall) -> None:
    parts = [make_box(np.array([0.0, 0, z]), np.array([1.0, 1, z + 1])) for z in (0.0, 0.0, 2.0, 3.0, 3.0, 3.0, 5.2)]
    names = ["Ground", "Ground", "Ground", "First", "First", "First", "First"]  # the last of each is a lintel
    words = {
        "element_guid": [str(i) for i in range(7)],
        "ifc_class": ["IfcWall"] * 7,
        "storey": names,
        "facade": ["S"] * 7,
        "surface_area_m2": [6.0] * 7,
        "triangles": [12] * 7,
    }
    rows = [{key: values[i] for key, values in words.items()} for i in range(7)]
    building = replace(
        painted.building,
        vertices_site_m=np.vstack([vertices for vertices, _ in parts]),
        triangles=np.vstack([triangles + 8 * i for i, (_, triangles) in enumerate(parts)]),
        element_of_triangle=np.repeat(np.arange(7), 12),
        elements=table_from_rows("elements", rows),
    )
    levels = find_storey_bases(building)
    assert [level.name for level in levels] == ["Ground", "First"]
    np.testing.assert_allclose([level.z_site_m for level in levels], [0.0, 3.0], rtol=0, atol=1e-9)  # m
    # Two buildings' storeys at one level, told apart in the tables, are both named.
    rows[0]["storey"], rows[1]["storey"] = "Ground, A", "Ground, B"
    names_at_one_level = [
        level.name for level in find_storey_bases(replace(building, elements=table_from_rows("elements", rows)))
    ]
    assert names_at_one_level[0] == "Ground, A / Ground, B"
