"""Identify elements: by GlobalId, and by GlobalId and STEP id where several have the same."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

import ifcopenshell

_LISTED = 5


def name_elements(model: ifcopenshell.file) -> dict[int, str]:
    """The elements' identifiers by STEP id: the GlobalId, such as "1Uoh21Wyf3Q9Hcs5CRwY8o".

    Where it is missing or several elements have the same, the STEP id is appended ("1Uoh21Wyf3Q9Hcs5CRwY8o#41").
    """
    elements = model.by_type("IfcProduct")
    count = Counter(element.GlobalId for element in elements)
    return {
        element.id(): str(element.GlobalId)
        if element.GlobalId and count[element.GlobalId] == 1
        else f"{element.GlobalId or ''}#{element.id()}"
        for element in elements
    }


def describe_shared_guids(identifiers: Mapping[int, str]) -> str:
    """Remark on elements that cannot be identified by GlobalId alone; empty if there are none."""
    shared = sorted(identifier for identifier in identifiers.values() if "#" in identifier)
    if not shared:
        return ""
    listed = ", ".join(shared[:_LISTED]) + (" ..." if len(shared) > _LISTED else "")
    return (
        f"{len(shared)} elements have no GlobalId or that of another element; they are kept apart by their STEP ids, "
        f"which the next export changes ({listed}): repair the GlobalIds in the authoring tool"
    )
