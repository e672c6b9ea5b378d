"""The errors that Facadelake raises; each message states what, the value, the limit and the remedy."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches


class FacadelakeError(Exception):
    """Base class of all errors of Facadelake. The message is written for the person who ran the command."""


class InputDataError(FacadelakeError):
    """A photograph, table, portfolio or setting of the user cannot be used."""


class GeoreferenceError(FacadelakeError):
    """The campaign or the building model cannot be georeferenced."""


class ModelError(FacadelakeError):
    """A building model or a detector model is unreadable or differs from its declaration."""


class SchemaError(FacadelakeError):
    """A table lacks the columns, types or values that schemas/ declares."""


class StoreError(FacadelakeError):
    """The lake cannot be read or written; committed versions are unchanged."""


class HistoryOutdatedError(StoreError):
    """The lake has changed since the building's campaigns were tracked; nothing was written."""


class CodeVersionError(FacadelakeError):
    """The code of a result cannot be identified, or changed while it was computed; nothing was stored."""


def suggest_name(given: str, known: Iterable[str]) -> str:
    """`` (did you mean 'x'?)`` with the known name most like ``given``, whatever its case; empty where none is."""
    names = {name.lower(): name for name in known}
    found = get_close_matches(given.lower(), names, n=1)
    return f" (did you mean '{names[found[0]]}'?)" if found else ""
