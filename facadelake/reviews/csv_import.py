"""Words out of a table that a person filled in: a line for a defect, a detection, or a defect that was missed."""

from __future__ import annotations

import csv
import io
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path

from facadelake.core.errors import InputDataError
from facadelake.core.photo_names import PhotoNames
from facadelake.detection import Box, Crosswalk, clip_box
from facadelake.reviews.coco_import import ParsedReviews
from facadelake.reviews.review import Review
from facadelake.reviews.review_items import ReviewItem, ReviewProvenance, create_missed_review, create_review
from schemas.vocabulary import DefectClass, Verdict

_SIDES = ("box_x_px", "box_y_px", "box_width_px", "box_height_px")
_VERDICT_SYNONYMS = {"yes": Verdict.CONFIRMED, "y": Verdict.CONFIRMED, "no": Verdict.REJECTED, "n": Verdict.REJECTED}
_REMARKS_MAX = 1000


def read_csv_reviews(
    file: Path,
    shown: Sequence[ReviewItem],
    sizes: Mapping[str, tuple[int, int]],
    crosswalk: Crosswalk,
    said: ReviewProvenance,
) -> ParsedReviews:
    """Words of a filled-in table on ``shown``; ``sizes`` (width, height in px) by photo_id.

    A line with a ``defect_id`` speaks of all its sightings, one with a ``detection_id`` of that one; ``missed`` needs a
    ``photo_id``, a box and a class. ``corrected`` takes ``corrected_class``, and for a detection the box. A line
    without ``verdict`` was not looked at. A line that cannot be used is a remark, and the others count.
    Raises InputDataError for a file that is no table or lacks the columns.
    """
    lines = _read_lines(file)
    by_defect: dict[str, list[ReviewItem]] = defaultdict(list)
    by_detection = {place.detection_id: place for place in shown if place.detection_id is not None}
    for place in shown:
        if place.defect_id is not None:
            by_defect[place.defect_id].append(place)
    names = PhotoNames(sizes)
    reviews: list[Review] = []
    remarks: list[str] = []
    for number, line in lines:
        try:
            word = _parse_verdict(line)
            if word is None:
                continue
            if word is Verdict.MISSED:
                reviews.append(_review_missed(line, names, sizes, crosswalk, said))
                continue
            run = line.get("run_id", "")
            if run and run != said.run_id:
                raise _LineError(f"it is of the run {run}, the campaign's is {said.run_id} now; export the task anew")
            places = _select_items(line, by_defect, by_detection)
            reviews += [_review_item(place, word, line, crosswalk, said, alone=len(places) == 1) for place in places]
        except _LineError as error:
            remarks.append(f"line {number}: {error}")
    return ParsedReviews(reviews=tuple(reviews), remarks=tuple(remarks[:_REMARKS_MAX]))


class _LineError(ValueError):
    """Why a line cannot be used, in words."""


def _read_lines(file: Path) -> list[tuple[int, dict[str, str]]]:
    try:
        text = file.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputDataError(f"{file} cannot be read as UTF-8 text: {error}; save it as CSV UTF-8") from error
    head = text.split("\n", 1)[0]
    delimiter = max(",;\t", key=head.count)  # spreadsheets of some countries write semicolons
    reader = csv.DictReader(io.StringIO(text), delimiter=delimiter)
    columns = [name.strip() for name in reader.fieldnames or []]
    if "verdict" not in columns or not {"defect_id", "detection_id", "photo_id"} & set(columns):
        raise InputDataError(
            f"{file} has the columns {', '.join(columns) or 'none'}; it needs 'verdict' and one of 'defect_id', "
            "'detection_id' or, for missed ones, 'photo_id' ('facadelake review export-task' writes such a table)"
        )
    reader.fieldnames = columns
    return [
        (reader.line_num, {name: (value or "").strip() for name, value in line.items() if isinstance(name, str)})
        for line in reader
    ]


def _parse_verdict(line: Mapping[str, str]) -> Verdict | None:
    word = line["verdict"].casefold()
    if not word:
        return None
    if word in _VERDICT_SYNONYMS:
        return _VERDICT_SYNONYMS[word]
    if word not in set(Verdict):
        raise _LineError(f"verdict is '{line['verdict']}'; use {', '.join(Verdict)}, or leave it empty")
    return Verdict(word)


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
        places = by_defect[defect_id]
        # A box that was rejected by itself stays so, unless that is said of the whole defect.
        return [place for place in places if place.is_defect] or places
    raise _LineError("it names neither a defect_id nor a detection_id")


def _review_item(
    place: ReviewItem,
    verdict: Verdict,
    line: Mapping[str, str],
    crosswalk: Crosswalk,
    said: ReviewProvenance,
    *,
    alone: bool,
) -> Review:
    note = line.get("note") or None
    if verdict is not Verdict.CORRECTED:
        return create_review(place, verdict, said, note=note)
    name = line.get("corrected_class", "")
    box = _parse_box(line) if alone and line.get("detection_id") else None
    if not name and (box is None or box == place.box):
        raise _LineError("'corrected' needs 'corrected_class', or a detection_id with another box")
    defect_class = _parse_class(name, crosswalk) if name else place.defect_class
    return create_review(
        place, verdict, said, box=box, defect_class=defect_class, mask=None if box else place.mask, note=note
    )


def _review_missed(
    line: Mapping[str, str],
    names: PhotoNames,
    sizes: Mapping[str, tuple[int, int]],
    crosswalk: Crosswalk,
    said: ReviewProvenance,
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
    return create_missed_review(match.photo_id, inside.inside, defect_class, said, note=line.get("note") or None)


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
        raise _LineError(f"the box {', '.join(values)} is not four numbers in pixels, with a point") from error
    if not all(abs(value) < 1e9 for value in (x, y)) or not 0 < width < 1e9 or not 0 < height < 1e9:
        raise _LineError(f"the box {', '.join(values)} has no size, or is no place in a photograph")
    return Box(x_px=x, y_px=y, width_px=width, height_px=height)
