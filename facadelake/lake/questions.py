"""The stored questions of sql/questions/, answered with bound parameters."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pyarrow as pa

from facadelake.core.checkout import locate_source
from facadelake.core.errors import InputDataError, suggest_name
from facadelake.core.sql_files import SqlStatement, read_statements
from facadelake.lake.read import Value, query

# Parameters that name something in the lake: what it is, and the table and column that list it.
_NAMES = {
    "building_id": ("building", "campaigns", "building_id"),
    "campaign_id": ("campaign", "campaigns", "campaign_id"),
    "since_campaign": ("campaign", "campaigns", "campaign_id"),
    "from_campaign": ("campaign", "campaigns", "campaign_id"),
    "to_campaign": ("campaign", "campaigns", "campaign_id"),
    "track_id": ("track", "tracks", "track_id"),
}
_LISTED = 20


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


def require_known_names(lake: Path, parameters: Mapping[str, Value], *, as_of: int | None = None) -> None:
    """Check that the buildings, campaigns and tracks that parameters name are in the lake.

    A question about another one has no rows, which reads as 'nothing is new'.

    Args:
        lake: folder of the lake.
        parameters: values by name; a track may be named by its number.
        as_of: an earlier version; None: the newest.

    Raises InputDataError for the first that is unknown, with those that are known.
    """
    building = parameters.get("building_id")
    for name, (kind, table, column) in _NAMES.items():
        given = parameters.get(name)
        if given is None:
            continue
        where = "" if building is None or name == "building_id" else "WHERE building_id = $building_id"
        rows = query(
            lake,
            f"SELECT DISTINCT {column} AS name FROM {table} {where} ORDER BY name",
            {"building_id": building} if where else None,
            as_of=as_of,
        )
        known = rows.column("name").to_pylist()
        numbers = {one.rpartition("-")[2].lstrip("0") for one in known} if name == "track_id" else set()
        if given not in known and str(given).lstrip("0") not in numbers:
            at = "" if as_of is None else f" at version {as_of}"
            of = f" of building '{building}'" if where else ""
            listed = ", ".join(known[:_LISTED]) + (f" and {len(known) - _LISTED} more" if len(known) > _LISTED else "")
            raise InputDataError(
                f"the lake {lake} has{at} no {kind} '{given}'{of}{suggest_name(str(given), known)}; "
                f"it has {listed or 'none'}"
            )
