"""A detector judged on labelled photographs: files opened, everything looked at once, figures made."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from facadelake.core.errors import InputDataError
from facadelake.detection import Crosswalk, build_crosswalk, find_default_model
from facadelake.evaluation.detectors.figures import Judgement, judge
from facadelake.evaluation.detectors.image_level import ImageLevelFigures, judge_image_labels, open_image_labels
from facadelake.evaluation.detectors.labels.format import Form
from facadelake.evaluation.detectors.labels.labels import LabelledSet, joined, labelled_only, sound_photographs
from facadelake.evaluation.detectors.labels.open import open_labels
from facadelake.evaluation.detectors.labels.sites import with_scale, with_sites
from facadelake.evaluation.detectors.predictions import Collected, Looker, collect
from facadelake.evaluation.detectors.sources import FileLooker, OnnxLooker
from schemas.vocabulary import DefectClass


@dataclass(frozen=True, kw_only=True)
class Question:
    """What to judge on. ``sites`` and ``split`` hold for labelled photographs and for those without defects alike.

    ``labelled``: the classes that the data has labels of, where its list of classes says more; None: as it says.
    """

    data: tuple[Path, ...] = ()
    form: Form = Form.AUTO
    class_names: tuple[str, ...] = ()
    sites: Path | None = None
    split: str | None = None
    labelled: frozenset[DefectClass] | None = None
    negatives: tuple[Path, ...] = ()
    scale: Path | None = None
    image_labels: tuple[Path, ...] = ()


@dataclass(frozen=True, kw_only=True, eq=False)
class Answer:
    """``boxes``: on labelled photographs and those without defects; ``image_labels``: a folder each."""

    boxes: Judgement | None
    collected: Collected
    collected_negatives: Collected | None
    image_labels: tuple[ImageLevelFigures, ...]


def model_file(model: str) -> Path:
    """The file that ``--model`` names: an ONNX model, a COCO file, or ``default``."""
    path = find_default_model() if model == "default" else Path(model)
    if path.suffix.lower() not in {".onnx", ".json"} or not path.is_file():
        raise InputDataError(
            f"--model {model} is no file to be judged; give 'default', an ONNX model (.onnx), or detections in a COCO "
            "file (.json)"
        )
    return path


def looker_of(path: Path, threshold: float | None) -> tuple[Looker, Crosswalk]:
    """What looks, and how its class names are read; ``threshold`` goes over the card's."""
    if path.suffix.lower() == ".json":
        return FileLooker(path, threshold or 0.0), build_crosswalk({})
    looker = OnnxLooker(path, threshold=threshold)
    return looker, build_crosswalk(looker.card.classes)


def evaluate_looker(looker: Looker, crosswalk: Crosswalk, question: Question) -> Answer:
    """Open what there is to judge on, look at all of it, and make the figures."""
    if not (question.data or question.negatives or question.image_labels):
        raise InputDataError("there is nothing to judge on; give --data, --negatives or --image-labels")
    labelled, negatives = _with_scale(_labelled(question, crosswalk), _negatives(question), question.scale)
    folders = [open_image_labels(folder, crosswalk) for folder in question.image_labels]
    if isinstance(looker, FileLooker):
        everything = [labelled, negatives, *(one.labelled for one in folders)]
        looker.refuse_if_strange([image for one in everything if one is not None for image in one.images])
    collected = collect(looker, labelled.images if labelled else (), crosswalk)
    collected_negatives = None if negatives is None else collect(looker, negatives.images, crosswalk)
    boxes = None
    if labelled is not None or negatives is not None:
        boxes = judge(
            looker,
            labelled or LabelledSet(name="", form="", images=()),
            collected,
            split=question.split,
            negatives=negatives,
            collected_negatives=collected_negatives,
        )
    return Answer(
        boxes=boxes,
        collected=collected,
        collected_negatives=collected_negatives,
        image_labels=tuple(
            judge_image_labels(looker, one, collect(looker, one.labelled.images, crosswalk)) for one in folders
        ),
    )


def _labelled(question: Question, crosswalk: Crosswalk) -> LabelledSet | None:
    sets = [
        with_sites(
            open_labels(
                data,
                crosswalk,
                form=question.form,
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
    whole = joined(sets)
    return whole if question.labelled is None else labelled_only(whole, question.labelled)


def _negatives(question: Question) -> LabelledSet | None:
    sets = [
        with_sites(sound_photographs(folder), question.sites, question.split if question.sites else None)
        for folder in question.negatives
    ]
    return joined(sets) if sets else None


def _with_scale(
    labelled: LabelledSet | None, negatives: LabelledSet | None, file: Path | None
) -> tuple[LabelledSet | None, LabelledSet | None]:
    """Both with GSD and area where the file tells of them."""
    if file is None:
        return labelled, negatives
    sets: Sequence[LabelledSet | None] = (labelled, negatives)
    scaled = iter(with_scale(tuple(image for one in sets if one is not None for image in one.images), file))
    first, second = (
        None if one is None else replace(one, images=tuple(next(scaled) for _ in one.images)) for one in sets
    )
    return first, second
