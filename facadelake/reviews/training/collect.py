"""Reviewed campaigns of several buildings as one training set."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.metadata import version as version_of
from pathlib import Path

from facadelake.core.errors import InputDataError
from facadelake.lake import list_versions, read_table
from facadelake.registry import Building
from facadelake.reviews.campaign import read_reviewed_campaign
from facadelake.reviews.training.options import PictureMode, Split, TrainingLabelFormat, choose_split, parse_splits
from facadelake.reviews.training.training_set import TERMS, TrainingSet, TrainingSource, write_training_set


def make_training_set(
    buildings: Sequence[Building],
    folder: Path,
    *,
    lake: Path,
    form: TrainingLabelFormat,
    pictures: PictureMode,
    side_px: int,
    splits: tuple[str, ...],
    terms: str | None,
) -> tuple[TrainingSet, dict[str, Split]]:
    """Write every reviewed campaign of ``buildings`` to ``folder``; also returns the split of each building.

    Raises InputDataError where nothing was reviewed, or ``splits`` (BUILDING=SPLIT) name a building that is not among
    them.
    """
    chosen = parse_splits(splits)
    strange = sorted(chosen.keys() - {building.id for building in buildings})
    if strange:
        raise InputDataError(
            f"--split names {', '.join(strange)}, but the set is of {', '.join(b.id for b in buildings)}"
        )
    placed = {building.id: choose_split(building.id, chosen) for building in buildings}
    newest = {(row["building_id"], row["campaign_id"]): row["version"] for row in list_versions(lake).to_pylist()}
    sources = []
    for building in buildings:
        held = read_table(lake, "reviews", building_id=building.id)
        for campaign_id in sorted(set(held.column("campaign_id").to_pylist())):
            campaign = read_reviewed_campaign(building, campaign_id, lake=lake)
            rows = campaign.tables["detections"].select(["detector", "detector_sha256"]).to_pylist()
            sources.append(
                TrainingSource(
                    building_id=building.id,
                    campaign_id=campaign_id,
                    run_id=campaign.run_id,
                    version=newest[building.id, campaign_id],
                    root=building.locate_photographs(campaign_id),
                    split=placed[building.id],
                    status=campaign.status,
                    detectors={row["detector"]: row["detector_sha256"] for row in rows},
                )
            )
    if not sources:
        raise InputDataError(
            f"nothing of {', '.join(placed)} was reviewed; 'facadelake review export-task' begins a review"
        )
    done = write_training_set(
        sources,
        folder,
        form=form,
        pictures=pictures,
        side_px=side_px,
        terms=terms or TERMS,
        version=version_of("facadelake"),
    )
    return done, placed
