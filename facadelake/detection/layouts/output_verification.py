"""The outputs of a probe image against the declared layout: which output is which part, and can its values be."""

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
_CLASS_COUNT_MAX = 1000  # of a model whose number of classes is looked for


def verify_outputs(outputs: Mapping[str, Float32Array], card: ModelCard, model: str) -> tuple[str, ...]:
    """The names of the outputs that are the declared layout's parts, in their order.

    ``outputs`` are all that the model gave for one probe image, with the batch axis. Raises ModelError where they are
    not of the layout, in shape or in values; it says what was expected and found, and which layout would fit.
    """
    try:
        names = assign_outputs(outputs, card)
    except ModelError as error:
        raise ModelError(f"model {model}: {error}; {_describe_alternatives(outputs, card)}{_REMEDY}") from error
    fault = _check_values(outputs, names, card)
    if fault:
        raise ModelError(f"model {model}: {fault}; {_describe_alternatives(outputs, card)}{_REMEDY}")
    return names


def assign_outputs(outputs: Mapping[str, Float32Array], card: ModelCard) -> tuple[str, ...]:
    """Which outputs are the layout's parts: those that the card names, else by known names, else by their shapes.

    Raises ModelError where none are, or where shapes alone leave a choice.
    """
    reader = READERS[card.output.layout]
    shapes = {name: values.shape for name, values in outputs.items()}
    forms = reader.list_signatures(card)
    _check_names(tuple(shapes), forms[0], card)
    for form in forms:
        named = _match_names(shapes, form, card)
        if named and match_shapes([shapes[name] for name in named], form):
            return named
    if not card.output.output_names and len(forms[0]) > 1:
        for form in forms:
            ways = [
                way for way in permutations(shapes, len(form)) if match_shapes([shapes[name] for name in way], form)
            ]
            if len(ways) == 1:
                return ways[0]
            if ways:
                raise ModelError(
                    f"its outputs {_describe_shapes(shapes)} could be {' and '.join(part.name for part in form)} in "
                    f"{len(ways)} ways; say in the card which is which: output.names in this order"
                )
    expected = " or ".join(_describe_signature(form) for form in forms)
    one = len(forms[0]) == 1 and (named := _match_names(shapes, forms[0], card))
    found = f"output has shape {shapes[named[0]]}" if one else f"outputs are {_describe_shapes(shapes)}"
    raise ModelError(
        f"its {found}, layout {card.output.layout} with {len(card.class_names)} classes at {card.input.width_px} x "
        f"{card.input.height_px} px has {expected}"
    )


def find_fitting_layouts(outputs: Mapping[str, Float32Array], card: ModelCard) -> tuple[OutputLayout, ...]:
    """The layouts that would do for ``card``'s class names and input, in shape and in values."""
    fitting = []
    for layout in OutputLayout:
        try:
            names = assign_outputs(outputs, (as_declared := _replace_layout(card, layout)))
        except ModelError:
            continue
        if not _check_values(outputs, names, as_declared):
            fitting.append(layout)
    return tuple(fitting)


def find_class_counts(outputs: Mapping[str, Float32Array], card: ModelCard) -> tuple[int, ...]:
    """How many classes would make the outputs' shapes fit the card's layout; empty where none would, or any."""
    forms = READERS[card.output.layout].list_signatures
    if forms(_replace_class_names(card, 1)) == forms(_replace_class_names(card, 2)):
        return ()
    sizes = {0, *(size for values in outputs.values() for size in values.shape)}
    # A row has its classes' scores, up to five numbers of its box, and perhaps as many coefficients as prototypes.
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
    """The card with another layout, its outputs to be found."""
    output = card.output.model_copy(update={"layout": layout, "name": None, "names": ()})
    return card.model_copy(update={"output": output})


def _check_values(outputs: Mapping[str, Float32Array], names: Sequence[str], card: ModelCard) -> str:
    reader = READERS[card.output.layout]
    parts = [outputs[name][0] for name in names]
    nans = sum(int(np.isnan(part).sum()) for part in parts)
    if nans:
        return f"{nans} values of the outputs for a probe image are not numbers (NaN)"
    return reader.explain_mismatch(parts, reader.read_candidates(parts, card, NO_THRESHOLD), card)


def _describe_alternatives(outputs: Mapping[str, Float32Array], card: ModelCard) -> str:
    """What would fit instead."""
    fitting = [layout for layout in find_fitting_layouts(outputs, card) if layout is not card.output.layout]
    if fitting:
        return f"shape and values fit layout {' or '.join(fitting)}; "
    counts = [count for count in find_class_counts(outputs, card) if count != len(card.class_names)]
    if counts:
        return f"with {' or '.join(str(count) for count in counts[:3])} class_names its shape would fit; "
    return ""


def _check_names(given: Sequence[str], form: Sequence[OutputTensor], card: ModelCard) -> None:
    """Raise ModelError where the card names outputs that the model has not, or too few or many."""
    named = card.output.output_names
    missing = [name for name in named if name not in given]
    if missing:
        raise ModelError(f"it has no output '{missing[0]}' (it has {list(given)}), which the card's output names")
    if named and len(named) != len(form):
        raise ModelError(
            f"the card's output.names are {len(named)} ({', '.join(named)}), layout {card.output.layout} has "
            f"{len(form)} ({', '.join(part.name for part in form)})"
        )


def _match_names(
    shapes: Mapping[str, tuple[int, ...]], form: Sequence[OutputTensor], card: ModelCard
) -> tuple[str, ...]:
    """The outputs that the card names or whose names are known; a layout of one output takes the first."""
    if card.output.output_names:
        return card.output.output_names
    if len(form) == 1:
        return (next(iter(shapes)),)
    known = [[name for name in shapes if name.casefold() in part.usual_names] for part in form]
    return tuple(names[0] for names in known) if all(len(names) == 1 for names in known) else ()


def _describe_signature(form: Sequence[OutputTensor]) -> str:
    if len(form) == 1:
        return str(form[0])
    return " and ".join(f"{part.name} {part}" for part in form)


def _describe_shapes(shapes: Mapping[str, tuple[int, ...]]) -> str:
    return ", ".join(f"{name} {shape}" for name, shape in shapes.items())
