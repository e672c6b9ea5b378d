"""Images of a COCO file without a size: whether their boxes can be of the photographs as stored.

COCO wants width and height of each image. Without them nothing tells boxes of a resized or turned copy from those of
the photograph, but the boxes themselves.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Protocol

from facadelake.core.errors import InputDataError
from facadelake.detection.coco.coco_records import CocoFile, CocoImage, parse_box_values

# Detectors let boxes overhang the border by less than this share of the photograph.
_OVERHANG_SHARE = 0.02
# So many boxes in so many photographs do not all lie in the upper left quarter by chance (1 in 65,000).
_QUARTER_SHARE, _MIN_BOXES, _MIN_IMAGES = 0.5, 8, 3
_REMEDY = "state width and height of each entry of 'images', or export boxes of the original photographs"


_End = tuple[int | str, int | str, float, float]


class _Sized(Protocol):
    """A photograph with its size as stored, px."""

    @property
    def width_px(self) -> int: ...

    @property
    def height_px(self) -> int: ...

    @property
    def orientation(self) -> int: ...


def is_size_stated(image: CocoImage) -> bool:
    """Whether the file states width and height of an image."""
    return image.width_px is not None and image.height_px is not None


def find_boxes_of_another_size(coco: CocoFile, photographs: Mapping[int | str, _Sized]) -> dict[int | str, str]:
    """Images without a size that have a box beyond their photograph, by id, with the reason why none is used."""
    reasons: dict[int | str, str] = {}
    for image_id, annotation_id, right, bottom in _list_ends(coco, photographs):
        photograph, image = photographs[image_id], coco.images[image_id]
        if max(right / photograph.width_px, bottom / photograph.height_px) <= 1 + _OVERHANG_SHARE:
            continue
        is_turned = right <= photograph.height_px and bottom <= photograph.width_px
        reasons.setdefault(
            image_id,
            f"annotation {annotation_id} on {image.file_name} ends at {right:g}, {bottom:g}, outside the photograph "
            f"({photograph.width_px} x {photograph.height_px} px), and the file states no size of the image: boxes of "
            f"a {'turned' if is_turned else 'resized'} photograph? {_REMEDY}",
        )
    return reasons


def refuse_boxes_of_smaller_copies(coco: CocoFile, photographs: Mapping[int | str, _Sized]) -> None:
    """Raise InputDataError where all boxes on images without a size lie in the upper left quarter of photographs."""
    ends = list(_list_ends(coco, photographs))
    largest = _measure_upper_left(ends, photographs)
    if largest is not None:
        raise InputDataError(
            f"detections file {coco.path}: it states no size of its images, and all {len(ends)} boxes on them end "
            f"within {largest:.0%} of the width and height of their photographs, at the upper left: boxes of resized "
            f"photographs? {_REMEDY}"
        )


def describe_boxes_of_smaller_copies(coco: CocoFile, photographs: Mapping[int | str, _Sized]) -> str:
    """The remark where all boxes, of images with a size, lie in the upper left quarter of photographs; else empty."""
    ends = list(_list_ends_of_all(coco, photographs))
    largest = _measure_upper_left(ends, photographs)
    if largest is None:
        return ""
    return (
        f"all {len(ends)} boxes of the file end within {largest:.0%} of the width and height of their photographs, at "
        "the upper left: boxes of resized photographs, whose size the file does not state?"
    )


def _measure_upper_left(ends: Sequence[_End], photographs: Mapping[int | str, _Sized]) -> float | None:
    """The largest share of a photograph's width or height at which one of many boxes ends; None if it is not small."""
    if len(ends) < _MIN_BOXES or len({image_id for image_id, *_ in ends}) < _MIN_IMAGES:
        return None
    largest = max(
        max(right / photographs[image_id].width_px, bottom / photographs[image_id].height_px)
        for image_id, _, right, bottom in ends
    )
    return largest if largest <= _QUARTER_SHARE else None


def _list_ends_of_all(coco: CocoFile, photographs: Mapping[int | str, _Sized]) -> Iterator[_End]:
    """Image, annotation, right and bottom of the boxes of photographs that EXIF leaves as they are."""
    for annotation in coco.annotations:
        photograph, box = photographs.get(annotation.image_id), parse_box_values(annotation.bbox)
        if photograph is not None and box is not None and photograph.orientation == 1:
            yield annotation.image_id, annotation.annotation_id, box[0] + box[2], box[1] + box[3]


def _list_ends(coco: CocoFile, photographs: Mapping[int | str, _Sized]) -> Iterator[_End]:
    """Those of the boxes on images without a size."""
    return (end for end in _list_ends_of_all(coco, photographs) if not is_size_stated(coco.images[end[0]]))
