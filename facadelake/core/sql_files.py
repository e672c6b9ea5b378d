"""The statements of sql/: one a file, with a header of grain, meaning and bound parameters.

The header is SQL comments: ``-- grain: storey and class``, ``-- meaning: ...``, ``-- $campaign_id: the campaign``,
and for a check ``-- table: defects``.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from facadelake.core.errors import StoreError

_LINE = re.compile(r"^-- (\$?\w+): (.*\S)\s*$")


@dataclass(frozen=True, kw_only=True)
class Statement:
    """One SQL file; ``parameters`` without their dollar; ``table`` is what a check looks at, "" elsewhere."""

    name: str
    grain: str
    meaning: str
    table: str
    parameters: tuple[str, ...]
    sql: str


def read_statement(path: Path) -> Statement:
    """The statement of one file. Raises StoreError where its header lacks grain or meaning."""
    text = path.read_text("utf-8")
    header: dict[str, str] = {}
    for line in text.splitlines():
        found = _LINE.match(line)
        if not found:
            break
        header[found[1]] = found[2]
    missing = [word for word in ("grain", "meaning") if word not in header]
    if missing:
        raise StoreError(f"{path.name} has no {' and no '.join(missing)} in its header; begin it with '-- grain: ...'")
    return Statement(
        name=path.stem,
        grain=header["grain"],
        meaning=header["meaning"],
        table=header.get("table", ""),
        parameters=tuple(word[1:] for word in header if word.startswith("$")),
        sql=text,
    )


@cache
def statements(folder: Path) -> tuple[Statement, ...]:
    """The statements of a folder (``sql/views``, ``sql/questions``, ``sql/checks``) by name."""
    return tuple(read_statement(path) for path in sorted(folder.glob("*.sql")))
