"""Severity by rule packs: one SELECT a file over ``defects``, giving defect_id and severity; versions are new files.

Every scheme has its own words (FISP's UNSAFE, SWARMP, SAFE): the header's ``-- severities:`` lists them, worst first.
"""

from __future__ import annotations

import re
from contextlib import closing
from pathlib import Path

import pyarrow as pa

from facadelake.core.checkout import locate_source
from facadelake.core.duckdb_engine import SqlError, open_duckdb
from facadelake.core.errors import InputDataError, SchemaError
from facadelake.core.sql_guard import require_plain_select
from schemas.tables import TABLES

RULES = locate_source("data/severity")
GRADES = ("severity", "severity_rule", "graded_by")
BY_RULES = "rules"  # graded_by: a proposal; a person's grade has the person's name
_SEVERITIES = re.compile(r"^-- severities: (.+)$", re.MULTILINE)
_NAME = re.compile(r"[a-z][a-z0-9_]*_v[0-9]+")


def list_rule_packs(folder: Path = RULES) -> tuple[str, ...]:
    """The names of the rule packs that there are, in order."""
    return tuple(sorted(found.stem for found in folder.glob("*_v*.sql")))


def find_rule_file(name: str, folder: Path = RULES) -> Path:
    """The file of rule pack ``name`` such as ``extent_v1``. Raises InputDataError, naming those there are."""
    path = folder / f"{name}.sql"
    if not _NAME.fullmatch(name) or not path.is_file():
        there = ", ".join(list_rule_packs(folder)) or "none"
        raise InputDataError(f"there is no severity rule pack {name} in {folder}; there are {there}")
    return path


def grade_defects(defects: pa.Table, rule_file: Path) -> pa.Table:
    """The defects with ``severity``, ``severity_rule`` (the file's name) and ``graded_by`` filled by the rule pack.

    These columns may be absent or hold anything before, which the rule does not see; the others keep their order.
    Raises InputDataError for a rule that is no plain SELECT over ``defects``; SchemaError where it leaves a defect
    without a severity, grades one twice or one that does not exist, or gives a word that is none of its severities.
    """
    try:
        rule = rule_file.read_text("utf-8")
    except OSError as error:
        raise InputDataError(f"the severity rule {rule_file} cannot be read: {error}") from error
    words = _parse_severities(rule, rule_file.name)
    given = defects.drop_columns([name for name in GRADES if name in defects.column_names])
    with closing(open_duckdb()) as connection:
        require_plain_select(connection, rule, frozenset({"defects"}))
        connection.register("defects", given)
        connection.execute("SET enable_external_access = false")
        try:
            graded = connection.execute(
                f"SELECT defect_id, severity FROM ({rule.rstrip().rstrip(';')}\n)"
            ).to_arrow_table()
        except SqlError as error:
            raise InputDataError(f"the severity rule {rule_file.name} cannot be run: {error}") from error
    return _fill_grades(defects, graded, rule_file.stem, words)


def severities(rule_file: Path) -> tuple[str, ...]:
    """The words of a rule pack, worst first. Raises InputDataError where its header does not list them."""
    return tuple(_parse_severities(rule_file.read_text("utf-8"), rule_file.name))


def _parse_severities(rule: str, name: str) -> list[str]:
    found = _SEVERITIES.search(rule)
    if found is None:
        raise InputDataError(f"the severity rule {name} does not say '-- severities: worst, ..., least'; add that line")
    return [word.strip() for word in found[1].split(",")]


def _fill_grades(defects: pa.Table, graded: pa.Table, rule: str, words: list[str]) -> pa.Table:
    ids = graded.column("defect_id").to_pylist()
    words_of = dict(zip(ids, graded.column("severity").to_pylist(), strict=True))
    wanted = defects.column("defect_id").to_pylist()
    faults = {
        "defects without a severity": [one for one in wanted if words_of.get(one) is None],
        "defects graded twice": sorted({one for one in ids if ids.count(one) > 1}) if len(ids) > len(words_of) else [],
        "defects that do not exist": sorted(words_of.keys() - set(wanted)),
        f"severities that are none of {', '.join(words)}": sorted(
            {str(word) for word in words_of.values() if word is not None and word not in words}
        ),
    }
    for fault, examples in faults.items():
        if examples:
            raise SchemaError(
                f"the severity rule {rule} gives {len(examples)} {fault}, such as {examples[0]!r}; "
                "correct it in a new version of the file"
            )
    columns = {
        "severity": [words_of[one] for one in wanted],
        "severity_rule": [rule] * len(wanted),
        "graded_by": [BY_RULES] * len(wanted),
    }
    table = defects
    for name, values in columns.items():
        field = TABLES["defects"].arrow.field(name)
        if name in table.column_names:
            table = table.set_column(table.column_names.index(name), field, pa.array(values, pa.string()))
        else:
            table = table.append_column(field, pa.array(values, pa.string()))
    return table
