"""Patches on surfaces of known shape: masks and boxes, flat, round a corner, behind a railing, in a deep window."""

from dataclasses import replace

import numpy as np
import pytest
import shapely

from facadelake.building.model import BuildingModel
from facadelake.building.surface.raycasting import Surface
from facadelake.core.tables import table_from_rows
from facadelake.registration.observation import observe_detections
from facadelake.registration.patch import convert_patches_to_wkb
from facadelake.registration.settings import RegistrationSettings
from tests.unit.registration.wall_scene import look_at, make_rectangle

SETTINGS = RegistrationSettings()
AHEAD = look_at([0.0, -10.0, 2.0], [0.0, 0.0, 2.0])
OBLIQUE = look_at([-8.0, -6.0, 4.0], [0.0, 0.0, 2.0])


def building_of(wall: BuildingModel, *parts: tuple[str, str, str | None, np.ndarray]) -> BuildingModel:
    """A building of rectangles: (guid, ifc_class, host_guid, corners (4, 3)); parts with one guid are one element."""
    guids = list(dict.fromkeys(guid for guid, *_ in parts))
    first = {guid: (kind, host) for guid, kind, host, _ in reversed(parts)}
    rows = [
        {
            "element_guid": guid, "ifc_class": first[guid][0], "host_guid": first[guid][1], "facade": "S",
            "surface_area_m2": 1.0, "triangles": 2, "storey": "Ground floor",
        }
        for guid in guids
    ]  # fmt: skip
    corner = 4 * np.arange(len(parts))[:, None, None]
    return replace(
        wall,
        vertices_site_m=np.vstack([corners for *_, corners in parts]),
        triangles=(corner + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3),
        element_of_triangle=np.repeat([guids.index(guid) for guid, *_ in parts], 2),
        elements=table_from_rows("elements", rows),
    )


def masked(detections, *outlines_img):
    """The detections, each with a mask and the box about it."""
    rows = detections.to_pylist()
    for row, outline in zip(rows, outlines_img, strict=True):
        left, top, right, bottom = outline.bounds
        row |= {"mask": shapely.to_wkt(outline, rounding_precision=6), "box_x_px": left, "box_y_px": top}
        row |= {"box_width_px": right - left, "box_height_px": bottom - top}
    return table_from_rows("detections", rows)


def seen_as(posed, corners_site):
    """A polygon on the building as the photograph shows it; its sides are followed, for the lens may bend them."""
    shape = shapely.segmentize(shapely.Polygon(corners_site[:, [0, 2]]), 0.02)
    xz = shapely.get_coordinates(shape)
    return shapely.Polygon(posed.project_site(np.column_stack([xz[:, 0], np.zeros(len(xz)), xz[:, 1]])))


def box_about(posed, corners_site):
    low, high = (f(posed.project_site(corners_site), axis=0) for f in (np.min, np.max))
    return (low[0], low[1], *(high - low))


def only(table):
    [row] = table.to_pylist()
    return row


def xyz(row):
    return np.array([row["x_site_m"], row["y_site_m"], row["z_site_m"]])


def patches_in_site(patches, origin):
    """Column ``patch`` (WKB in EPSG:4979) as polygons in site metres."""
    return shapely.transform(shapely.from_wkb(patches), origin.site_from_geo, include_z=True)


def patch_in_site(row, building):
    return patches_in_site([row["patch"]], building.origin)[0]


CRACK = np.array([[-1.0, 0, 1.2], [0.2, 0, 2.1], [0.2, 0, 2.112], [-1.0, 0, 1.212]])  # 1.5 m long, 12 mm high


@pytest.mark.parametrize("posed", [AHEAD, OBLIQUE], ids=["ahead", "oblique"])
def test_an_inclined_cracks_length_area_and_centre_do_not_depend_on_the_view(wall, detections_of, posed):
    made = masked(detections_of(("a", "p", "crack", (0, 0, 1, 1))), seen_as(posed, CRACK))
    row = only(observe_detections(made, {"p": posed}, wall, Surface(wall), SETTINGS))
    assert row["observation_outcome"] == "registered"
    np.testing.assert_allclose(row["length_m"], np.hypot(1.2, 0.912), rtol=0, atol=1e-3)  # m
    np.testing.assert_allclose(row["area_m2"], 1.2 * 0.012, rtol=0, atol=1e-4)  # m2
    np.testing.assert_allclose([row["width_m"], row["height_m"]], [1.2, 0.912], rtol=0, atol=1e-3)  # m
    # The centroid of the pixels is 1 cm and more nearer to an oblique camera; that of the surface is not.
    np.testing.assert_allclose(xyz(row), [-0.4, 0, 1.656], rtol=0, atol=0.001)  # m
    outline = patch_in_site(row, wall)
    flat = shapely.Polygon(shapely.get_coordinates(outline, include_z=True)[:, [0, 2]])
    true = shapely.Polygon(CRACK[:, [0, 2]])
    assert shapely.area(shapely.symmetric_difference(flat, true)) < 0.02 * true.area  # m2
    assert np.abs(shapely.get_coordinates(outline, include_z=True)[:, 1]).max() < 1e-5  # m off the wall


def test_a_crack_width_in_pixels_is_measured_across_the_crack(wall, detections_of):
    """From 53 deg aside the wall is squeezed along x alone: an upright crack's pixel is wider than a level one's."""
    upright = np.array([[-0.01, 0, 1.5], [0.01, 0, 1.5], [0.01, 0, 2.5], [-0.01, 0, 2.5]])
    level = np.array([[-0.5, 0, 1.99], [0.5, 0, 1.99], [0.5, 0, 2.01], [-0.5, 0, 2.01]])
    aside = look_at([-8.0, -6.0, 2.0], [0.0, 0.0, 2.0])
    made = detections_of(*[(name, "p", "crack", (0, 0, 1, 1)) for name in ("level", "upright")], crack_width_px=2.0)
    made = masked(made, seen_as(aside, level), seen_as(aside, upright))
    wide = {
        row["detection_id"]: row["crack_width_mm"]
        for row in observe_detections(made, {"p": aside}, wall, Surface(wall), SETTINGS).to_pylist()
    }
    np.testing.assert_allclose(wide["level"], 2 * 10000 / 1500, rtol=0.01, atol=0)  # mm: two pixels at 10 m
    np.testing.assert_allclose(wide["upright"], 2 * 10000 / 1500 / 0.6, rtol=0.01, atol=0)  # mm
    box = detections_of(("a", "p", "crack", (990, 740, 20, 20)), crack_width_px=2.0)
    of_box = only(observe_detections(box, {"p": aside}, wall, Surface(wall), SETTINGS))["crack_width_mm"]
    np.testing.assert_allclose(of_box, 2 * 10000 / 1500 / np.sqrt(0.6), rtol=0.01, atol=0)  # mm
    without = detections_of(("a", "p", "crack", (990, 740, 20, 20)))
    assert only(observe_detections(without, {"p": aside}, wall, Surface(wall), SETTINGS))["crack_width_mm"] is None


def test_a_mask_in_pieces_is_one_patch_of_its_pieces(wall, detections_of):
    halves = [np.array([[x, 0, 1.0], [x + 0.3, 0, 1.0], [x + 0.3, 0, 1.1], [x, 0, 1.1]]) for x in (-0.5, 0.2)]
    outline = shapely.MultiPolygon([seen_as(AHEAD, half) for half in halves])
    made = masked(detections_of(("a", "p", "crack", (0, 0, 1, 1))), outline)
    row = only(observe_detections(made, {"p": AHEAD}, wall, Surface(wall), SETTINGS))
    np.testing.assert_allclose(row["area_m2"], 0.06, rtol=0, atol=6e-4)  # m2
    np.testing.assert_allclose(row["width_m"], 1.0, rtol=0, atol=1e-3)  # m
    np.testing.assert_allclose(xyz(row), [0, 0, 1.05], rtol=0, atol=0.001)  # m
    assert len(patch_in_site(row, wall).geoms) == 2


def test_a_boxs_patch_is_its_four_corners_on_the_wall(wall, detections_of):
    row = only(
        observe_detections(
            detections_of(("a", "p", "crack", (700, 600, 90, 60))), {"p": OBLIQUE}, wall, Surface(wall), SETTINGS
        )
    )
    corners = shapely.get_coordinates(patch_in_site(row, wall), include_z=True)
    assert len(corners) == 5
    pixels = OBLIQUE.project_site(corners)
    box = shapely.box(700, 600, 790, 660)
    assert shapely.area(shapely.symmetric_difference(shapely.Polygon(pixels), box)) < 0.01  # px2
    flat = shapely.Polygon(corners[:, [0, 2]])
    np.testing.assert_allclose(row["area_m2"], flat.area, rtol=1e-3, atol=0)  # m2
    sides = corners[:4, None] - corners[None, :4]
    np.testing.assert_allclose(row["length_m"], np.linalg.norm(sides, axis=-1).max(), rtol=0, atol=1e-4)  # m


def test_a_patch_goes_round_a_corner_and_both_sides_count(wall, detections_of):
    """A wall's corner at x = 0, seen across its edge: half of the crack is on each side."""
    corner = building_of(
        wall,
        ("south", "IfcWall", None, make_rectangle([-5, 0, 0], [5, 0, 0], [0, 0, 4])),
        ("east", "IfcWall", None, make_rectangle([0, 0, 0], [0, 5, 0], [0, 0, 4])),
    )
    posed = look_at([7.0, -7.0, 2.0], [0.0, 0.0, 2.0])
    ends = np.array([[-0.4, 0, 1.9], [-0.4, 0, 2.1], [0, 0.6, 1.9], [0, 0.6, 2.1]])
    made = detections_of(("a", "p", "crack", box_about(posed, ends)))
    row = only(observe_detections(made, {"p": posed}, corner, Surface(corner), SETTINGS))
    assert row["element_guid"] == "east"  # the box's centre is there
    outline = shapely.get_coordinates(patch_in_site(row, corner), include_z=True)
    on_south, on_east = np.abs(outline[:, 1]) < 1e-4, np.abs(outline[:, 0]) < 1e-4
    assert (on_south | on_east).all() and on_south.any() and on_east.any()
    np.testing.assert_allclose([outline[:, 0].min(), outline[:, 1].max()], [-0.4, 0.6], rtol=0, atol=0.02)  # m
    # As high as the ends in pixels, which nearer by at the corner are fewer millimetres.
    assert 0.19 < row["area_m2"] < 0.2
    np.testing.assert_allclose(row["length_m"], np.hypot(np.hypot(0.4, 0.6), 0.21), rtol=0, atol=0.02)  # m


def test_a_defect_behind_a_railing_is_on_the_wall_although_the_centre_ray_hits_a_bar(wall, detections_of):
    bars = [
        ("railing", "IfcRailing", None, make_rectangle([x - 0.01, -1.5, 0], [0.02, 0, 0], [0, 0, 3]))
        for x in (-0.2, 0.0, 0.2)
    ]
    building = building_of(wall, ("wall", "IfcWall", None, make_rectangle([-10, 0, 0], [20, 0, 0], [0, 0, 6])), *bars)
    made = detections_of(("a", "p", "crack", (1000 - 45, 750 - 30, 90, 60)))
    row = only(observe_detections(made, {"p": AHEAD}, building, Surface(building), SETTINGS))
    assert row["element_guid"] == "wall"
    np.testing.assert_allclose(xyz(row), [0, 0, 2], rtol=0, atol=1e-6)  # m: where the centre ray would hit the wall
    np.testing.assert_allclose(row["width_m"], 0.6, rtol=0, atol=1e-3)  # m
    assert patch_in_site(row, building).area < 0.6 * 0.4  # the bars are cut out


def deep_window(wall, depth_m=0.25):
    """A wall with a window of 1 m x 1 m, 1 to 2 m up, whose glass lies ``depth_m`` behind the wall; reveals all round.

    A lining of the window, 2 cm off the reveal, stands on its left side.
    """
    d = depth_m
    return building_of(
        wall,
        ("wall", "IfcWall", None, make_rectangle([-5, 0, 0], [4.5, 0, 0], [0, 0, 4])),
        ("wall", "IfcWall", None, make_rectangle([0.5, 0, 0], [4.5, 0, 0], [0, 0, 4])),
        ("wall", "IfcWall", None, make_rectangle([-0.5, 0, 0], [1, 0, 0], [0, 0, 1])),
        ("wall", "IfcWall", None, make_rectangle([-0.5, 0, 2], [1, 0, 0], [0, 0, 2])),
        ("wall", "IfcWall", None, make_rectangle([-0.5, 0, 1], [0, d, 0], [0, 0, 1])),
        ("wall", "IfcWall", None, make_rectangle([0.5, 0, 1], [0, d, 0], [0, 0, 1])),
        ("wall", "IfcWall", None, make_rectangle([-0.5, 0, 1], [1, 0, 0], [0, d, 0])),
        ("wall", "IfcWall", None, make_rectangle([-0.5, 0, 2], [1, 0, 0], [0, d, 0])),
        ("window", "IfcWindow", "wall", make_rectangle([-0.5, d, 1], [1, 0, 0], [0, 0, 1])),
        ("window", "IfcWindow", "wall", make_rectangle([-0.48, 0.02, 1], [0, d - 0.02, 0], [0, 0, 1])),
    )


def element_under(building, detections_of, posed, corners_site):
    made = detections_of(("a", "p", "crack", box_about(posed, np.asarray(corners_site, dtype=float))))
    row = only(observe_detections(made, {"p": posed}, building, Surface(building), SETTINGS))
    assert row["observation_outcome"] == "registered"
    return row


def test_what_is_mostly_on_the_wall_beside_a_deep_window_is_on_the_wall_and_in_its_plane(wall, detections_of):
    building = deep_window(wall)
    # 0.14 m of the box lie on the wall, 0.10 m over the opening, where the rays go on to the glass.
    row = element_under(building, detections_of, AHEAD, [[0.40, 0, 1.4], [0.64, 0, 1.4], [0.64, 0, 1.6]])
    assert row["element_guid"] == "wall"
    np.testing.assert_allclose(row["y_site_m"], 0.0, rtol=0, atol=1e-6)  # m


def test_what_is_on_a_windows_frame_stays_on_the_window(wall, detections_of):
    row = element_under(deep_window(wall), detections_of, AHEAD, [[0.1, 0.25, 1.2], [0.4, 0.25, 1.2], [0.4, 0.25, 1.4]])
    assert row["element_guid"] == "window"
    np.testing.assert_allclose(row["y_site_m"], 0.25, rtol=0, atol=1e-6)  # m


def test_what_is_on_a_reveal_is_on_the_wall_that_hosts_the_window(wall, detections_of):
    building = deep_window(wall)
    from_left, from_right = look_at([-6, -6, 1.5], [0.5, 0.1, 1.5]), look_at([6, -6, 1.5], [-0.5, 0.1, 1.5])
    bare = element_under(building, detections_of, from_left, [[0.5, 0.05, 1.4], [0.5, 0.2, 1.4], [0.5, 0.2, 1.6]])
    assert bare["element_guid"] == "wall"
    # The lining is within the model's tolerance of the reveal, so a defect there is as likely on the wall.
    lined = element_under(
        building, detections_of, from_right, [[-0.48, 0.05, 1.4], [-0.48, 0.2, 1.4], [-0.48, 0.2, 1.6]]
    )
    assert lined["element_guid"] == "wall"
    strict = replace(SETTINGS, model_sigma_m=0.005)
    box = box_about(from_right, np.array([[-0.48, 0.05, 1.4], [-0.48, 0.2, 1.4], [-0.48, 0.2, 1.6]]))
    made = detections_of(("a", "p", "crack", box))
    assert (
        only(observe_detections(made, {"p": from_right}, building, Surface(building), strict))["element_guid"]
        == "window"
    )


def test_patches_come_back_from_the_globe_where_they_were(wall):
    polygons = shapely.from_wkt(
        ["POLYGON Z ((0 0 1, 1 0 1, 1 0 2, 0 0 2, 0 0 1))", "MULTIPOLYGON Z (((5 5 1, 6 5 1, 6 6 2, 5 5 1)))"]
    )
    there = convert_patches_to_wkb(polygons, wall.origin)
    lon_lat = shapely.get_coordinates(shapely.from_wkb(there))
    np.testing.assert_allclose(lon_lat, [[8.4078, 48.9405]] * len(lon_lat), rtol=0, atol=2e-4)  # deg
    assert shapely.equals_exact(patches_in_site(there, wall.origin), polygons, tolerance=1e-6).all()  # m


def test_a_mask_beside_its_box_leaves_the_box(wall, detections_of):
    made = detections_of(("a", "p", "crack", (900, 700, 30, 30)), mask="POLYGON ((0 0, 10 0, 10 10, 0 0))")
    plain = detections_of(("a", "p", "crack", (900, 700, 30, 30)))
    assert observe_detections(made, {"p": AHEAD}, wall, Surface(wall), SETTINGS).equals(
        observe_detections(plain, {"p": AHEAD}, wall, Surface(wall), SETTINGS)
    )


def test_a_mask_that_runs_over_a_jump_has_the_outline_and_area_of_its_part_on_the_wall(wall, detections_of):
    """The wall ends at x = 0.5; another one begins there 2 m behind, so that no reveal joins them."""
    building = building_of(
        wall,
        ("wall", "IfcWall", None, make_rectangle([0.5, 0, 0], [4.5, 0, 0], [0, 0, 4])),
        ("behind", "IfcWall", None, make_rectangle([-5, 2, 0], [10, 0, 0], [0, 0, 4])),
    )
    crack = np.array([[0.2, 0, 1.3], [1.2, 0, 1.8], [1.2, 0, 1.83], [0.2, 0, 1.33]])  # 0.7 m of it on the wall
    made = masked(detections_of(("a", "p", "crack", (0, 0, 1, 1))), seen_as(AHEAD, crack))
    row = only(observe_detections(made, {"p": AHEAD}, building, Surface(building), SETTINGS))
    assert row["element_guid"] == "wall"
    assert row["target_share"] == 1.0
    outline = shapely.Polygon(shapely.get_coordinates(patch_in_site(row, building), include_z=True)[:, [0, 2]])
    pitch_m = np.sqrt(0.03 / 121)
    np.testing.assert_allclose(outline.bounds[0], 0.5, rtol=0, atol=1.5 * pitch_m)  # m: a cell and half its neighbour
    np.testing.assert_allclose(row["area_m2"], 0.7 * 0.03, rtol=0, atol=0.03 * pitch_m)  # m2
    np.testing.assert_allclose(row["area_m2"], outline.area, rtol=0, atol=0.03 * pitch_m)  # m2
    np.testing.assert_allclose(xyz(row), [0.85, 0, 1.64], rtol=0, atol=pitch_m)  # m


def test_a_defect_mostly_on_the_wall_is_in_its_plane_although_its_centre_is_over_the_opening(wall, detections_of):
    """From the left the reveal is visible, so wall, reveal and glass are continuous; the centre ray hits the reveal."""
    building = deep_window(wall)
    posed = look_at([-3, -9, 1.5], [0.5, 0, 1.5])
    corners = np.array([[0.15, 0, 1.4], [0.8, 0, 1.4], [0.8, 0, 1.6]])
    made = detections_of(("a", "p", "crack", box_about(posed, corners)))
    row = only(observe_detections(made, {"p": posed}, building, Surface(building), SETTINGS))
    assert (row["observation_outcome"], row["element_guid"]) == ("registered", "wall")
    np.testing.assert_allclose([row["normal_x"], row["normal_y"]], [0, -1], rtol=0, atol=1e-9)
    np.testing.assert_allclose(row["y_site_m"], 0.0, rtol=0, atol=1e-6)  # m
    # The ray itself hits the reveal.
    [[column, line]] = posed.project_site(np.array([xyz(row)]))
    met = Surface(building).cast(*posed.rays_site_from_img(np.array([[column, line]])))
    assert met.xyz_site_m[0, 1] > 0.01  # m


def test_through_a_lens_that_bends_a_boxs_area_is_that_of_its_corners(wall, detections_of):
    bent = replace(OBLIQUE, camera=replace(OBLIQUE.camera, k1=-0.12, k2=0.05, p1=3e-3, p2=-2e-3, fy_px=1470.0))
    for box in ((250.0, 300.0, 30.0, 20.0), (1000.0, 1000.0, 20.0, 30.0)):
        row = only(
            observe_detections(detections_of(("a", "p", "crack", box)), {"p": bent}, wall, Surface(wall), SETTINGS)
        )
        corners = shapely.get_coordinates(patch_in_site(row, wall), include_z=True)
        np.testing.assert_allclose(row["area_m2"], shapely.Polygon(corners[:, [0, 2]]).area, rtol=1e-3, atol=0)  # m2


def test_no_detections_make_no_observations(wall, detections_of):
    assert len(observe_detections(detections_of(), {"p": AHEAD}, wall, Surface(wall), SETTINGS)) == 0
    one = detections_of(("a", "elsewhere", "crack", (0, 0, 10, 10)))
    assert only(observe_detections(one, {}, wall, Surface(wall), SETTINGS))["observation_outcome"] == "unlocalised"
