"""Words out of a corrected COCO file: what was kept, moved, deleted and drawn anew, beside what had been shown.

Annotation tools number annotations anew and drop attributes they do not know, so that a box's place and class say what
became of it; an attribute ``subject`` that came back decides where it is there.
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
from facadelake.detection import Box, Crosswalk, clip_box, describe_box
from facadelake.detection.coco import (
    CocoAnnotation,
    bound_segmentation,
    parse_number,
    parse_segmentation,
    polygons_from_wkt,
    read_coco,
)
from facadelake.reviews.box_matching import compute_iou, corners_from_boxes, pair_greedily
from facadelake.reviews.review import Review
from facadelake.reviews.review_items import ReviewItem, ReviewProvenance, create_missed_review, create_review
from facadelake.reviews.task_files import read_json
from schemas.vocabulary import DefectClass, Verdict

_log = logging.getLogger(__name__)

_SAME_BOX_IOU_MIN = 0.3  # a box moved further than to this overlap is another one
_UNCHANGED_IOU_MIN = 0.95  # a box, or mask, that still overlaps so far was left as it was (tools round)
_UNCHANGED_PX = 1.0  # and a small one whose sides moved by a pixel at most


@dataclass(frozen=True, kw_only=True)
class ParsedReviews:
    """Words that were understood, and remarks on what was not."""

    reviews: tuple[Review, ...]
    remarks: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class _DrawnBox:
    photo_id: str
    box: Box
    defect_class: DefectClass
    mask: str | None
    subject: str | None


def read_coco_reviews(
    file: Path,
    shown: Sequence[ReviewItem],
    sizes: Mapping[str, tuple[int, int]],
    crosswalk: Crosswalk,
    said: ReviewProvenance,
    *,
    deletions_count: bool,
) -> ParsedReviews:
    """Words of a corrected file on ``shown``, on the photographs (``sizes``: width, height in px by photo_id) it names.

    A box left as it was is confirmed, a moved or renamed one corrected, a new one missed; one that is gone is rejected
    where ``deletions_count``, which needs ``shown`` to be what the person was shown. A photograph that the file's
    images lack was not looked at. Raises InputDataError for a file that is not COCO or names none of the photographs.
    """
    coco = read_coco(file)
    names = PhotoNames(sizes)
    matches = {image_id: names.match(image.file_name) for image_id, image in coco.images.items()}
    remarks = [match.reason for match in matches.values() if match.photo_id is None]
    looked_at = set()
    for image_id, match in matches.items():
        if match.photo_id is None:
            continue
        image = coco.images[image_id]
        stated, (width, height) = (image.width_px, image.height_px), sizes[match.photo_id]
        if None not in stated and stated != (width, height):
            remarks.append(
                f"the file says {match.photo_id} is {stated[0]:g} x {stated[1]:g} px, the photograph is {width} x "
                f"{height} px: it was not taken as looked at; review the original, neither turned nor resized"
            )
        else:
            looked_at.add(match.photo_id)
    if not looked_at:
        raise InputDataError(
            f"{file}: none of its {len(coco.images)} images is a photograph of this campaign in its size "
            f"({remarks[0] if remarks else 'it has no images'}); name the campaign that was reviewed"
        )
    subjects = [_get_subject(entry) for entry in read_json(file)["annotations"]]
    drawn: dict[str, list[_DrawnBox]] = defaultdict(list)
    for annotation, subject in zip(coco.annotations, subjects, strict=True):
        on = matches.get(annotation.image_id)
        if on is None or on.photo_id is None:
            remarks.append(f"annotation {annotation.annotation_id} is on none of the campaign's photographs")
            continue
        if on.photo_id not in looked_at:
            continue
        source = coco.categories.get(annotation.category_id)
        one = _parse_annotation(annotation, on.photo_id, source, sizes[on.photo_id], crosswalk, subject)
        if isinstance(one, str):
            remarks.append(f"annotation {annotation.annotation_id} on {on.photo_id}: {one}")
        else:
            drawn[on.photo_id].append(one)
    reviews: list[Review] = []
    for photo_id in sorted(looked_at):
        ours = [place for place in shown if place.photo_id == photo_id]
        reviews += _review_photograph(photo_id, ours, drawn[photo_id], said, deletions_count)
    _log.info("%s: %d words on %d photographs, %d remarks", file.name, len(reviews), len(looked_at), len(remarks))
    return ParsedReviews(reviews=tuple(reviews), remarks=tuple(remarks))


def _review_photograph(
    photo_id: str,
    shown: Sequence[ReviewItem],
    drawn: Sequence[_DrawnBox],
    said: ReviewProvenance,
    deletions_count: bool,
) -> list[Review]:
    fit = compute_iou(corners_from_boxes(place.box for place in shown), corners_from_boxes(one.box for one in drawn))
    for i, place in enumerate(shown):
        for j, one in enumerate(drawn):
            if one.subject is not None:
                fit[i, j] = 2.0 if one.subject == place.subject else 0.0
            elif place.is_defect and fit[i, j] >= _SAME_BOX_IOU_MIN and one.defect_class is place.defect_class:
                fit[i, j] += 0.1  # of two boxes at one place each keeps its class
    pairs = pair_greedily(fit, _SAME_BOX_IOU_MIN)
    kept = {pair.first: drawn[pair.second] for pair in pairs}
    words = []
    for i, place in enumerate(shown):
        left = kept.get(i)
        if left is None:
            words += [create_review(place, Verdict.REJECTED, said)] if deletions_count and place.is_defect else []
        elif _is_unchanged(place, left):
            words.append(create_review(place, Verdict.CONFIRMED, said))
        else:
            corrected = create_review(
                place, Verdict.CORRECTED, said, box=left.box, defect_class=left.defect_class, mask=left.mask
            )
            words.append(corrected)
    used = {pair.second for pair in pairs}
    new = [one for j, one in enumerate(drawn) if j not in used]
    return words + [create_missed_review(photo_id, one.box, one.defect_class, said, mask=one.mask) for one in new]


def _is_unchanged(place: ReviewItem, one: _DrawnBox) -> bool:
    if one.defect_class is not place.defect_class:
        return False
    after = None if one.mask is None else polygons_from_wkt(one.mask)
    if after is not None:
        shown = None if place.mask is None else polygons_from_wkt(place.mask)
        before = shapely.box(*corners_from_boxes([place.box])[0]) if shown is None else shown
        return bool(before.intersection(after).area >= _UNCHANGED_IOU_MIN * before.union(after).area)
    both = corners_from_boxes([place.box, one.box])
    return bool(
        abs(both[0] - both[1]).max() <= _UNCHANGED_PX or compute_iou(both[:1], both[1:])[0, 0] >= _UNCHANGED_IOU_MIN
    )


def _parse_annotation(
    annotation: CocoAnnotation,
    photo_id: str,
    source: str | None,
    size: tuple[int, int],
    crosswalk: Crosswalk,
    subject: str | None,
) -> _DrawnBox | str:
    """What a person drew, or why it cannot be used."""
    defect_class = None if source is None else crosswalk.find_defect_class(source)
    if defect_class is None:
        return (
            f"category_id {annotation.category_id!r} has no name"
            if source is None
            else crosswalk.explain_unknown(source)
        )
    bbox = annotation.bbox
    if bbox is None:
        bbox = bound_segmentation(annotation.segmentation, *size)
    values = [parse_number(value) for value in bbox] if isinstance(bbox, list) else []
    if len(values) != 4 or None in values:
        return f"bbox is {annotation.bbox!r}; it must be [x, y, width, height] in pixels"
    box = Box(**dict(zip(("x_px", "y_px", "width_px", "height_px"), (float(v or 0.0) for v in values), strict=True)))
    if box.width_px <= 0 or box.height_px <= 0:
        return f"box {describe_box(box)}: width and height must be more than 0 px"
    clipped = clip_box(box, image_width_px=size[0], image_height_px=size[1])
    if clipped.inside is None:
        return clipped.remark
    mask = parse_segmentation(annotation.segmentation, clipped.inside, *size)
    outline = None if mask.outline is None else str(shapely.to_wkt(mask.outline, rounding_precision=2))
    return _DrawnBox(photo_id=photo_id, box=clipped.inside, defect_class=defect_class, mask=outline, subject=subject)


def _get_subject(entry: Mapping[str, object]) -> str | None:
    attributes = entry.get("attributes")
    subject = attributes.get("subject") if isinstance(attributes, dict) else None
    return subject if isinstance(subject, str) and subject else None
