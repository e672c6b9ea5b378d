"""The rendered depth against rays, and the paper's Eq. 7 as printed."""

import numpy as np
import pytest
import shapely
import trimesh

from facadelake.camera import Camera, PosedCamera
from facadelake.frames import Similarity
from facadelake.geobim.depth_buffer import buffer_step, eye_depth
from facadelake.geobim.model import BuildingModel
from facadelake.geobim.surface import Surface
from facadelake.geobim.virtual_view import virtual_view
from facadelake.geodesy import SiteOrigin
from facadelake.tables import table_of_rows

NEAR, FAR = 2.0, 80.0


def buffer_value(depth_m):
    """What a perspective projection (Eqs. 5 and 6, OpenGL's matrix) writes into the buffer for a depth."""
    clip_z = (FAR + NEAR) / (FAR - NEAR) * depth_m - 2 * FAR * NEAR / (FAR - NEAR)
    return (clip_z / depth_m + 1) / 2


def test_equation_7_corrected_inverts_the_projection_and_as_printed_does_not():
    depth = np.linspace(NEAR, FAR, 50)
    z_s = buffer_value(depth)
    np.testing.assert_allclose(eye_depth(z_s, NEAR, FAR), depth, rtol=0, atol=1e-9)  # m
    printed = NEAR / (z_s * (FAR - NEAR) + FAR)
    assert np.abs(printed - depth).min() > 1.9  # m: wrong at every depth


def test_a_step_of_the_buffer_is_the_derivative():
    depth = np.array([3.0, 10.0, 60.0])
    up = eye_depth(buffer_value(depth) + 2.0**-24, NEAR, FAR)
    np.testing.assert_allclose(buffer_step(depth, NEAR, FAR), up - depth, rtol=0.01)


@pytest.fixture(scope="module")
def block():
    """A block of 6 x 4 x 5 m, as a building."""
    box = trimesh.creation.box(extents=[6, 4, 5])
    row = {
        "element_guid": "block", "ifc_class": "IfcWall", "facade": "S", "surface_area_m2": 148.0, "triangles": 12,
        "geometry": shapely.to_wkb(shapely.box(8.4, 48.9, 8.41, 48.91)),
    }  # fmt: skip
    return BuildingModel(
        origin=SiteOrigin(lon_deg=8.4, lat_deg=48.9, height_ellipsoidal_m=180.0), map_crs="EPSG:25832",
        vertical_datum="ellipsoidal", georeference_level="50", remarks="",
        vertices_site_m=np.asarray(box.vertices) + np.array([3.0, 20.0, 1.0]),
        triangles=np.asarray(box.faces, dtype=np.int64),
        element_of_triangle=np.zeros(12, dtype=np.int64), elements=table_of_rows("elements", [row]),
    )  # fmt: skip


def test_rendered_depth_agrees_with_rays_within_the_buffers_resolution(block):
    eye, at = np.array([-4.0, 2.0, 3.0]), np.array([3.0, 20.0, 1.0])
    z = (at - eye) / np.linalg.norm(at - eye)
    x = np.cross(z, [0, 0, 1.0]) / np.linalg.norm(np.cross(z, [0, 0, 1.0]))
    posed = PosedCamera(
        camera=Camera(width_px=400, height_px=300, fx_px=420, fy_px=415, cx_px=207.3, cy_px=146.1),
        site_from_cam=Similarity(rotation=np.array([x, np.cross(z, x), z]).T, translation=eye),
    )
    view = virtual_view(block, posed)
    rays, _ = Surface(block).depth_image(posed, 1.0)
    both = np.isfinite(rays) & np.isfinite(view.depth_m)
    assert (np.isfinite(rays) != np.isfinite(view.depth_m)).mean() < 0.005  # the outline's pixels alone
    assert both.mean() > 0.1
    # Two steps of the buffer, and float32's share in the transform of the corners.
    limit = 2 * buffer_step(rays[both], view.near_m, view.far_m) + 2e-5 * rays[both]
    error = np.abs(view.depth_m[both] - rays[both])
    assert (error < limit).mean() > 0.985  # the rest are pixels on an edge, where the renderer takes either face
    assert np.median(error) < 1e-4  # m
    assert view.colour.shape == (300, 400, 3)
    assert len(np.unique(view.colour.reshape(-1, 3), axis=0)) >= 3  # sky and two shaded faces
