"""docs/tables.md, made from schemas/: ``python -m schemas.document > docs/tables.md``."""

from __future__ import annotations

from collections.abc import Iterator

from schemas.column_type import Column
from schemas.tables import LAKE_TABLES, RUN_KEYS, SCHEMA_VERSION, Table

HEADER = f"""# Tables

Made from `schemas/` by `python -m schemas.document`; do not edit. Schema version {SCHEMA_VERSION}.

Every table begins with `building_id`, `campaign_id` and `run_id`, which are not repeated below. A campaign is
committed in one transaction, as one version of the lake. A geometry is WKB; its CRS is in the unit column (longitude,
latitude, ellipsoidal height, in that order). Times are UTC. Columns marked "may be empty" are nullable, all others
have a value in every row. Table `reviews` belongs to no run: rows are appended and never changed. Checks across
tables are in `sql/checks/`, questions to ask in `sql/questions/`.
"""


def build_document() -> str:
    """The text of docs/tables.md."""
    index = ["| table | a row is a | says |", "|---|---|---|"]
    index += [f"| [{table.name}](#{table.name}) | {table.grain} | {table.meaning} |" for table in LAKE_TABLES.values()]
    return "\n".join([HEADER, *index, "", *(line for table in LAKE_TABLES.values() for line in _format_table(table))])


def _format_table(table: Table) -> Iterator[str]:
    yield f"## {table.name}"
    yield ""
    yield f"One row per {table.grain}: {table.meaning}. Key: {', '.join(f'`{name}`' for name in table.key)}."
    yield "The table may have no rows." if table.may_be_empty else "The table has at least one row."
    yield ""
    yield "| column | type | unit | meaning | allowed | may be empty |"
    yield "|---|---|---|---|---|---|"
    for column in table.columns:
        if column.name not in RUN_KEYS:
            empty = "yes" if column.name in table.optional else ""
            cells = (f"`{column.name}`", column.kind, column.unit, column.meaning, _format_allowed(column), empty)
            yield f"| {' | '.join(str(cell).replace('|', chr(92) + '|') for cell in cells)} |"
    yield ""


def _format_allowed(column: Column) -> str:
    if column.allowed:
        return ", ".join(column.allowed)
    low, high = column.minimum, column.maximum
    if low is not None and high is not None:
        return f"{low:g} to {high:g}"
    if low is not None:
        return f"{low:g} or more"
    return "" if high is None else f"{high:g} or less"


def main() -> None:
    """Print the document."""
    print(build_document(), end="")


if __name__ == "__main__":
    main()
