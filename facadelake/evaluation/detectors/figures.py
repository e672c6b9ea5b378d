"""The figures of a detector on labelled photographs, and on photographs without defects."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from facadelake.core.arrays import Float64Array
from facadelake.evaluation.detectors.average_precision import (
    PredictionMatches,
    compute_average_precision,
    match_predictions,
)
from facadelake.evaluation.detectors.bootstrap import GROUPS_FEW, BootstrapInterval, estimate_interval
from facadelake.evaluation.detectors.calibration import CalibrationFigures, compute_calibration
from facadelake.evaluation.detectors.false_alarms import FalseAlarmFigures, compute_false_alarms
from facadelake.evaluation.detectors.labels.labels import LabelledImage, LabelledSet
from facadelake.evaluation.detectors.operating_point import (
    Confusion,
    OperatingPoint,
    compute_operating_point,
    count_confusions,
    sum_operating_points,
)
from facadelake.evaluation.detectors.predictions import CollectedPredictions, PredictionSource
from schemas.vocabulary import DefectClass

_BOXES_UNLIMITED = 10**6  # at the threshold every box is shown, however many
NO_SITE = "(site unknown)"


@dataclass(frozen=True, kw_only=True)
class EvaluatedDetector:
    """The detector: its name, its file's hash and the score from which a user is shown a box."""

    name: str
    sha256: str
    threshold: float


@dataclass(frozen=True, kw_only=True)
class EvaluationData:
    """The labelled photographs; ``left_out`` counts, by reason, what could not be used."""

    name: str
    form: str
    sha256: str
    split: str | None
    photographs: int
    sites: int
    without_site: int
    left_out: dict[str, int]


@dataclass(frozen=True, kw_only=True)
class SiteFigures:
    """One class at one site; average precision is None where the site has no truth of it."""

    site: str
    defect_class: DefectClass
    photographs: int
    truths: int
    ap50: float | None
    ap50_95: float | None
    operating: OperatingPoint


@dataclass(frozen=True, kw_only=True)
class ClassFigures:
    """One class in the photographs that have labels of it.

    ``ap50`` and ``ap50_95`` are COCO's, None where there is no truth; ``mean_ap50_of_sites`` gives every site the same
    weight. Intervals hold AP50 with 95 %, by sites and by photographs drawn again.
    """

    defect_class: DefectClass
    photographs: int
    truths: int
    ap50: float | None
    ap50_95: float | None
    ap50_by_sites: BootstrapInterval | None
    ap50_by_photographs: BootstrapInterval | None
    mean_ap50_of_sites: float | None
    operating: OperatingPoint
    calibration: CalibrationFigures


@dataclass(frozen=True, kw_only=True)
class DetectorFigures:
    """All figures; ``map50`` and ``map50_95`` are means over the classes that have truths.

    ``megapixels_per_s`` is of the looking alone, down to faint boxes.
    """

    judged: EvaluatedDetector
    data: EvaluationData
    classes: tuple[ClassFigures, ...]
    map50: float | None
    map50_95: float | None
    operating: OperatingPoint
    sites: tuple[SiteFigures, ...]
    confusions: tuple[Confusion, ...]
    unjudged: dict[str, int]
    negatives: FalseAlarmFigures | None
    photographs_per_s: float | None
    megapixels_per_s: float | None
    remarks: tuple[str, ...]

    def to_json(self) -> dict[str, object]:
        """Everything by name; keys are stable."""
        found: dict[str, object] = asdict(self)
        found["operating"] = self.operating.to_json()
        found["classes"] = [{**asdict(one), "operating": one.operating.to_json()} for one in self.classes]
        found["sites"] = [{**asdict(one), "operating": one.operating.to_json()} for one in self.sites]
        return found


@dataclass(frozen=True, kw_only=True, eq=False)
class BoxEvaluation:
    """Figures with what they come from, for pictures: matches down to the floor and as shown, by class."""

    figures: DetectorFigures
    matches_above_floor: Mapping[DefectClass, PredictionMatches]
    matches_above_threshold: Mapping[DefectClass, PredictionMatches]


def evaluate_boxes(
    looker: PredictionSource,
    labelled: LabelledSet,
    collected: CollectedPredictions,
    *,
    split: str | None = None,
    negatives: LabelledSet | None = None,
    collected_negatives: CollectedPredictions | None = None,
) -> BoxEvaluation:
    """Figures of what ``looker`` found (``collected``) in ``labelled`` photographs, and in sound ones (``negatives``).

    Average precision and calibration rest on all boxes down to the floor, counts on those that a user is shown.
    """
    images = collected.images
    classes = [one for one in DefectClass if one in labelled.labelled]
    low = {one: match_predictions(images, collected.above_floor, one) for one in classes}
    shown = {one: match_predictions(images, collected.above_threshold, one, most=_BOXES_UNLIMITED) for one in classes}
    sites = tuple(figures for one in classes for figures in _compute_site_figures(low[one], shown[one]))
    by_class = tuple(_compute_class_figures(low[one], shown[one], sites, looker.threshold) for one in classes)
    alarms = None
    if negatives is not None and collected_negatives is not None:
        found = collected_negatives
        alarms = compute_false_alarms(negatives.name, found.images, found.above_threshold, found.above_floor)
    known_sites = {image.site for image in images if image.site is not None}
    left_out = Counter(labelled.left_out) + Counter(collected.left_out)
    figures = DetectorFigures(
        judged=EvaluatedDetector(name=looker.name, sha256=looker.sha256, threshold=looker.threshold),
        data=EvaluationData(
            name=labelled.name,
            form=labelled.label_format,
            sha256=labelled.sha256,
            split=split,
            photographs=len(images),
            sites=len(known_sites),
            without_site=sum(image.site is None for image in images),
            left_out=dict(left_out),
        ),
        classes=by_class,
        map50=_average_known([one.ap50 for one in by_class]),
        map50_95=_average_known([one.ap50_95 for one in by_class]),
        operating=sum_operating_points([one.operating for one in by_class]),
        sites=sites,
        confusions=count_confusions(images, collected.above_threshold),
        unjudged=_count_unlabelled(images, collected),
        negatives=alarms,
        photographs_per_s=len(images) / collected.seconds if collected.seconds > 0 else None,
        megapixels_per_s=collected.megapixels / collected.seconds if collected.seconds > 0 else None,
        remarks=tuple(_collect_remarks(by_class, known_sites, images, alarms)),
    )
    return BoxEvaluation(figures=figures, matches_above_floor=low, matches_above_threshold=shown)


def _compute_class_figures(
    low: PredictionMatches, shown: PredictionMatches, sites: Sequence[SiteFigures], threshold: float
) -> ClassFigures:
    def ap50(weights: Float64Array) -> float:
        return float(compute_average_precision(low, weights, thresholds=1)[0])

    has_truth = len(low.truth_image) > 0
    has_sites = any(image.site is not None for image in low.images)
    return ClassFigures(
        defect_class=low.defect_class,
        photographs=len(low.images),
        truths=len(low.truth_image),
        ap50=_drop_nan(low.coco_precision[0]),
        ap50_95=_drop_nan(low.coco_precision.mean()),
        ap50_by_sites=estimate_interval(low.images, ap50, by_site=True) if has_truth and has_sites else None,
        ap50_by_photographs=estimate_interval(low.images, ap50, by_site=False) if has_truth else None,
        mean_ap50_of_sites=_average_known([one.ap50 for one in sites if one.defect_class is low.defect_class]),
        operating=compute_operating_point(shown),
        calibration=compute_calibration(low, threshold),
    )


def _compute_site_figures(low: PredictionMatches, shown: PredictionMatches) -> list[SiteFigures]:
    names = [NO_SITE if image.site is None else image.site for image in low.images]
    figures = []
    for site in sorted(set(names)):
        weights = np.array([float(name == site) for name in names])
        precision = compute_average_precision(low, weights)
        figures.append(
            SiteFigures(
                site=site,
                defect_class=low.defect_class,
                photographs=int(weights.sum()),
                truths=int(weights[low.truth_image].sum()),
                ap50=_drop_nan(precision[0]),
                ap50_95=_drop_nan(precision.mean()),
                operating=compute_operating_point(shown, weights),
            )
        )
    return figures


def _count_unlabelled(images: Sequence[LabelledImage], collected: CollectedPredictions) -> dict[str, int]:
    """Shown boxes of classes of which their photograph has no labels, so that nobody knows whether they are right."""
    counts = Counter(
        str(one.defect_class)
        for image in images
        for one in collected.above_threshold[image.key]
        if one.defect_class not in image.labelled
    )
    return dict(counts)


def _collect_remarks(
    classes: Sequence[ClassFigures],
    sites: set[str],
    images: Sequence[LabelledImage],
    alarms: FalseAlarmFigures | None,
) -> list[str]:
    told = []
    without = sum(image.site is None for image in images)
    if not sites:
        told.append(
            "sites are unknown: photographs of one wall are alike, so the interval by photographs is too narrow for "
            "another site; give --sites"
        )
    elif len(sites) + without < GROUPS_FEW:
        told.append(f"only {len(sites) + without} sites: the interval by sites is rough, another site may lie outside")
    for one in classes:
        if not one.truths:
            told.append(f"no labelled {one.defect_class}: average precision cannot be told")
        elif one.truths < 30:
            told.append(f"only {one.truths} labelled {one.defect_class}: figures of that class are rough")
    if alarms is not None and alarms.rates[0].area_m2 is None:
        told.append("areas of the photographs without defects are unknown: no false alarms per m2; give --scale")
    return told


def _drop_nan(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _average_known(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return sum(known) / len(known) if known else None
