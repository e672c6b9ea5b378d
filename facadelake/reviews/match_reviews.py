"""What holds of a campaign's detections after all reviews: the last words, met with the detections there are now."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from facadelake.core.arrays import Float64Array
from facadelake.detection import Box
from facadelake.reviews.box_matching import corners_of, overlaps, pairs_of
from facadelake.reviews.review import Review, box_of_row, latest
from schemas.vocabulary import DefectClass, DetectionOutcome

# A new run's box that shares less with the one that was judged may be another defect's.
SAME_PLACE = 0.5
_UNMOVED = 0.98  # the same detection by its id, if the box is the same, too


@dataclass(frozen=True, kw_only=True)
class Detected:
    """An accepted detection, as reviews look at it; ``mask`` is WKT."""

    detection_id: str
    photo_id: str
    defect_class: DefectClass
    score: float
    box: Box
    mask: str | None
    detector: str
    detector_sha256: str


@dataclass(frozen=True, kw_only=True)
class Standing:
    """The last word on a subject and the detection that it is about now, None where there is none any more."""

    review: Review
    detection: Detected | None


@dataclass(frozen=True, kw_only=True)
class Judgement:
    """A campaign as reviewed: the words that count, and the detections that nobody has spoken of."""

    standing: tuple[Standing, ...]
    unreviewed: tuple[Detected, ...]

    @property
    def unmatched(self) -> tuple[Review, ...]:
        """Words on detections that the campaign no longer has; a word on a missed defect needs none."""
        return tuple(
            one.review for one in self.standing if one.detection is None and one.review.reviewed_box is not None
        )


def detected(detections: pa.Table) -> tuple[Detected, ...]:
    """The accepted rows of table ``detections``."""
    return tuple(
        Detected(
            detection_id=row["detection_id"],
            photo_id=row["photo_id"],
            defect_class=DefectClass(row["defect_class"]),
            score=row["score"],
            box=box,
            mask=row["mask"],
            detector=row["detector"],
            detector_sha256=row["detector_sha256"],
        )
        for row in detections.to_pylist()
        if row["detection_outcome"] == DetectionOutcome.ACCEPTED and (box := box_of_row(row)) is not None
    )


def judge(reviews: Sequence[Review], detections: Sequence[Detected]) -> Judgement:
    """Meet the last words of ``reviews`` (in the order of time) with ``detections``.

    A word holds for the detection that it was about where that is unchanged; else, after another run or model, for the
    one of a fitting class in the same photograph that overlaps most with the box judged or drawn (0.5 or more).
    """
    words = latest(reviews)
    met: dict[int, Detected] = {}
    spoken: set[str] = set()
    by_photo: dict[str, list[Detected]] = defaultdict(list)
    for one in detections:
        by_photo[one.photo_id].append(one)
    places: dict[str, list[int]] = defaultdict(list)
    for place, word in enumerate(words):
        places[word.photo_id].append(place)
    for photo_id, ours in places.items():
        there = by_photo.get(photo_id, [])
        for pair in pairs_of(_fit([words[place] for place in ours], there), SAME_PLACE):
            met[ours[pair.one]] = there[pair.other]
            spoken.add(there[pair.other].detection_id)
    return Judgement(
        standing=tuple(Standing(review=word, detection=met.get(place)) for place, word in enumerate(words)),
        unreviewed=tuple(one for one in detections if one.detection_id not in spoken),
    )


def _fit(words: Sequence[Review], there: Sequence[Detected]) -> Float64Array:
    """How well each word (rows) fits each detection of its photograph: the overlap, 2 for the very one."""
    boxes = corners_of(one.box for one in there)
    judged = overlaps(corners_of(word.reviewed_box or word.place for word in words), boxes)
    fit = np.maximum(judged, overlaps(corners_of(word.place for word in words), boxes))
    for i, word in enumerate(words):
        for j, one in enumerate(there):
            if one.defect_class not in (word.reviewed_class, word.defect_class):
                fit[i, j] = 0.0
            elif (word.detection_id, word.detector_sha256) == (one.detection_id, one.detector_sha256):
                fit[i, j] = 2.0 if judged[i, j] >= _UNMOVED else fit[i, j]
    return fit
