"""A new model becomes the default detector, where a comparison with the old one and its card speak for it."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from facadelake.core.errors import InputDataError, ModelError
from facadelake.core.hashing import hash_file
from facadelake.detection import (
    MODEL_LIST,
    MODELS_FOLDER,
    Promotion,
    add_promotion,
    find_default_model,
    read_promotions,
)
from facadelake.detection.inference import find_card, load_detector
from facadelake.evaluation.detectors.card_results import list_evaluations
from facadelake.evaluation.model_comparison.report import REPORT, ModelComparison, locate_comparison, read_comparison


def list_objections(
    comparison: ModelComparison,
    *,
    old_sha256: str | None,
    new_sha256: str,
    evaluations: Sequence[Mapping[str, Any]],
    lost_max: int,
    confirmed_min: int,
) -> tuple[str, ...]:
    """What speaks against promoting ``new_sha256`` in the place of ``old_sha256`` (None: there is no default yet).

    ``list_evaluations`` are those of the new model's card; ``lost_max`` confirmed defects may be lost, and at least
    ``confirmed_min`` must have been looked at. An empty answer is a yes.
    """
    found = []
    compared = (comparison.old.sha256, comparison.new.sha256)
    if compared[1] != new_sha256 or old_sha256 not in (None, compared[0]):
        found.append(
            f"the comparison is of {compared[0][:12]} with {compared[1][:12]}, not of the default "
            f"{(old_sha256 or 'none')[:12]} with {new_sha256[:12]}; run 'facadelake compare-models' with these two"
        )
    words = comparison.words
    confirmed = words.get("confirmed", 0)
    if confirmed < confirmed_min:
        found.append(
            f"the compared photographs show {confirmed} confirmed defects, at least {confirmed_min} are needed to tell "
            "whether any is lost; review detections ('facadelake review export-task') or compare more campaigns"
        )
    if len(comparison.lost) > lost_max:
        named = ", ".join(f"{one.defect} ({one.defect_class})" for one in comparison.lost[:5])
        more = f" and {len(comparison.lost) - 5} more" if len(comparison.lost) > 5 else ""
        found.append(
            f"it loses {len(comparison.lost)} of the {words.get('confirmed_by_old', 0)} confirmed defects that the old "
            f"one finds, allowed are {lost_max}: {named}{more}; train it on them ('facadelake training-set'), or allow "
            "it with --max-lost"
        )
    own = [one for one in evaluations if one.get("model_sha256") == new_sha256]
    if not own:
        other = f" (it has {len(evaluations)} of another file's hash)" if evaluations else ""
        found.append(
            f"its card holds no evaluation of this file{other}; run 'facadelake evaluate-detector' and let it write "
            "the figures into the card"
        )
    return tuple(found)


def describe_evidence(comparison: ModelComparison, *, lost_max: int) -> str:
    """What a promotion rests on, in a sentence for the list of models."""
    words = comparison.words
    photographs = sum(len(campaign.photographs) for campaign in comparison.campaigns)
    campaigns = ", ".join(f"{one.building_id}/{one.campaign_id}" for one in comparison.campaigns)
    return (
        f"compared with {comparison.old.sha256[:12]} on {photographs} photographs of {campaigns}: "
        f"{words.get('confirmed_lost', 0)} of {words.get('confirmed', 0)} confirmed defects lost (allowed {lost_max}), "
        f"{words.get('confirmed_gained', 0)} gained, {words.get('rejected_lost', 0)} of {words.get('rejected', 0)} "
        "rejected ones gone"
    )


_log = logging.getLogger("facadelake.flows")


def promote_model(
    new: Path,
    *,
    lake: Path,
    report: Path | None,
    by: str,
    why: str,
    lost_max: int,
    confirmed_min: int,
    models: Path = MODELS_FOLDER,
) -> tuple[Promotion, str]:
    """Make ``new`` the default detector where nothing speaks against it; also returns what it rests on, in words.

    Raises ModelError with every objection; the default then stays as it was.
    """
    if not new.is_file():
        raise ModelError(f"model {new} does not exist; correct the path")
    for name, text in (("--by", by), ("--why", why)):
        if not text.strip():
            raise InputDataError(f"{name} is empty; a promotion says who decided it and why")
    new_sha256 = hash_file(new)
    old_sha256 = _hash_default_model(models)
    known = read_promotions(models)
    if known and known[-1].sha256 == new_sha256:
        return known[-1], f"{new} is the default detector already"
    path = report or _locate_report(lake, old_sha256, new_sha256)
    comparison = read_comparison(path)
    load_detector(new, threads=1)  # a model that does not run as its card says is no default
    against = list_objections(
        comparison,
        old_sha256=old_sha256,
        new_sha256=new_sha256,
        evaluations=list_evaluations(find_card(new).metrics),
        lost_max=lost_max,
        confirmed_min=confirmed_min,
    )
    if against:
        listed = "\n".join(f"  - {one}" for one in against)
        raise ModelError(f"{new.name} was not promoted, the default stays as it was:\n{listed}")
    rests_on = describe_evidence(comparison, lost_max=lost_max)
    done = add_promotion(new, by=by.strip(), why=why.strip(), evidence=rests_on, replaces=old_sha256, folder=models)
    return done, f"{rests_on}; the models' list is {models / MODEL_LIST}"


def _hash_default_model(models: Path) -> str | None:
    """The default detector's hash, None where there is none yet."""
    try:
        return hash_file(find_default_model(models))
    except ModelError as error:
        _log.warning("%s", error)
        return None


def _locate_report(lake: Path, old_sha256: str | None, new_sha256: str) -> Path:
    if old_sha256 is None:
        raise InputDataError(
            "there is no default detector to compare with; name the comparison that speaks for the new one: --report"
        )
    path = locate_comparison(lake, old_sha256, new_sha256) / REPORT
    if not path.is_file():
        raise InputDataError(
            f"the new model was not compared with the default one (no {path}); run 'facadelake compare-models default "
            "NEW --campaign BUILDING/CAMPAIGN' on campaigns that were reviewed"
        )
    return path
