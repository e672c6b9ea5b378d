"""The comparison of two models on stored campaigns, as it is written and read again: what a promotion rests on."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

from pydantic import BaseModel, ConfigDict, ValidationError

from facadelake.core.errors import InputDataError, StoreError
from facadelake.evaluation.model_comparison.box_changes import BoxChange, Change
from facadelake.evaluation.model_comparison.defect_changes import DefectChange
from facadelake.evaluation.model_comparison.review_comparison import ReviewComparison, ReviewedFinding
from facadelake.reviews import Review

FOLDER, REPORT = "comparisons", "comparison.json"

ChangeCounts = dict[str, dict[str, int]]  # class -> change -> number


class _ReportPart(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class ComparedModel(_ReportPart):
    """A model by its card's name and its file's hash."""

    name: str
    sha256: str


class LostDefect(_ReportPart):
    """A confirmed defect that the old model finds and the new one does not, by one of its photographs."""

    defect: str
    defect_class: str
    photo_id: str
    box_px: tuple[float, float, float, float]
    sightings: int


class CampaignComparison(_ReportPart):
    """One campaign: ``boxes`` and ``wall`` count changes by class; ``wall_remark`` says why there is no wall."""

    building_id: str
    campaign_id: str
    run_id: str
    photographs_total: int
    photographs: tuple[str, ...]
    boxes: ChangeCounts
    wall: ChangeCounts | None
    wall_remark: str
    words: dict[str, int]
    lost: tuple[LostDefect, ...]


class ModelComparison(_ReportPart):
    """Two models on the photographs of stored campaigns."""

    old: ComparedModel
    new: ComparedModel
    made_at: datetime
    facadelake: str
    campaigns: tuple[CampaignComparison, ...]

    @property
    def words(self) -> dict[str, int]:
        """What persons said, over all campaigns."""
        total: Counter[str] = Counter()
        for campaign in self.campaigns:
            total.update(campaign.words)
        return dict(total)

    @property
    def lost(self) -> tuple[LostDefect, ...]:
        """The confirmed defects that the new model loses."""
        return tuple(one for campaign in self.campaigns for one in campaign.lost)


def locate_comparison(lake: Path, old_sha256: str, new_sha256: str) -> Path:
    """Where the comparison of two models on a lake's campaigns is."""
    return lake / FOLDER / f"{old_sha256[:12]}-{new_sha256[:12]}"


def count_changes(changes: Sequence[BoxChange | DefectChange]) -> ChangeCounts:
    """Changes by class; a renamed box counts for the class it had."""
    out: ChangeCounts = {}
    for one in changes:
        defect_class = (
            one.defect_class if isinstance(one, DefectChange) else (one.old or one.representative).defect_class
        )
        of_class = out.setdefault(str(defect_class), {str(change): 0 for change in Change})
        of_class[str(one.change)] += 1
    return dict(sorted(out.items()))


def list_lost_defects(words: ReviewComparison) -> tuple[LostDefect, ...]:
    """The defects that the new model loses, as the report names them."""
    return tuple(_describe_lost_defect(place) for place in words.lost)


def _describe_lost_defect(place: ReviewedFinding) -> LostDefect:
    largest: Review = max(place.words, key=lambda word: word.effective_box.width_px * word.effective_box.height_px)
    box = largest.effective_box
    return LostDefect(
        defect=largest.defect_id or largest.subject,
        defect_class=str(largest.defect_class),
        photo_id=largest.photo_id,
        box_px=(box.x_px, box.y_px, box.width_px, box.height_px),
        sightings=len(place.words),
    )


def write_comparison(comparison: ModelComparison, folder: Path) -> Path:
    """Write the report to ``folder``. Raises StoreError where the disk fails."""
    path = folder / REPORT
    part = path.with_name(f".{REPORT}.part")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        part.write_text(comparison.model_dump_json(indent=1) + "\n", encoding="utf-8")
        part.replace(path)
    except OSError as error:
        raise StoreError(f"the comparison cannot be written to {path}: {error}; check rights and free space") from error
    return path


def read_comparison(path: Path) -> ModelComparison:
    """Read a report. Raises InputDataError where it is missing or not one."""
    try:
        return ModelComparison.model_validate_json(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise InputDataError(f"there is no comparison at {path}; 'facadelake compare-models' makes it") from error
    except (OSError, UnicodeDecodeError, ValidationError) as error:
        raise InputDataError(f"{path} is no comparison of two models: {error}; make it anew") from error
