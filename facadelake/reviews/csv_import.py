"""Reviews from a CSV table that a reviewer filled in: a line for a defect, a detection or a missed defect."""

from __future__ import annotations

import csv
import io
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path

from facadelake.core.errors import InputDataError
from facadelake.core.photo_names import PhotoNames
from facadelake.detection import Box, Crosswalk, clip_box
from facadelake.reviews.review import ParsedReviews, Review
from facadelake.reviews.review_items import ReviewItem, ReviewProvenance, create_missed_review, create_review
from schemas.vocabulary import DefectClass, Verdict

_SIDES = ("box_x_px", "box_y_px", "box_width_px", "box_height_px")
_VERDICT_SYNONYMS = {"yes": Verdict.CONFIRMED, "y": Verdict.CONFIRMED, "no": Verdict.REJECTED, "n": Verdict.REJECTED}
_REMARKS_MAX = 1000


def read_csv_reviews(
    file: Path,
    items: Sequence[ReviewItem],
    sizes: Mapping[str, tuple[int, int]],
    crosswalk: Crosswalk,
    provenance: ReviewProvenance,
) -> ParsedReviews:
    """Read the reviews of a filled-in table.

    A line with a ``defect_id`` reviews all observations of the defect, one with a ``detection_id`` that detection.
    ``missed`` needs a ``photo_id``, a box and a class; ``corrected`` needs ``corrected_class`` or, for a detection, a
    box. A line without ``verdict`` is no review. A line that cannot be used becomes a remark.

    Args:
        file: The table, with commas, semicolons or tabs.
        items: What the reviewer was shown.
        sizes: (width, height) in px of the campaign's photographs, by photo_id.
        crosswalk: Defect classes by class name.
        provenance: Reviewer, time and run.

    Returns:
        The reviews, and remarks on lines that cannot be used: all of them, the first 1000 singly, the others counted.

    Raises:
        InputDataError: The file is not a table in UTF-8, or lacks the columns.
    """
    lines = _read_lines(file)
    by_defect: dict[str, list[ReviewItem]] = defaultdict(list)
    by_detection = {item.detection_id: item for item in items if item.detection_id is not None}
    for item in items:
        if item.defect_id is not None:
            by_defect[item.defect_id].append(item)
    names = PhotoNames(sizes)
    reviews: list[Review] = []
    remarks: list[str] = []
    for number, line in lines:
        try:
            verdict = _parse_verdict(line)
            if verdict is None:
                continue
            if verdict is Verdict.MISSED:
                reviews.append(_review_missed(line, names, sizes, crosswalk, provenance))
                continue
            run = line.get("run_id", "")
            if run and run != provenance.run_id:
                raise _LineError(
                    f"it reviews the run {run}, the campaign's run is {provenance.run_id} now; export the task again"
                )
            selected = _select_items(line, by_defect, by_detection)
            reviews += [
                _review_item(item, verdict, line, crosswalk, provenance, alone=len(selected) == 1) for item in selected
            ]
        except _LineError as error:
            remarks.append(f"line {number}: {error}")
    if len(remarks) > _REMARKS_MAX:
        remarks[_REMARKS_MAX:] = [f"and {len(remarks) - _REMARKS_MAX} more lines that cannot be used"]
    return ParsedReviews(reviews=tuple(reviews), remarks=tuple(remarks))


class _LineError(ValueError):
    """Why a line cannot be used."""


def _read_lines(file: Path) -> list[tuple[int, dict[str, str]]]:
    try:
        text = file.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputDataError(f"{file} cannot be read as UTF-8 text: {error}; save it as CSV UTF-8") from error
    head = text.split("\n", 1)[0]
    delimiter = max(",;\t", key=head.count)  # spreadsheets write semicolons in some locales
    reader = csv.DictReader(io.StringIO(text), delimiter=delimiter)
    columns = [name.strip() for name in reader.fieldnames or []]
    if "verdict" not in columns or not {"defect_id", "detection_id", "photo_id"} & set(columns):
        raise InputDataError(
            f"{file} has the columns {', '.join(columns) or 'none'}; it needs 'verdict' and one of 'defect_id', "
            "'detection_id' or, for missed defects, 'photo_id' ('facadelake review export-task' writes such a table)"
        )
    reader.fieldnames = columns
    return [
        (reader.line_num, {name: (value or "").strip() for name, value in line.items() if isinstance(name, str)})
        for line in reader
    ]


def _parse_verdict(line: Mapping[str, str]) -> Verdict | None:
    name = line["verdict"].casefold()
    if not name:
        return None
    if name in _VERDICT_SYNONYMS:
        return _VERDICT_SYNONYMS[name]
    if name not in set(Verdict):
        raise _LineError(f"verdict is '{line['verdict']}'; use {', '.join(Verdict)}, or leave it empty")
    return Verdict(name)


def _select_items(
    line: Mapping[str, str], by_defect: Mapping[str, Sequence[ReviewItem]], by_detection: Mapping[str, ReviewItem]
) -> Sequence[ReviewItem]:
    if detection_id := line.get("detection_id"):
        if detection_id not in by_detection:
            raise _LineError(f"there is no detection '{detection_id}' in the campaign")
        return (by_detection[detection_id],)
    if defect_id := line.get("defect_id"):
        if not by_defect.get(defect_id):
            raise _LineError(f"there is no defect '{defect_id}' in the campaign")
        items = by_defect[defect_id]
        # The review of a defect leaves its rejected observations rejected, unless all of them are.
        return [item for item in items if item.is_defect] or items
    raise _LineError("it has neither a defect_id nor a detection_id")


def _review_item(
    item: ReviewItem,
    verdict: Verdict,
    line: Mapping[str, str],
    crosswalk: Crosswalk,
    provenance: ReviewProvenance,
    *,
    alone: bool,
) -> Review:
    note = line.get("note") or None
    if verdict is not Verdict.CORRECTED:
        return create_review(item, verdict, provenance, note=note)
    name = line.get("corrected_class", "")
    box = _parse_box(line) if alone and line.get("detection_id") else None
    if not name and (box is None or box == item.box):
        raise _LineError("'corrected' needs 'corrected_class', or a detection_id with another box")
    defect_class = _parse_class(name, crosswalk) if name else item.defect_class
    return create_review(
        item, verdict, provenance, box=box, defect_class=defect_class, mask=None if box else item.mask, note=note
    )


def _review_missed(
    line: Mapping[str, str],
    names: PhotoNames,
    sizes: Mapping[str, tuple[int, int]],
    crosswalk: Crosswalk,
    provenance: ReviewProvenance,
) -> Review:
    match = names.match(line.get("photo_id", ""))
    if match.photo_id is None:
        raise _LineError(f"'missed' needs a photograph: {match.reason}")
    box = _parse_box(line)
    if box is None:
        raise _LineError(f"'missed' needs a box: {', '.join(_SIDES)}")
    width, height = sizes[match.photo_id]
    inside = clip_box(box, image_width_px=width, image_height_px=height)
    if inside.inside is None:
        raise _LineError(inside.remark)
    defect_class = _parse_class(line.get("corrected_class") or line.get("defect_class", ""), crosswalk)
    return create_missed_review(match.photo_id, inside.inside, defect_class, provenance, note=line.get("note") or None)


def _parse_class(name: str, crosswalk: Crosswalk) -> DefectClass:
    found = crosswalk.find_defect_class(name)
    if found is None:
        raise _LineError(crosswalk.explain_unknown(name))
    return found


def _parse_box(line: Mapping[str, str]) -> Box | None:
    values = [line.get(side, "") for side in _SIDES]
    if not any(values):
        return None
    try:
        x, y, width, height = (float(value) for value in values)
    except ValueError as error:
        raise _LineError(f"the box {', '.join(values)} is not four numbers in pixels, with a decimal point") from error
    if not all(abs(value) < 1e9 for value in (x, y)) or not 0 < width < 1e9 or not 0 < height < 1e9:
        raise _LineError(f"the box {', '.join(values)} has no size, or lies beyond any photograph")
    return Box(x_px=x, y_px=y, width_px=width, height_px=height)
