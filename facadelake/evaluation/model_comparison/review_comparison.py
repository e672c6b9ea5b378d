"""Detections of two models compared with reviews: which confirmed defects the new model loses, which rejected boxes
it drops."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Sequence
from dataclasses import dataclass

from facadelake.evaluation.model_comparison.box_changes import is_found
from facadelake.reviews import AcceptedDetection, Review, ReviewStatus


@dataclass(frozen=True, kw_only=True)
class ReviewedFinding:
    """A confirmed defect with the reviews of all its observations, or a rejected box with its review; which models
    find it."""

    reviews: tuple[Review, ...]
    found_by_old: bool
    found_by_new: bool


@dataclass(frozen=True, kw_only=True)
class ReviewComparison:
    """The reviewed defects and rejected boxes of the photographs that both models processed."""

    defects: tuple[ReviewedFinding, ...]
    rejected: tuple[ReviewedFinding, ...]

    @property
    def lost(self) -> tuple[ReviewedFinding, ...]:
        """Confirmed defects that the old model finds in a photograph and the new one in none."""
        return tuple(finding for finding in self.defects if finding.found_by_old and not finding.found_by_new)

    def count_outcomes(self) -> dict[str, int]:
        """Numbers of ``confirmed`` defects and ``rejected`` boxes.

        Suffixes ``_by_old`` and ``_by_new``: those that a model finds; ``_lost``: only the old one finds them;
        ``_gained``: only the new one does.
        """
        counts = {}
        for name, findings in (("confirmed", self.defects), ("rejected", self.rejected)):
            counts[name] = len(findings)
            counts[f"{name}_by_old"] = sum(finding.found_by_old for finding in findings)
            counts[f"{name}_by_new"] = sum(finding.found_by_new for finding in findings)
            counts[f"{name}_lost"] = sum(finding.found_by_old and not finding.found_by_new for finding in findings)
            counts[f"{name}_gained"] = sum(finding.found_by_new and not finding.found_by_old for finding in findings)
        return counts


def compare_with_reviews(
    status: ReviewStatus,
    old: Sequence[AcceptedDetection],
    new: Sequence[AcceptedDetection],
    photographs: Collection[str],
) -> ReviewComparison:
    """Compare the detections of two models with the current reviews.

    Args:
        status: The reviews of a campaign.
        old: Detections of the old model.
        new: Detections of the new model.
        photographs: photo_id of the photographs that both models processed; other reviews are left out.

    Returns:
        Defects that reviewers confirmed, corrected or added, and rejected boxes. Observations with one ``defect_id`` of
        one run are one defect, which a model finds by a box of its class at any of them. A rejected box is found by a
        box of the rejected class.
    """
    boxes_by_model = [_group_by_photograph(boxes) for boxes in (old, new)]
    reviews_by_defect: dict[str, list[Review]] = defaultdict(list)
    rejected: list[ReviewedFinding] = []
    for matched in status.current:
        review = matched.review
        if review.photo_id not in photographs:
            continue
        if review.box is not None and review.defect_class is not None:
            # defect_id is unique within its run only.
            key = f"{review.run_id} {review.defect_id}" if review.defect_id else review.subject
            reviews_by_defect[key].append(review)
        else:
            by_old, by_new = (
                is_found(boxes.get(review.photo_id, ()), review.effective_box, review.reviewed_class)
                for boxes in boxes_by_model
            )
            rejected.append(ReviewedFinding(reviews=(review,), found_by_old=by_old, found_by_new=by_new))
    defects = []
    for reviews in reviews_by_defect.values():
        by_old, by_new = (
            any(
                is_found(boxes.get(review.photo_id, ()), review.effective_box, review.defect_class)
                for review in reviews
            )
            for boxes in boxes_by_model
        )
        defects.append(ReviewedFinding(reviews=tuple(reviews), found_by_old=by_old, found_by_new=by_new))
    return ReviewComparison(defects=tuple(defects), rejected=tuple(rejected))


def _group_by_photograph(detections: Sequence[AcceptedDetection]) -> dict[str, list[AcceptedDetection]]:
    grouped: dict[str, list[AcceptedDetection]] = defaultdict(list)
    for detection in detections:
        grouped[detection.photo_id].append(detection)
    return grouped
