"""Ask the lake in SQL, strictly read-only: a free SELECT, or a named question of sql/questions/."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import duckdb
import pyarrow as pa

from facadelake.errors import InputDataError, StoreError
from facadelake.lake.connect import DATA, extension_file, quoted, reading, store_errors
from facadelake.lake.guard import refuse_unless_plain_select
from facadelake.lake.read import check_version
from facadelake.lake.sqlfiles import Statement, statements
from schemas.tables import TABLES

Value = str | int | float | bool | None


def list_questions() -> tuple[Statement, ...]:
    """The named questions, each with its grain, meaning and parameters."""
    return statements("questions")


def ask(lake: Path, name: str, parameters: Mapping[str, Value] | None = None, *, as_of: int | None = None) -> pa.Table:
    """The answer to a named question; a parameter left out is NULL, which the question's header explains.

    Raises InputDataError for an unknown question or parameter.
    """
    known = {question.name: question for question in list_questions()}
    if name not in known:
        raise InputDataError(f"there is no question {name}; there are {', '.join(known)}")
    question = known[name]
    given = dict(parameters or {})
    allowed = [parameter.name for parameter in question.parameters]
    strange = sorted(given.keys() - set(allowed))
    if strange:
        raise InputDataError(
            f"question {name} has no parameter {', '.join(strange)}; it has {', '.join(allowed) or 'none'}"
        )
    return query(lake, question.sql, {key: given.get(key) for key in allowed}, as_of=as_of)


def query(lake: Path, sql: str, parameters: Mapping[str, Value] | None = None, *, as_of: int | None = None) -> pa.Table:
    """Rows of one SELECT over the lake's tables and the views of sql/views/; geometry comes as WKB.

    ``parameters`` are bound to ``$name``. Spatial functions (ST_...) work. Raises InputDataError for anything but a
    SELECT over tables and views, or one that DuckDB cannot answer; StoreError where the lake cannot be read.
    """
    with _sealed(lake, as_of) as connection:
        views = {view.name for view in statements("views")}
        refuse_unless_plain_select(connection, sql, frozenset(TABLES) | views)
        try:
            rows = connection.execute(sql, dict(parameters) if parameters else None).to_arrow_table()
        except (duckdb.IOException, duckdb.InternalException, duckdb.FatalException) as error:
            raise StoreError(f"the lake {lake} could not be read: {error}; check that its files are whole") from error
        except duckdb.Error as error:
            raise InputDataError(f"the question cannot be answered: {str(error).strip()}") from error
    plain = [pa.field(field.name, field.type, field.nullable) for field in rows.schema]  # without DuckDB's metadata
    return rows.cast(pa.schema(plain))


@contextmanager
def _sealed(lake: Path, as_of: int | None) -> Iterator[duckdb.DuckDBPyConnection]:
    """A reading connection with the views, that can open no file but the lake's own and cannot be reconfigured."""
    with reading(lake, as_of=as_of) as connection:
        check_version(connection, lake)
        with store_errors(f"preparing the lake {lake} for questions", "check that its files are whole"):
            connection.execute(f"LOAD {quoted(extension_file('spatial'))}")
            for view in statements("views"):
                connection.execute(f"CREATE TEMP VIEW {view.name} AS {view.sql}")
            data = quoted(f"{lake.resolve() / DATA}/")
            connection.execute(f"SET allowed_directories = [{data}]")
            connection.execute("SET enable_external_access = false")
            connection.execute("SET lock_configuration = true")
        yield connection
