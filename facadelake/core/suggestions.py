"""The known name that a mistyped one resembles, for error messages."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches


def suggest_name(given: str, known: Iterable[str]) -> str:
    """`` (did you mean 'x'?)`` with the known name most like ``given``, whatever its case; empty where none is."""
    names = {name.lower(): name for name in known}
    found = get_close_matches(given.lower(), names, n=1)
    return f" (did you mean '{names[found[0]]}'?)" if found else ""
