"""Lookup of a model's card, and the draft of a card for a model that has none."""

from __future__ import annotations

import ast
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from facadelake.core.arrays import Float32Array
from facadelake.core.errors import ModelError
from facadelake.detection.card import (
    CardInput,
    CardOutput,
    ModelCard,
    OutputLayout,
    ResizeMode,
    format_card,
    locate_card,
    parse_card,
    read_card,
)
from facadelake.detection.inference.session import ModelSession
from facadelake.detection.layouts.output_reader import NO_THRESHOLD
from facadelake.detection.layouts.output_verification import assign_outputs, find_class_counts, find_fitting_layouts
from facadelake.detection.layouts.readers import READERS

METADATA_KEY = "facadelake.card"


def find_card(model: Path, card: Path | None = None) -> ModelCard:
    """The card at ``card``, else beside ``model`` (``.card.yaml``, ``.card.yml``, ``.card.json``), or in its metadata.

    Raises ModelError if there is none; the message contains a draft from the file's metadata and a probe image.
    """
    if card is not None:
        return read_card(card)
    beside = locate_card(model)
    for path in (beside, beside.with_suffix(".yml"), beside.with_suffix(".json")):
        if path.is_file():
            return read_card(path)
    session = ModelSession(model)
    text = session.metadata.get(METADATA_KEY)
    if text is not None:
        return parse_card(text, f"model {model}, metadata {METADATA_KEY}")
    session.refuse_other_tasks()
    draft = draft_card(session)
    raise ModelError(
        f"model card {beside} does not exist; every detector needs one beside it, or in its metadata under "
        f"{METADATA_KEY} (docs/model-card.md shows one). {draft.remark} Check it and save it as {beside.name}:\n"
        f"\n{draft.text}"
    )


_IMAGENET_NORMALISATION = {"mean": (0.485, 0.456, 0.406), "std": (0.229, 0.224, 0.225)}
_INPUT_SIZE_DEFAULT_PX = 640
_CANDIDATE_PER_CELL = {OutputLayout.YOLOV5, OutputLayout.YOLOV8, OutputLayout.YOLOV5_SEG, OutputLayout.YOLOV8_SEG}


@dataclass(frozen=True, kw_only=True)
class CardDraft:
    """Text of a drafted card, and the evidence it is based on."""

    text: str
    remark: str


def draft_card(session: ModelSession) -> CardDraft:
    """Draft a card from the outputs for a probe image and from metadata in Ultralytics' form."""
    metadata = session.metadata
    names = _read_class_names(metadata)
    height, width = _read_input_size(session, metadata)
    outputs = _run_probe(session, height, width)
    base = _build_card(session.model.stem, metadata, names, height, width, OutputLayout.YOLOV8)
    fitting: list[ModelCard] = []
    for layout in _list_possible_layouts(height, width) if outputs else ():
        card = _build_card(session.model.stem, metadata, names, height, width, layout)
        for count in (len(names),) if names else (1, *find_class_counts(outputs, card)):
            candidate = card.model_copy(update={"class_names": names or _number_classes(count)})
            if layout in find_fitting_layouts(outputs, candidate):
                fitting.append(candidate)
                break
    if not fitting:
        shapes = ", ".join(f"{name} {values.shape}" for name, values in outputs.items()) or "the model does not run"
        return CardDraft(
            text=format_card(base if names else base.model_copy(update={"class_names": _number_classes(1)})),
            remark=f"This draft is a guess: no layout fits the outputs for a probe image ({shapes}).",
        )
    # Output names are more specific than shapes: RF-DETR and RT-DETR have the same shapes.
    best = max(fitting, key=lambda card: (_count_usual_names(outputs, card), _has_enough_rows(outputs, card)))
    others = [card.output.layout for card in fitting if card is not best]
    evidence = "its metadata and a probe image" if names else "a probe image (class names are unknown)"
    alternatives = f"; {' or '.join(others)} would fit, too" if others else ""
    return CardDraft(
        text=format_card(best), remark=f"A draft from {evidence}, layout {best.output.layout}{alternatives}."
    )


def _build_card(
    stem: str, metadata: Mapping[str, str], names: tuple[str, ...], height: int, width: int, layout: OutputLayout
) -> ModelCard:
    """A card with the usual preprocessing of models of this layout."""
    size = {"width_px": width, "height_px": height}
    match layout:
        case OutputLayout.YOLOX:
            spec = CardInput(**size, colour="bgr", scale=1.0, resize=ResizeMode.CORNER)
        case (
            OutputLayout.RTDETR
            | OutputLayout.RTDETR_TRIPLE
            | OutputLayout.RTDETR_ROWS
            | OutputLayout.MAP
            | OutputLayout.MAP_LOGITS
        ):
            spec = CardInput(**size, colour="rgb", scale=1 / 255, resize=ResizeMode.STRETCH)
        case OutputLayout.RFDETR | OutputLayout.RFDETR_SEG:
            spec = CardInput(**size, colour="rgb", scale=1 / 255, resize=ResizeMode.STRETCH, **_IMAGENET_NORMALISATION)
        case _:
            spec = CardInput(**size, colour="rgb", scale=1 / 255, resize=ResizeMode.CENTRE)
    return ModelCard(
        name=stem or "detector",
        licence=metadata.get("license") or "unknown",
        source=metadata.get("description", ""),
        class_names=names or _number_classes(1),
        input=spec,
        output=CardOutput(layout=layout),
        score_threshold=0.25,
    )


def _list_possible_layouts(height: int, width: int) -> tuple[OutputLayout, ...]:
    """The layouts that are possible for an input of this size: YOLOX needs multiples of its strides."""
    stride = max(CardOutput(layout=OutputLayout.YOLOX).strides)
    return tuple(
        layout for layout in OutputLayout if layout is not OutputLayout.YOLOX or not (height % stride or width % stride)
    )


def _run_probe(session: ModelSession, height: int, width: int) -> dict[str, Float32Array]:
    """The outputs for an image of noise; empty if the model does not run."""
    noise = np.random.default_rng(0).random((1, 3, height, width), dtype=np.float32)
    try:
        outputs = session.run(noise, session.output_names)
    except Exception:  # the only common base class of onnxruntime's errors
        return {}
    return dict(zip(session.output_names, outputs, strict=True))


def _count_usual_names(outputs: Mapping[str, Float32Array], card: ModelCard) -> int:
    """Number of outputs whose names are usual for the layout; 0 unless all are."""
    names = assign_outputs(outputs, card)
    for signature in READERS[card.output.layout].list_signatures(card):
        if all(name.casefold() in tensor.usual_names for name, tensor in zip(names, signature, strict=True)):
            return len(names)
    return 0


def _has_enough_rows(outputs: Mapping[str, Float32Array], card: ModelCard) -> bool:
    """Whether a layout with one candidate per cell has at least the cells of the grids of stride 16 and 32."""
    if card.output.layout not in _CANDIDATE_PER_CELL:
        return True
    reader, names = READERS[card.output.layout], assign_outputs(outputs, card)
    count = len(reader.read_candidates([outputs[name][0] for name in names], card, NO_THRESHOLD).rows)
    return count >= sum((card.input.width_px // stride) * (card.input.height_px // stride) for stride in (16, 32))


def _read_input_size(session: ModelSession, metadata: Mapping[str, str]) -> tuple[int, int]:
    """Height and width: fixed by the graph, else from the metadata's ``imgsz``, else the default."""
    stated = _parse_literal(metadata.get("imgsz", ""))
    if isinstance(stated, int):
        stated = [stated, stated]
    if not (
        isinstance(stated, list | tuple)
        and len(stated) == 2
        and all(isinstance(side, int) and side > 0 for side in stated)
    ):
        stated = [_INPUT_SIZE_DEFAULT_PX, _INPUT_SIZE_DEFAULT_PX]
    height, width = session.input_shape[2:]
    return height or stated[0], width or stated[1]


def _read_class_names(metadata: Mapping[str, str]) -> tuple[str, ...]:
    """The metadata's ``names``: a mapping of numbers to names, or a list; empty if it is neither."""
    stated = _parse_literal(metadata.get("names", ""))
    if isinstance(stated, dict) and all(isinstance(key, int) for key in stated):
        return tuple(str(stated[key]) for key in sorted(stated))
    return tuple(str(name) for name in stated) if isinstance(stated, list | tuple) else ()


def _parse_literal(text: str) -> object:
    try:
        value: object = ast.literal_eval(text)
    except (ValueError, SyntaxError):
        return None
    return value


def _number_classes(count: int) -> tuple[str, ...]:
    return tuple(f"class {i}" for i in range(count))
