from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import shapely
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from facadelake.building.surface.raycasting import Surface
from facadelake.core.frames import axes_from_normal
from facadelake.core.tables import table_from_rows
from facadelake.reporting.cards.cards import draw_cards
from facadelake.reporting.cards.crops import crop_detection, write_crops
from facadelake.reporting.cards.facts import group_merges, list_card_facts
from facadelake.reporting.cards.figure import CardContents, choose_bar_length_m, draw_card, format_bar_length
from facadelake.reporting.cards.observations import group_observations, read_outline
from facadelake.reporting.cards.patch_view import PatchView, rectify_patch
from facadelake.reporting.drawing.palette import bgr_from_hex, get_class_colour
from facadelake.reporting.drawing.photograph import read_photograph
from facadelake.reporting.elevations.elevation import find_drawn_facades, map_defects_to_model
from facadelake.reporting.elevations.marks import DefectMark, create_marks
from facadelake.reporting.elevations.overview import draw_defect_location, render_model_overview
from facadelake.reporting.elevations.storeys import find_storey_bases
from facadelake.reporting.inspection import Inspection, PictureSettings
from tests.unit.reporting.painted_wall import (
    PAINT_PX_PER_M,
    WALL_HEIGHT_M,
    PaintedWall,
    make_box,
    make_defect_row,
    make_inspection,
)

SETTINGS = PictureSettings(cell_m=0.02)


def make_mark(painted: PaintedWall, x_m: float, z_m: float, **others: Any) -> DefectMark:
    (mark,) = create_marks(
        table_from_rows("defects", [make_defect_row("D1", x_m, z_m, **others)]), painted.building.origin
    )
    return mark


def rectify_mark(painted: PaintedWall, mark: DefectMark, photo_id: str = "a.png", cells: int = 300) -> PatchView:
    posed = painted.posed[photo_id]
    pixels = read_photograph(painted.root / photo_id, posed.camera)
    return rectify_patch(mark, posed, pixels, painted.surface, cells, pixel_m=0.006)


def sample_painting(painted: PaintedWall, x_m: np.ndarray, z_m: np.ndarray) -> np.ndarray:
    """The painting at places of the wall's front."""
    at_x = (x_m * PAINT_PX_PER_M - 0.5).astype(np.float32)
    at_y = ((WALL_HEIGHT_M - z_m) * PAINT_PX_PER_M - 0.5).astype(np.float32)
    return np.asarray(cv2.remap(painted.paint, at_x, at_y, cv2.INTER_CUBIC))


@pytest.mark.parametrize("photo_id", ["a.png", "b.png"])
def test_the_rectified_patch_is_true_to_scale(painted: PaintedWall, photo_id: str) -> None:
    """The painting's own coordinates against the patch's cells: the best scale between them is one, to 1 %."""
    x_m, z_m = 3.6, 2.2
    view = rectify_mark(painted, make_mark(painted, x_m, z_m, width_m=0.9, height_m=0.7), photo_id)
    assert view.visible.all()
    assert view.side_m == pytest.approx(0.9 * 1.8, rel=1e-9)
    along = (np.arange(300) + 0.5 - 150) * view.cell_m
    got = cv2.cvtColor(view.picture, cv2.COLOR_RGB2GRAY).astype(np.float32)

    def unlikeness(scale_x: float, scale_z: float) -> float:
        xs, zs = np.meshgrid(x_m + along * scale_x, z_m - along * scale_z)
        want = cv2.cvtColor(sample_painting(painted, xs, zs).astype(np.float32), cv2.COLOR_RGB2GRAY)
        return float(np.abs(got - want).mean())

    assert unlikeness(1.0, 1.0) < 3.0  # grey levels
    scales = np.arange(0.95, 1.0501, 0.005)
    assert scales[np.argmin([unlikeness(s, 1.0) for s in scales])] == pytest.approx(1.0, abs=0.0051)
    assert scales[np.argmin([unlikeness(1.0, s) for s in scales])] == pytest.approx(1.0, abs=0.0051)
    assert unlikeness(-1.0, 1.0) > 5 * unlikeness(1.0, 1.0)  # mirrored it would be another picture


def test_a_reduced_patch_lies_where_the_fine_one_does(painted: PaintedWall) -> None:
    mark = make_mark(painted, 3.5, 2.0, width_m=1.2, height_m=1.0)
    posed = painted.posed["a.png"]
    pixels = read_photograph(painted.root / "a.png", posed.camera)
    small = rectify_patch(mark, posed, pixels, painted.surface, 60, pixel_m=0.006)  # cells of 36 mm: reduced by 4
    along = (np.arange(60) + 0.5 - 30) * small.cell_m
    xs, zs = np.meshgrid(3.5 + along, 2.0 - along)
    want = sample_painting(painted, xs, zs).astype(np.float32)
    (dx, dy), response = cv2.phaseCorrelate(
        cv2.cvtColor(small.picture, cv2.COLOR_RGB2GRAY).astype(np.float32), cv2.cvtColor(want, cv2.COLOR_RGB2GRAY)
    )
    assert response > 0.4
    np.testing.assert_allclose([dx, dy], [0.0, 0.0], rtol=0, atol=0.15)  # cells


def test_a_patch_off_the_model_is_rectified_at_its_own_depth(painted: PaintedWall) -> None:
    """A place 0.25 m before the wall projects elsewhere than the wall behind it: its own ray says where."""
    off = make_mark(painted, 3.5, 2.0, y_site_m=-0.25)
    posed = painted.posed["a.png"]
    xyz = posed.centre_site_m
    ray = np.array([3.5, -0.25, 2.0]) - xyz
    behind = xyz + ray * (-xyz[1] / ray[1])  # where that ray meets the painted wall
    view = rectify_mark(painted, off, cells=301)
    want = sample_painting(painted, behind[[0]][None], behind[[2]][None])[0, 0]
    np.testing.assert_allclose(view.picture[150, 150].astype(float), want, rtol=0, atol=4.0)  # grey levels
    assert np.abs(sample_painting(painted, np.array([[3.5]]), np.array([[2.0]]))[0, 0] - want).max() > 8.0


def test_hidden_cells_are_grey(painted: PaintedWall) -> None:
    screen, triangles = make_box(np.array([3.0, -2.0, 0.0]), np.array([4.0, -1.9, 4.0]))
    surface = Surface.from_mesh(
        np.vstack([painted.building.vertices_site_m, screen]), np.vstack([painted.building.triangles, triangles + 8])
    )
    view = rectify_mark(replace(painted, surface=surface), make_mark(painted, 3.4, 2.0, width_m=1.0, height_m=1.0))
    # From the camera at x = 2, y = -5.5 the screen at y = -1.9 hides the wall's front from x of 3.5 to about 5.
    x_m = 3.4 + (np.arange(300) + 0.5 - 150) * view.cell_m
    assert not view.visible[150, (x_m > 3.7) & (x_m < 4.2)].any()
    assert view.visible[150, x_m < 3.4].all()
    assert (view.picture[~view.visible] == 225).all()


def test_a_measured_patch_is_the_outline(painted: PaintedWall) -> None:
    site = np.array([[2.0, 0.0, 1.0], [2.6, 0.0, 1.0], [2.0, 0.0, 1.4], [2.0, 0.0, 1.0]])
    wkb = shapely.to_wkb(shapely.Polygon(painted.building.origin.geo_from_site(site)), output_dimension=3)
    mark = make_mark(painted, 2.2, 1.1, patch=wkb)
    (ring,) = mark.outlines_site_m
    np.testing.assert_allclose(ring, site, rtol=0, atol=1e-4)  # m
    view = rectify_mark(painted, mark)
    np.testing.assert_allclose(view.rings_m[0][0], [-0.2, -0.1], rtol=0, atol=1e-4)  # m, right and up


@pytest.mark.parametrize("normal", [(0, -1, 0), (1, 0, 0), (0.3, 0.4, 0.5), (0, 0, 1), (0, 0, -1)])
def test_surface_axes_are_right_handed(normal: tuple[float, ...]) -> None:
    axes = axes_from_normal(np.array(normal))
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), rtol=0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(axes), 1.0, rtol=0, atol=1e-12)
    assert axes[0, 2] == pytest.approx(0.0, abs=1e-12)  # right is level
    assert axes[1, 2] >= -1e-12


def test_the_marker_is_at_the_defects_pixel(painted: PaintedWall) -> None:
    inspection = make_inspection(painted, [make_defect_row("D1", 5.5, 3.0)], [])
    (facade,) = find_drawn_facades(inspection, painted.surface, SETTINGS)
    backdrop = map_defects_to_model(inspection, painted.surface, [facade], ["D1"])["D1"]
    mark = create_marks(inspection.defects, painted.building.origin)[0]
    figure = Figure(figsize=(9, 5), dpi=100)
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_axes((0, 0, 1, 1))
    draw_defect_location(axes, backdrop, find_storey_bases(painted.building), mark)
    axes.axis("off")
    canvas.draw()
    picture = np.asarray(canvas.buffer_rgba())[..., :3].astype(int)
    ink = np.array(bgr_from_hex(get_class_colour("crack"))[::-1])
    ys, xs = np.nonzero(np.abs(picture - ink).max(axis=2) < 12)
    centre = np.array([(xs.min() + xs.max() + 1) / 2, 500 - (ys.min() + ys.max() + 1) / 2])
    found = axes.transData.inverted().transform(centre)
    # On a wall that faces south, u is x and v is z of the site.
    np.testing.assert_allclose(found, [5.5, 3.0], rtol=0, atol=0.03)  # m, about two pixels


def test_the_backdrop_shows_the_wall_where_it_is(painted: PaintedWall) -> None:
    inspection = make_inspection(painted, [], [])
    (facade,) = find_drawn_facades(inspection, painted.surface, SETTINGS)
    backdrop = render_model_overview(facade, painted.surface, painted.building)
    per_m = backdrop.picture.shape[1] / backdrop.width_m
    columns = np.flatnonzero((backdrop.picture < 250).all(axis=2).any(axis=0))
    np.testing.assert_allclose(np.array([columns.min(), columns.max() + 1]) / per_m, [0.5, 8.5], rtol=0, atol=0.04)  # m


@pytest.mark.parametrize(
    ("width_m", "length_m", "words"),
    [(0.3, 0.1, "10 cm"), (1.0, 0.2, "20 cm"), (8.0, 2.0, "2 m"), (0.02, 0.005, "5 mm"), (150.0, 50.0, "50 m")],
)
def test_bars_are_round_and_fit_a_third(width_m: float, length_m: float, words: str) -> None:
    assert choose_bar_length_m(width_m) == pytest.approx(length_m, rel=1e-12)
    assert format_bar_length(choose_bar_length_m(width_m)) == words


def test_a_mask_is_drawn_where_it_is(painted: PaintedWall) -> None:
    detection = {
        "box_x_px": 100.0, "box_y_px": 80.0, "box_width_px": 60.0, "box_height_px": 40.0,
        "mask": "POLYGON ((100 80, 160 80, 100 120, 100 80))",
    }  # fmt: skip
    blank = np.zeros((300, 400, 3), dtype=np.uint8)
    crop = crop_detection(blank, read_outline(detection), 192, get_class_colour("crack"))
    drawn = np.argwhere(crop.max(axis=2) > 100)[:, ::-1]
    # 192 px show 60 * 3.2 px of the photograph: one to one, from its centre (130, 100) less 96.
    left, top = 130 - 96, 100 - 96
    np.testing.assert_allclose(drawn.min(axis=0), [100 - left, 80 - top], rtol=0, atol=2)  # px
    assert crop[120 - top - 3, 160 - left - 3].max() == 0  # a box would have its corner there
    assert read_outline({**detection, "mask": "no polygon"}).rings_px == ()


def make_inspection_with_two_views(painted: PaintedWall) -> Inspection:
    inspection = make_inspection(
        painted, [make_defect_row("D1", 2.5, 1.5), make_defect_row("D2", 3.2, 2.5)], ["D1", "D2"]
    )
    detections = inspection.detections.to_pylist()
    observations = inspection.observations.to_pylist()
    xy = painted.posed["b.png"].project_site(np.array([[3.2, 0.0, 2.5]]))[0]
    detections.append({**detections[1], "detection_id": "D2b", "photo_id": "b.png", "box_x_px": xy[0] - 20,
                       "box_y_px": xy[1] - 10})  # fmt: skip
    observations.append({**observations[1], "detection_id": "D2b", "photo_id": "b.png", "gsd_mm": 2.0,
                         "incidence_deg": 60.0})  # fmt: skip
    return replace(
        inspection,
        detections=table_from_rows("detections", detections),
        observations=table_from_rows("observations", observations),
    )


def test_the_best_photograph_comes_first(painted: PaintedWall) -> None:
    own = group_observations(make_inspection_with_two_views(painted))["D2"]
    assert [one.photo_id for one in own] == ["a.png", "b.png"]  # best_photo_id before the smaller pixel
    assert own[1].pixel_mm == pytest.approx(4.0, rel=1e-9)
    assert own[0].pixel_mm == np.inf


def test_cards_are_written_and_unreadable_photographs_are_listed(
    painted: PaintedWall, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    inspection = make_inspection_with_two_views(painted)
    places = map_defects_to_model(
        inspection, painted.surface, find_drawn_facades(inspection, painted.surface, SETTINGS), ["D2"]
    )
    cards = draw_cards(inspection, painted.surface, ["D1", "D2"], tmp_path, overviews=places, max_observations=9)
    assert cards.missing == ()
    assert {name: path.name for name, path in cards.paths.items()} == {"D1": "card_1.png", "D2": "card_2.png"}
    whole = cv2.imread(str(cards.paths["D2"]))
    assert whole.shape[1] == 1980
    elsewhere = tmp_path / "photographs"
    elsewhere.mkdir()
    (elsewhere / "b.png").write_bytes((painted.root / "b.png").read_bytes())
    (elsewhere / "a.png").write_bytes(b"no picture")
    broken = draw_cards(
        replace(inspection, photographs_root=elsewhere), painted.surface, ["D1", "D2"], tmp_path / "again",
        overviews={}, max_observations=1,
    )  # fmt: skip
    assert broken.missing == ("a.png",)
    assert set(broken.paths) == {"D1", "D2"}
    assert "a.png cannot be decoded" in caplog.text


def test_the_next_best_photograph_replaces_an_unreadable_one(painted: PaintedWall, tmp_path: Path) -> None:
    inspection = make_inspection_with_two_views(painted)
    (tmp_path / "b.png").write_bytes((painted.root / "b.png").read_bytes())
    (tmp_path / "a.png").write_bytes(b"no picture")
    broken = replace(inspection, photographs_root=tmp_path)
    assert set(write_crops(broken, tmp_path / "crops")) == {"D2"}  # D1 is in a.png alone
    seen: dict[str, CardContents] = {}

    def keep(contents: CardContents) -> Figure:
        seen[contents.mark.defect_id] = contents
        return draw_card(contents)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("facadelake.reporting.cards.cards.draw_card", keep)
        draw_cards(broken, painted.surface, ["D1", "D2"], tmp_path / "cards", overviews={}, max_observations=1)
    assert seen["D2"].best_photo_id == "b.png"
    assert seen["D2"].best is not None
    assert seen["D2"].patch is not None
    assert seen["D1"].best is None
    assert [seen[name].unreadable for name in ("D1", "D2")] == [["a.png"], ["a.png"]]  # named on the cards


def test_the_caption_of_the_rectified_view_does_not_run_into_the_facts(painted: PaintedWall, tmp_path: Path) -> None:
    figures: list[Figure] = []

    def keep(contents: CardContents) -> Figure:
        assert contents.patch is not None
        hidden = replace(contents.patch, visible=np.zeros_like(contents.patch.visible), cell_m=0.0123)
        figures.append(draw_card(replace(contents, patch=hidden)))
        return figures[-1]

    inspection = make_inspection_with_two_views(painted)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("facadelake.reporting.cards.cards.draw_card", keep)
        draw_cards(inspection, painted.surface, ["D1"], tmp_path, overviews={}, max_observations=1)
    renderer = figures[0].canvas.get_renderer()  # type: ignore[attr-defined]  # of FigureCanvasAgg
    boxes = {text.get_text(): text.get_window_extent(renderer) for axes in figures[0].axes for text in axes.texts}
    (caption,) = (box for text, box in boxes.items() if text.startswith("rectified"))
    assert caption.x1 < boxes["severity"].x0


def test_facts_that_were_not_measured_are_omitted(painted: PaintedWall) -> None:
    inspection = make_inspection(painted, [make_defect_row("D1", 2.0, 1.0, score=0.537)], ["D1"])
    (row,) = inspection.defects.to_pylist()
    bare = dict(list_card_facts(row, inspection, []))
    assert bare["detected by"] == "coco:x, score 0.54"
    assert not {"deviation", "merged", "not merged", "crack width", "one sigma", "position method"} & set(bare)
    assert "None" not in " ".join(bare.values())
    pairs = [
        {"detection_id": "a", "other_detection_id": "b", "defect_id": "D1", "other_defect_id": "D1",
         "merge_decision": "joined", "merge_reason": "geography_and_image", "separation_m": 0.02,
         "mahalanobis_distance": 1.24,
         "overlap_share": 0.8, "appearance_score": 0.71},
        {"detection_id": "a", "other_detection_id": "c", "defect_id": "D1", "other_defect_id": "D9",
         "merge_decision": "apart", "merge_reason": "looks_different", "separation_m": 0.2, "mahalanobis_distance": 2.0,
         "overlap_share": None, "appearance_score": None},
    ]  # fmt: skip
    merges = group_merges(table_from_rows("merges", pairs))
    assert len(merges["D1"]) == 2
    assert len(merges["D9"]) == 1
    measured = {"deviation_from_model_m": -0.034, "deviation_sigma_m": 0.005, "crack_width_mm": 0.4, "length_m": 1.5}
    sigmas = {"sigma_east_m": 0.01, "sigma_north_m": 0.02, "sigma_up_m": 0.03}
    rich = {**row, **measured, **sigmas, "position_method": "triangulated"}
    facts = dict(list_card_facts(rich, inspection, merges["D1"]))
    assert facts["deviation"] == "34 mm behind the model surface (± 5 mm)"
    assert facts["merged"] == ("1 pair (geography and image); Mahalanobis distance up to 1.2, similarity 0.71 to 0.71")
    assert facts["not merged"] == "with D9, 20 cm away: looks different"
    assert facts["site E, N, U (m)"] == "2.000, 0.000, 1.000"
    assert facts["facade u, v (m)"] == "2.000, 1.000"  # on a south wall
    assert facts["one sigma"] == "10.0 mm east, 20.0 mm north, 30.0 mm up"
    assert facts["lon, lat, height"] == "8.40000000, 48.90000000, 181.000 m (EPSG:4979)"
    assert facts["position method"] == "triangulated from its observations"
    assert facts["crack width"] == "0.40 mm"
    error = {"crack_width_mm": 2.34, "crack_width_sigma_mm": 0.42, "crack_width_max_mm": 4.06}
    assert dict(list_card_facts({**rich, **error}, inspection, []))["crack width"] == "2.3 ± 0.4 mm, maximum 4.1 mm"
    overstated = {**error, "crack_width_blur_mm": 13.4}
    assert dict(list_card_facts({**rich, **overstated}, inspection, []))["crack width"] == (
        "2.3 ± 0.4 mm, maximum 4.1 mm; may be overstated by about 13 mm (unknown blur)"
    )
    uncertain = {"severity": "severe", "severity_low": "moderate", "severity_high": "severe"}
    told = dict(list_card_facts({**rich, **uncertain}, inspection, []))["severity"]
    assert told.startswith("severe (moderate to severe), rule pack")
    bound = {"crack_width_mm": None, "crack_width_limit_mm": 3.24, "crack_width_outcome": "below_limit"}
    assert dict(list_card_facts({**rich, **bound}, inspection, []))["crack width"] == "< 3.2 mm"
    assert "crack width" not in dict(
        list_card_facts({**rich, **bound, "crack_width_outcome": "no_line"}, inspection, [])
    )
    assert "longest extent 1.50 m" in facts["size"]
