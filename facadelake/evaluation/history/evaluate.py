"""Comparison of a building's history in the lake with truth."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc

from facadelake.building import BuildingModel, read_registered_model
from facadelake.campaigns import BuildingHistory, read_history
from facadelake.core.errors import InputDataError, StoreError
from facadelake.evaluation.campaigns.association import match_defects, match_detections
from facadelake.evaluation.history.comparison import DefectKey, HistoryComparison, compare_histories
from facadelake.evaluation.history.expected_states import check_stated_states
from facadelake.evaluation.history.tracked import collect_measured_defects, list_called_states
from facadelake.evaluation.history.truth import HistoryTruth, TrueDefect, read_history_truth
from facadelake.lake import has_lake, read_tables
from facadelake.registry import Building
from schemas.vocabulary import ObservationOutcome, SurfaceKind

log = logging.getLogger(__name__)

_READ = ("detections", "observations", "track_states")


@dataclass(frozen=True, kw_only=True, eq=False)
class EvaluatedHistory:
    """A building's history beside truth, with what pictures of it need."""

    compared: HistoryComparison
    history: BuildingHistory
    model: BuildingModel


def compare_history(building: Building, *, lake: Path, truth: Path) -> EvaluatedHistory:
    """Compare the history of a building with truth; the lake is not changed.

    Args:
        building: The registered building.
        lake: Folder of the lake; all its campaigns of the building are evaluated.
        truth: Folder with the truth of a history (``read_history_truth``). Campaigns that the lake does not hold are
            left out, as if nobody had flown them.

    Returns:
        The comparison, for ``compute_history_figures`` and ``write_confusion_sheets``.

    Raises:
        StoreError: The lake holds no track of the building.
        InputDataError: The truth cannot be used, or is not of these campaigns.
    """
    if building.surface_kind is SurfaceKind.AS_BUILT:
        raise InputDataError(
            f"building '{building.id}' has no model (model: as-built): the site frames of its campaigns cannot be "
            "related here, so its history cannot be evaluated"
        )
    content = read_history_truth(truth)
    tables = _read_tables(lake, building)
    model = read_registered_model(building)
    history = read_history(lake, building.id, model, None)
    by_time = sorted(history.records, key=lambda one: (one.tracked.captured_at, one.campaign_id))
    campaigns = [one.campaign_id for one in by_time]
    unknown = [campaign for campaign in campaigns if campaign not in content.defects]
    if unknown:
        raise InputDataError(
            f"{truth} has no truth of {', '.join(unknown)}, which the lake holds of {building.id} (truth has "
            f"{', '.join(content.defects)}); give the truth of this building's campaigns"
        )
    histories = _list_true_histories(content, campaigns)
    absent = [campaign for campaign in content.defects if campaign not in campaigns]
    if absent:
        log.warning("the lake does not hold %s, of which there is truth: left out", ", ".join(absent))
    else:
        for one in histories.values():
            check_stated_states(one)
    true_ids: dict[DefectKey, str | None] = {}
    for campaign in campaigns:
        of_campaign = {name: table.filter(pc.equal(table["campaign_id"], campaign)) for name, table in tables.items()}
        true_ids |= _match_campaign(content, campaign, of_campaign)
    compared = compare_histories(
        campaigns,
        histories,
        collect_measured_defects(by_time, true_ids),
        list_called_states(tables["track_states"]),
    )
    return EvaluatedHistory(compared=compared, history=history, model=model)


def _read_tables(lake: Path, building: Building) -> dict[str, pa.Table]:
    if not has_lake(lake):
        raise StoreError(f"there is no lake at {lake}; run 'facadelake inspect {building.id}' first")
    tables = read_tables(lake, _READ, building_id=building.id)
    if not len(tables["track_states"]):
        raise StoreError(
            f"the lake {lake} has no tracks of {building.id}; inspect a campaign of it with this version, or see "
            "'facadelake campaigns'"
        )
    return tables


def _list_true_histories(content: HistoryTruth, campaigns: Sequence[str]) -> dict[str, list[TrueDefect]]:
    """Each true defect in the campaigns, in order of capture."""
    days = zip(*(content.defects[campaign] for campaign in campaigns), strict=True)
    return {of_days[0].true_id: list(of_days) for of_days in days}


def _match_campaign(
    content: HistoryTruth, campaign: str, tables: Mapping[str, pa.Table]
) -> dict[DefectKey, str | None]:
    """The true defect that each defect of a campaign shows, by its annotations."""
    annotations = content.true_id_of_annotation[campaign]
    true_id_of_detection = match_detections(tables["detections"], annotations, content.path[campaign])
    if len(tables["detections"]) and not true_id_of_detection:
        raise InputDataError(
            f"the detections of {campaign} are those of a model: truth identifies the boxes of a file; inspect the "
            "campaign with 'facadelake inspect ... --detections'"
        )
    registered = [
        row for row in tables["observations"].to_pylist() if row["observation_outcome"] == ObservationOutcome.REGISTERED
    ]
    defect_ids = sorted({row["defect_id"] for row in registered if row["defect_id"]})
    matched = match_defects(defect_ids, registered, true_id_of_detection)
    return {(campaign, defect_id): true_id for defect_id, true_id in zip(defect_ids, matched, strict=True)}
