"""The reach of the detector that the portfolio configures for a building."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc

from facadelake.coverage.detector_reach import DetectorReach, resolve_reach
from facadelake.detection import read_configured_card
from facadelake.detection.coco import list_searched_photographs
from facadelake.registry import Building, CocoDetectorSetting, OnnxDetectorSetting
from schemas.vocabulary import PhotoOutcome


def resolve_campaign_reach(building: Building, campaign_id: str, choice: str | None, photos: pa.Table) -> DetectorReach:
    """The reach of the detector of a campaign.

    Args:
        building: building in the portfolio.
        campaign_id: the campaign.
        choice: other detections than the portfolio's, as of ``Building.locate_detections``.
        photos: table ``photos``.

    Raises:
        InputDataError: the file of imported boxes does not exist or cannot be read.
        ModelError: the model has no card.
    """
    if isinstance(building.detector, CocoDetectorSetting):
        file = building.locate_detections(campaign_id, choice)
        return _resolve_imported_reach(building.detector, file, choice, photos)
    return _resolve_model_reach(building.detector, photos)


def _resolve_imported_reach(
    setting: CocoDetectorSetting, file: Path, choice: str | None, photos: pa.Table
) -> DetectorReach:
    """Photographs that the file lists; recall as the portfolio declares it of its own file, of another one unknown."""
    searched = list_searched_photographs(file, photos, exif_view=setting.exif_view)
    is_own = choice is None or setting.alternatives.get(choice, choice) == setting.file
    return resolve_reach(setting.recall_by_size if is_own else None, searched)


def _resolve_model_reach(setting: OnnxDetectorSetting, photos: pa.Table) -> DetectorReach:
    """All accepted photographs; recall as the card declares it.

    A score threshold of the portfolio above the card's makes the recall unknown, which the card states at its own.
    """
    card = read_configured_card(setting)
    accepted = photos.filter(pc.equal(photos.column("photo_outcome"), str(PhotoOutcome.ACCEPTED)))
    is_stricter = setting.score_threshold is not None and setting.score_threshold > card.score_threshold
    recall = None if is_stricter else card.recall_by_size
    return resolve_reach(recall, frozenset(accepted.column("photo_id").to_pylist()), card.input.gsd_mm)
