"""The errors Facadelake raises; each message says what, the value, the limit and the remedy."""

from __future__ import annotations


class FacadelakeError(Exception):
    """Anything Facadelake refuses to go on with. Its text is written for the person who ran the command."""


class InputDataError(FacadelakeError):
    """A photograph, table, registry or setting that a person gave cannot be used."""


class GeoreferenceError(FacadelakeError):
    """The campaign or the building model cannot be placed on the globe."""


class ModelError(FacadelakeError):
    """A building model or a detector model is unreadable or not what was declared."""


class SchemaError(FacadelakeError):
    """A table does not have the columns, types or values that schemas/ declares."""


class StoreError(FacadelakeError):
    """The lake cannot be read or written; what was committed before stays as it was."""
