"""The rendered depth against rays, and the paper's Eq. 7 as printed."""

from dataclasses import replace

import numpy as np
import pytest
import shapely
import trimesh

from facadelake.building.ifc.meshes import mesh_elements, open_ifc
from facadelake.building.model import BuildingModel
from facadelake.building.surface.raycasting import Surface
from facadelake.building.surface.virtual_view import (
    VirtualView,
    depth_from_buffer,
    render_virtual_photograph,
    render_virtual_view,
    undistort_camera,
)
from facadelake.core.camera import Camera, PosedCamera
from facadelake.core.frames import Similarity
from facadelake.core.geodesy import SiteOrigin
from facadelake.core.tables import table_from_rows
from tests.unit.building.conftest import Box, Ifc

NEAR, FAR = 2.0, 80.0


def buffer_value(depth_m):
    """What a perspective projection (Eqs. 5 and 6, OpenGL's matrix) writes into the buffer for a depth."""
    clip_z = (FAR + NEAR) / (FAR - NEAR) * depth_m - 2 * FAR * NEAR / (FAR - NEAR)
    return (clip_z / depth_m + 1) / 2


def test_equation_7_corrected_inverts_the_projection_and_as_printed_does_not():
    depth = np.linspace(NEAR, FAR, 50)
    z_s = buffer_value(depth)
    np.testing.assert_allclose(depth_from_buffer(z_s, NEAR, FAR), depth, rtol=0, atol=1e-9)  # m
    printed = NEAR / (z_s * (FAR - NEAR) + FAR)
    assert np.abs(printed - depth).min() > 1.9  # m: wrong at every depth


def buffer_step(depth_m, near_m, far_m):
    """Spacing in metres of neighbouring values of a buffer of 24 bits at ``depth_m``."""
    return depth_m**2 * (far_m - near_m) / (far_m * near_m) / 2**24


def building(vertices, triangles, owner):
    """A building of bodies that are given in site."""
    rows = [
        {
            "element_guid": f"e{i}", "ifc_class": "IfcWall", "facade": "S", "surface_area_m2": 1.0,
            "triangles": int((owner == i).sum()), "geometry": shapely.to_wkb(shapely.box(8.4, 48.9, 8.41, 48.91)),
        }
        for i in range(int(owner.max()) + 1)
    ]  # fmt: skip
    return BuildingModel(
        origin=SiteOrigin(lon_deg=8.4, lat_deg=48.9, height_ellipsoidal_m=180.0), map_crs="EPSG:25832",
        vertical_datum="ellipsoidal", georeference_level="50", remarks="", vertices_site_m=vertices,
        triangles=triangles, element_of_triangle=owner, elements=table_from_rows("elements", rows),
    )  # fmt: skip


@pytest.fixture
def scene(write_ifc):
    """A plane behind, a sphere on the right, and on the left two walls that came out of an IFC."""
    plane = np.array([[-20, 30, -15], [25, 40, -15], [25, 40, 20], [-20, 30, 20]], dtype=float)
    ball = trimesh.creation.icosphere(subdivisions=3, radius=3)
    walls = mesh_elements(
        open_ifc(
            write_ifc(
                Ifc(boxes=(Box(size_m=(4.0, 0.3, 3.0)), Box(size_m=(0.3, 4, 3.0), corner_m=(4.0, 0.0, 0.0), name="B")))
            )
        ),
        deflection_m=0.001,
        workers=1,
    )
    parts = [
        (plane, np.array([[0, 1, 2], [0, 2, 3]])),
        (np.asarray(ball.vertices) + np.array([5.0, 20.0, 2.0]), np.asarray(ball.faces)),
        *((wall.vertices_ifc_m + np.array([-4.0, 14.0, 0.0]), wall.triangles) for wall in walls),
    ]
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    return building(
        np.vstack([vertices for vertices, _ in parts]),
        np.vstack([faces + start for (_, faces), start in zip(parts, starts[:-1], strict=True)]).astype(np.int64),
        np.repeat(np.arange(len(parts)), [len(faces) for _, faces in parts]),
    )


def looking(eye, at, camera):
    z = (np.array(at) - eye) / np.linalg.norm(np.array(at) - eye)
    x = np.cross(z, [0, 0, 1.0]) / np.linalg.norm(np.cross(z, [0, 0, 1.0]))
    rotation = np.array([x, np.cross(z, x), z]).T
    return PosedCamera(camera=camera, site_from_cam=Similarity(rotation=rotation, translation=np.array(eye)))


def ray_depths(surface, posed, width_px, height_px):
    """Depth (n,) along z, element (n,), and which pixels lie whole in one triangle, or whole off the model.

    A pixel that a triangle's edge crosses is the renderer's to give to either side: such pixels are found by rays
    through the four corners, and are not compared.
    """
    camera = posed.camera
    size = np.array([camera.width_px / width_px, camera.height_px / height_px])
    centres = (np.stack(np.meshgrid(np.arange(width_px), np.arange(height_px)), axis=-1).reshape(-1, 2) + 0.5) * size
    origins, directions = posed.rays_site_from_img(centres)
    hits = surface.cast(origins, directions)
    whole = np.ones(len(centres), dtype=bool)
    for corner in ((-0.5, -0.5), (-0.5, 0.5), (0.5, -0.5), (0.5, 0.5)):
        whole &= surface.cast(*posed.rays_site_from_img(centres + corner * size)).triangle == hits.triangle
    return hits.distance_m * (directions @ posed.site_from_cam.rotation[:, 2]), hits.element, whole


# What the buffer resolves: its rounding, and as much again from each of the float32 operations (4 of the projection,
# the division, 3 of the interpolation over the triangle) that make the value, whose own rounding is the same 2**-24.
STEPS = 8


def test_rendered_depth_agrees_with_rays_within_the_buffers_resolution(scene):
    """On a plane, a sphere and an IFC's walls; the paper's Eq. 7 as printed fails it at every pixel."""
    posed = looking(
        [-3.0, 1.0, 3.0],
        [1.0, 20.0, 1.0],
        Camera(width_px=400, height_px=300, fx_px=420, fy_px=415, cx_px=207.3, cy_px=146.1),
    )
    view = render_virtual_view(scene, posed)
    rays, element, whole = ray_depths(Surface(scene), posed, 400, 300)
    depth, met = view.depth_m.ravel(), np.isfinite(rays)
    np.testing.assert_array_equal(np.isfinite(depth)[whole], met[whole])
    for body in range(4):
        one = whole & (element == body)
        assert one.sum() > 500
        steps = np.abs(depth[one] - rays[one]) / buffer_step(rays[one], view.near_m, view.far_m)
        assert steps.max() < STEPS
        assert steps.max() > 0.1  # it is a depth buffer, not the rays again
    both = whole & met
    printed = view.near_m / (view.buffer.ravel()[both] * (view.far_m - view.near_m) + view.far_m)
    assert (np.abs(printed - rays[both]) > STEPS * buffer_step(rays[both], view.near_m, view.far_m)).all()
    assert view.colour.shape == (300, 400, 3)
    assert len(np.unique(view.colour.reshape(-1, 3), axis=0)) >= 4  # sky, and shaded faces


def render_by_rays(building, posed, *, scale):
    """Replaces the renderer by rays of a camera without distortion, because the test is of the resampling."""
    depth, _ = Surface(building).render_depth(posed, scale)
    buffer = np.where(np.isfinite(depth), buffer_value(np.where(np.isfinite(depth), depth, NEAR)), 1.0)
    return VirtualView(colour=np.zeros((*depth.shape, 3), dtype=np.uint8), buffer=buffer, near_m=NEAR, far_m=FAR)


def test_a_virtual_photograph_has_the_photographs_distortion(scene, monkeypatch):
    """Half the size, 30 px of barrel distortion at the corner: its depths are those of the photograph's own rays."""
    monkeypatch.setattr("facadelake.building.surface.virtual_view.render_virtual_view", render_by_rays)
    camera = Camera(
        width_px=800, height_px=600, fx_px=840, fy_px=830, cx_px=414.6, cy_px=292.2, k1=-0.18, k2=0.03, p1=0.001,
        p2=-0.001,
    )  # fmt: skip
    posed = looking([-3.0, 1.0, 3.0], [1.0, 20.0, 1.0], camera)
    view = render_virtual_photograph(scene, posed, scale=0.5)
    rays, _, whole = ray_depths(Surface(scene), posed, 400, 300)
    depth = view.depth_m.ravel()
    met = whole & np.isfinite(rays) & np.isfinite(depth)
    assert met.mean() > 0.7
    # The nearest rendered pixel is half a pixel off, across and down: the depth may change by that much over the image.
    image = rays.reshape(300, 400)
    slope = sum(np.abs(np.gradient(np.where(np.isfinite(image), image, 0.0), axis=axis)) for axis in (0, 1)).ravel()
    error = np.abs(depth[met] - rays[met])
    assert np.mean(error <= 0.75 * slope[met] + 1e-4) > 0.999
    undistorted = looking([-3.0, 1.0, 3.0], [1.0, 20.0, 1.0], replace(camera, k1=0.0, k2=0.0, p1=0.0, p2=0.0))
    plain, _, _ = ray_depths(Surface(scene), undistorted, 400, 300)
    both = met & np.isfinite(plain)
    assert np.median(np.abs(plain[both] - rays[both])) > 5 * np.median(
        np.abs(depth[both] - rays[both])
    )  # the difference is the distortion


def test_the_undistorted_camera_covers_every_pixel_of_the_photograph():
    camera = Camera(width_px=800, height_px=600, fx_px=840, fy_px=830, cx_px=414.6, cy_px=292.2, k1=0.1, p1=0.002)
    undistorted = undistort_camera(camera)
    border = np.array([[0, 0], [800, 0], [0, 600], [800, 600], [400, 0], [0, 300], [800, 300], [400, 600]], dtype=float)
    assert undistorted.is_inside(undistorted.project(camera.rays_cam_from_img(border))).all()
    plain = Camera(width_px=800, height_px=600, fx_px=840, fy_px=830, cx_px=414.6, cy_px=292.2)
    assert abs(undistort_camera(plain).width_px - 800) <= 4  # px: no more than is needed
