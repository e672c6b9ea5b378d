"""Severity by rule packs: a pack is an SQL file with one SELECT over ``defects``, which returns defect_id and severity.

Every pack has its own severities (UNSAFE, SWARMP and SAFE in FISP), listed in its header ``-- severities:``, worst
first. A changed pack is a new file with the next version.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc

from facadelake.core.checkout import locate_source
from facadelake.core.duckdb_engine import Connection, SqlError, open_duckdb
from facadelake.core.errors import InputDataError, SchemaError, suggest_name
from facadelake.core.sql_files import read_statement_file
from facadelake.core.sql_guard import require_plain_select
from facadelake.severity.description import GRADED_BY_RULES
from schemas.tables import TABLES

RULE_FOLDER = locate_source("data/severity")
GRADE_COLUMNS = ("severity", "severity_rule", "graded_by", "severity_low", "severity_high")
_RANGE_SIGMAS = 2.0  # of the crack width, to either side, within which the severity may be another one
_SEVERITIES = re.compile(r"^-- severities: (.+)$", re.MULTILINE)
_NAME = re.compile(r"[a-z][a-z0-9_]*_v[0-9]+")


def list_rule_packs(folder: Path = RULE_FOLDER) -> tuple[str, ...]:
    """Names of the rule packs in ``folder``, sorted."""
    return tuple(sorted(found.stem for found in folder.glob("*_v*.sql")))


def find_rule_file(name: str, folder: Path = RULE_FOLDER) -> Path:
    """The file of rule pack ``name``, such as ``extent_v1``.

    Raises InputDataError, with the names of the packs that exist.
    """
    path = folder / f"{name}.sql"
    if not _NAME.fullmatch(name) or not path.is_file():
        available = ", ".join(list_rule_packs(folder)) or "none"
        raise InputDataError(
            f"there is no severity rule pack {name} in {folder}{suggest_name(name, list_rule_packs(folder))}; "
            f"available: {available}"
        )
    return path


@dataclass(frozen=True, kw_only=True)
class RulePack:
    """What the header of a rule pack says: ``severities`` worst first, ``basis`` the lines of its limits and sources.

    An indented line of ``basis`` is one item of a list.
    """

    name: str
    meaning: str
    severities: tuple[str, ...]
    basis: tuple[str, ...]


def read_rule_pack(name: str, folder: Path = RULE_FOLDER) -> RulePack:
    """The header of rule pack ``name``. Raises InputDataError where there is no such pack."""
    path = find_rule_file(name, folder)
    text = path.read_text("utf-8")
    (statement,) = read_statement_file(path)
    comments = [line.removeprefix("--").removeprefix(" ") for line in text.splitlines() if line.startswith("--")]
    basis = tuple(line for line in comments if line and not re.match(r"(grain|meaning|severities): ", line))
    return RulePack(
        name=name, meaning=statement.meaning, severities=tuple(_parse_severities(text, path.name)), basis=basis
    )


def grade_defects(defects: pa.Table, rule_file: Path) -> pa.Table:
    """The defects with the grade columns: ``severity``, ``severity_rule`` (the file's name), ``graded_by`` and a range.

    ``severity_low`` and ``severity_high`` are the least and the most severe grade that the rule gives for the crack
    width and for that width less and more two sigmas. The grade columns may be absent or filled before; the rule does
    not see them. The other columns keep their order.

    Raises InputDataError for a rule that is not a plain SELECT over ``defects``; SchemaError where it leaves a defect
    without a severity, grades one twice or one that does not exist, or returns a severity that its header does not
    list.
    """
    try:
        rule = rule_file.read_text("utf-8")
    except OSError as error:
        raise InputDataError(f"the severity rule {rule_file} cannot be read: {error}") from error
    severities = _parse_severities(rule, rule_file.name)
    ungraded = defects.drop_columns([name for name in GRADE_COLUMNS if name in defects.column_names])
    name = rule_file.stem
    with closing(open_duckdb()) as connection:
        require_plain_select(connection, rule, frozenset({"defects"}))
        connection.execute("SET enable_external_access = false")
        try:
            grades = [
                _grade(connection, rule, _shift_crack_widths(ungraded, sigmas))
                for sigmas in (0.0, -_RANGE_SIGMAS, _RANGE_SIGMAS)
            ]
        except SqlError as error:
            raise InputDataError(f"the severity rule {rule_file.name} cannot be run: {error}") from error
    ids = defects.column("defect_id").to_pylist()
    of_width, *others = [_list_severities(ids, graded, name, severities) for graded in grades]
    ranks = [[severities.index(word) for word in words] for words in zip(of_width, *others, strict=True)]
    return _fill_columns(
        defects,
        {
            "severity": of_width,
            "severity_rule": [name] * len(ids),
            "graded_by": [GRADED_BY_RULES] * len(ids),
            "severity_low": [severities[max(rank)] for rank in ranks],
            "severity_high": [severities[min(rank)] for rank in ranks],
        },
    )


def _grade(connection: Connection, rule: str, ungraded: pa.Table) -> pa.Table:
    """What the rule returns for the defects: defect_id and severity."""
    connection.register("defects", ungraded)
    query = f"SELECT defect_id, severity FROM ({rule.rstrip().rstrip(';')}\n)"
    return connection.execute(query).to_arrow_table()


def _shift_crack_widths(defects: pa.Table, sigmas: float) -> pa.Table:
    """The defects with crack widths that are ``sigmas`` times their sigma wider, but not below 0."""
    if "crack_width_sigma_mm" not in defects.column_names:
        return defects
    shift = pc.multiply(pc.fill_null(defects.column("crack_width_sigma_mm"), 0.0), sigmas)
    for name in ("crack_width_mm", "crack_width_max_mm"):
        if name in defects.column_names:
            width = pc.add(defects.column(name), shift)
            shifted = pc.if_else(pc.less(width, 0.0), 0.0, width)
            defects = defects.set_column(defects.column_names.index(name), defects.schema.field(name), shifted)
    return defects


def _parse_severities(rule: str, name: str) -> list[str]:
    """The severities in the header of the rule ``name``, worst first."""
    header = _SEVERITIES.search(rule)
    if header is None:
        raise InputDataError(
            f"the severity rule {name} has no header '-- severities: worst, ..., least'; add that line"
        )
    return [severity.strip() for severity in header[1].split(",")]


def _list_severities(defect_ids: list[str], graded: pa.Table, rule: str, severities: list[str]) -> list[str]:
    """The severities in the order of ``defect_ids``.

    Args:
        defect_ids: the defects.
        graded: defect_id and severity, as the rule returned them.
        rule: name of the rule pack.
        severities: its severities.

    Raises:
        SchemaError: where the grades do not cover the defects exactly once, or are not of the listed severities.
    """
    ids = graded.column("defect_id").to_pylist()
    severity_by_id = dict(zip(ids, graded.column("severity").to_pylist(), strict=True))
    faults = {
        "defects without a severity": [one for one in defect_ids if severity_by_id.get(one) is None],
        "defects graded twice": sorted({one for one in ids if ids.count(one) > 1})
        if len(ids) > len(severity_by_id)
        else [],
        "defects that do not exist": sorted(severity_by_id.keys() - set(defect_ids)),
        f"severities that are not one of {', '.join(severities)}": sorted(
            {
                str(severity)
                for severity in severity_by_id.values()
                if severity is not None and severity not in severities
            }
        ),
    }
    for fault, examples in faults.items():
        if examples:
            raise SchemaError(
                f"the severity rule {rule} returns {len(examples)} {fault}, such as {examples[0]!r}; "
                "correct it in a new version of the file"
            )
    return [severity_by_id[one] for one in defect_ids]


def _fill_columns(defects: pa.Table, columns: Mapping[str, list[str]]) -> pa.Table:
    """The defects with these columns of text, replaced in place or appended."""
    table = defects
    for name, values in columns.items():
        field = TABLES["defects"].arrow.field(name)
        if name in table.column_names:
            table = table.set_column(table.column_names.index(name), field, pa.array(values, pa.string()))
        else:
            table = table.append_column(field, pa.array(values, pa.string()))
    return table
