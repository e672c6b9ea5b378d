"""Verification of a model's outputs for a probe image against the declared layout, in names, shapes and values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import permutations

import numpy as np

from facadelake.core.arrays import Float32Array
from facadelake.core.errors import ModelError
from facadelake.detection.card import ModelCard, OutputLayout
from facadelake.detection.layouts.output_reader import NO_THRESHOLD, OutputTensor, match_shapes
from facadelake.detection.layouts.readers import READERS

_REMEDY = "correct output.layout or class_names in the card, or export the model again"
_CLASS_COUNT_MAX = 1000  # largest number of classes that is tried


def verify_outputs(outputs: Mapping[str, Float32Array], card: ModelCard, model: str) -> tuple[str, ...]:
    """Names of the outputs in the order of the declared layout's signature.

    ``outputs`` are all outputs of the model for one probe image, with the batch axis. Raises ModelError if their shapes
    or values are not those of the layout; the message has the expected and actual shapes and the layouts that fit.
    """
    try:
        names = assign_outputs(outputs, card)
    except ModelError as error:
        raise ModelError(f"model {model}: {error}; {_describe_alternatives(outputs, card)}{_REMEDY}") from error
    mismatch = _check_values(outputs, names, card)
    if mismatch:
        raise ModelError(f"model {model}: {mismatch}; {_describe_alternatives(outputs, card)}{_REMEDY}")
    return names


def assign_outputs(outputs: Mapping[str, Float32Array], card: ModelCard) -> tuple[str, ...]:
    """Assign outputs to the layout's tensors: by the card's names, else by usual names, else by shapes.

    Raises ModelError if no assignment fits, or if several fit by shape.
    """
    reader = READERS[card.output.layout]
    shapes = {name: values.shape for name, values in outputs.items()}
    signatures = reader.list_signatures(card)
    _check_names(tuple(shapes), signatures[0], card)
    for signature in signatures:
        named = _match_names(shapes, signature, card)
        if named and match_shapes([shapes[name] for name in named], signature):
            return named
    if not card.output.output_names and len(signatures[0]) > 1:
        for signature in signatures:
            assignments = [
                names
                for names in permutations(shapes, len(signature))
                if match_shapes([shapes[name] for name in names], signature)
            ]
            if len(assignments) == 1:
                return assignments[0]
            if assignments:
                tensors = " and ".join(tensor.name for tensor in signature)
                raise ModelError(
                    f"its outputs {_describe_shapes(shapes)} could be {tensors} in {len(assignments)} ways; "
                    "state which is which in the card: output.names in this order"
                )
    expected = " or ".join(_describe_signature(signature) for signature in signatures)
    single = len(signatures[0]) == 1 and (named := _match_names(shapes, signatures[0], card))
    actual = f"output has shape {shapes[named[0]]}" if single else f"outputs are {_describe_shapes(shapes)}"
    raise ModelError(
        f"its {actual}, layout {card.output.layout} with {len(card.class_names)} classes at {card.input.width_px} x "
        f"{card.input.height_px} px has {expected}"
    )


def find_fitting_layouts(outputs: Mapping[str, Float32Array], card: ModelCard) -> tuple[OutputLayout, ...]:
    """The layouts that fit the outputs in shape and values, with the card's class names and input."""
    fitting = []
    for layout in OutputLayout:
        try:
            names = assign_outputs(outputs, (candidate := _replace_layout(card, layout)))
        except ModelError:
            continue
        if not _check_values(outputs, names, candidate):
            fitting.append(layout)
    return tuple(fitting)


def find_class_counts(outputs: Mapping[str, Float32Array], card: ModelCard) -> tuple[int, ...]:
    """Numbers of classes for which the outputs' shapes fit the card's layout; empty if none fits, or any."""
    list_signatures = READERS[card.output.layout].list_signatures
    if list_signatures(_replace_class_names(card, 1)) == list_signatures(_replace_class_names(card, 2)):
        return ()
    sizes = {0, *(size for values in outputs.values() for size in values.shape)}
    # A row holds class scores, up to five numbers of its box, and possibly one coefficient per prototype.
    possible = {size - box - other for size in sizes for box in (0, 1, 4, 5) for other in sizes}
    counts = []
    for count in sorted(possible & set(range(1, _CLASS_COUNT_MAX + 1))):
        try:
            assign_outputs(outputs, _replace_class_names(card, count))
        except ModelError:
            continue
        counts.append(count)
    return tuple(counts)


def _replace_class_names(card: ModelCard, count: int) -> ModelCard:
    return card.model_copy(update={"class_names": ("",) * count})


def _replace_layout(card: ModelCard, layout: OutputLayout) -> ModelCard:
    """The card with another layout and without output names."""
    output = card.output.model_copy(update={"layout": layout, "name": None, "names": ()})
    return card.model_copy(update={"output": output})


def _check_values(outputs: Mapping[str, Float32Array], names: Sequence[str], card: ModelCard) -> str:
    reader = READERS[card.output.layout]
    tensors = [outputs[name][0] for name in names]
    nans = sum(int(np.isnan(tensor).sum()) for tensor in tensors)
    if nans:
        return f"{nans} values of the outputs for a probe image are not numbers (NaN)"
    return reader.explain_mismatch(tensors, reader.read_candidates(tensors, card, NO_THRESHOLD), card)


def _describe_alternatives(outputs: Mapping[str, Float32Array], card: ModelCard) -> str:
    """The layouts or numbers of classes that fit instead, for a message."""
    fitting = [layout for layout in find_fitting_layouts(outputs, card) if layout is not card.output.layout]
    if fitting:
        return f"shape and values fit layout {' or '.join(fitting)}; "
    counts = [count for count in find_class_counts(outputs, card) if count != len(card.class_names)]
    if counts and (kind := _describe_extra(counts[0] - len(card.class_names))):
        return f"with {counts[0]} class_names its shape fits; or it is {kind}, which no layout reads; "
    if counts:
        return f"with {' or '.join(str(count) for count in counts[:3])} class_names its shape fits; "
    return ""


def _describe_extra(count: int) -> str:
    """What a model has ``count`` more numbers than classes for each box; empty for none."""
    if count == 1:
        return "an export of oriented boxes (one number more: the angle)"
    return "an export of poses (numbers of key points)" if count > 1 and not (count % 3 and count % 2) else ""


def _check_names(outputs: Sequence[str], signature: Sequence[OutputTensor], card: ModelCard) -> None:
    """Raise ModelError if the card names outputs that the model does not have, or too few or too many."""
    named = card.output.output_names
    missing = [name for name in named if name not in outputs]
    if missing:
        raise ModelError(f"it has no output '{missing[0]}' (it has {list(outputs)}), which the card names under output")
    if named and len(named) != len(signature):
        raise ModelError(
            f"the card's output.names are {len(named)} ({', '.join(named)}), layout {card.output.layout} has "
            f"{len(signature)} ({', '.join(tensor.name for tensor in signature)})"
        )


def _match_names(
    shapes: Mapping[str, tuple[int, ...]], signature: Sequence[OutputTensor], card: ModelCard
) -> tuple[str, ...]:
    """Outputs by the card's names or by usual names, empty if not unique; a single-output layout has the first."""
    if card.output.output_names:
        return card.output.output_names
    if len(signature) == 1:
        return (next(iter(shapes)),)
    known = [[name for name in shapes if name.casefold() in tensor.usual_names] for tensor in signature]
    return tuple(names[0] for names in known) if all(len(names) == 1 for names in known) else ()


def _describe_signature(signature: Sequence[OutputTensor]) -> str:
    if len(signature) == 1:
        return str(signature[0])
    return " and ".join(f"{tensor.name} {tensor}" for tensor in signature)


def _describe_shapes(shapes: Mapping[str, tuple[int, ...]]) -> str:
    return ", ".join(f"{name} {shape}" for name, shape in shapes.items())
