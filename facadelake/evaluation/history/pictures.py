"""Pictures of every wrong state: its place before and after at one scale, a sheet for each kind of confusion."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from facadelake.building.surface import Surface
from facadelake.campaigns import collect_campaign_views
from facadelake.core.arrays import UInt8Image
from facadelake.core.progress import report_progress
from facadelake.evaluation.history.comparison import DefectKey, HistoryComparison, JudgedState
from facadelake.evaluation.history.evaluate import EvaluatedHistory
from facadelake.evaluation.history.look_request import build_look_request
from facadelake.evaluation.history.state_figures import name_called_state, name_true_state
from facadelake.evaluation.picture_sheet import SheetCell, write_picture_sheet
from facadelake.tracking import Look, LookRequest, look_at_places
from schemas.vocabulary import TrackState

_SIDE_PX, _COLUMNS = 300, 3
_GAP_PX = 4  # between both pictures of a look
_GREY = 200


def write_confusion_sheets(evaluated: EvaluatedHistory, folder: Path, title: str) -> list[Path]:
    """Write ``TRUE-called-CALLED.png`` into ``folder`` for each kind of wrong state.

    The earlier campaign is on the left; beneath are track and true defect, the two campaigns and what the look says. A
    track without a true defect is drawn where it is called repaired. Earlier sheets of the folder are removed.

    Args:
        evaluated: the comparison.
        folder: the folder.
        title: of building and truth.

    Returns:
        The paths.

    Raises:
        StoreError: a sheet cannot be written.
    """
    for earlier in folder.glob("*-called-*.png"):
        earlier.unlink()
    wrong = [one for one in evaluated.compared.judged if _is_drawn(one)]
    requests = {id(one): request for one in wrong if (request := _request_look(one, evaluated)) is not None}
    looks = _look(evaluated, list(requests.values()))
    by_kind: dict[tuple[str, str], list[SheetCell]] = defaultdict(list)
    for one in wrong:
        request = requests.get(id(one))
        cell = _draw_cell(one, evaluated.compared, None if request is None else looks[request.key])
        by_kind[name_true_state(one), name_called_state(one)].append(cell)
    return [
        write_picture_sheet(
            folder / f"{true.replace(' ', '_')}-called-{called.replace(' ', '_')}.png",
            cells,
            title=f"{title}: {true}, called {called}",
            columns_max=_COLUMNS,
        )
        for (true, called), cells in sorted(by_kind.items())
    ]


def _is_drawn(judged: JudgedState) -> bool:
    if judged.true_id is None:
        return judged.called is not None and judged.called.state is TrackState.REPAIRED
    return not judged.is_right


def _request_look(judged: JudgedState, evaluated: EvaluatedHistory) -> LookRequest | None:
    """The look at a wrong state's place: with the nearest other detection, else with the campaign before or after.

    None for a track of which no campaign has another view.
    """
    compared = evaluated.compared
    detections = {
        row.campaign_id: row.defect_id
        for row in compared.called
        if row.track_id == judged.track_id and row.defect_id is not None
    }
    number = compared.campaigns.index(judged.campaign_id)
    others = [k for k, campaign in enumerate(compared.campaigns) if campaign in detections and k != number]
    if others:
        seen = max((k for k in others if k < number), default=others[0])
        return _build_request(evaluated, compared.campaigns[seen], detections, judged.campaign_id)
    if judged.campaign_id in detections and len(compared.campaigns) > 1:
        other = compared.campaigns[number - 1 if number else 1]
        return _build_request(evaluated, judged.campaign_id, detections, other)
    return None


def _build_request(
    evaluated: EvaluatedHistory, seen: str, detections: dict[str, str], campaign: str
) -> LookRequest | None:
    records = next(one for one in evaluated.history.records if one.campaign_id == seen)
    row = records.tracked.defects.defect_id.tolist().index(detections[seen])
    key: DefectKey = (campaign, detections.get(campaign, ""))
    there = evaluated.compared.defects.get(key)
    return build_look_request(records, row, campaign, None if there is None else there.xyz_site_m)


def _look(evaluated: EvaluatedHistory, requests: Sequence[LookRequest]) -> dict[tuple[str, str, str], Look]:
    if not requests:
        return {}
    with report_progress("Building the surface"):
        surface = Surface(evaluated.model)
    campaigns = collect_campaign_views(evaluated.history, requests)
    return {look.key: look for look in look_at_places(requests, campaigns, surface)}


def _draw_cell(judged: JudgedState, compared: HistoryComparison, look: Look | None) -> SheetCell:
    """Both patches of a look, or a grey cell; the caption names what is known."""
    truth = "no defect" if judged.true_id is None else judged.true_id
    evidence = "" if judged.called is None else f", {judged.called.evidence}"
    title = f"{judged.track_id} {truth} {judged.campaign_id}{evidence}"
    if look is None:
        return SheetCell(image=_make_blank(), title=title, below="no other campaign shows the place")
    seen, _, other = look.key
    before, after = sorted((seen, other), key=compared.campaigns.index)
    below = f"{before} | {after}; look: {look.verdict}"
    if look.comparison is not None:
        below += f", similarity {look.comparison.at_defect:.2f}"
    if look.picture is None:
        return SheetCell(image=_make_blank(), title=title, below=f"{below} {look.remark or ''}")
    return SheetCell(image=_arrange_pair(look.picture, is_seen_first=before == seen), title=title, below=below)


def _arrange_pair(picture: bytes, *, is_seen_first: bool) -> UInt8Image:
    """The two halves of a look's picture, the earlier campaign on the left, within a cell."""
    image = np.asarray(cv2.imdecode(np.frombuffer(picture, np.uint8), cv2.IMREAD_COLOR), dtype=np.uint8)
    half = (image.shape[1] - _GAP_PX) // 2
    if not is_seen_first:
        image = np.hstack([image[:, half + _GAP_PX :], image[:, half : half + _GAP_PX], image[:, :half]])
    scale = min(2 * _SIDE_PX / image.shape[1], _SIDE_PX / image.shape[0])
    method = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(image, None, fx=scale, fy=scale, interpolation=method), dtype=np.uint8)


def _make_blank() -> UInt8Image:
    return np.full((_SIDE_PX // 2, _SIDE_PX, 3), _GREY, dtype=np.uint8)
