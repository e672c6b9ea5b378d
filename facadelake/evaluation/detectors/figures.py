"""The figures of a detector on labelled photographs, and on photographs without defects."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from facadelake.core.arrays import Float64Array
from facadelake.evaluation.detectors.average_precision import Matches, average_precision, match
from facadelake.evaluation.detectors.bootstrap import FEW, Interval, interval_of
from facadelake.evaluation.detectors.calibration import Calibration, calibration_of
from facadelake.evaluation.detectors.false_alarms import FalseAlarms, false_alarms_of
from facadelake.evaluation.detectors.labels.labels import LabelledImage, LabelledSet
from facadelake.evaluation.detectors.operating_point import (
    Confusion,
    Operating,
    confusions,
    joined_operating,
    operating_of,
)
from facadelake.evaluation.detectors.predictions import Collected, Looker
from schemas.vocabulary import DefectClass

_EVERY = 10**6  # at the threshold every box is shown, however many
NO_SITE = "(site unknown)"


@dataclass(frozen=True, kw_only=True)
class Judged:
    """The detector: its name, its file's hash and the score from which a user is shown a box."""

    name: str
    sha256: str
    threshold: float


@dataclass(frozen=True, kw_only=True)
class Data:
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
    operating: Operating


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
    ap50_by_sites: Interval | None
    ap50_by_photographs: Interval | None
    mean_ap50_of_sites: float | None
    operating: Operating
    calibration: Calibration


@dataclass(frozen=True, kw_only=True)
class Figures:
    """All figures; ``map50`` and ``map50_95`` are means over the classes that have truths.

    ``megapixels_per_s`` is of the looking alone, down to faint boxes.
    """

    judged: Judged
    data: Data
    classes: tuple[ClassFigures, ...]
    map50: float | None
    map50_95: float | None
    operating: Operating
    sites: tuple[SiteFigures, ...]
    confusions: tuple[Confusion, ...]
    unjudged: dict[str, int]
    negatives: FalseAlarms | None
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
class Judgement:
    """Figures with what they come from, for pictures: matches down to the floor and as shown, by class."""

    figures: Figures
    matches_above_floor: Mapping[DefectClass, Matches]
    matches_above_threshold: Mapping[DefectClass, Matches]


def judge(
    looker: Looker,
    labelled: LabelledSet,
    collected: Collected,
    *,
    split: str | None = None,
    negatives: LabelledSet | None = None,
    collected_negatives: Collected | None = None,
) -> Judgement:
    """Figures of what ``looker`` found (``collected``) in ``labelled`` photographs, and in sound ones (``negatives``).

    Average precision and calibration rest on all boxes down to the floor, counts on those that a user is shown.
    """
    images = collected.images
    classes = [one for one in DefectClass if one in labelled.labelled]
    low = {one: match(images, collected.down_to_floor, one) for one in classes}
    shown = {one: match(images, collected.shown, one, most=_EVERY) for one in classes}
    sites = tuple(figures for one in classes for figures in _sites(low[one], shown[one]))
    by_class = tuple(_class(low[one], shown[one], sites, looker.threshold) for one in classes)
    alarms = None
    if negatives is not None and collected_negatives is not None:
        found = collected_negatives
        alarms = false_alarms_of(negatives.name, found.images, found.shown, found.down_to_floor)
    known_sites = {image.site for image in images if image.site is not None}
    left_out = Counter(labelled.left_out) + Counter(collected.left_out)
    figures = Figures(
        judged=Judged(name=looker.name, sha256=looker.sha256, threshold=looker.threshold),
        data=Data(
            name=labelled.name,
            form=labelled.form,
            sha256=labelled.sha256,
            split=split,
            photographs=len(images),
            sites=len(known_sites),
            without_site=sum(image.site is None for image in images),
            left_out=dict(left_out),
        ),
        classes=by_class,
        map50=_mean([one.ap50 for one in by_class]),
        map50_95=_mean([one.ap50_95 for one in by_class]),
        operating=joined_operating([one.operating for one in by_class]),
        sites=sites,
        confusions=confusions(images, collected.shown),
        unjudged=_unjudged(images, collected),
        negatives=alarms,
        photographs_per_s=len(images) / collected.seconds if collected.seconds > 0 else None,
        megapixels_per_s=collected.megapixels / collected.seconds if collected.seconds > 0 else None,
        remarks=tuple(_remarks(by_class, known_sites, images, alarms)),
    )
    return Judgement(figures=figures, matches_above_floor=low, matches_above_threshold=shown)


def _class(low: Matches, shown: Matches, sites: Sequence[SiteFigures], threshold: float) -> ClassFigures:
    def ap50(weights: Float64Array) -> float:
        return float(average_precision(low, weights, thresholds=1)[0])

    has_truth = len(low.truth_image) > 0
    has_sites = any(image.site is not None for image in low.images)
    return ClassFigures(
        defect_class=low.defect_class,
        photographs=len(low.images),
        truths=len(low.truth_image),
        ap50=_number(low.coco_precision[0]),
        ap50_95=_number(low.coco_precision.mean()),
        ap50_by_sites=interval_of(low.images, ap50, by_site=True) if has_truth and has_sites else None,
        ap50_by_photographs=interval_of(low.images, ap50, by_site=False) if has_truth else None,
        mean_ap50_of_sites=_mean([one.ap50 for one in sites if one.defect_class is low.defect_class]),
        operating=operating_of(shown),
        calibration=calibration_of(low, threshold),
    )


def _sites(low: Matches, shown: Matches) -> list[SiteFigures]:
    names = [NO_SITE if image.site is None else image.site for image in low.images]
    figures = []
    for site in sorted(set(names)):
        weights = np.array([float(name == site) for name in names])
        precision = average_precision(low, weights)
        figures.append(
            SiteFigures(
                site=site,
                defect_class=low.defect_class,
                photographs=int(weights.sum()),
                truths=int(weights[low.truth_image].sum()),
                ap50=_number(precision[0]),
                ap50_95=_number(precision.mean()),
                operating=operating_of(shown, weights),
            )
        )
    return figures


def _unjudged(images: Sequence[LabelledImage], collected: Collected) -> dict[str, int]:
    """Shown boxes of classes of which their photograph has no labels, so that nobody knows whether they are right."""
    counts = Counter(
        str(one.defect_class)
        for image in images
        for one in collected.shown[image.key]
        if one.defect_class not in image.labelled
    )
    return dict(counts)


def _remarks(
    classes: Sequence[ClassFigures],
    sites: set[str],
    images: Sequence[LabelledImage],
    alarms: FalseAlarms | None,
) -> list[str]:
    told = []
    without = sum(image.site is None for image in images)
    if not sites:
        told.append(
            "sites are unknown: photographs of one wall are alike, so the interval by photographs is too narrow for "
            "another site; give --sites"
        )
    elif len(sites) + without < FEW:
        told.append(f"only {len(sites) + without} sites: the interval by sites is rough, another site may lie outside")
    for one in classes:
        if not one.truths:
            told.append(f"no labelled {one.defect_class}: average precision cannot be told")
        elif one.truths < 30:
            told.append(f"only {one.truths} labelled {one.defect_class}: figures of that class are rough")
    if alarms is not None and alarms.rates[0].area_m2 is None:
        told.append("areas of the photographs without defects are unknown: no false alarms per m2; give --scale")
    return told


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return sum(known) / len(known) if known else None
