"""Two models against what persons said: which confirmed defects the new one loses, which false alarms it drops."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Sequence
from dataclasses import dataclass

from facadelake.evaluation.model_comparison.box_changes import is_found
from facadelake.reviews import AcceptedDetection, Review, ReviewStatus


@dataclass(frozen=True, kw_only=True)
class ReviewedFinding:
    """A confirmed defect, as a person tells them apart (all its sightings), or a rejected box; who finds it."""

    reviews: tuple[Review, ...]
    found_by_old: bool
    found_by_new: bool


@dataclass(frozen=True, kw_only=True)
class ReviewComparison:
    """What persons said of the photographs that both models looked at."""

    defects: tuple[ReviewedFinding, ...]
    rejected: tuple[ReviewedFinding, ...]

    @property
    def lost(self) -> tuple[ReviewedFinding, ...]:
        """Confirmed defects that the old model finds in some photograph and the new one in none."""
        return tuple(place for place in self.defects if place.found_by_old and not place.found_by_new)

    def count_outcomes(self) -> dict[str, int]:
        """The table's numbers by name."""
        out = {}
        for name, places in (("confirmed", self.defects), ("rejected", self.rejected)):
            out[name] = len(places)
            out[f"{name}_by_old"] = sum(place.found_by_old for place in places)
            out[f"{name}_by_new"] = sum(place.found_by_new for place in places)
            out[f"{name}_lost"] = sum(place.found_by_old and not place.found_by_new for place in places)
            out[f"{name}_gained"] = sum(place.found_by_new and not place.found_by_old for place in places)
        return out


def compare_with_reviews(
    judgement: ReviewStatus,
    old: Sequence[AcceptedDetection],
    new: Sequence[AcceptedDetection],
    photographs: Collection[str],
) -> ReviewComparison:
    """Meet the words on ``photographs`` with both models' boxes there.

    A defect is what a person confirmed, corrected or drew; sightings of one run's defect_id count as one, found where
    a box of its class tells of any. A rejected box is found where a box of the class rejected tells of it.
    """
    both = [_group_by_photograph(boxes) for boxes in (old, new)]
    defects: dict[str, list[Review]] = defaultdict(list)
    rejected: list[ReviewedFinding] = []
    for standing in judgement.current:
        word = standing.review
        if word.photo_id not in photographs:
            continue
        if word.box is not None and word.defect_class is not None:
            # Each run names its defects anew.
            defects[f"{word.run_id} {word.defect_id}" if word.defect_id else word.subject].append(word)
        else:
            by_old, by_new = (
                is_found(boxes.get(word.photo_id, ()), word.effective_box, word.reviewed_class) for boxes in both
            )
            rejected.append(ReviewedFinding(reviews=(word,), found_by_old=by_old, found_by_new=by_new))
    found = []
    for words in defects.values():
        by_old, by_new = (
            any(is_found(boxes.get(word.photo_id, ()), word.effective_box, word.defect_class) for word in words)
            for boxes in both
        )
        found.append(ReviewedFinding(reviews=tuple(words), found_by_old=by_old, found_by_new=by_new))
    return ReviewComparison(defects=tuple(found), rejected=tuple(rejected))


def _group_by_photograph(boxes: Sequence[AcceptedDetection]) -> dict[str, list[AcceptedDetection]]:
    out: dict[str, list[AcceptedDetection]] = defaultdict(list)
    for one in boxes:
        out[one.photo_id].append(one)
    return out
