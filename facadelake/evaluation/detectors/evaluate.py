"""Evaluation of a detector on labelled photographs: labels are read, predictions collected, figures computed."""

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
    """The data of an evaluation.

    ``data``: labelled photographs, in ``label_format``; ``class_names``: names of YOLO's class numbers. ``sites`` and
    ``split`` apply to labelled photographs and to ``negatives`` (photographs without defects). ``labelled``: the
    classes that are labelled, where the data lists more; None: all listed ones. ``scale``: a CSV with GSD or area.
    ``image_labels``: folders of photographs labelled as a whole.
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
    """``boxes``: the evaluation on labelled photographs and those without defects; ``image_labels``: one a folder."""

    boxes: BoxEvaluation | None
    collected: CollectedPredictions
    collected_negatives: CollectedPredictions | None
    image_labels: tuple[ImageLevelFigures, ...]


def locate_model_file(model: str) -> Path:
    """The file of ``--model``: an ONNX model, a COCO file, or that of the default detector for ``default``."""
    path = find_default_model() if model == "default" else Path(model)
    if path.suffix.lower() not in {".onnx", ".json"} or not path.is_file():
        raise InputDataError(
            f"--model {model} is not a file that can be evaluated; give 'default', an ONNX model (.onnx), or a COCO "
            "file of detections (.json)"
        )
    return path


def open_prediction_source(path: Path, threshold: float | None) -> tuple[PredictionSource, Crosswalk]:
    """The source of predictions of a file, and the crosswalk of its class names; ``threshold`` overrides the card's."""
    if path.suffix.lower() == ".json":
        return CocoPredictionSource(path, threshold or 0.0), build_crosswalk({})
    source = OnnxPredictionSource(path, threshold=threshold)
    return source, build_crosswalk(source.card.classes)


def evaluate_prediction_source(
    source: PredictionSource, crosswalk: Crosswalk, request: DetectorEvaluationRequest
) -> DetectorEvaluation:
    """Evaluate a source of predictions. Raises InputDataError where there is no data, or where it cannot be used."""
    if not (request.data or request.negatives or request.image_labels):
        raise InputDataError("no data to evaluate on; give --data, --negatives or --image-labels")
    labelled, negatives = _assign_scale(_open_labelled(request, crosswalk), _open_negatives(request), request.scale)
    folders = [open_image_labels(folder, crosswalk) for folder in request.image_labels]
    if isinstance(source, CocoPredictionSource):
        sets = [labelled, negatives, *(one.labelled for one in folders)]
        source.require_photographs([image for one in sets if one is not None for image in one.images])
    collected = collect_predictions(source, labelled.images if labelled else (), crosswalk)
    collected_negatives = None if negatives is None else collect_predictions(source, negatives.images, crosswalk)
    boxes = None
    if labelled is not None or negatives is not None:
        boxes = evaluate_boxes(
            source,
            labelled or LabelledSet(name="", label_format="", images=()),
            collected,
            split=request.split,
            negatives=negatives,
            collected_negatives=collected_negatives,
        )
    return DetectorEvaluation(
        boxes=boxes,
        collected=collected,
        collected_negatives=collected_negatives,
        image_labels=tuple(
            evaluate_image_labels(source, one, collect_predictions(source, one.labelled.images, crosswalk))
            for one in folders
        ),
    )


def _open_labelled(request: DetectorEvaluationRequest, crosswalk: Crosswalk) -> LabelledSet | None:
    sets = [
        assign_sites(
            open_labels(
                data,
                crosswalk,
                label_format=request.label_format,
                class_names=request.class_names,
                split=request.split,
                has_sites=request.sites is not None,
            ),
            request.sites,
            request.split,
        )
        for data in request.data
    ]
    if not sets:
        return None
    combined = combine_sets(sets)
    return combined if request.labelled is None else restrict_to_classes(combined, request.labelled)


def _open_negatives(request: DetectorEvaluationRequest) -> LabelledSet | None:
    sets = [
        assign_sites(open_sound_photographs(folder), request.sites, request.split if request.sites else None)
        for folder in request.negatives
    ]
    return combine_sets(sets) if sets else None


def _assign_scale(
    labelled: LabelledSet | None, negatives: LabelledSet | None, file: Path | None
) -> tuple[LabelledSet | None, LabelledSet | None]:
    """Both sets with the GSD and the area that ``file`` states."""
    if file is None:
        return labelled, negatives
    sets: Sequence[LabelledSet | None] = (labelled, negatives)
    scaled = iter(assign_scale(tuple(image for one in sets if one is not None for image in one.images), file))
    first, second = (
        None if one is None else replace(one, images=tuple(next(scaled) for _ in one.images)) for one in sets
    )
    return first, second
