"""A new model becomes the default detector, where a comparison with the old one and its card speak for it."""

from __future__ import annotations

import logging
from pathlib import Path

from facadelake.core.errors import InputDataError, ModelError
from facadelake.core.hashing import file_sha256
from facadelake.detection.inference.detector import load_detector
from facadelake.detection.inference.find_card import find_card
from facadelake.detection.model_registry import LIST, MODELS, Promotion, default_model, promote, promotions
from facadelake.evaluation.detectors.card_results import evaluations
from facadelake.evaluation.model_comparison.promotion import evidence, objections
from facadelake.evaluation.model_comparison.report import REPORT, comparison_folder, read_comparison

log = logging.getLogger("facadelake.flows")


def promote_model(
    new: Path,
    *,
    lake: Path,
    report: Path | None,
    by: str,
    why: str,
    lost_max: int,
    confirmed_min: int,
    models: Path = MODELS,
) -> tuple[Promotion, str]:
    """Make ``new`` the default detector where nothing speaks against it; also returns what it rests on, in words.

    Raises ModelError with every objection; the default then stays as it was.
    """
    if not new.is_file():
        raise ModelError(f"model {new} does not exist; correct the path")
    for name, text in (("--by", by), ("--why", why)):
        if not text.strip():
            raise InputDataError(f"{name} is empty; a promotion says who decided it and why")
    new_sha256 = file_sha256(new)
    old_sha256 = _default_sha256(models)
    known = promotions(models)
    if known and known[-1].sha256 == new_sha256:
        return known[-1], f"{new} is the default detector already"
    path = report or _report_of(lake, old_sha256, new_sha256)
    comparison = read_comparison(path)
    load_detector(new, threads=1)  # a model that does not run as its card says is no default
    against = objections(
        comparison,
        old_sha256=old_sha256,
        new_sha256=new_sha256,
        evaluations=evaluations(find_card(new).metrics),
        lost_max=lost_max,
        confirmed_min=confirmed_min,
    )
    if against:
        listed = "\n".join(f"  - {one}" for one in against)
        raise ModelError(f"{new.name} was not promoted, the default stays as it was:\n{listed}")
    rests_on = evidence(comparison, lost_max=lost_max)
    done = promote(new, by=by.strip(), why=why.strip(), evidence=rests_on, replaces=old_sha256, folder=models)
    return done, f"{rests_on}; the models' list is {models / LIST}"


def _default_sha256(models: Path) -> str | None:
    """The default detector's hash, None where there is none yet."""
    try:
        return file_sha256(default_model(models))
    except ModelError as error:
        log.warning("%s", error)
        return None


def _report_of(lake: Path, old_sha256: str | None, new_sha256: str) -> Path:
    if old_sha256 is None:
        raise InputDataError(
            "there is no default detector to compare with; name the comparison that speaks for the new one: --report"
        )
    path = comparison_folder(lake, old_sha256, new_sha256) / REPORT
    if not path.is_file():
        raise InputDataError(
            f"the new model was not compared with the default one (no {path}); run 'facadelake compare-models default "
            "NEW --campaign BUILDING/CAMPAIGN' on campaigns that were reviewed"
        )
    return path
