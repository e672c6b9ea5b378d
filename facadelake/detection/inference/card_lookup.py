"""Where a model's card is found, and the card drafted for a model that has none."""

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
    """The card at ``card``, or beside ``model`` (``.card.yaml``, ``.card.yml``, ``.card.json``), or in its metadata.

    Raises ModelError where there is none; it prints a draft of one, made from what the file says of itself.
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
    """A card's text and what it rests on."""

    text: str
    remark: str


def draft_card(session: ModelSession) -> CardDraft:
    """The card that ``session``'s model seems to want. Its metadata is read as Ultralytics writes it."""
    metadata = session.metadata
    names = _read_class_names(metadata)
    height, width = _read_input_size(session, metadata)
    outputs = _run_probe(session, height, width)
    base = _build_card(session.model.stem, metadata, names, height, width, OutputLayout.YOLOV8)
    fitting: list[ModelCard] = []
    for layout in _list_possible_layouts(height, width) if outputs else ():
        card = _build_card(session.model.stem, metadata, names, height, width, layout)
        for count in (len(names),) if names else (1, *find_class_counts(outputs, card)):
            tried = card.model_copy(update={"class_names": names or _number_classes(count)})
            if layout in find_fitting_layouts(outputs, tried):
                fitting.append(tried)
                break
    if not fitting:
        found = ", ".join(f"{name} {values.shape}" for name, values in outputs.items()) or "it does not run"
        return CardDraft(
            text=format_card(base if names else base.model_copy(update={"class_names": _number_classes(1)})),
            remark=f"This draft is a guess: no layout fits the outputs of a probe image ({found}).",
        )
    # Usual names of outputs say more than shapes: RF-DETR and RT-DETR have the same.
    best = max(fitting, key=lambda card: (_count_usual_names(outputs, card), _has_enough_rows(outputs, card)))
    others = [card.output.layout for card in fitting if card is not best]
    said = "its metadata and a probe image" if names else "a probe image (class names are unknown)"
    also = f"; {' or '.join(others)} would fit too" if others else ""
    return CardDraft(text=format_card(best), remark=f"A draft from {said}, layout {best.output.layout}{also}.")


def _build_card(
    stem: str, metadata: Mapping[str, str], names: tuple[str, ...], height: int, width: int, layout: OutputLayout
) -> ModelCard:
    """A card with what models of this layout usually want."""
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
    """The layouts that an input of this size can have: YOLOX' grids must fit it."""
    stride = max(CardOutput(layout=OutputLayout.YOLOX).strides)
    return tuple(
        layout for layout in OutputLayout if layout is not OutputLayout.YOLOX or not (height % stride or width % stride)
    )


def _run_probe(session: ModelSession, height: int, width: int) -> dict[str, Float32Array]:
    """The outputs for noise; none where the model does not run."""
    noise = np.random.default_rng(0).random((1, 3, height, width), dtype=np.float32)
    try:
        outputs = session.run(noise, session.output_names)
    except Exception:  # onnxruntime's errors share no base class but this
        return {}
    return dict(zip(session.output_names, outputs, strict=True))


def _count_usual_names(outputs: Mapping[str, Float32Array], card: ModelCard) -> int:
    """How many outputs of the layout have the names that its exports use; 0 unless all have."""
    names = assign_outputs(outputs, card)
    for form in READERS[card.output.layout].list_signatures(card):
        if all(name.casefold() in part.usual_names for name, part in zip(names, form, strict=True)):
            return len(names)
    return 0


def _has_enough_rows(outputs: Mapping[str, Float32Array], card: ModelCard) -> bool:
    """Whether a layout with a candidate for every cell has as many as the cells of two coarse grids."""
    if card.output.layout not in _CANDIDATE_PER_CELL:
        return True
    reader, names = READERS[card.output.layout], assign_outputs(outputs, card)
    count = len(reader.read_candidates([outputs[name][0] for name in names], card, NO_THRESHOLD).rows)
    return count >= sum((card.input.width_px // stride) * (card.input.height_px // stride) for stride in (16, 32))


def _read_input_size(session: ModelSession, metadata: Mapping[str, str]) -> tuple[int, int]:
    """Height and width: fixed by the graph, else of the metadata's ``imgsz``, else the usual."""
    said = _parse_literal(metadata.get("imgsz", ""))
    if isinstance(said, int):
        said = [said, said]
    if not (
        isinstance(said, list | tuple) and len(said) == 2 and all(isinstance(side, int) and side > 0 for side in said)
    ):
        said = [_INPUT_SIZE_DEFAULT_PX, _INPUT_SIZE_DEFAULT_PX]
    height, width = session.input_shape[2:]
    return height or said[0], width or said[1]


def _read_class_names(metadata: Mapping[str, str]) -> tuple[str, ...]:
    """Metadata's ``names``: a mapping of numbers to names, or a list; empty where it is neither."""
    said = _parse_literal(metadata.get("names", ""))
    if isinstance(said, dict) and all(isinstance(key, int) for key in said):
        return tuple(str(said[key]) for key in sorted(said))
    return tuple(str(name) for name in said) if isinstance(said, list | tuple) else ()


def _parse_literal(text: str) -> object:
    try:
        value: object = ast.literal_eval(text)
    except (ValueError, SyntaxError):
        return None
    return value


def _number_classes(count: int) -> tuple[str, ...]:
    return tuple(f"class {i}" for i in range(count))
