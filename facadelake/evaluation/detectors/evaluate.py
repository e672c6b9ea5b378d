"""A detector judged on labelled photographs: files opened, everything looked at once, figures made."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from facadelake.core.errors import InputDataError
from facadelake.detection import Crosswalk, build_crosswalk, find_default_model
from facadelake.evaluation.detectors.figures import BoxEvaluation, evaluate_boxes
from facadelake.evaluation.detectors.image_level import ImageLevelFigures, evaluate_image_labels, open_image_labels
from facadelake.evaluation.detectors.labels.format import LabelFormat
from facadelake.evaluation.detectors.labels.labels import (
    LabelledSet,
    combine_sets,
    open_sound_photographs,
    restrict_to_classes,
)
from facadelake.evaluation.detectors.labels.open import open_labels
from facadelake.evaluation.detectors.labels.sites import assign_scale, assign_sites
from facadelake.evaluation.detectors.predictions import CollectedPredictions, PredictionSource, collect_predictions
from facadelake.evaluation.detectors.sources import CocoPredictionSource, OnnxPredictionSource
from schemas.vocabulary import DefectClass


@dataclass(frozen=True, kw_only=True)
class DetectorEvaluationRequest:
    """What to judge on. ``sites`` and ``split`` hold for labelled photographs and for those without defects alike.

    ``labelled``: the classes that the data has labels of, where its list of classes says more; None: as it says.
    """

    data: tuple[Path, ...] = ()
    label_format: LabelFormat = LabelFormat.AUTO
    class_names: tuple[str, ...] = ()
    sites: Path | None = None
    split: str | None = None
    labelled: frozenset[DefectClass] | None = None
    negatives: tuple[Path, ...] = ()
    scale: Path | None = None
    image_labels: tuple[Path, ...] = ()


@dataclass(frozen=True, kw_only=True, eq=False)
class DetectorEvaluation:
    """``boxes``: on labelled photographs and those without defects; ``image_labels``: a folder each."""

    boxes: BoxEvaluation | None
    collected: CollectedPredictions
    collected_negatives: CollectedPredictions | None
    image_labels: tuple[ImageLevelFigures, ...]


def locate_model_file(model: str) -> Path:
    """The file that ``--model`` names: an ONNX model, a COCO file, or ``default``."""
    path = find_default_model() if model == "default" else Path(model)
    if path.suffix.lower() not in {".onnx", ".json"} or not path.is_file():
        raise InputDataError(
            f"--model {model} is no file to be judged; give 'default', an ONNX model (.onnx), or detections in a COCO "
            "file (.json)"
        )
    return path


def open_prediction_source(path: Path, threshold: float | None) -> tuple[PredictionSource, Crosswalk]:
    """What looks, and how its class names are read; ``threshold`` goes over the card's."""
    if path.suffix.lower() == ".json":
        return CocoPredictionSource(path, threshold or 0.0), build_crosswalk({})
    looker = OnnxPredictionSource(path, threshold=threshold)
    return looker, build_crosswalk(looker.card.classes)


def evaluate_prediction_source(
    looker: PredictionSource, crosswalk: Crosswalk, question: DetectorEvaluationRequest
) -> DetectorEvaluation:
    """Open what there is to judge on, look at all of it, and make the figures."""
    if not (question.data or question.negatives or question.image_labels):
        raise InputDataError("there is nothing to judge on; give --data, --negatives or --image-labels")
    labelled, negatives = _assign_scale(_open_labelled(question, crosswalk), _open_negatives(question), question.scale)
    folders = [open_image_labels(folder, crosswalk) for folder in question.image_labels]
    if isinstance(looker, CocoPredictionSource):
        everything = [labelled, negatives, *(one.labelled for one in folders)]
        looker.require_photographs([image for one in everything if one is not None for image in one.images])
    collected = collect_predictions(looker, labelled.images if labelled else (), crosswalk)
    collected_negatives = None if negatives is None else collect_predictions(looker, negatives.images, crosswalk)
    boxes = None
    if labelled is not None or negatives is not None:
        boxes = evaluate_boxes(
            looker,
            labelled or LabelledSet(name="", label_format="", images=()),
            collected,
            split=question.split,
            negatives=negatives,
            collected_negatives=collected_negatives,
        )
    return DetectorEvaluation(
        boxes=boxes,
        collected=collected,
        collected_negatives=collected_negatives,
        image_labels=tuple(
            evaluate_image_labels(looker, one, collect_predictions(looker, one.labelled.images, crosswalk))
            for one in folders
        ),
    )


def _open_labelled(question: DetectorEvaluationRequest, crosswalk: Crosswalk) -> LabelledSet | None:
    sets = [
        assign_sites(
            open_labels(
                data,
                crosswalk,
                label_format=question.label_format,
                class_names=question.class_names,
                split=question.split,
                sited=question.sites is not None,
            ),
            question.sites,
            question.split,
        )
        for data in question.data
    ]
    if not sets:
        return None
    whole = combine_sets(sets)
    return whole if question.labelled is None else restrict_to_classes(whole, question.labelled)


def _open_negatives(question: DetectorEvaluationRequest) -> LabelledSet | None:
    sets = [
        assign_sites(open_sound_photographs(folder), question.sites, question.split if question.sites else None)
        for folder in question.negatives
    ]
    return combine_sets(sets) if sets else None


def _assign_scale(
    labelled: LabelledSet | None, negatives: LabelledSet | None, file: Path | None
) -> tuple[LabelledSet | None, LabelledSet | None]:
    """Both with GSD and area where the file tells of them."""
    if file is None:
        return labelled, negatives
    sets: Sequence[LabelledSet | None] = (labelled, negatives)
    scaled = iter(assign_scale(tuple(image for one in sets if one is not None for image in one.images), file))
    first, second = (
        None if one is None else replace(one, images=tuple(next(scaled) for _ in one.images)) for one in sets
    )
    return first, second
