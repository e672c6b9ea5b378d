"""What parameters of stored questions may be: words of a closed list, or values that the lake has.

The header of a question declares it in brackets:

- ``[length_m | area_m2]``: words.
- ``[tracks.defect_class]``: a column; the words that ``schemas`` allows there, else the values that the lake has, those
  of the given building and campaign.
- ``[tracks.track_state, ...]``: several, separated by commas.
- ``[tracks.track_id or number]``: also the number at the end of an id.
- ``[number]``, ``[date]``: left to the cast in the question.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from facadelake.core.errors import InputDataError, suggest_name
from facadelake.core.tables import list_rows
from facadelake.lake.read import Value, query
from schemas.tables import LAKE_TABLES

_UNCHECKED = frozenset({"", "number", "date"})
_SEVERAL, _OR_NUMBER = ", ...", " or number"
_LISTED = 20
_NEAR = 3


@dataclass(frozen=True, kw_only=True)
class _Declaration:
    """What one parameter may be; ``words`` is empty where the values are those of ``column`` in the lake."""

    noun: str
    table: str
    column: str
    words: tuple[str, ...]
    several: bool
    or_number: bool

    def split(self, given: Value) -> list[str]:
        """The single values of what was given."""
        return str(given).replace(" ", "").split(",") if self.several else [str(given)]


def require_known_values(
    lake: Path, values: Mapping[str, Value], declared: Mapping[str, str], *, as_of: int | None = None
) -> None:
    """Require that values are of those that their declarations allow.

    A question about another one has no rows, which reads as 'nothing is new'.

    Args:
        lake: folder of the lake.
        values: values by parameter; None: left out.
        declared: what each parameter may be, as the header of a question declares it.
        as_of: an earlier version; None: the newest.

    Raises:
        InputDataError: for the first unknown one, with those like it and those that there are.
    """
    checked = {
        name: _read_declaration(name, text)
        for name, text in declared.items()
        if text not in _UNCHECKED and values.get(name) is not None
    }
    held = _read_values(lake, {name: one for name, one in checked.items() if not one.words}, values, as_of)
    for name, one in checked.items():
        for given in one.split(values[name]):
            if one.words and given not in one.words:
                raise InputDataError(
                    f"{name}={values[name]}: there is no {one.noun} '{given}'{suggest_name(given, one.words)}; there "
                    f"are {', '.join(one.words)}"
                )
            if not one.words and not _is_known(given, held[name], one):
                at = "" if as_of is None else f" at version {as_of}"
                raise InputDataError(
                    f"the lake {lake} has{at} no {one.noun} '{given}'{_describe_scope(one, values)}"
                    f"{_list_known(given, held[name], one)}"
                )


def _read_declaration(name: str, text: str) -> _Declaration:
    base = text.removesuffix(_SEVERAL).removesuffix(_OR_NUMBER)
    table, dot, column = base.partition(".")
    allowed = [one.allowed for one in LAKE_TABLES[table].columns if one.name == column] if dot else []
    return _Declaration(
        noun=(column or name).removesuffix("_id").removesuffix("_guid").replace("_", " "),
        table=table if dot else "",
        column=column,
        words=allowed[0] if dot else tuple(base.split(" | ")),
        several=text.endswith(_SEVERAL),
        or_number=text.endswith(_OR_NUMBER),
    )


def _list_scope(one: _Declaration, values: Mapping[str, Value]) -> Iterator[str]:
    """The given keys that narrow the values of a column."""
    for key in ("building_id", "campaign_id"):
        if values.get(key) is not None and key != one.column and key in LAKE_TABLES[one.table].key:
            yield key


def _describe_scope(one: _Declaration, values: Mapping[str, Value]) -> str:
    scope = [f"{key.removesuffix('_id')} '{values[key]}'" for key in _list_scope(one, values)]
    return f" of {', '.join(scope)}" if scope else ""


def _read_values(
    lake: Path, wanted: Mapping[str, _Declaration], values: Mapping[str, Value], as_of: int | None
) -> dict[str, list[str]]:
    """The values in the lake that each parameter may have, sorted."""
    if not wanted:
        return {}
    parts = []
    for name, one in wanted.items():
        where = "".join(f" AND {key} = ${key}" for key in _list_scope(one, values))
        parts.append(
            f"SELECT DISTINCT '{name}' AS parameter, {one.column}::VARCHAR AS value FROM {one.table} "
            f"WHERE {one.column} IS NOT NULL{where}"
        )
    keys = {key for one in wanted.values() for key in _list_scope(one, values)}
    sql = f"{' UNION ALL '.join(parts)} ORDER BY ALL"
    rows = list_rows(query(lake, sql, {key: values[key] for key in sorted(keys)} or None, as_of=as_of))
    return {name: [row["value"] for row in rows if row["parameter"] == name] for name in wanted}


def _is_known(given: str, held: Sequence[str], one: _Declaration) -> bool:
    return given in held or (
        one.or_number
        and given.isdigit()
        and given.lstrip("0") in {value.rpartition("-")[2].lstrip("0") for value in held}
    )


def _list_known(given: str, held: Sequence[str], one: _Declaration) -> str:
    if len(held) <= _LISTED:
        return f"{suggest_name(given, held)}; it has {', '.join(held) or 'none'}"
    command = f'facadelake sql "SELECT DISTINCT {one.column} FROM {one.table} ORDER BY ALL"'
    return f"{suggest_name(given, held, _NEAR)}; it has {len(held)}, see {command}"
