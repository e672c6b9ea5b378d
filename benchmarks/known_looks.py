"""What looks say of places whose truth is known, in photographs: every detected defect in every other campaign."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from facadelake.building.surface import Surface
from facadelake.campaigns import collect_campaign_views
from facadelake.evaluation.history import EvaluatedHistory, build_look_request, compare_history
from facadelake.registry import read_portfolio
from facadelake.tracking import LookRequest, look_at_places
from schemas.vocabulary import LookVerdict


def count_known_looks(portfolio: Path, building: str, lake: Path, truth: Path) -> Counter[tuple[str, LookVerdict]]:
    """Verdicts by truth of the place in the campaign looked at: there, changed in size, gone, not imaged, false.

    A false detection's place is a wall that did not change. Looks go to campaigns before and after the detection.

    Args:
        portfolio: the portfolio file.
        building: its building.
        lake: the lake with the campaigns.
        truth: the truth of the history.
    """
    evaluated = compare_history(read_portfolio(portfolio).get_building(building), lake=lake, truth=truth)
    wanted = [(name, request) for name, request in _list_requests(evaluated)]
    requests = [request for _, request in wanted]
    campaigns = collect_campaign_views(evaluated.history, requests)
    looks = look_at_places(requests, campaigns, Surface(evaluated.model))
    return Counter((name, look.verdict) for (name, _), look in zip(wanted, looks, strict=True))


def _list_requests(evaluated: EvaluatedHistory) -> list[tuple[str, LookRequest]]:
    compared, found = evaluated.compared, []
    number = {campaign: k for k, campaign in enumerate(compared.campaigns)}
    place = {(one.true_id, key[0]): one.xyz_site_m for key, one in compared.defects.items() if one.true_id}
    for records in evaluated.history.records:
        defects = records.tracked.defects
        for row, defect_id in enumerate(defects.defect_id.tolist()):
            true_id = compared.defects[records.campaign_id, defect_id].true_id
            for campaign in compared.campaigns:
                if campaign == records.campaign_id:
                    continue
                request = build_look_request(records, row, campaign, place.get((true_id, campaign)))
                then, now = number[records.campaign_id], number[campaign]
                found.append((_name_truth(evaluated, true_id, then, now), request))
    return found


def _name_truth(evaluated: EvaluatedHistory, true_id: str | None, then: int, now: int) -> str:
    if true_id is None:
        return "false detection"
    history = evaluated.compared.truth[true_id]
    if not history[now].imaged:
        return "not imaged"
    if not history[now].exists:
        return "gone"
    same = (history[now].width_m, history[now].height_m) == (history[then].width_m, history[then].height_m)
    return "there" if same else "there, of another size"
