"""False alarms on photographs without defects: per square metre of facade and per photograph."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from facadelake.core.errors import InputDataError
from facadelake.evaluation.detectors.bootstrap import estimate_interval
from facadelake.evaluation.detectors.labels.labels import LabelledImage
from facadelake.evaluation.detectors.predictions import Prediction
from schemas.vocabulary import DefectClass

TEN_M2 = 10.0


@dataclass(frozen=True, kw_only=True)
class FalseAlarmRate:
    """False alarms of one class (None: of all classes) on ``area_m2`` of facade (None: unknown).

    ``with_one``: photographs with a false alarm. ``low_per_10_m2`` and ``high_per_10_m2``: the 95 % interval, the wider
    of the exact Poisson interval (Garwood 1936) and of the bootstrap by sites, because false alarms are clustered.
    """

    defect_class: DefectClass | None
    count: int
    photographs: int
    with_one: int
    area_m2: float | None
    per_10_m2: float | None
    low_per_10_m2: float | None
    high_per_10_m2: float | None


@dataclass(frozen=True, kw_only=True)
class FalseAlarmsAtThreshold:
    """False alarms per 10 m2 and per photograph for a threshold of ``score``."""

    score: float
    count: int
    per_10_m2: float | None
    per_photograph: float


@dataclass(frozen=True, kw_only=True)
class FalseAlarmFigures:
    """Rates of false alarms at the detector's threshold (of all classes, then by class), and by threshold.

    Facade in several photographs counts several times, and so do its false alarms: these are the rates before
    deduplication. Without the area of every photograph only counts are given. ``gsd_mm``: median GSD, mm/px.
    """

    name: str
    gsd_mm: float | None
    rates: tuple[FalseAlarmRate, ...]
    by_threshold: tuple[FalseAlarmsAtThreshold, ...]


def compute_false_alarms(
    name: str,
    images: Sequence[LabelledImage],
    above_threshold: Mapping[str, tuple[Prediction, ...]],
    above_floor: Mapping[str, tuple[Prediction, ...]],
) -> FalseAlarmFigures:
    """Count the predictions on photographs without defects as false alarms.

    Args:
        name: Name of the data.
        images: The photographs.
        above_threshold: Predictions at the detector's threshold, by the photograph's key.
        above_floor: Predictions down to the lowest score.

    Raises:
        InputDataError: There is no photograph.
    """
    if not images:
        raise InputDataError(f"none of the photographs without defects ({name}) can be read; give other photographs")
    areas = [image.area_m2 for image in images]
    known = [area for area in areas if area is not None]
    total = sum(known) if known and len(known) == len(images) else None
    scores = np.array([one.score for image in images for one in above_floor[image.key]])
    by_threshold = []
    for score in np.round(np.arange(0.05, 1.0, 0.05), 2).tolist():
        count = int((scores >= score).sum())
        by_threshold.append(
            FalseAlarmsAtThreshold(
                score=score,
                count=count,
                per_10_m2=TEN_M2 * count / total if total else None,
                per_photograph=count / len(images),
            )
        )
    classes: list[DefectClass | None] = [None, *DefectClass]
    rates = tuple(_compute_rate(images, above_threshold, one, total) for one in classes)
    gsds = [image.gsd_mm for image in images if image.gsd_mm is not None]
    gsd = float(np.median(gsds)) if gsds else None
    return FalseAlarmFigures(name=name, gsd_mm=gsd, rates=rates, by_threshold=tuple(by_threshold))


def _compute_rate(
    images: Sequence[LabelledImage],
    above_threshold: Mapping[str, tuple[Prediction, ...]],
    defect_class: DefectClass | None,
    total_m2: float | None,
) -> FalseAlarmRate:
    count_by_image: Counter[str] = Counter(
        image.key
        for image in images
        for one in above_threshold[image.key]
        if defect_class is None or one.defect_class is defect_class
    )
    count = sum(count_by_image.values())
    low = high = None
    if total_m2:
        low = TEN_M2 * (float(chi2.ppf(0.025, 2 * count)) / 2 if count else 0.0) / total_m2
        high = TEN_M2 * float(chi2.ppf(0.975, 2 * (count + 1))) / 2 / total_m2
        counts = np.array([count_by_image[image.key] for image in images], dtype=np.float64)
        areas = np.array([image.area_m2 for image in images], dtype=np.float64)
        bootstrap = estimate_interval(
            images, lambda weight: TEN_M2 * float(weight @ counts) / float(weight @ areas), by_site=True
        )
        if bootstrap is not None:
            low, high = min(low, bootstrap.low), max(high, bootstrap.high)
    return FalseAlarmRate(
        defect_class=defect_class,
        count=count,
        photographs=len(images),
        with_one=len(count_by_image),
        area_m2=total_m2,
        per_10_m2=TEN_M2 * count / total_m2 if total_m2 else None,
        low_per_10_m2=low,
        high_per_10_m2=high,
    )
