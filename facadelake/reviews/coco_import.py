"""Reviews from a corrected COCO file: its annotations are compared with the items that the reviewer was shown.

Annotation tools renumber annotations and drop attributes that they do not know. An annotation is therefore matched by
its box and class; where it still has the attribute ``subject``, that decides.
"""

from __future__ import annotations

import logging
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import shapely

from facadelake.core.errors import InputDataError
from facadelake.core.photo_names import PhotoNames
from facadelake.detection import Box, Crosswalk, clip_box
from facadelake.detection.coco import (
    BoxView,
    CocoAnnotation,
    StoredImage,
    find_views,
    fit_mask,
    parse_shape,
    polygons_from_wkt,
    read_coco,
)
from facadelake.reviews.box_matching import compute_iou, corners_from_boxes, pair_greedily
from facadelake.reviews.review import ParsedReviews, Review
from facadelake.reviews.review_items import ReviewItem, ReviewProvenance, create_missed_review, create_review
from schemas.vocabulary import DefectClass, Verdict

_log = logging.getLogger(__name__)

_SAME_BOX_IOU_MIN = 0.3  # below it the box is another one
_UNCHANGED_IOU_MIN = 0.95  # of box or mask: annotation tools round coordinates
_UNCHANGED_PX = 1.0  # of a small box: its sides moved by a pixel at most


@dataclass(frozen=True, kw_only=True)
class _DrawnBox:
    """A usable annotation: box in px of the photograph, mask in WKT, subject where the tool kept it."""

    photo_id: str
    box: Box
    defect_class: DefectClass
    mask: str | None
    subject: str | None


def read_coco_reviews(
    file: Path,
    items: Sequence[ReviewItem],
    photographs: Mapping[str, StoredImage],
    crosswalk: Crosswalk,
    provenance: ReviewProvenance,
    *,
    deletions_count: bool,
) -> ParsedReviews:
    """Compare the annotations of a corrected COCO file with ``items``, photograph by photograph.

    An unchanged box is confirmed, a moved or reclassified one corrected, a new one missed. A photograph that is not
    among the file's images counts as not reviewed.

    Args:
        file: The COCO file as the annotation tool wrote it.
        items: What the reviewer was shown.
        photographs: Size and EXIF orientation of the campaign's photographs, by photo_id.
        crosswalk: Defect classes by class name.
        provenance: Reviewer, time and run.
        deletions_count: Reject an item without annotation. Requires that ``items`` are those of the exported task.

    Returns:
        The reviews, and remarks on images and annotations that cannot be used.

    Raises:
        InputDataError: The file is not COCO, or none of its images is a photograph of the campaign.
    """
    coco = read_coco(file)
    names = PhotoNames(photographs).match_all(image.file_name for image in coco.images.values())
    matches = {image_id: names[image.file_name] for image_id, image in coco.images.items()}
    remarks = [match.reason for match in matches.values() if match.photo_id is None]
    photo_of = {image_id: match.photo_id for image_id, match in matches.items() if match.photo_id is not None}
    stored = {image_id: photographs[photo_id] for image_id, photo_id in photo_of.items()}
    views: dict[int | str, BoxView] = {}
    for image_id, view in find_views(coco, stored, None).items():
        if isinstance(view, str):
            remarks.append(f"{photo_of[image_id]} counts as not reviewed: {view}")
        else:
            views[image_id] = view
    reviewed_photographs = {photo_of[image_id] for image_id in views}
    if not reviewed_photographs:
        raise InputDataError(
            f"{file}: none of its {len(coco.images)} images is a photograph of this campaign in its size "
            f"({remarks[0] if remarks else 'the file has no images'}); give the campaign that was reviewed"
        )
    drawn: dict[str, list[_DrawnBox]] = defaultdict(list)
    for annotation in coco.annotations:
        photo_id = photo_of.get(annotation.image_id)
        if photo_id is None:
            remarks.append(f"annotation {annotation.annotation_id} is on none of the campaign's photographs")
            continue
        if annotation.image_id not in views:
            continue
        class_name = coco.categories.get(annotation.category_id)
        parsed = _parse_annotation(
            annotation, photo_id, class_name, photographs[photo_id], views[annotation.image_id], crosswalk
        )
        if isinstance(parsed, str):
            remarks.append(f"annotation {annotation.annotation_id} on {photo_id}: {parsed}")
        else:
            drawn[photo_id].append(parsed)
    reviews: list[Review] = []
    for photo_id in sorted(reviewed_photographs):
        items_of_photo = [item for item in items if item.photo_id == photo_id]
        reviews += _review_photograph(photo_id, items_of_photo, drawn[photo_id], provenance, deletions_count)
    _log.info(
        "%s: %d reviews on %d photographs, %d remarks", file.name, len(reviews), len(reviewed_photographs), len(remarks)
    )
    return ParsedReviews(reviews=tuple(reviews), remarks=tuple(remarks))


def _review_photograph(
    photo_id: str,
    items: Sequence[ReviewItem],
    drawn: Sequence[_DrawnBox],
    provenance: ReviewProvenance,
    deletions_count: bool,
) -> list[Review]:
    scores = compute_iou(corners_from_boxes(item.box for item in items), corners_from_boxes(one.box for one in drawn))
    for i, item in enumerate(items):
        for j, one in enumerate(drawn):
            if one.subject is not None:
                scores[i, j] = 2.0 if one.subject == item.subject else 0.0
            elif item.is_defect and scores[i, j] >= _SAME_BOX_IOU_MIN and one.defect_class is item.defect_class:
                scores[i, j] += 0.1  # of two boxes at one location each keeps its class
    pairs = pair_greedily(scores, _SAME_BOX_IOU_MIN)
    drawn_by_item = {pair.first: drawn[pair.second] for pair in pairs}
    reviews = []
    for i, item in enumerate(items):
        match = drawn_by_item.get(i)
        if match is None:
            if deletions_count and item.is_defect:
                reviews.append(create_review(item, Verdict.REJECTED, provenance))
        elif _is_unchanged(item, match):
            reviews.append(create_review(item, Verdict.CONFIRMED, provenance))
        else:
            corrected = create_review(
                item, Verdict.CORRECTED, provenance, box=match.box, defect_class=match.defect_class, mask=match.mask
            )
            reviews.append(corrected)
    paired = {pair.second for pair in pairs}
    new = [one for j, one in enumerate(drawn) if j not in paired]
    return reviews + [
        create_missed_review(photo_id, one.box, one.defect_class, provenance, mask=one.mask) for one in new
    ]


def _is_unchanged(item: ReviewItem, drawn: _DrawnBox) -> bool:
    if drawn.defect_class is not item.defect_class:
        return False
    after = None if drawn.mask is None else polygons_from_wkt(drawn.mask)
    if after is not None:
        exported = None if item.mask is None else polygons_from_wkt(item.mask)
        before = shapely.box(*corners_from_boxes([item.box])[0]) if exported is None else exported
        return bool(before.intersection(after).area >= _UNCHANGED_IOU_MIN * before.union(after).area)
    both = corners_from_boxes([item.box, drawn.box])
    return bool(
        abs(both[0] - both[1]).max() <= _UNCHANGED_PX or compute_iou(both[:1], both[1:])[0, 0] >= _UNCHANGED_IOU_MIN
    )


def _parse_annotation(
    annotation: CocoAnnotation,
    photo_id: str,
    class_name: str | None,
    photograph: StoredImage,
    view: BoxView,
    crosswalk: Crosswalk,
) -> _DrawnBox | str:
    """The annotation as a box, or the reason why it cannot be used."""
    defect_class = None if class_name is None else crosswalk.find_defect_class(class_name)
    if defect_class is None:
        return (
            f"category_id {annotation.category_id!r} has no name"
            if class_name is None
            else crosswalk.explain_unknown(class_name)
        )
    shape = parse_shape(annotation, view)
    if shape.problem or shape.box is None:
        return shape.problem
    clipped = clip_box(shape.box, image_width_px=photograph.width_px, image_height_px=photograph.height_px)
    if clipped.inside is None:
        return clipped.remark
    outline = fit_mask(shape.mask, clipped.inside).outline
    return _DrawnBox(
        photo_id=photo_id,
        box=clipped.inside,
        defect_class=defect_class,
        mask=None if outline is None else str(shapely.to_wkt(outline, rounding_precision=2)),
        subject=annotation.subject,
    )
