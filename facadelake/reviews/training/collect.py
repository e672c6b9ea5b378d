"""Training set from the reviewed campaigns of several buildings."""

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
    label_format: TrainingLabelFormat,
    pictures: PictureMode,
    side_px: int,
    splits: tuple[str, ...],
    terms: str | None,
    as_of: int | None = None,
) -> tuple[TrainingSet, dict[str, Split]]:
    """Write the reviewed campaigns of ``buildings`` as a training set.

    Args:
        buildings: The registered buildings.
        folder: Folder to write; it must not exist, or be empty.
        lake: Folder of the lake.
        label_format: Format of the label files.
        pictures: Tiles or whole photographs.
        side_px: Side of a tile.
        splits: ``BUILDING=SPLIT`` for buildings whose split is not to be that of their id's hash.
        terms: Terms of use of the photographs, for the manifest; None: a reminder to state them.
        as_of: An earlier version of the lake; None: the newest.

    Returns:
        The set, and the split of each building.

    Raises:
        InputDataError: The campaigns have no review, or ``splits`` has another building.
        StoreError: The set cannot be written.
    """
    chosen = parse_splits(splits)
    unknown = sorted(chosen.keys() - {building.id for building in buildings})
    if unknown:
        raise InputDataError(
            f"--split has the building {', '.join(unknown)}, but the set has {', '.join(b.id for b in buildings)}; "
            "correct the id"
        )
    split_by_building = {building.id: choose_split(building.id, chosen) for building in buildings}
    version_by_campaign = {
        (row["building_id"], row["campaign_id"]): row["version"]
        for row in list_versions(lake).to_pylist()
        if as_of is None or row["version"] <= as_of
    }
    sources = []
    for building in buildings:
        reviews = read_table(lake, "reviews", building_id=building.id, as_of=as_of)
        for campaign_id in sorted(set(reviews.column("campaign_id").to_pylist())):
            campaign = read_reviewed_campaign(building, campaign_id, lake=lake, as_of=as_of)
            rows = campaign.tables["detections"].select(["detector", "detector_sha256"]).to_pylist()
            sources.append(
                TrainingSource(
                    building_id=building.id,
                    campaign_id=campaign_id,
                    run_id=campaign.run_id,
                    version=version_by_campaign[building.id, campaign_id],
                    root=building.locate_photographs(campaign_id),
                    split=split_by_building[building.id],
                    status=campaign.status,
                    detectors={row["detector"]: row["detector_sha256"] for row in rows},
                )
            )
    if not sources:
        raise InputDataError(
            f"{', '.join(split_by_building)}: no reviews; export a review task with 'facadelake review export-task'"
        )
    training_set = write_training_set(
        sources,
        folder,
        label_format=label_format,
        pictures=pictures,
        side_px=side_px,
        terms=terms or TERMS,
        version=version_of("facadelake"),
    )
    return training_set, split_by_building
