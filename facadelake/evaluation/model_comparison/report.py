"""Report of the comparison of two models on committed campaigns; a promotion requires one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

from pydantic import AliasChoices, BaseModel, ConfigDict, Field, ValidationError

from facadelake.core.errors import InputDataError, StoreError
from facadelake.evaluation.model_comparison.box_changes import BoxChange, Change
from facadelake.evaluation.model_comparison.defect_changes import DefectChange
from facadelake.evaluation.model_comparison.review_comparison import ReviewComparison, ReviewedFinding
from facadelake.reviews import Review

FOLDER, REPORT = "comparisons", "comparison.json"

ChangeCounts = dict[str, dict[str, int]]  # class -> change -> number


class _ReportPart(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class ComparedDetector(_ReportPart):
    """A model: the name in its card and the SHA-256 of its file."""

    name: str
    sha256: str


class LostDefect(_ReportPart):
    """A confirmed defect that the old model finds and the new one does not.

    ``photo_id`` and ``box_px`` (left, top, width, height) are those of its largest reviewed box, ``observations`` is
    the number of its reviewed boxes. The second name of a field is that of earlier reports.
    """

    defect: str
    defect_class: str
    photo_id: str
    box_px: tuple[float, float, float, float]
    observations: int = Field(validation_alias=AliasChoices("observations", "sightings"))


class CampaignComparison(_ReportPart):
    """The comparison on one campaign.

    ``boxes`` and ``wall`` count the changes of boxes in photographs and of defects on the building, by class; without a
    building model ``wall`` is None and ``wall_remark`` has the reason. ``reviews``: see
    ``ReviewComparison.count_outcomes``.
    """

    building_id: str
    campaign_id: str
    run_id: str
    photographs_total: int
    photographs: tuple[str, ...]
    boxes: ChangeCounts
    wall: ChangeCounts | None
    wall_remark: str
    reviews: dict[str, int] = Field(validation_alias=AliasChoices("reviews", "words"))
    lost: tuple[LostDefect, ...]


class DetectorComparison(_ReportPart):
    """The comparison of two models on the photographs of committed campaigns."""

    old: ComparedDetector
    new: ComparedDetector
    made_at: datetime
    facadelake: str
    campaigns: tuple[CampaignComparison, ...]

    @property
    def review_counts(self) -> dict[str, int]:
        """``reviews`` summed over all campaigns."""
        total: Counter[str] = Counter()
        for campaign in self.campaigns:
            total.update(campaign.reviews)
        return dict(total)

    @property
    def lost(self) -> tuple[LostDefect, ...]:
        """The confirmed defects that the new model loses, of all campaigns."""
        return tuple(defect for campaign in self.campaigns for defect in campaign.lost)


def locate_comparison(lake: Path, old_sha256: str, new_sha256: str) -> Path:
    """The default folder of the comparison of two models on campaigns of a lake."""
    return lake / FOLDER / f"{old_sha256[:12]}-{new_sha256[:12]}"


def count_changes(changes: Sequence[BoxChange | DefectChange]) -> ChangeCounts:
    """Numbers of changes by class; a reclassified box counts for its class by the old model."""
    counts: ChangeCounts = {}
    for one in changes:
        defect_class = (
            one.defect_class if isinstance(one, DefectChange) else (one.old or one.representative).defect_class
        )
        of_class = counts.setdefault(str(defect_class), {str(change): 0 for change in Change})
        of_class[str(one.change)] += 1
    return dict(sorted(counts.items()))


def list_lost_defects(comparison: ReviewComparison) -> tuple[LostDefect, ...]:
    """The defects that the new model loses, for the report."""
    return tuple(_describe_lost_defect(finding) for finding in comparison.lost)


def _describe_lost_defect(finding: ReviewedFinding) -> LostDefect:
    largest: Review = max(
        finding.reviews, key=lambda review: review.effective_box.width_px * review.effective_box.height_px
    )
    box = largest.effective_box
    return LostDefect(
        defect=largest.defect_id or largest.subject,
        defect_class=str(largest.defect_class),
        photo_id=largest.photo_id,
        box_px=(box.x_px, box.y_px, box.width_px, box.height_px),
        observations=len(finding.reviews),
    )


def write_comparison(comparison: DetectorComparison, folder: Path) -> Path:
    """Write the report to ``folder`` and return its path. Raises StoreError where it cannot be written."""
    path = folder / REPORT
    part = path.with_name(f".{REPORT}.part")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        part.write_text(comparison.model_dump_json(indent=1) + "\n", encoding="utf-8")
        part.replace(path)
    except OSError as error:
        raise StoreError(
            f"the comparison cannot be written to {path}: {error}; check permissions and free space"
        ) from error
    return path


def read_comparison(path: Path) -> DetectorComparison:
    """Read a report. Raises InputDataError where it is missing or not a report."""
    try:
        return DetectorComparison.model_validate_json(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise InputDataError(f"comparison {path} does not exist; run 'facadelake compare-models'") from error
    except (OSError, UnicodeDecodeError, ValidationError) as error:
        raise InputDataError(
            f"{path} is not a comparison of two models: {error}; run 'facadelake compare-models' again"
        ) from error
