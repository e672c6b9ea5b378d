"""Questions read, and can do nothing else."""

from collections.abc import Iterator
from pathlib import Path

import duckdb
import pytest

from facadelake.core.duckdb_engine import find_extension_file
from facadelake.core.errors import InputDataError, StoreError
from facadelake.core.sql_files import read_statement_file
from facadelake.core.sql_guard import require_plain_select
from facadelake.lake.questions import answer_question
from facadelake.lake.read import open_sealed, query
from schemas.tables import TABLES
from tests.unit.lake.small_campaign import CAMPAIGN, commit


@pytest.fixture(scope="module")
def lake(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("lake")
    commit(folder, defects=4, sightings=2)
    commit(folder, campaign_id="2026-10", defects=1, sightings=1)
    (folder / "secret.csv").write_text("a,b\n1,2\n")
    return folder


def test_select_with_parameters_spatial_functions_and_views(lake: Path) -> None:
    rows = query(
        lake,
        "WITH far AS (SELECT *, ST_X(ST_Centroid(geometry)) AS lon FROM defects WHERE campaign_id = $c) "
        "SELECT lon, lon_deg, geometry, i FROM far, range(1) AS r(i) WHERE z_site_m > $z",
        {"c": CAMPAIGN, "z": 3.1},
    )
    assert rows["lon"].to_pylist() == rows["lon_deg"].to_pylist()
    assert len(rows) == 3
    assert rows.schema.field("geometry").metadata is None
    assert query(lake, "SELECT count(*) AS n FROM defect_observations")["n"].to_pylist() == [9]
    assert "defects" in query(lake, "SHOW TABLES")["name"].to_pylist()
    assert "defect_id" in query(lake, "DESCRIBE defects")["column_name"].to_pylist()
    assert query(lake, "SELECT max(n) AS n FROM (SELECT count(*) AS n FROM lake.main.defects)")["n"].to_pylist() == [5]


@pytest.fixture(scope="module")
def connection(lake: Path) -> Iterator[duckdb.DuckDBPyConnection]:
    with open_sealed(lake, None) as opened:
        yield opened


@pytest.mark.parametrize(
    "sql",
    [
        "DELETE FROM defects",
        "INSERT INTO defects SELECT * FROM defects",
        "DROP TABLE defects",
        "CREATE TABLE x (a INT)",
        "CREATE TEMP TABLE x (a INT)",
        "ATTACH '{lake}/other.db'",
        "ATTACH 'ducklake:sqlite:{lake}/catalog.sqlite' AS again",
        "COPY defects TO '{lake}/out.parquet'",
        "COPY (SELECT 1) TO '{lake}/tables/out.csv'",
        "EXPORT DATABASE '{lake}/out'",
        "INSTALL httpfs",
        "LOAD '{spatial}'",
        "SET enable_external_access = true",
        "RESET lock_configuration",
        "PRAGMA database_list",
        "CALL ducklake_cleanup_old_files('lake', cleanup_all => true)",
        "USE memory",
        "SELECT 1; DELETE FROM defects",
        "SELECT 1; SELECT 2",
        "SELECT * FROM read_csv('{lake}/secret.csv')",
        "SELECT * FROM '{lake}/secret.csv'",
        "SELECT * FROM read_parquet('{lake}/tables/**/*.parquet')",
        "SELECT * FROM read_text('/etc/hostname')",
        "SELECT * FROM glob('/etc/*')",
        "SELECT * FROM ST_Read('{lake}/secret.csv')",
        "SELECT * FROM sqlite_scan('{lake}/catalog.sqlite', 'ducklake_snapshot')",
        "SELECT * FROM __ducklake_metadata_lake.main.ducklake_snapshot",
        "SELECT * FROM ducklake_cleanup_old_files('lake', cleanup_all => true)",
        "SELECT * FROM query('SELECT * FROM read_csv(''{lake}/secret.csv'')')",
        "SELECT (SELECT max(a) FROM read_csv('{lake}/secret.csv')) AS a FROM defects",
        "WITH x AS (SELECT * FROM read_csv('{lake}/secret.csv')) SELECT * FROM x",
        "SELECT * FROM duckdb_secrets()",
        "SUMMARIZE '{lake}/secret.csv'",
        "DESCRIBE '{lake}/secret.csv'",
        "DESCRIBE SELECT * FROM read_csv('{lake}/secret.csv')",
        "",
    ],
)
def test_anything_else_is_refused_by_the_guard(lake: Path, connection: duckdb.DuckDBPyConnection, sql: str) -> None:
    text = sql.format(lake=lake, spatial=find_extension_file("spatial"))
    with pytest.raises(InputDataError) as refusal:
        require_plain_select(connection, text, frozenset(TABLES))
    assert any(
        words in str(refusal.value)
        for words in (
            "only a SELECT is allowed",
            "only one statement is allowed",
            "is not allowed",
            "the lake has no table",
        )
    ), refusal.value


@pytest.mark.parametrize(
    "sql",
    [
        "DELETE FROM defects",
        "CREATE TABLE x (a INT)",
        "ATTACH '{lake}/other.db'",
        "COPY defects TO '{lake}/out.parquet'",
        "SELECT * FROM read_csv('{lake}/secret.csv')",
        "SET enable_external_access = true",
        "CALL ducklake_expire_snapshots('lake', older_than => now())",
    ],
)
def test_connection_itself_refuses_without_the_guard(
    lake: Path, connection: duckdb.DuckDBPyConnection, sql: str
) -> None:
    with pytest.raises(duckdb.Error):
        connection.execute(sql.format(lake=lake))


def test_query_asks_the_guard_and_leaves_the_lake_alone(lake: Path) -> None:
    before = {path: path.stat().st_mtime_ns for path in lake.rglob("*") if path.is_file()}
    for sql in ("DELETE FROM defects", "COPY (SELECT 1) TO 'x.csv'", "SELECT * FROM sqlite_scan('a', 'b')"):
        with pytest.raises(InputDataError):
            query(lake, sql)
    assert {path: path.stat().st_mtime_ns for path in lake.rglob("*") if path.is_file()} == before


def test_mistakes_are_named(lake: Path) -> None:
    with pytest.raises(
        InputDataError, match=r"no question defects_by_colour.*; there are campaign_outcome, campaigns, "
    ):
        answer_question(lake, "defects_by_colour")
    with pytest.raises(InputDataError, match="no parameter colour; it has building_id, campaign_id"):
        answer_question(lake, "defects_by_storey", {"colour": "red"})
    with pytest.raises(InputDataError, match=r'(?s)cannot be answered.*"colour"'):
        query(lake, "SELECT colour FROM defects")
    with pytest.raises(InputDataError, match="syntax error"):
        query(lake, "SELEKT 1")
    with pytest.raises(InputDataError, match="the lake has no table defetcs; its tables are buildings, "):
        query(lake, "SELECT * FROM defetcs")
    with pytest.raises(StoreError, match="has no version 99; it has "):
        query(lake, "SELECT 1", as_of=99)


@pytest.mark.usefixtures("first")
def test_data_file_gone_is_the_stores_error(tmp_path: Path) -> None:
    for file in (tmp_path / "tables" / "main" / "defects").iterdir():
        file.unlink()
    with pytest.raises(StoreError, match=r"is damaged: .*The way back: "):
        query(tmp_path, "SELECT * FROM defects")


def test_statement_without_a_header(tmp_path: Path) -> None:
    (tmp_path / "x.sql").write_text("-- grain: row\nSELECT 1")
    with pytest.raises(StoreError, match=r"the header of x.sql lacks meaning"):
        read_statement_file(tmp_path / "x.sql")


def test_a_parameter_of_another_type_is_named_without_sql(lake: Path) -> None:
    with pytest.raises(InputDataError) as raised:
        answer_question(lake, "worst_defects", {"limit": "x"})
    assert str(raised.value) == (
        "the question cannot be answered with limit=x: Could not convert string 'x' to INT64; give a value of that type"
    )
