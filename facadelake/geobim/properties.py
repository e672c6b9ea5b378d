"""Property sets of an element and its type."""

from __future__ import annotations

import json
import math
from typing import Any

import ifcopenshell
import ifcopenshell.util.element

_MOST_CHARACTERS = 8192  # some exporters hang whole specifications on every window
_LEFT_OUT = "_left_out"


def property_sets(element: ifcopenshell.entity_instance) -> dict[str, dict[str, Any]]:
    """Values of the element's property sets, its own before its type's, by set and name."""
    found = ifcopenshell.util.element.get_psets(element, psets_only=True)
    return {
        name: {key: _plain(value) for key, value in values.items() if key != "id"} for name, values in found.items()
    }


def as_json(sets: dict[str, dict[str, Any]]) -> str:
    """The sets as JSON of at most 8192 characters; where they are more, the largest are left out and named."""
    kept = {name: json.dumps(values, ensure_ascii=False, sort_keys=True) for name, values in sets.items() if values}
    left: list[str] = []
    # IFC's own Pset_ stay longest: they are what queries ask for.
    for name in sorted(kept, key=lambda name: (name.startswith("Pset_"), -len(kept[name]))):
        if sum(len(text) + len(key) + 6 for key, text in kept.items()) <= _MOST_CHARACTERS:
            break
        left.append(name)
        del kept[name]
    parts = [f"{json.dumps(name, ensure_ascii=False)}: {kept[name]}" for name in sorted(kept)]
    if left:
        parts.append(f"{json.dumps(_LEFT_OUT)}: {json.dumps(sorted(left)[:20], ensure_ascii=False)}")
    return "{" + ", ".join(parts) + "}" if parts else ""


def is_external(sets: dict[str, dict[str, Any]]) -> bool | None:
    """IsExternal of the element's common property set; None where it is not said."""
    for name, values in sets.items():
        if name.startswith("Pset_") and name.endswith("Common") and isinstance(values.get("IsExternal"), bool):
            return bool(values["IsExternal"])
    return None


def _plain(value: Any) -> Any:
    """A value that JSON can hold: entities by their text, no NaN."""
    if isinstance(value, dict):
        return {str(key): _plain(inner) for key, inner in value.items() if key != "id"}
    if isinstance(value, (list, tuple)):
        return [_plain(inner) for inner in value]
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return value if value is None or isinstance(value, (bool, int, float, str)) else str(value)
