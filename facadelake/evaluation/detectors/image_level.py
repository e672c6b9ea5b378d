"""Photographs labelled as a whole, a folder a class: does the best score tell those with a defect from sound ones?"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from scipy.stats import rankdata

from facadelake.core.arrays import Float64Array
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
    """One class against sound photographs, by a photograph's best score of that class (0 where nothing was found).

    ``compute_auroc``: probability that one with the defect scores higher than a sound one (ties half; 0.5 is guessing).
    ``average_precision``: mean precision over those with the defect in order of score; guessing gives their share.
    ``recall`` and ``false_alarm_share`` are shares of photographs with a box at the card's threshold.
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
    """Figures of a folder of folders; ``sound_folders`` were taken as free of defects, ``left_out`` was not used."""

    judged: EvaluatedDetector
    name: str
    sha256: str
    sound_folders: tuple[str, ...]
    classes: tuple[ImageLevelClassFigures, ...]
    left_out: dict[str, int]

    def to_json(self) -> dict[str, object]:
        """Everything by name."""
        return asdict(self)


@dataclass(frozen=True, kw_only=True)
class ImageLevelSet:
    """Photographs whose ``labelled`` classes are those they show (none: sound), and the folders taken as sound."""

    labelled: LabelledSet
    sound_folders: tuple[str, ...]


def open_image_labels(folder: Path, crosswalk: Crosswalk) -> ImageLevelSet:
    """Photographs below ``folder`` by the folder they lie in: its name stands for a defect class, or for none (intact,
    clean, not_spalling, ...). Others are left out and counted.

    Raises InputDataError where no class, or nothing sound, is there.
    """
    if not folder.is_dir():
        raise InputDataError(f"{folder} is no folder; image labels are folders of photographs, one for each class")
    gathered = LabelCollector(folder)
    sound: set[str] = set()
    for path in find_photographs(folder):
        name = path.parent.name
        defect_class = crosswalk.find_defect_class(name)
        is_sound = name.lower() in _SOUND_NAMES or name.lower().startswith(_NEGATION_PREFIXES)
        if defect_class is None and not is_sound:
            gathered.left_out[f"photographs in folder '{name}', which stands for no class and not for sound"] += 1
            continue
        size = gathered.read_size(path)
        if size is not None:
            if is_sound:
                sound.add(name)
            gathered.add(path, size, [], frozenset() if defect_class is None else frozenset({defect_class}))
    labelled = gathered.create_set("image labels")
    if not labelled.labelled or not sound:
        raise InputDataError(
            f"{folder} needs folders named by defect classes (crack, spalling, moisture) and one of sound photographs "
            f"({', '.join(sorted(_SOUND_NAMES))}, or not_...); it has {sorted({i.path.parent.name for i in labelled.images})}"
        )
    return ImageLevelSet(labelled=labelled, sound_folders=tuple(sorted(sound)))


def evaluate_image_labels(
    looker: PredictionSource, image_set: ImageLevelSet, collected: CollectedPredictions
) -> ImageLevelFigures:
    """The figures of every class that has a folder."""
    labelled = image_set.labelled
    left_out = Counter(labelled.left_out) + Counter(collected.left_out)
    return ImageLevelFigures(
        judged=EvaluatedDetector(name=looker.name, sha256=looker.sha256, threshold=looker.threshold),
        name=labelled.name,
        sha256=labelled.sha256,
        sound_folders=image_set.sound_folders,
        classes=tuple(_compute_class_figures(one, collected) for one in labelled.labelled),
        left_out=dict(left_out),
    )


def _compute_class_figures(defect_class: DefectClass, collected: CollectedPredictions) -> ImageLevelClassFigures:
    images = [one for one in collected.images if not one.labelled or defect_class in one.labelled]
    positive = np.array([defect_class in one.labelled for one in images])
    best = np.array([_find_best_score(defect_class, one, collected) for one in images])
    shown = np.array(
        [any(g.defect_class is defect_class for g in collected.above_threshold[one.key]) for one in images]
    )

    def area(weights: Float64Array) -> float:
        return compute_auroc(best.repeat(weights.astype(int)), positive.repeat(weights.astype(int)))

    sited = [replace(one, site=one.site or f"\0{i}") for i, one in enumerate(images)]
    value = area(np.ones(len(images)))
    precision = compute_image_average_precision(best, positive)
    return ImageLevelClassFigures(
        defect_class=defect_class,
        with_defect=int(positive.sum()),
        sound=int((~positive).sum()),
        auroc=value if np.isfinite(value) else None,
        auroc_by_sites=estimate_interval(sited, area, by_site=True),
        average_precision=precision if np.isfinite(precision) else None,
        recall=float(shown[positive].mean()) if positive.any() else None,
        false_alarm_share=float(shown[~positive].mean()) if (~positive).any() else None,
    )


def _find_best_score(defect_class: DefectClass, image: LabelledImage, collected: CollectedPredictions) -> float:
    found = collected.above_floor[image.key]
    return max((one.score for one in found if one.defect_class is defect_class), default=0.0)


def compute_auroc(scores: Float64Array, positive: Sequence[bool] | np.ndarray) -> float:
    """Area under the ROC curve by the ranks (Mann and Whitney 1947); NaN where one of the two kinds is missing."""
    is_positive = np.asarray(positive, dtype=np.bool_)
    n, m = int(is_positive.sum()), int((~is_positive).sum())
    if not n or not m:
        return float("nan")
    return float((rankdata(scores)[is_positive].sum() - n * (n + 1) / 2) / (n * m))


def compute_image_average_precision(scores: Float64Array, positive: Sequence[bool] | np.ndarray) -> float:
    """Sum over thresholds of the gain in recall times precision; equal scores fall together. NaN without positives."""
    is_positive = np.asarray(positive, dtype=np.bool_)
    if not is_positive.any():
        return float("nan")
    order = np.argsort(-scores, kind="stable")
    hits, ends = np.cumsum(is_positive[order]), np.flatnonzero(np.append(np.diff(scores[order]) != 0, True))
    gains = np.diff(np.append(0, hits[ends])) / is_positive.sum()
    return float(gains @ (hits[ends] / (ends + 1)))
