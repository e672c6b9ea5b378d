"""The stored questions of sql/questions/, answered with bound parameters."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pyarrow as pa

from facadelake.core.checkout import locate_source
from facadelake.core.errors import InputDataError, suggest_name
from facadelake.core.sql_files import SqlStatement, read_statements
from facadelake.lake.read import Value, query


def list_questions() -> tuple[SqlStatement, ...]:
    """The stored questions, each with its grain, meaning and parameters."""
    return read_statements(locate_source("sql/questions"))


def answer_question(
    lake: Path, name: str, parameters: Mapping[str, Value] | None = None, *, as_of: int | None = None
) -> pa.Table:
    """The rows of a stored question.

    Args:
        lake: folder of the lake.
        name: name of the question.
        parameters: values by name; a parameter left out is NULL, as the header of the question explains.
        as_of: an earlier version; None: the newest.

    Raises InputDataError for an unknown question or parameter.
    """
    known = {question.name: question for question in list_questions()}
    if name not in known:
        raise InputDataError(f"there is no question {name}{suggest_name(name, known)}; there are {', '.join(known)}")
    question = known[name]
    given = dict(parameters or {})
    allowed = question.parameters
    strange = sorted(given.keys() - set(allowed))
    if strange:
        raise InputDataError(
            f"question {name} has no parameter {', '.join(strange)}; it has {', '.join(allowed) or 'none'}"
        )
    return query(lake, question.sql, {key: given.get(key) for key in allowed}, as_of=as_of)
