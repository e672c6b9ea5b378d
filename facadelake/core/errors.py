"""The errors that Facadelake raises; each message states what, the value, the limit and the remedy."""

from __future__ import annotations

import re
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


def suggest_name(given: str, known: Iterable[str], count: int = 1) -> str:
    """`` (did you mean 'x'?)`` with the known names most like ``given``, at most ``count``; empty where none is."""
    near = [f"'{name}'" for name in _find_near_names(given, known, count)]
    return f" (did you mean {' or '.join(filter(None, (', '.join(near[:-1]), near[-1])))}?)" if near else ""


def _find_near_names(given: str, known: Iterable[str], count: int) -> list[str]:
    """The known names most like ``given``, the nearest first; neither case nor zeros before a number count.

    A number alone is near the names that end in it.
    """
    names: dict[str, str] = {}
    for name in known:
        names.setdefault(_simplify(name), name)
    wanted = _simplify(given)
    if wanted in names:
        return [names[wanted]]
    ending = [form for form in names if re.search(rf"\D{wanted}$", form)] if wanted.isdigit() else []
    return [names[form] for form in (ending or get_close_matches(wanted, names, n=count))[:count]]


def _simplify(name: str) -> str:
    return re.sub(r"0*(\d+)", r"\1", name.lower())
