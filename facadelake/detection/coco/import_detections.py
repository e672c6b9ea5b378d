"""Import of detections from a COCO file: boxes of another detector, or drawn by a person."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import pyarrow as pa
import shapely

from facadelake.core.errors import InputDataError
from facadelake.core.hashing import hash_file
from facadelake.core.photo_names import NameMatch, PhotoNames
from facadelake.core.progress import track
from facadelake.core.tables import table_from_rows
from facadelake.detection.boxes import Box, clip_box
from facadelake.detection.coco.annotation_shape import AnnotationShape, parse_shape
from facadelake.detection.coco.coco_file import read_coco
from facadelake.detection.coco.coco_records import CocoAnnotation, CocoFile, CocoImage, parse_number
from facadelake.detection.coco.exif_view import AS_STORED, BoxView, StoredImage, find_views
from facadelake.detection.coco.mask import fit_mask
from facadelake.detection.coco.repeated_boxes import find_repeated_boxes
from facadelake.detection.coco.unstated_size import (
    describe_boxes_of_smaller_copies,
    is_size_stated,
    refuse_boxes_of_smaller_copies,
)
from facadelake.detection.crosswalk import Crosswalk, build_crosswalk
from facadelake.registry import ExifView
from schemas.vocabulary import DetectionOutcome, PhotoOutcome

_log = logging.getLogger(__name__)
_PHOTO_COLUMNS = ["photo_id", "photo_outcome", "image_width_px", "image_height_px", "exif_orientation"]


@dataclass(frozen=True, kw_only=True)
class _BoxDecision:
    """Outcome of a box, with the reason."""

    outcome: DetectionOutcome = DetectionOutcome.ACCEPTED
    reason: str | None = None


@dataclass(frozen=True, kw_only=True)
class _MatchedPhotograph:
    """The photograph that an image of the file is, with its size and the view of its boxes, or the outcome of all of
    them; ``remark`` goes to the reason of each box."""

    photo_id: str
    decision: _BoxDecision = field(default_factory=_BoxDecision)
    stored: StoredImage | None = None
    view: BoxView = field(default_factory=BoxView)
    remark: str = ""


def import_coco(
    file: Path, photos: pa.Table, *, class_names: Mapping[str, str], exif_view: ExifView | None = None
) -> pa.Table:
    """Import every annotation of a COCO file as a row of table ``detections``, usable or not.

    A box partly outside its photograph is clipped to it, with the reason. A box outside, without size, of an unknown
    class or of an unknown photograph is a row with that outcome. A box that is not four numbers is left empty, and the
    reason quotes it; an annotation with a mask and no box has the mask's bounding box. A mask that cannot be used is
    omitted, with the reason. Of boxes that are in the file twice under two ids, one is used.

    Args:
        file: The COCO file.
        photos: Table ``photos``.
        class_names: The file's class name -> defect class; overrides the built-in crosswalk.
        exif_view: The view of the boxes of photographs that EXIF turns; None: as the sizes in the file tell.

    Returns:
        Table ``detections``, in pixels as stored.

    Raises:
        InputDataError: The file as a whole cannot be used: unreadable, keys missing, an id used twice, boxes normalised
            to 0..1 or given as corners, or no box on an accepted photograph of this campaign with the size that the
            file states.
    """
    crosswalk = build_crosswalk(class_names)
    coco = read_coco(file)
    photographs = _match_images(coco, photos, exif_view)
    _refuse_if_none_accepted(coco, photographs, len(photos))
    sha256 = hash_file(file)
    rows: list[dict[str, Any]] = []
    for annotation in track(coco.annotations, label="Reading boxes"):
        photograph = photographs[annotation.image_id]
        source_class = coco.categories.get(annotation.category_id)
        defect_class = crosswalk.find_defect_class(source_class) if source_class is not None else None
        shape = parse_shape(annotation, photograph.view)
        box, decision = _check_box(annotation, shape, photograph)
        if photograph.decision.outcome is not DetectionOutcome.ACCEPTED:
            decision = photograph.decision
        elif decision.outcome is DetectionOutcome.ACCEPTED and defect_class is None:
            decision = _explain_unknown_class(annotation, source_class, crosswalk)
        columns: dict[str, Any] = {}
        if decision.outcome is DetectionOutcome.ACCEPTED and box is not None:
            columns, remarks = _parse_mask_and_width(annotation, shape, box)
            reasons = filter(None, [decision.reason, photograph.remark, *remarks])
            decision = replace(decision, reason="; ".join(reasons) or None)
        rows.append(
            {
                "detection_id": f"{photograph.photo_id}#{annotation.annotation_id}",
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
    _mark_repeated_boxes(rows, file)
    outcomes = Counter(row["detection_outcome"] for row in rows)
    _log.info("%s: %d boxes, %s", file.name, len(rows), ", ".join(f"{n} {name}" for name, n in outcomes.items()))
    return table_from_rows("detections", rows)


def _mark_repeated_boxes(rows: list[dict[str, Any]], file: Path) -> None:
    repeated = find_repeated_boxes(rows)
    for index, other in repeated.items():
        rows[index]["detection_outcome"] = str(DetectionOutcome.BAD_BOX)
        rows[index]["reason"] = f"the same as annotation {rows[other]['source_annotation']}, which is used"
    if repeated:
        _log.warning("%s: %d boxes repeat another of their photograph and class; not used", file.name, len(repeated))


def list_searched_photographs(file: Path, photos: pa.Table, *, exif_view: ExifView | None = None) -> frozenset[str]:
    """The accepted photographs that a COCO file lists and whose boxes can be used, with boxes or without.

    A photograph that is not listed was not searched, as far as the file tells.

    Args:
        file: The COCO file.
        photos: Table ``photos``.
        exif_view: As of ``import_coco``.

    Raises:
        InputDataError: The file cannot be read.
    """
    matched = _match_images(read_coco(file), photos, exif_view).values()
    return frozenset(one.photo_id for one in matched if one.decision.outcome is DetectionOutcome.ACCEPTED)


def _match_images(
    coco: CocoFile, photos: pa.Table, exif_view: ExifView | None
) -> Mapping[int | str, _MatchedPhotograph]:
    """The photograph of every image_id that an annotation refers to."""
    rows = {row["photo_id"]: row for row in photos.select(_PHOTO_COLUMNS).to_pylist()}
    matches = PhotoNames(rows).match_all(image.file_name for image in coco.images.values())
    photographs = {
        image_id: _match_image(image, matches[image.file_name], rows) for image_id, image in coco.images.items()
    }
    stored = {image_id: photo.stored for image_id, photo in photographs.items() if photo.stored is not None}
    refuse_boxes_of_smaller_copies(coco, stored)
    suspicion = describe_boxes_of_smaller_copies(coco, stored)
    if suspicion:
        _log.warning("%s: %s", coco.path.name, suspicion)
    for image_id, view in find_views(coco, stored, exif_view).items():
        photographs[image_id] = (
            replace(photographs[image_id], decision=_BoxDecision(outcome=DetectionOutcome.BAD_BOX, reason=view))
            if isinstance(view, str)
            else replace(photographs[image_id], view=view, remark=photographs[image_id].remark or suspicion)
        )
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
    if width is None or height is None:
        return _MatchedPhotograph(photo_id=match.photo_id)
    orientation = photo["exif_orientation"] or AS_STORED
    stored = StoredImage(width_px=width, height_px=height, orientation=orientation)
    remark = "" if is_size_stated(image) else f"the file states no size of its image; taken as {width} x {height} px"
    return _MatchedPhotograph(photo_id=match.photo_id, stored=stored, remark=remark)


def _columns_from_box(box: Box) -> dict[str, float]:
    return {f"box_{name}": value for name, value in asdict(box).items()}


def _check_box(
    annotation: CocoAnnotation, shape: AnnotationShape, photograph: _MatchedPhotograph
) -> tuple[Box | None, _BoxDecision]:
    """The box to keep (None where it is not four numbers), and its outcome."""
    bad = DetectionOutcome.BAD_BOX
    if shape.problem or shape.box is None:
        return shape.box, _BoxDecision(outcome=bad, reason=shape.problem)
    score = parse_number(annotation.score)
    if annotation.score is not None and (score is None or not 0 <= score <= 1):
        reason = f"score is {annotation.score!r}; it must be a number from 0 to 1"
        return shape.box, _BoxDecision(outcome=bad, reason=reason)
    stored = photograph.stored
    if stored is None:
        return shape.box, _BoxDecision()
    clipped = clip_box(shape.box, image_width_px=stored.width_px, image_height_px=stored.height_px)
    if clipped.inside is None:
        return shape.box, _BoxDecision(outcome=DetectionOutcome.OUTSIDE_IMAGE, reason=clipped.remark)
    return clipped.inside, _BoxDecision(reason=clipped.remark or None)


def _parse_mask_and_width(
    annotation: CocoAnnotation, shape: AnnotationShape, box: Box
) -> tuple[dict[str, Any], list[str]]:
    """Columns of the mask and the crack width, where the annotation has them, and remarks on values not used."""
    mask = fit_mask(shape.mask, box)
    remarks = [*shape.remarks, mask.remark]
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
