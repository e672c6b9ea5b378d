"""Boxes of photographs that EXIF turns: of the pixels as stored, or of the photograph as displayed.

Viewers and annotation tools turn a photograph by its EXIF orientation; Facadelake uses the pixels as stored. The size
of the image in the COCO file tells which view its boxes are of, where the orientation exchanges width and height.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import shapely
import shapely.affinity

from facadelake.detection.boxes import ROUNDING_PX, Box
from facadelake.detection.coco.coco_records import CocoFile, CocoImage, parse_box_values
from facadelake.detection.coco.unstated_size import find_boxes_of_another_size
from facadelake.registry import ExifView

AS_STORED = 1
# x, y as stored of u, v as displayed: coefficients of u, v, width, height and of u, v, width, height (EXIF 3.0, 4.6.4).
_STORED_FROM_DISPLAYED = {
    1: ((1, 0, 0, 0), (0, 1, 0, 0)),
    2: ((-1, 0, 1, 0), (0, 1, 0, 0)),
    3: ((-1, 0, 1, 0), (0, -1, 0, 1)),
    4: ((1, 0, 0, 0), (0, -1, 0, 1)),
    5: ((0, 1, 0, 0), (1, 0, 0, 0)),
    6: ((0, 1, 0, 0), (-1, 0, 0, 1)),
    7: ((0, -1, 1, 0), (-1, 0, 0, 1)),
    8: ((0, -1, 1, 0), (1, 0, 0, 0)),
}
_FIRST_TRANSPOSED = 5


@dataclass(frozen=True, kw_only=True)
class StoredImage:
    """Size of a photograph as stored, px, and its EXIF orientation (1 to 8; 1 where EXIF states none)."""

    width_px: int
    height_px: int
    orientation: int = AS_STORED

    @property
    def displayed_size(self) -> tuple[int, int]:
        """Width and height of the photograph as displayed."""
        size = (self.width_px, self.height_px)
        return size if self.orientation < _FIRST_TRANSPOSED else size[::-1]


@dataclass(frozen=True, kw_only=True)
class BoxView:
    """The view that the boxes of an image are of: its size, None where unknown, and the way back to the stored pixels.

    ``to_stored``: shapely's affine coefficients, None where the view is that of the stored pixels.
    """

    width_px: float | None = None
    height_px: float | None = None
    to_stored: tuple[float, ...] | None = None

    def map_shape(self, shape: Any) -> Any:
        """A shape in pixels of the view, in pixels as stored."""
        return shape if self.to_stored is None else shapely.affinity.affine_transform(shape, self.to_stored)

    def map_box(self, box: Box) -> Box:
        """A box in pixels of the view, in pixels as stored."""
        if self.to_stored is None:
            return box
        corners = shapely.box(box.x_px, box.y_px, box.x_px + box.width_px, box.y_px + box.height_px)
        left, top, right, bottom = self.map_shape(corners).bounds
        return Box(x_px=left, y_px=top, width_px=right - left, height_px=bottom - top)


def find_views(
    coco: CocoFile, photographs: Mapping[int | str, StoredImage], exif_view: ExifView | None
) -> Mapping[int | str, BoxView | str]:
    """The view of each image with a photograph, by image id, or the reason why its boxes cannot be used.

    Args:
        coco: The file.
        photographs: The photographs by image id.
        exif_view: The view of the boxes of photographs that EXIF turns; None: as the sizes in the file tell.
    """
    contradiction = "" if exif_view else _find_contradiction(coco, photographs)
    unlike = find_boxes_of_another_size(coco, photographs)
    return {
        image_id: unlike.get(image_id) or _find_view(coco.images[image_id], photograph, exif_view, contradiction)
        for image_id, photograph in photographs.items()
    }


def _find_view(
    image: CocoImage, photograph: StoredImage, exif_view: ExifView | None, contradiction: str
) -> BoxView | str:
    stored, displayed = (photograph.width_px, photograph.height_px), photograph.displayed_size
    is_stated = None not in (image.width_px, image.height_px)
    stated = (image.width_px, image.height_px) if is_stated else stored
    if stated not in (stored, displayed):
        return (
            f"the file states an image of {stated[0]:g} x {stated[1]:g} px, the photograph has {stored[0]} x "
            f"{stored[1]} px; export boxes of the original photograph, neither rotated nor resized"
        )
    if photograph.orientation == AS_STORED:
        return BoxView(width_px=stored[0], height_px=stored[1])
    view = exif_view
    if view is None and is_stated and stored != displayed and not contradiction:
        view = ExifView.STORED if stated == stored else ExifView.DISPLAYED
    if view is None:
        return (
            f"EXIF turns the photograph (orientation {photograph.orientation}), and "
            f"{contradiction or 'the size in the file does not tell'} whether boxes are of the pixels as stored or as "
            "displayed; set exif_view of the building's detector to stored or displayed"
        )
    if view is ExifView.STORED:
        return BoxView(width_px=stored[0], height_px=stored[1])
    (a, b, *of_x), (d, e, *of_y) = _STORED_FROM_DISPLAYED[photograph.orientation]
    shift = [one[0] * stored[0] + one[1] * stored[1] for one in (of_x, of_y)]
    return BoxView(width_px=displayed[0], height_px=displayed[1], to_stored=(a, b, d, e, *shift))


def _find_contradiction(coco: CocoFile, photographs: Mapping[int | str, StoredImage]) -> str:
    """A box that is inside the displayed photograph alone, though the file states the size as stored; else empty."""
    for annotation in coco.annotations:
        photograph, box = photographs.get(annotation.image_id), parse_box_values(annotation.bbox)
        if photograph is None or photograph.orientation == AS_STORED or box is None:
            continue
        image, stored = coco.images[annotation.image_id], (photograph.width_px, photograph.height_px)
        end = (box[0] + box[2], box[1] + box[3])
        is_stated_as_stored = image.width_px == stored[0] and image.height_px == stored[1]
        if is_stated_as_stored and not _is_inside(end, stored) and _is_inside(end, photograph.displayed_size):
            return (
                f"annotation {annotation.annotation_id} on {image.file_name} leaves the {stored[0]} x {stored[1]} px "
                "that the file states, so sizes do not tell"
            )
    return ""


def _is_inside(end: tuple[float, float], size: tuple[int, int]) -> bool:
    return end[0] <= size[0] + ROUNDING_PX and end[1] <= size[1] + ROUNDING_PX
