"""Figures of a detector on labelled photographs and on photographs without defects."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from facadelake.core.arrays import Float64N
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
    RecallAtSize,
    compute_operating_point,
    compute_recall_by_size,
    count_confusions,
    sum_operating_points,
)
from facadelake.evaluation.detectors.predictions import CollectedPredictions, PredictionSource
from schemas.vocabulary import DefectClass

_BOXES_UNLIMITED = 10**6  # predictions of a photograph at the threshold
NO_SITE = "(site unknown)"
_KEYS = {"detector": "judged", "unlabelled": "unjudged"}  # of the JSON output, where they are not the fields' names


@dataclass(frozen=True, kw_only=True)
class EvaluatedDetector:
    """The evaluated detector: its name, the SHA-256 of its file, and the least score of a box that is shown."""

    name: str
    sha256: str
    threshold: float


@dataclass(frozen=True, kw_only=True)
class EvaluationData:
    """The labelled photographs; ``left_out`` counts photographs and boxes that cannot be used, by reason."""

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
    """Figures of one class at one site; average precision is None without labelled boxes of the class."""

    site: str
    defect_class: DefectClass
    photographs: int
    truths: int
    ap50: float | None
    ap50_95: float | None
    operating: OperatingPoint


@dataclass(frozen=True, kw_only=True)
class ClassFigures:
    """Figures of one class in the photographs with labels of that class.

    ``ap50`` and ``ap50_95``: COCO's average precision, None without labelled boxes (``truths``);
    ``mean_ap50_of_sites``: mean over sites of equal weight. ``ap50_by_*``: bootstrap intervals of 95 % of ``ap50``.
    ``recall_by_size``: by the root of a box's area, for the key of that name of the model card.
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
    recall_by_size: tuple[RecallAtSize, ...]
    calibration: CalibrationFigures


@dataclass(frozen=True, kw_only=True)
class DetectorFigures:
    """All figures of an evaluation.

    ``map50``, ``map50_95``: means over the classes with labelled boxes. ``unlabelled``: number of shown boxes of a
    class without labels in their photograph, by class. ``photographs_per_s``, ``megapixels_per_s``: speed of detection
    without reading of files.
    """

    detector: EvaluatedDetector
    data: EvaluationData
    classes: tuple[ClassFigures, ...]
    map50: float | None
    map50_95: float | None
    operating: OperatingPoint
    sites: tuple[SiteFigures, ...]
    confusions: tuple[Confusion, ...]
    unlabelled: dict[str, int]
    negatives: FalseAlarmFigures | None
    photographs_per_s: float | None
    megapixels_per_s: float | None
    remarks: tuple[str, ...]

    def convert_to_json(self) -> dict[str, object]:
        """The figures under stable keys."""
        content: dict[str, object] = {_KEYS.get(name, name): value for name, value in asdict(self).items()}
        content["operating"] = self.operating.convert_to_json()
        content["classes"] = [{**asdict(one), "operating": one.operating.convert_to_json()} for one in self.classes]
        content["sites"] = [{**asdict(one), "operating": one.operating.convert_to_json()} for one in self.sites]
        return content


@dataclass(frozen=True, kw_only=True, eq=False)
class BoxEvaluation:
    """Figures with the matches by class that they are computed from: of all predictions, and at the threshold."""

    figures: DetectorFigures
    matches_above_floor: Mapping[DefectClass, PredictionMatches]
    matches_above_threshold: Mapping[DefectClass, PredictionMatches]


def evaluate_boxes(
    source: PredictionSource,
    labelled: LabelledSet,
    collected: CollectedPredictions,
    *,
    split: str | None = None,
    negatives: LabelledSet | None = None,
    collected_negatives: CollectedPredictions | None = None,
) -> BoxEvaluation:
    """Compute the figures of a detector.

    Average precision and calibration are of all predictions down to the lowest score, counts are of those at the
    detector's threshold.

    Args:
        source: The detector.
        labelled: The labelled photographs.
        collected: Its predictions on them.
        split: Name of their split, for the figures.
        negatives: Photographs without defects, if any.
        collected_negatives: Its predictions on them.

    Raises:
        InputDataError: There are ``negatives``, but none can be read.
    """
    images = collected.images
    classes = [one for one in DefectClass if one in labelled.labelled]
    matches_above_floor = {one: match_predictions(images, collected.above_floor, one) for one in classes}
    matches_above_threshold = {
        one: match_predictions(images, collected.above_threshold, one, boxes_max=_BOXES_UNLIMITED) for one in classes
    }
    sites = tuple(
        figures
        for one in classes
        for figures in _compute_site_figures(matches_above_floor[one], matches_above_threshold[one])
    )
    by_class = tuple(
        _compute_class_figures(matches_above_floor[one], matches_above_threshold[one], sites, source.threshold)
        for one in classes
    )
    alarms = None
    if negatives is not None and collected_negatives is not None:
        alarms = compute_false_alarms(
            negatives.name,
            collected_negatives.images,
            collected_negatives.above_threshold,
            collected_negatives.above_floor,
        )
    known_sites = {image.site for image in images if image.site is not None}
    left_out = Counter(labelled.left_out) + Counter(collected.left_out)
    figures = DetectorFigures(
        detector=EvaluatedDetector(name=source.name, sha256=source.sha256, threshold=source.threshold),
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
        unlabelled=_count_unlabelled(images, collected),
        negatives=alarms,
        photographs_per_s=len(images) / collected.seconds if collected.seconds > 0 else None,
        megapixels_per_s=collected.megapixels / collected.seconds if collected.seconds > 0 else None,
        remarks=tuple(_collect_remarks(by_class, known_sites, images, alarms)),
    )
    return BoxEvaluation(
        figures=figures, matches_above_floor=matches_above_floor, matches_above_threshold=matches_above_threshold
    )


def _compute_class_figures(
    all_matches: PredictionMatches, shown_matches: PredictionMatches, sites: Sequence[SiteFigures], threshold: float
) -> ClassFigures:
    def ap50(weights: Float64N) -> float:
        return float(compute_average_precision(all_matches, weights, thresholds=1)[0])

    has_truth = len(all_matches.truth_image) > 0
    has_sites = any(image.site is not None for image in all_matches.images)
    return ClassFigures(
        defect_class=all_matches.defect_class,
        photographs=len(all_matches.images),
        truths=len(all_matches.truth_image),
        ap50=_drop_nan(all_matches.coco_precision[0]),
        ap50_95=_drop_nan(all_matches.coco_precision.mean()),
        ap50_by_sites=estimate_interval(all_matches.images, ap50, by_site=True) if has_truth and has_sites else None,
        ap50_by_photographs=estimate_interval(all_matches.images, ap50, by_site=False) if has_truth else None,
        mean_ap50_of_sites=_average_known([one.ap50 for one in sites if one.defect_class is all_matches.defect_class]),
        operating=compute_operating_point(shown_matches),
        recall_by_size=compute_recall_by_size(shown_matches),
        calibration=compute_calibration(all_matches, threshold),
    )


def _compute_site_figures(all_matches: PredictionMatches, shown_matches: PredictionMatches) -> list[SiteFigures]:
    names = [NO_SITE if image.site is None else image.site for image in all_matches.images]
    figures = []
    for site in sorted(set(names)):
        weights = np.array([float(name == site) for name in names])
        precision = compute_average_precision(all_matches, weights)
        figures.append(
            SiteFigures(
                site=site,
                defect_class=all_matches.defect_class,
                photographs=int(weights.sum()),
                truths=int(weights[all_matches.truth_image].sum()),
                ap50=_drop_nan(precision[0]),
                ap50_95=_drop_nan(precision.mean()),
                operating=compute_operating_point(shown_matches, weights),
            )
        )
    return figures


def _count_unlabelled(images: Sequence[LabelledImage], collected: CollectedPredictions) -> dict[str, int]:
    """Numbers of shown boxes of a class without labels in their photograph, which can be right or wrong."""
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
    remarks = []
    without = sum(image.site is None for image in images)
    if not sites:
        remarks.append(
            "sites are unknown: photographs of one wall are alike, so the interval by photographs is too narrow for "
            "another site; give --sites"
        )
    elif len(sites) + without < GROUPS_FEW:
        remarks.append(
            f"only {len(sites) + without} sites: the interval by sites is rough, another site may lie outside"
        )
    for one in classes:
        if not one.truths:
            remarks.append(f"no labelled {one.defect_class}: average precision is undefined")
        elif one.truths < 30:
            remarks.append(f"only {one.truths} labelled {one.defect_class}: figures of that class are rough")
    if alarms is not None and alarms.rates[0].area_m2 is None:
        remarks.append(
            "areas of the photographs without defects are unknown: no rate of false alarms per m2; give --scale"
        )
    return remarks


def _drop_nan(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _average_known(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return sum(known) / len(known) if known else None
