"""The stored questions of sql/questions/, answered with bound parameters."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pyarrow as pa

from facadelake.core.checkout import locate_source
from facadelake.core.errors import InputDataError, suggest_name
from facadelake.core.sql_files import SqlStatement, read_statements
from facadelake.lake.known_values import require_known_values
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

    Raises InputDataError for an unknown question or parameter, and for a value that its parameter cannot have.
    """
    known = {question.name: question for question in list_questions()}
    if name not in known:
        raise InputDataError(f"there is no question {name}{suggest_name(name, known)}; there are {', '.join(known)}")
    question = known[name]
    given = dict(parameters or {})
    allowed = question.parameters
    strange = sorted(given.keys() - allowed.keys())
    if strange:
        raise InputDataError(
            f"question {name} has no parameter {', '.join(strange)}; it has {', '.join(allowed) or 'none'}"
        )
    require_known_values(lake, given, allowed, as_of=as_of)
    return query(lake, question.sql, {key: given.get(key) for key in allowed}, as_of=as_of)


def find_latest_campaign(lake: Path, building_id: str, *, as_of: int | None = None) -> str:
    """The building's campaign that was flown last, in the lake at version ``as_of`` (None: the newest).

    Raises InputDataError where the lake has none.
    """
    sql = "SELECT campaign_id FROM campaign_order WHERE building_id = $building_id AND is_latest"
    found = query(lake, sql, {"building_id": building_id}, as_of=as_of).column("campaign_id").to_pylist()
    if not found:
        at = "" if as_of is None else f" at version {as_of}"
        raise InputDataError(
            f"the lake {lake} has{at} no campaign of building '{building_id}'; 'facadelake inspect' adds one, "
            "'facadelake campaigns' lists what there is"
        )
    return str(found[0])
