"""Depth, element and target images of a wall behind a bench."""

import numpy as np
import pytest

from facadelake.building.surface.raycasting import Surface
from facadelake.building.surface.view_images import render_view_images
from facadelake.core.camera import Camera, PosedCamera
from facadelake.core.errors import InputDataError
from facadelake.core.frames import Similarity
from facadelake.core.tables import table_from_rows

# Looks along +y from the origin.
POSED = PosedCamera(
    camera=Camera(width_px=200, height_px=160, fx_px=100, fy_px=100, cx_px=100, cy_px=80, k1=-0.05),
    site_from_cam=Similarity(rotation=np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]), translation=np.zeros(3)),
)


def sheet(x, y, z):
    return np.array([[x[0], y, z[0]], [x[1], y, z[0]], [x[1], y, z[1]], [x[0], y, z[1]]], dtype=float)


@pytest.fixture
def elements():
    kinds = (("wall", "IfcWall", "Ground floor"), ("bench", "IfcFurniture", None))
    return table_from_rows(
        "elements",
        [
            {
                "element_guid": name, "ifc_class": kind, "element_name": name, "storey": storey, "facade": "S",
                "surface_area_m2": 1.0, "triangles": 2,
            }
            for name, kind, storey in kinds
        ],
    )  # fmt: skip


@pytest.fixture
def surface():
    """A wall 10 m off from x -4 to 4, a bench 5 m off before its lower half; beyond is nothing."""
    return Surface.from_mesh(
        np.vstack([sheet((-4, 4), 10, (-3, 3)), sheet((-1, 1), 5, (-2, -0.5))]),
        np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]]),
        np.array([0, 0, 1, 1]),
    )


def at(image, xyz, scale):
    """The image's value where the photograph shows a point: an independent way, by projection."""
    x, y = POSED.project_site(np.array([xyz], dtype=float))[0] * scale
    return image[int(y), int(x)]


@pytest.mark.parametrize("scale", [1.0, 0.5])
def test_each_pixel_has_depth_element_and_target(surface, elements, scale):
    images = render_view_images(POSED, surface, elements, scale)
    assert images.depth_m.shape == images.element.shape == images.target.shape == (160 * scale, 200 * scale)
    for xyz, depth, element, target in (
        ([2.5, 10, 2.0], 10.0, 0, True), ([0.5, 5, -1.2], 5.0, 1, False), ([-7, 10, 0], np.inf, -1, False),
    ):  # fmt: skip
        np.testing.assert_allclose(at(images.depth_m, xyz, scale), depth, rtol=0, atol=1e-5)  # m
        assert at(images.element, xyz, scale) == element
        assert at(images.target, xyz, scale) == target


def test_rendering_in_bands_gives_the_same_images(surface, elements, monkeypatch):
    whole = render_view_images(POSED, surface, elements, 1.0)
    monkeypatch.setattr("facadelake.building.surface.raycasting._CHUNK", 700)  # three rows and a half
    bands = render_view_images(POSED, surface, elements, 1.0)
    np.testing.assert_array_equal(bands.depth_m, whole.depth_m)
    np.testing.assert_array_equal(bands.element, whole.element)


def test_the_saved_archive_has_the_images_and_the_legend(surface, elements, tmp_path):
    images = render_view_images(POSED, surface, elements, 0.5)
    images.save(tmp_path / "view.npz")
    with np.load(tmp_path / "view.npz", allow_pickle=False) as archive:
        for name, kind in (("depth_m", np.float32), ("element", np.int32), ("target", np.bool_)):
            np.testing.assert_array_equal(archive[name], getattr(images, name))
            assert archive[name].dtype == kind
        legend = {name: archive[name][1] for name in ("element_guid", "ifc_class", "element_name", "storey")}
    assert legend == {"element_guid": "bench", "ifc_class": "IfcFurniture", "element_name": "bench", "storey": ""}


def test_a_scale_out_of_range_is_refused(surface, elements):
    with pytest.raises(InputDataError, match=r"scale of view images is 1\.5"):
        render_view_images(POSED, surface, elements, 1.5)
