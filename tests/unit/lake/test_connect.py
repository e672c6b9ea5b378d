"""Opening a lake: offline, movable, and with messages where it cannot be."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from facadelake.core.duckdb_engine import open_duckdb
from facadelake.core.errors import SchemaError, StoreError
from facadelake.lake.commit import CommitResult
from facadelake.lake.connect import hold_lock, open_catalog_to_write
from facadelake.lake.migrate import get_schema_version, migrate, read_migrations
from facadelake.lake.read import list_versions, read_table
from schemas.tables import LAKE_TABLES, SCHEMA_VERSION
from tests.unit.lake.small_campaign import REPOSITORY, commit, in_process


def test_needs_no_network_and_nothing_in_the_home_folder(tmp_path: Path) -> None:
    home = tmp_path / "home"
    home.mkdir()
    code = f"""
        from facadelake.lake.read import read_table
        commit(Path({str(tmp_path / "lake")!r}))
        print(len(read_table(Path({str(tmp_path / "lake")!r}), "defects")))
    """
    command = in_process(code)
    if shutil.which("unshare") and subprocess.run(["unshare", "-n", "true"], check=False).returncode == 0:
        command = ["unshare", "-n", *command]  # a network namespace with no interface at all
    environment = {"HOME": str(home), "PATH": os.environ["PATH"]}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert done.stdout == "3\n"
    assert done.stderr == ""
    assert not (home / ".duckdb").exists()


def test_lake_may_be_moved_and_then_written(tmp_path: Path, template: tuple[Path, CommitResult]) -> None:
    old, new = tmp_path / "old", tmp_path / "it's new"
    folder, first = template
    shutil.copytree(folder, old)
    old.rename(new)
    assert len(read_table(new, "defects")) == 3
    commit(new, run_id="run-2", inputs="j" * 64, defects=4)
    assert len(read_table(new, "defects")) == 4
    assert len(read_table(new, "defects", as_of=first.version)) == 3


def test_folder_without_a_lake(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match=r"there is no lake in .*; inspect a campaign first, or name another lake"):
        list_versions(tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("first")
def test_unknown_version_and_table(tmp_path: Path) -> None:
    for version in (-1, 0, 99):  # 0: DuckLake's own beginning, without tables
        with pytest.raises(StoreError, match=rf"no version {version}; it has \d+ to \d+ \('facadelake sql"):
            read_table(tmp_path, "defects", as_of=version)
    with pytest.raises(SchemaError, match="there is no table defetcs; the tables are buildings, "):
        read_table(tmp_path, "defetcs")


def test_catalog_that_is_no_catalog(tmp_path: Path) -> None:
    (tmp_path / "catalog.sqlite").write_bytes(b"not a database " * 400)
    with pytest.raises(StoreError, match=r"is damaged: its catalog\.sqlite cannot be read \(file is not a database"):
        read_table(tmp_path, "defects")


def test_failing_migration_leaves_the_version_before(tmp_path: Path) -> None:
    steps = tmp_path / "steps"
    steps.mkdir()
    for path in (REPOSITORY / "sql" / "migrations").glob("*.sql"):
        shutil.copy(path, steps)
    bad = steps / f"{SCHEMA_VERSION + 1:04d}_bad.sql"
    bad.write_text("CREATE TABLE extra (a BIGINT); ALTER TABLE defects ADD COLUMN nonsense NO_SUCH_TYPE;")
    lake = tmp_path / "lake"
    lake.mkdir()
    with hold_lock(lake), open_catalog_to_write(lake) as connection:
        with pytest.raises(StoreError, match=r"migration \d+_bad of the lake failed"):
            migrate(connection, lake, steps)
        assert get_schema_version(connection) == SCHEMA_VERSION
        tables = {row[0] for row in connection.execute("SELECT table_name FROM duckdb_tables()").fetchall()}
    assert "defects" in tables
    assert "extra" not in tables


def test_gap_in_the_migrations(tmp_path: Path) -> None:
    (tmp_path / "0002_late.sql").write_text("SELECT 1;")
    with pytest.raises(StoreError, match=r"numbered \[2\]; they must run 1, 2, 3 without a gap"):
        read_migrations(tmp_path)


def test_migrated_lake_has_the_tables_of_the_schemas(tmp_path: Path) -> None:
    assert len(read_migrations()) == SCHEMA_VERSION
    query = (
        "SELECT table_name, column_name, data_type, is_nullable FROM duckdb_columns() "
        "WHERE database_name = ? AND table_name != 'migrations' ORDER BY table_name, column_index"
    )
    with hold_lock(tmp_path), open_catalog_to_write(tmp_path) as connection:
        migrate(connection, tmp_path)
        made = connection.execute(query, ["lake"]).fetchall()
    plain = open_duckdb()
    for table in LAKE_TABLES.values():
        columns = [f"{c.name} {c.kind.sql}{'' if c.name in table.optional else ' NOT NULL'}" for c in table.columns]
        plain.execute(f"CREATE TABLE {table.name} ({', '.join(columns)})")
    assert made == plain.execute(query, ["memory"]).fetchall()
    assert len(made) == sum(len(table.columns) for table in LAKE_TABLES.values())
