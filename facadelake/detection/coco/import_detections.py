"""Import of detections from a COCO file: boxes of another detector, or drawn by a person."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import pyarrow as pa
import shapely

from facadelake.core.errors import InputDataError
from facadelake.core.hashing import hash_file
from facadelake.core.photo_names import NameMatch, PhotoNames
from facadelake.core.progress import track
from facadelake.core.tables import table_from_rows
from facadelake.detection.boxes import Box, clip_box, describe_box
from facadelake.detection.coco.coco_file import CocoAnnotation, CocoFile, CocoImage, parse_number, read_coco
from facadelake.detection.coco.mask import bound_segmentation, parse_segmentation
from facadelake.detection.crosswalk import Crosswalk, build_crosswalk
from schemas.vocabulary import DetectionOutcome, PhotoOutcome

_log = logging.getLogger(__name__)
_PHOTO_COLUMNS = ["photo_id", "photo_outcome", "image_width_px", "image_height_px"]


@dataclass(frozen=True, kw_only=True)
class _BoxDecision:
    """Outcome of a box, with the reason."""

    outcome: DetectionOutcome = DetectionOutcome.ACCEPTED
    reason: str | None = None


@dataclass(frozen=True, kw_only=True)
class _MatchedPhotograph:
    """The photograph that an image of the file is, with its size, or the outcome of all its boxes."""

    photo_id: str
    decision: _BoxDecision
    width_px: int | None = None
    height_px: int | None = None


def import_coco(file: Path, photos: pa.Table, *, class_names: Mapping[str, str]) -> pa.Table:
    """Import every annotation of a COCO file as a row of table ``detections``, usable or not.

    A box partly outside its photograph is clipped to it, with the reason. A box outside, without size, of an unknown
    class or of an unknown photograph is a row with that outcome. A box that is not four numbers is left empty, and the
    reason quotes it; an annotation with a mask and no box has the mask's bounding box. A mask that cannot be used is
    omitted, with the reason.

    ``photos`` is table ``photos``; ``class_names`` (the file's class name -> defect class) overrides the built-in
    crosswalk.

    Raises InputDataError where the file as a whole cannot be used: unreadable, keys missing, boxes normalised to
    0..1, or no box on an accepted photograph of this campaign with the size that the file states.
    """
    crosswalk = build_crosswalk(class_names)
    coco = read_coco(file)
    _refuse_normalised_boxes(coco)
    photographs = _match_images(coco, photos)
    _refuse_if_none_accepted(coco, photographs, len(photos))
    sha256 = hash_file(file)
    used: Counter[str] = Counter()
    rows: list[dict[str, Any]] = []
    for annotation in track(coco.annotations, label="Reading boxes"):
        photograph = photographs[annotation.image_id]
        source_class = coco.categories.get(annotation.category_id)
        defect_class = crosswalk.find_defect_class(source_class) if source_class is not None else None
        box, decision = _check_box(annotation, photograph)
        if photograph.decision.outcome is not DetectionOutcome.ACCEPTED:
            decision = photograph.decision
        elif decision.outcome is DetectionOutcome.ACCEPTED and defect_class is None:
            decision = _explain_unknown_class(annotation, source_class, crosswalk)
        columns: dict[str, Any] = {}
        if decision.outcome is DetectionOutcome.ACCEPTED and box is not None:
            columns, remarks = _parse_mask_and_width(annotation, box, photograph)
            decision = replace(decision, reason="; ".join(filter(None, [decision.reason, *remarks])) or None)
        rows.append(
            {
                "detection_id": _make_unique(f"{photograph.photo_id}#{annotation.annotation_id}", used),
                "photo_id": photograph.photo_id,
                "source_annotation": annotation.annotation_id,
                "detection_outcome": str(decision.outcome),
                "reason": decision.reason,
                "defect_class": None if defect_class is None else str(defect_class),
                "source_class": f"category {annotation.category_id}" if source_class is None else source_class,
                "score": _parse_score(annotation),
                **({} if box is None else _columns_from_box(box)),
                **columns,
                "detector": f"coco:{file.name}",
                "detector_sha256": sha256,
            }
        )
    outcomes = Counter(row["detection_outcome"] for row in rows)
    _log.info("%s: %d boxes, %s", file.name, len(rows), ", ".join(f"{n} {name}" for name, n in outcomes.items()))
    return table_from_rows("detections", rows)


def _match_images(coco: CocoFile, photos: pa.Table) -> Mapping[int | str, _MatchedPhotograph]:
    """The photograph of every image_id that an annotation refers to."""
    rows = {row["photo_id"]: row for row in photos.select(_PHOTO_COLUMNS).to_pylist()}
    matches = PhotoNames(rows).match_all(image.file_name for image in coco.images.values())
    photographs = {
        image_id: _match_image(image, matches[image.file_name], rows) for image_id, image in coco.images.items()
    }
    for annotation in coco.annotations:
        if annotation.image_id not in photographs:
            reason = f"image_id {annotation.image_id!r} is not among the file's 'images'"
            decision = _BoxDecision(outcome=DetectionOutcome.UNKNOWN_PHOTO, reason=reason)
            photographs[annotation.image_id] = _MatchedPhotograph(
                photo_id=f"image {annotation.image_id}", decision=decision
            )
    return photographs


def _match_image(image: CocoImage, match: NameMatch, photos: Mapping[str, Mapping[str, Any]]) -> _MatchedPhotograph:
    unknown = DetectionOutcome.UNKNOWN_PHOTO
    if match.photo_id is None:
        return _MatchedPhotograph(photo_id=image.file_name, decision=_BoxDecision(outcome=unknown, reason=match.reason))
    photo = photos[match.photo_id]
    if photo["photo_outcome"] != PhotoOutcome.ACCEPTED:
        reason = f"the photograph was not accepted: {photo['photo_outcome']}"
        return _MatchedPhotograph(photo_id=match.photo_id, decision=_BoxDecision(outcome=unknown, reason=reason))
    width, height = photo["image_width_px"], photo["image_height_px"]
    decision = _BoxDecision()
    stated = (image.width_px, image.height_px)
    if None not in (*stated, width, height) and stated != (width, height):
        reason = (
            f"the file states an image of {stated[0]:g} x {stated[1]:g} px, the photograph has {width} x {height} px; "
            "export boxes of the original photograph, neither rotated nor resized"
        )
        decision = _BoxDecision(outcome=DetectionOutcome.BAD_BOX, reason=reason)
    return _MatchedPhotograph(photo_id=match.photo_id, decision=decision, width_px=width, height_px=height)


def _columns_from_box(box: Box) -> dict[str, float]:
    return {f"box_{name}": value for name, value in asdict(box).items()}


def _check_box(annotation: CocoAnnotation, photograph: _MatchedPhotograph) -> tuple[Box | None, _BoxDecision]:
    """The box to keep (None where it is not four numbers), and its outcome."""
    bad = DetectionOutcome.BAD_BOX
    bbox = annotation.bbox
    if bbox is None:
        bbox = bound_segmentation(annotation.segmentation, photograph.width_px, photograph.height_px)
    if not isinstance(bbox, list) or len(bbox) != 4:
        return None, _BoxDecision(outcome=bad, reason=f"bbox is {bbox!r}; it must be [x, y, width, height] in pixels")
    values = [value for value in map(parse_number, bbox) if value is not None]
    if len(values) != 4:
        return None, _BoxDecision(outcome=bad, reason=f"bbox is {bbox}; its four values must be finite numbers")
    x, y, width, height = values
    box = Box(x_px=x, y_px=y, width_px=width, height_px=height)
    if width <= 0 or height <= 0:
        return box, _BoxDecision(
            outcome=bad, reason=f"box {describe_box(box)}: width and height must be more than 0 px"
        )
    score = parse_number(annotation.score)
    if annotation.score is not None and (score is None or not 0 <= score <= 1):
        return box, _BoxDecision(outcome=bad, reason=f"score is {annotation.score!r}; it must be a number from 0 to 1")
    if photograph.width_px is None or photograph.height_px is None:
        return box, _BoxDecision()
    clipped = clip_box(box, image_width_px=photograph.width_px, image_height_px=photograph.height_px)
    if clipped.inside is None:
        return box, _BoxDecision(outcome=DetectionOutcome.OUTSIDE_IMAGE, reason=clipped.remark)
    return clipped.inside, _BoxDecision(reason=clipped.remark or None)


def _parse_mask_and_width(
    annotation: CocoAnnotation, box: Box, photograph: _MatchedPhotograph
) -> tuple[dict[str, Any], list[str]]:
    """Columns of the mask and the crack width, where the annotation has them, and remarks on values not used."""
    mask = parse_segmentation(annotation.segmentation, box, photograph.width_px, photograph.height_px)
    remarks = [mask.remark]
    columns: dict[str, Any] = {}
    if mask.outline is not None:
        columns["mask"] = shapely.to_wkt(mask.outline, rounding_precision=2)
    width = parse_number(annotation.crack_width_px)
    if width is not None and width >= 0:
        columns["crack_width_px"] = width
    elif annotation.crack_width_px is not None:
        remarks.append(f"crack_width_px is {annotation.crack_width_px!r} and was ignored; it must be 0 px or more")
    return columns, remarks


def _explain_unknown_class(annotation: CocoAnnotation, source_class: str | None, crosswalk: Crosswalk) -> _BoxDecision:
    reason = (
        f"category_id {annotation.category_id!r} is not among 'categories'"
        if source_class is None
        else crosswalk.explain_unknown(source_class)
    )
    return _BoxDecision(outcome=DetectionOutcome.UNKNOWN_CLASS, reason=reason)


def _parse_score(annotation: CocoAnnotation) -> float:
    """The score; 1 for a box without one (drawn by a person), 0 for an invalid one, which the row's reason quotes."""
    score = parse_number(annotation.score)
    if annotation.score is None:
        return 1.0
    return score if score is not None and 0 <= score <= 1 else 0.0


def _make_unique(detection_id: str, used: Counter[str]) -> str:
    """The id, with ``.2``, ``.3``, ... appended where a merged file repeats an annotation id."""
    used[detection_id] += 1
    return detection_id if used[detection_id] == 1 else f"{detection_id}.{used[detection_id]}"


def _refuse_normalised_boxes(coco: CocoFile) -> None:
    boxes = [a.bbox for a in coco.annotations if isinstance(a.bbox, list) and len(a.bbox) == 4]
    sizes = [[parse_number(value) for value in box] for box in boxes]
    if sizes and all(value is not None and 0 <= value <= 1 for box in sizes for value in box) and any(map(any, sizes)):
        raise InputDataError(
            f"detections file {coco.path}: all {len(sizes)} boxes lie within 0..1, so they are normalised; "
            "COCO boxes are [x, y, width, height] in pixels: export boxes in pixels"
        )


def _refuse_if_none_accepted(
    coco: CocoFile, photographs: Mapping[int | str, _MatchedPhotograph], campaign_count: int
) -> None:
    decisions = [photographs[annotation.image_id].decision for annotation in coco.annotations]
    if not decisions or any(decision.outcome is DetectionOutcome.ACCEPTED for decision in decisions):
        return
    raise InputDataError(
        f"detections file {coco.path}: none of its {len(decisions)} boxes is on an accepted photograph of the "
        f"campaign's {campaign_count} (first: {decisions[0].reason}); give the detections of this campaign, "
        "with file_name ending as the photographs' paths do"
    )
