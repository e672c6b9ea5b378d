"""The sheet of a view: four panels, pixel on pixel, and a legend with the numbers of visible elements."""

import numpy as np
import pyarrow as pa

from facadelake.building.surface.view_images import ViewImages
from facadelake.reporting.photo_view import ViewPanels, draw_view_sheet

HEIGHT, WIDTH = 60, 90


def draw_sheet():
    """A wall on the left half with a window in it, a bench at the bottom right, sky above it."""
    element = np.full((HEIGHT, WIDTH), -1, dtype=np.int32)
    element[:, :45] = 0
    element[20:40, 10:30] = 1
    element[45:, 60:] = 2
    depth = np.where(element >= 0, 12.5, np.inf).astype(np.float32)
    legend = pa.table(
        {
            "element_guid": ["a", "b", "c", "d"],
            "ifc_class": ["IfcWallStandardCase", "IfcWindow", "IfcFurniture", "IfcDoor"],
            "element_name": ["", "", "", ""],
            "storey": ["", "", "", ""],
        }
    )
    images = ViewImages(depth_m=depth, element=element, target=(element == 0) | (element == 1), legend=legend)
    photograph = np.full((HEIGHT, WIDTH, 3), (10, 200, 30), dtype=np.uint8)
    return draw_view_sheet(
        ViewPanels(photograph=photograph, virtual=photograph, images=images), title="Costs $5 and $6", note="a note"
    )


def render_pixels(figure):
    figure.canvas.draw()
    return np.asarray(figure.canvas.buffer_rgba())[..., :3].astype(int)


def test_panels_are_drawn_whole_pixels_large():
    figure = draw_sheet()
    picture = render_pixels(figure)
    panel = figure.axes[0].get_window_extent()
    np.testing.assert_allclose([panel.width, panel.height], [9 * WIDTH, 9 * HEIGHT], rtol=0, atol=1.0)  # px
    centre = picture[picture.shape[0] - int(panel.y0 + panel.height / 2), int(panel.x0 + panel.width / 2)]
    np.testing.assert_array_equal(centre, (10, 200, 30))


def test_the_legend_lists_visible_elements_only():
    texts = [
        text.get_text() for axes in draw_sheet().axes if axes.get_legend() for text in axes.get_legend().get_texts()
    ]
    assert texts == ["WallStandardCase (1)", "Window (1)", "not part of the building", "not in the model"]


def test_other_elements_are_grey_and_the_background_is_white():
    shown = draw_sheet().axes[-1].get_images()[0].get_array()
    np.testing.assert_allclose(shown[55, 80], [0.8, 0.8, 0.8], rtol=0, atol=1e-9)
    np.testing.assert_allclose(shown[10, 80], [1.0, 1.0, 1.0], rtol=0, atol=1e-9)
    assert np.ptp(shown[30, 20]) > 0.2  # the window has a colour of its own
    assert shown[30, 10].max() < 0.2  # and a border
