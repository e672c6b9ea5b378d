"""Evaluations in a model's card: written under ``metrics.evaluations`` and read back."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import yaml

from facadelake.core.errors import ModelError, StoreError
from facadelake.core.hashing import hash_file
from facadelake.detection import locate_card, read_card
from facadelake.evaluation.detectors.false_alarms import FalseAlarmFigures
from facadelake.evaluation.detectors.figures import ClassFigures, DetectorFigures
from facadelake.evaluation.detectors.image_level import ImageLevelFigures

KEY = "evaluations"
_BLOCK = re.compile(r"^metrics:.*\n(?:(?:[ \t-].*)?\n)*", re.MULTILINE)


def write_results(
    model: Path, figures: DetectorFigures | None, image_level: Sequence[ImageLevelFigures], *, command: str
) -> Path:
    """Write figures into the card beside a model; the rest of the card does not change.

    An earlier evaluation of the same kind on data of the same name and split is replaced. Evaluations with the hash of
    another model file are dropped.

    Args:
        model: The ONNX file.
        figures: Figures on labelled photographs and photographs without defects, if any.
        image_level: Figures on photographs labelled as a whole.
        command: The command of the evaluation.

    Returns:
        The card's path.

    Raises:
        ModelError: There is no card beside the model.
        StoreError: The card cannot be written.
    """
    path = _find_card_beside(model)
    sha256 = hash_file(model)
    head = {"model_sha256": sha256, "date": datetime.now(UTC).date().isoformat(), "command": command}
    entries = [] if figures is None else _build_entries(figures, head)
    entries += [_build_image_level_entry(one, head) for one in image_level]
    metrics = dict(read_card(path).metrics)
    replaced = {_identify_entry(one) for one in entries}
    earlier = [
        one
        for one in list_evaluations(metrics)
        if one.get("model_sha256") == sha256 and _identify_entry(one) not in replaced
    ]
    metrics[KEY] = [_round_numbers(one) for one in (*earlier, *entries)]
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".json":
        text = json.dumps({**json.loads(text), "metrics": metrics}, indent=2, ensure_ascii=False) + "\n"
    else:
        block = yaml.safe_dump({"metrics": metrics}, sort_keys=False, allow_unicode=True, width=110)
        kept = _BLOCK.sub("", text if text.endswith("\n") else text + "\n", count=1)
        text = kept.rstrip("\n") + "\n" + block
    part = path.with_name(f".{path.name}.part")
    try:
        part.write_text(text, encoding="utf-8")
        read_card(part)
        part.replace(path)
    except OSError as error:
        raise StoreError(f"card {path} cannot be written: {error}; it is unchanged") from error
    finally:
        part.unlink(missing_ok=True)
    return path


def list_evaluations(metrics: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The evaluations in the ``metrics`` of a card."""
    found = metrics.get(KEY, [])
    return [one for one in found if isinstance(one, dict)] if isinstance(found, list) else []


def _find_card_beside(model: Path) -> Path:
    beside = locate_card(model)
    for path in (beside, beside.with_suffix(".yml"), beside.with_suffix(".json")):
        if path.is_file():
            return path
    raise ModelError(f"card {beside} does not exist; figures cannot be written into a card in the model's metadata")


def _identify_entry(entry: Mapping[str, Any]) -> tuple[object, ...]:
    return entry.get("kind"), entry.get("data"), entry.get("split")


def _build_entries(figures: DetectorFigures, head: Mapping[str, str]) -> list[dict[str, Any]]:
    entries: list[dict[str, Any]] = []
    if figures.classes:
        data = figures.data
        entries.append(
            {
                "kind": "boxes",
                "data": data.name,
                "split": data.split,
                "data_sha256": data.sha256,
                **head,
                "threshold": figures.detector.threshold,
                "photographs": data.photographs,
                "sites": data.sites,
                "classes": [_build_class_entry(one) for one in figures.classes],
                "by_site": [
                    {
                        "site": one.site,
                        "class": str(one.defect_class),
                        "photographs": one.photographs,
                        "truths": one.truths,
                        "ap50": one.ap50,
                        "ap50_95": one.ap50_95,
                        "precision": one.operating.precision,
                        "recall": one.operating.recall,
                    }
                    for one in figures.sites
                ],
                "remarks": list(figures.remarks),
            }
        )
    if figures.negatives is not None:
        entries.append(_build_negatives_entry(figures.negatives, figures.detector.threshold, figures.data.split, head))
    return entries


def _build_class_entry(one: ClassFigures) -> dict[str, Any]:
    by_sites, by_photographs = one.ap50_by_sites, one.ap50_by_photographs
    return {
        "class": str(one.defect_class),
        "photographs": one.photographs,
        "truths": one.truths,
        "ap50": one.ap50,
        "ap50_by_sites": None if by_sites is None else [by_sites.low, by_sites.high],
        "ap50_by_photographs": None if by_photographs is None else [by_photographs.low, by_photographs.high],
        "mean_ap50_of_sites": one.mean_ap50_of_sites,
        "ap50_95": one.ap50_95,
        **one.operating.convert_to_json(),
        "recall_by_size": [[at.size_px, at.recall, at.truths] for at in one.recall_by_size],
        "ece": one.calibration.ece,
        "expected_precision": one.calibration.expected_precision,
        "precision_down_to_threshold": one.calibration.precision_shown,
    }


def _build_negatives_entry(
    alarms: FalseAlarmFigures, threshold: float, split: str | None, head: Mapping[str, str]
) -> dict[str, Any]:
    all_classes = alarms.rates[0]
    return {
        "kind": "without defects",
        "data": alarms.name,
        "split": split,
        **head,
        "threshold": threshold,
        "photographs": all_classes.photographs,
        "area_m2": all_classes.area_m2,
        "gsd_mm": alarms.gsd_mm,
        "rates": [
            {
                "class": "all" if one.defect_class is None else str(one.defect_class),
                "false_alarms": one.count,
                "photographs_with_one": one.with_one,
                "per_10_m2": one.per_10_m2,
                "per_10_m2_interval": None if one.low_per_10_m2 is None else [one.low_per_10_m2, one.high_per_10_m2],
            }
            for one in alarms.rates
        ],
    }


def _build_image_level_entry(figures: ImageLevelFigures, head: Mapping[str, str]) -> dict[str, Any]:
    return {
        "kind": "image labels",
        "data": figures.name,
        "split": None,
        "data_sha256": figures.sha256,
        **head,
        "threshold": figures.detector.threshold,
        "sound_folders": list(figures.sound_folders),
        "classes": [
            {
                "class": str(one.defect_class),
                "with_defect": one.with_defect,
                "sound": one.sound,
                "auroc": one.auroc,
                "auroc_by_sites": None
                if one.auroc_by_sites is None
                else [one.auroc_by_sites.low, one.auroc_by_sites.high],
                "average_precision": one.average_precision,
                "recall": one.recall,
                "false_alarm_share": one.false_alarm_share,
            }
            for one in figures.classes
        ],
    }


def _round_numbers(value: Any) -> Any:
    """The value with floats rounded to four decimals, recursively."""
    if isinstance(value, float):
        return round(value, 4)
    if isinstance(value, dict):
        return {key: _round_numbers(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_round_numbers(one) for one in value]
    return value
