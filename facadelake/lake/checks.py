"""The checks before a commit: Great Expectations on each table, SQL across tables; results are rows."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import duckdb
import pyarrow as pa
import pyarrow.compute as pc

from facadelake.core.checkout import locate_source
from facadelake.core.duckdb_engine import open_duckdb
from facadelake.core.environment import set_environment_defaults
from facadelake.core.errors import SchemaError, StoreError
from facadelake.core.sql_files import SqlStatement, read_statements
from facadelake.core.tables import get_stage_schema, table_from_rows
from schemas.expectations import Expectation, derive_expectations
from schemas.tables import HISTORY_TABLES, LAKE_TABLES, TABLES

CHECKED = tuple(name for name in (*TABLES, *HISTORY_TABLES) if name != "checks")
CHECKS = locate_source("sql/checks")
EXAMPLES = 5  # unexpected values or rows kept in a result's detail


def validate(tables: Mapping[str, pa.Table]) -> pa.Table:
    """Check all tables but ``checks`` and return the table ``checks`` (stage form), a row per expectation.

    The tables may have their run keys or not. Raises SchemaError where a table is missing or has other columns or
    types than schemas/; unexpected values are results.
    """
    stage = {}
    for name in CHECKED:
        if name not in tables:
            raise SchemaError(f"table {name} is missing from the campaign; the checks need all of {', '.join(CHECKED)}")
        filled = LAKE_TABLES[name].filled_at_commit
        stage[name] = tables[name].drop_columns([key for key in filled if key in tables[name].column_names])
        if not stage[name].schema.equals(get_stage_schema(name)):
            raise SchemaError(
                f"table {name} has the columns {stage[name].schema.to_string()}; "
                f"schemas/ wants {get_stage_schema(name).to_string()}"
            )
    return table_from_rows("checks", [*_check_tables(stage), *check_across_tables(stage)])


def select_failures(checks: pa.Table) -> pa.Table:
    """The rows of ``checks`` that were not met."""
    return checks.filter(pc.invert(checks.column("passed")))


def format_failures(checks: pa.Table) -> str:
    """The failed checks, one per line: table, column, expectation, number of rows, observed values."""
    lines = []
    for row in select_failures(checks).to_pylist():
        place = f"{row['table_name']}.{row['column_name']}" if row["column_name"] else row["table_name"]
        lines.append(f"{place}: {row['expectation']}, {row['unexpected']} unexpected, {row['detail']}")
    return "\n".join(lines)


def _check_tables(tables: Mapping[str, pa.Table]) -> list[dict[str, Any]]:
    set_environment_defaults()
    # Great Expectations takes seconds to import; only a run that validates pays for it.
    import great_expectations as gx
    from great_expectations.data_context.types.base import ProgressBarsConfig

    context = gx.get_context(mode="ephemeral")
    context.variables.progress_bars = ProgressBarsConfig(globally=False, metric_calculations=False)
    source = context.data_sources.add_pandas("stage")
    rows = []
    for name in CHECKED:
        frame = tables[name].drop_columns(list(LAKE_TABLES[name].geometry_columns)).to_pandas()
        batch = (
            source.add_dataframe_asset(name)
            .add_batch_definition_whole_dataframe("all")
            .get_batch(batch_parameters={"dataframe": frame})
        )
        wanted = derive_expectations(LAKE_TABLES[name])
        suite = gx.ExpectationSuite(
            name=name, expectations=[_build_expectation(gx.expectations, one, n) for n, one in enumerate(wanted)]
        )
        outcome: Any = batch.validate(
            suite, result_format={"result_format": "BASIC", "partial_unexpected_count": EXAMPLES}
        )
        results = {result.expectation_config.meta["number"]: result for result in outcome.results}
        rows += [_build_row(name, one, results[number]) for number, one in enumerate(wanted)]
    return rows


def _build_expectation(library: Any, expectation: Expectation, number: int) -> Any:
    """The expectation as an object of Great Expectations; its number identifies its result."""
    kind = getattr(library, "".join(word.title() for word in expectation.name.split("_")))
    columns: dict[str, Any] = {}
    if len(expectation.columns) == 1:
        columns = {"column": expectation.columns[0]}
    elif expectation.columns:
        columns = {"column_list": list(expectation.columns)}
    return kind(**columns, **expectation.settings, meta={"number": number})


def _build_row(table: str, expectation: Expectation, result: Any) -> dict[str, Any]:
    outcome = result.result
    raised = result.exception_info.get("exception_message") if not result.success else None
    found = outcome.get("partial_unexpected_list", outcome.get("observed_value", raised))
    return {
        "table_name": table,
        "expectation": expectation.name,
        "column_name": ", ".join(expectation.columns),
        "passed": bool(result.success),
        "unexpected": int(outcome.get("unexpected_count", 0 if result.success else 1)),
        "detail": json.dumps({"expected": expectation.settings, "found": found}, default=str),
    }


def check_across_tables(tables: Mapping[str, pa.Table]) -> list[dict[str, Any]]:
    """Rows of ``checks`` from sql/checks, where any row found is a failure."""
    connection = open_duckdb("spatial")
    try:
        for name in CHECKED:
            connection.register(name, tables[name])
        return [_build_sql_row(connection, check) for check in read_statements(CHECKS)]
    finally:
        connection.close()


def _build_sql_row(connection: duckdb.DuckDBPyConnection, check: SqlStatement) -> dict[str, Any]:
    try:
        bad = connection.execute(check.sql).to_arrow_table()
    except duckdb.Error as error:
        raise StoreError(f"the check {check.name} of sql/checks cannot be run: {error}; correct the file") from error
    return {
        "table_name": check.table,
        "expectation": f"sql:{check.name}",
        "column_name": "",
        "passed": len(bad) == 0,
        "unexpected": len(bad),
        "detail": json.dumps({"expected": check.meaning, "found": bad.slice(0, EXAMPLES).to_pylist()}, default=str),
    }
