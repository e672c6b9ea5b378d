"""Photographs labelled as a whole, a folder a class: separation of those with a defect from sound ones by score."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from scipy.stats import rankdata

from facadelake.core.arrays import Float64N
from facadelake.core.errors import InputDataError
from facadelake.detection import Crosswalk
from facadelake.evaluation.detectors.bootstrap import BootstrapInterval, estimate_interval
from facadelake.evaluation.detectors.figures import EvaluatedDetector
from facadelake.evaluation.detectors.labels.labels import LabelCollector, LabelledImage, LabelledSet, find_photographs
from facadelake.evaluation.detectors.predictions import CollectedPredictions, PredictionSource
from schemas.vocabulary import DefectClass

_SOUND_NAMES = frozenset(
    {"intact", "clean", "sound", "negative", "negatives", "none", "normal", "background", "undamaged"}
)
_NEGATION_PREFIXES = ("no_", "not_", "non_", "no-", "not-", "non-", "no ", "not ", "non ")


@dataclass(frozen=True, kw_only=True)
class ImageLevelClassFigures:
    """One class against sound photographs, by a photograph's highest score of that class (0 without predictions).

    ``auroc``: probability that a photograph with the defect has a higher score than a sound one (equal scores count
    half; chance: 0.5). ``average_precision``: area under precision over recall (chance: the share of photographs with
    the defect). ``recall``, ``false_alarm_share``: shares of photographs with a box at the detector's threshold.
    """

    defect_class: DefectClass
    with_defect: int
    sound: int
    auroc: float | None
    auroc_by_sites: BootstrapInterval | None
    average_precision: float | None
    recall: float | None
    false_alarm_share: float | None


@dataclass(frozen=True, kw_only=True)
class ImageLevelFigures:
    """Figures of a folder of class folders; ``sound_folders`` count as free of defects, ``left_out``: by reason."""

    detector: EvaluatedDetector
    name: str
    sha256: str
    sound_folders: tuple[str, ...]
    classes: tuple[ImageLevelClassFigures, ...]
    left_out: dict[str, int]

    def convert_to_json(self) -> dict[str, object]:
        """The figures under stable keys."""
        return {"judged" if name == "detector" else name: value for name, value in asdict(self).items()}


@dataclass(frozen=True, kw_only=True)
class ImageLevelSet:
    """Photographs whose ``labelled`` classes are those that they show (none: sound), and the folders of sound ones."""

    labelled: LabelledSet
    sound_folders: tuple[str, ...]


def open_image_labels(folder: Path, crosswalk: Crosswalk) -> ImageLevelSet:
    """Read photographs that are labelled by the name of their folder: a defect class, or sound (intact, clean,
    not_spalling, ...). Photographs in other folders are left out and counted.

    Raises InputDataError where ``folder`` is not a folder, or has no photographs of a class or no sound ones.
    """
    if not folder.is_dir():
        raise InputDataError(f"{folder} is not a folder; image labels are folders of photographs, one for each class")
    collector = LabelCollector(folder)
    sound: set[str] = set()
    for path in find_photographs(folder):
        name = path.parent.name
        defect_class = crosswalk.find_defect_class(name)
        is_sound = name.lower() in _SOUND_NAMES or name.lower().startswith(_NEGATION_PREFIXES)
        if defect_class is None and not is_sound:
            collector.left_out[f"photographs in folder '{name}', which is neither a defect class nor sound"] += 1
            continue
        size = collector.read_size(path)
        if size is not None:
            if is_sound:
                sound.add(name)
            collector.add(path, size, [], frozenset() if defect_class is None else frozenset({defect_class}))
    labelled = collector.create_set("image labels")
    if not labelled.labelled or not sound:
        raise InputDataError(
            f"{folder} needs folders named after defect classes (crack, spalling, moisture) and one of sound "
            f"photographs ({', '.join(sorted(_SOUND_NAMES))}, or not_...); it has "
            f"{sorted({i.path.parent.name for i in labelled.images})}"
        )
    return ImageLevelSet(labelled=labelled, sound_folders=tuple(sorted(sound)))


def evaluate_image_labels(
    source: PredictionSource, image_set: ImageLevelSet, collected: CollectedPredictions
) -> ImageLevelFigures:
    """Compute the figures of each class with a folder."""
    labelled = image_set.labelled
    left_out = Counter(labelled.left_out) + Counter(collected.left_out)
    return ImageLevelFigures(
        detector=EvaluatedDetector(name=source.name, sha256=source.sha256, threshold=source.threshold),
        name=labelled.name,
        sha256=labelled.sha256,
        sound_folders=image_set.sound_folders,
        classes=tuple(_compute_class_figures(one, collected) for one in labelled.labelled),
        left_out=dict(left_out),
    )


def _compute_class_figures(defect_class: DefectClass, collected: CollectedPredictions) -> ImageLevelClassFigures:
    images = [image for image in collected.images if not image.labelled or defect_class in image.labelled]
    positive = np.array([defect_class in image.labelled for image in images])
    scores = np.array([_find_best_score(defect_class, image, collected) for image in images])
    shown = np.array(
        [any(one.defect_class is defect_class for one in collected.above_threshold[image.key]) for image in images]
    )

    def weighted_auroc(weights: Float64N) -> float:
        return compute_auroc(scores.repeat(weights.astype(int)), positive.repeat(weights.astype(int)))

    with_sites = [replace(one, site=one.site or f"\0{i}") for i, one in enumerate(images)]
    value = weighted_auroc(np.ones(len(images)))
    precision = compute_image_average_precision(scores, positive)
    return ImageLevelClassFigures(
        defect_class=defect_class,
        with_defect=int(positive.sum()),
        sound=int((~positive).sum()),
        auroc=value if np.isfinite(value) else None,
        auroc_by_sites=estimate_interval(with_sites, weighted_auroc, by_site=True),
        average_precision=precision if np.isfinite(precision) else None,
        recall=float(shown[positive].mean()) if positive.any() else None,
        false_alarm_share=float(shown[~positive].mean()) if (~positive).any() else None,
    )


def _find_best_score(defect_class: DefectClass, image: LabelledImage, collected: CollectedPredictions) -> float:
    found = collected.above_floor[image.key]
    return max((one.score for one in found if one.defect_class is defect_class), default=0.0)


def compute_auroc(scores: Float64N, positive: Sequence[bool] | np.ndarray) -> float:
    """Area under the ROC curve by ranks (Mann and Whitney 1947); NaN without positives or without negatives."""
    is_positive = np.asarray(positive, dtype=np.bool_)
    n, m = int(is_positive.sum()), int((~is_positive).sum())
    if not n or not m:
        return float("nan")
    return float((rankdata(scores)[is_positive].sum() - n * (n + 1) / 2) / (n * m))


def compute_image_average_precision(scores: Float64N, positive: Sequence[bool] | np.ndarray) -> float:
    """Sum over thresholds of precision times gain in recall; equal scores are one threshold. NaN without positives."""
    is_positive = np.asarray(positive, dtype=np.bool_)
    if not is_positive.any():
        return float("nan")
    order = np.argsort(-scores, kind="stable")
    hits, ends = np.cumsum(is_positive[order]), np.flatnonzero(np.append(np.diff(scores[order]) != 0, True))
    gains = np.diff(np.append(0, hits[ends])) / is_positive.sum()
    return float(gains @ (hits[ends] / (ends + 1)))
