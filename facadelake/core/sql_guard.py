"""Restrict questions to one SELECT over the tables and views of the lake, without access to files.

The attachment is read-only and DuckDB's external access is off, but several table functions (``sqlite_scan``,
``ST_Read``, ``ducklake_cleanup_old_files``) bypass both. Therefore the parsed statement is checked, too.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import duckdb

from facadelake.core.duckdb_engine import quote_sql_string
from facadelake.core.errors import InputDataError

# Table functions that compute rows from their arguments alone.
ALLOWED_FUNCTIONS = frozenset({"range", "generate_series", "unnest"})


def require_plain_select(connection: duckdb.DuckDBPyConnection, sql: str, tables: frozenset[str]) -> None:
    """Raise InputDataError unless ``sql`` is one SELECT over ``tables`` (lower-case names), by DuckDB's parser."""
    row = connection.execute(f"SELECT json_serialize_sql({quote_sql_string(sql)}::VARCHAR)").fetchone()
    parsed: dict[str, Any] = json.loads(row[0]) if row else {}
    if parsed.get("error", True):
        message = str(parsed.get("error_message", "it cannot be parsed"))
        if parsed.get("error_type") == "not implemented":
            message = "it is not a SELECT"
        raise InputDataError(f"only a SELECT is allowed; this statement was refused ({message}): {_shorten(sql)}")
    if len(parsed["statements"]) != 1:
        raise InputDataError(f"only one statement is allowed; there are {len(parsed['statements'])}: {_shorten(sql)}")
    nodes = list(_walk_objects(parsed))
    known = tables | {
        str(entry["key"]).lower() for node in nodes for entry in _read_cte_entries(node.get("cte_map"))
    }  # names given by WITH
    for node in nodes:
        _check_node(node, known)


def _check_node(node: dict[str, Any], known: frozenset[str]) -> None:
    if node.get("type") == "TABLE_FUNCTION":
        name = str(node["function"].get("function_name", "")).lower()
        if name not in ALLOWED_FUNCTIONS:
            raise InputDataError(
                f"the table function {name} is not allowed; select from the tables and views of the lake"
            )
    if node.get("type") in ("BASE_TABLE", "SHOW_REF") and node.get("table_name"):
        catalog, schema = str(node.get("catalog_name", "")), str(node.get("schema_name", ""))
        name = str(node["table_name"]).strip('"').lower()
        in_lake = catalog.lower() in ("", "lake") and schema.lower() in ("", "main", "lake")
        if node["type"] == "SHOW_REF" and name in ("__show_tables_expanded", "tables", "databases"):
            return
        if not in_lake or name not in known:
            full = ".".join(part for part in (catalog, schema, str(node["table_name"])) if part)
            raise InputDataError(f"the lake has no table {full}; its tables are {', '.join(sorted(known))}")


def _walk_objects(value: Any) -> Iterator[dict[str, Any]]:
    if isinstance(value, dict):
        yield value
        for part in value.values():
            yield from _walk_objects(part)
    elif isinstance(value, list):
        for part in value:
            yield from _walk_objects(part)


def _read_cte_entries(cte_map: Any) -> list[dict[str, Any]]:
    return cte_map["map"] if isinstance(cte_map, dict) else []


def _shorten(sql: str) -> str:
    text = " ".join(sql.split())
    return text if len(text) <= 120 else text[:117] + "..."
