"""The statements of sql/: one per file, with a header that states grain, meaning and bound parameters.

The header consists of SQL comments: ``-- grain: storey and class``, ``-- meaning: ...``, ``-- $campaign_id: the
campaign``, and for a check ``-- table: defects``. A question declares in brackets what a parameter may be:
``-- $campaign_id [campaigns.campaign_id]: the campaign`` (see ``facadelake/lake/known_values.py``). A check of several
tables is a template: ``-- {table}: defects | observations`` lists the values of ``{table}``; other placeholders, such
as ``{key}``, have the same number of values.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from facadelake.core.errors import StoreError

_LINE = re.compile(r"^-- (\$?\w+|\{\w+\})(?: \[(.+?)\])?: (.*\S)\s*$")


@dataclass(frozen=True, kw_only=True)
class SqlStatement:
    """One statement; ``parameters`` (without the dollar sign) have what each may be, "" where that is not declared;
    ``table`` is the table of a check, "" elsewhere."""

    name: str
    grain: str
    meaning: str
    table: str
    parameters: Mapping[str, str]
    sql: str


@cache
def read_statements(folder: Path) -> tuple[SqlStatement, ...]:
    """The statements of a folder (``sql/views``, ``sql/questions``, ``sql/checks``) by name.

    Raises StoreError where a header lacks grain or meaning, or placeholders have different numbers of values.
    """
    return tuple(statement for path in sorted(folder.glob("*.sql")) for statement in read_statement_file(path))


def read_statement_file(path: Path) -> tuple[SqlStatement, ...]:
    """The statement of a file; for a template one for each of its tables, named after the file and the table."""
    text = path.read_text("utf-8")
    header = _read_header(text)
    columns = {name: header[name][1].split(" | ") for name in header if name.startswith("{")}
    if len({len(values) for values in columns.values()}) > 1:
        raise StoreError(
            f"{path.name}: the placeholders {', '.join(columns)} have different numbers of values; give each as many"
        )
    if not columns:
        return (_build_statement(path.stem, text, path.name),)
    return tuple(
        _build_statement(f"{path.stem}_{filled['{table}']}", _fill_template(text, filled), path.name)
        for filled in _zip_placeholder_values(columns)
    )


def _zip_placeholder_values(columns: dict[str, list[str]]) -> Iterator[dict[str, str]]:
    for values in zip(*columns.values(), strict=True):
        yield dict(zip(columns, values, strict=True))


def _fill_template(text: str, values: dict[str, str]) -> str:
    lines = [line for line in text.splitlines(keepends=True) if not line.startswith("-- {")]
    filled = "".join(lines)
    for name, value in values.items():
        filled = filled.replace(name, value)
    return filled


def _read_header(text: str) -> dict[str, tuple[str, str]]:
    """What a header declares in brackets, "" without them, and says of each name."""
    header: dict[str, tuple[str, str]] = {}
    for line in text.splitlines():
        found = _LINE.match(line)
        if not found:
            break
        header[found[1]] = (found[2] or "", found[3])
    return header


def _build_statement(name: str, text: str, file: str) -> SqlStatement:
    header = _read_header(text)
    missing = [key for key in ("grain", "meaning") if key not in header]
    if missing:
        raise StoreError(f"the header of {file} lacks {' and '.join(missing)}; begin it with '-- grain: ...'")
    return SqlStatement(
        name=name,
        grain=header["grain"][1],
        meaning=header["meaning"][1],
        table=header["table"][1] if "table" in header else "",
        parameters={key[1:]: declared for key, (declared, _) in header.items() if key.startswith("$")},
        sql=text,
    )
