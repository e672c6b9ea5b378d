"""Promotion of a model to the default detector, on the evidence of a comparison and of its card."""

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
from facadelake.evaluation.model_comparison.report import REPORT, DetectorComparison, locate_comparison, read_comparison

_log = logging.getLogger("facadelake.flows")


def list_objections(
    comparison: DetectorComparison,
    *,
    old_sha256: str | None,
    new_sha256: str,
    evaluations: Sequence[Mapping[str, Any]],
    lost_max: int,
    confirmed_min: int,
) -> tuple[str, ...]:
    """The reasons against a promotion; none: the model may be promoted.

    Args:
        comparison: Comparison of the old model with the new one.
        old_sha256: Hash of the default model; None: there is no default yet.
        new_sha256: Hash of the new model.
        evaluations: The evaluations in the new model's card.
        lost_max: Largest number of confirmed defects that the new model may lose.
        confirmed_min: Least number of confirmed defects in the compared photographs.
    """
    objections = []
    compared = (comparison.old.sha256, comparison.new.sha256)
    if compared[1] != new_sha256 or old_sha256 not in (None, compared[0]):
        objections.append(
            f"the comparison is of {compared[0][:12]} with {compared[1][:12]}, not of the default "
            f"{(old_sha256 or 'none')[:12]} with {new_sha256[:12]}; run 'facadelake compare-models' with these two"
        )
    counts = comparison.review_counts
    confirmed = counts.get("confirmed", 0)
    if confirmed < confirmed_min:
        objections.append(
            f"the compared photographs show {confirmed} confirmed defects, at least {confirmed_min} are needed to "
            "decide whether any is lost; review detections ('facadelake review export-task') or compare more campaigns"
        )
    if len(comparison.lost) > lost_max:
        named = ", ".join(f"{one.defect} ({one.defect_class})" for one in comparison.lost[:5])
        more = f" and {len(comparison.lost) - 5} more" if len(comparison.lost) > 5 else ""
        objections.append(
            f"it loses {len(comparison.lost)} of the {counts.get('confirmed_by_old', 0)} confirmed defects that the "
            f"old one finds, at most {lost_max} allowed: {named}{more}; train it on them ('facadelake training-set'), "
            "or raise --max-lost"
        )
    of_model = [one for one in evaluations if one.get("model_sha256") == new_sha256]
    if not of_model:
        other = f" (it has {len(evaluations)} of files with another hash)" if evaluations else ""
        objections.append(
            f"its card holds no evaluation of this file{other}; run 'facadelake evaluate-detector --write-card'"
        )
    return tuple(objections)


def describe_evidence(comparison: DetectorComparison, *, lost_max: int) -> str:
    """The evidence of a promotion in one sentence, for the list of models."""
    counts = comparison.review_counts
    photographs = sum(len(campaign.photographs) for campaign in comparison.campaigns)
    campaigns = ", ".join(f"{one.building_id}/{one.campaign_id}" for one in comparison.campaigns)
    return (
        f"compared with {comparison.old.sha256[:12]} on {photographs} photographs of {campaigns}: "
        f"{counts.get('confirmed_lost', 0)} of {counts.get('confirmed', 0)} confirmed defects lost "
        f"(allowed {lost_max}), {counts.get('confirmed_gained', 0)} gained, "
        f"{counts.get('rejected_lost', 0)} of {counts.get('rejected', 0)} rejected ones gone"
    )


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
    """Make a model the default detector, where there is no objection.

    Args:
        new: The ONNX file, with its card.
        lake: Folder of the lake.
        report: A report of ``compare_models``; None: that of the default and the new model in the lake.
        by: Who decides.
        why: The reason.
        lost_max: Largest number of confirmed defects that the new model may lose.
        confirmed_min: Least number of confirmed defects in the compared photographs.
        models: Folder of the model registry.

    Returns:
        The promotion, and its evidence in a sentence.

    Raises:
        ModelError: There are objections, all of which are in the message, or the model cannot be loaded. The default
            does not change.
        InputDataError: ``by`` or ``why`` is empty, or there is no report.
    """
    if not new.is_file():
        raise ModelError(f"model {new} does not exist; correct the path")
    for name, text in (("--by", by), ("--why", why)):
        if not text.strip():
            raise InputDataError(f"{name} is empty; a promotion records who decided it and why")
    new_sha256 = hash_file(new)
    old_sha256 = _hash_default_model(models)
    promotions = read_promotions(models)
    if promotions and promotions[-1].sha256 == new_sha256:
        return promotions[-1], f"{new} is the default detector already"
    path = report or _locate_report(lake, old_sha256, new_sha256)
    comparison = read_comparison(path)
    load_detector(new, threads=1)  # raises where the model does not run as its card states
    objections = list_objections(
        comparison,
        old_sha256=old_sha256,
        new_sha256=new_sha256,
        evaluations=list_evaluations(find_card(new).metrics),
        lost_max=lost_max,
        confirmed_min=confirmed_min,
    )
    if objections:
        listed = "\n".join(f"  - {one}" for one in objections)
        raise ModelError(f"{new.name} was not promoted, the default detector is unchanged:\n{listed}")
    evidence = describe_evidence(comparison, lost_max=lost_max)
    promotion = add_promotion(
        new, by=by.strip(), why=why.strip(), evidence=evidence, replaces=old_sha256, folder=models
    )
    return promotion, f"{evidence}; the list of models is {models / MODEL_LIST}"


def _hash_default_model(models: Path) -> str | None:
    """The default detector's hash; None where there is no default yet."""
    try:
        return hash_file(find_default_model(models))
    except ModelError as error:
        _log.warning("%s", error)
        return None


def _locate_report(lake: Path, old_sha256: str | None, new_sha256: str) -> Path:
    if old_sha256 is None:
        raise InputDataError(
            "there is no default detector to compare with; give the new model's comparison with --report"
        )
    path = locate_comparison(lake, old_sha256, new_sha256) / REPORT
    if not path.is_file():
        raise InputDataError(
            f"the new model was not compared with the default one ({path} does not exist); run 'facadelake "
            "compare-models default NEW --campaign BUILDING/CAMPAIGN' on reviewed campaigns"
        )
    return path
