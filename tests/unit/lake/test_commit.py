"""A campaign is in the lake whole or not at all; full disks are in tests/counterexamples/test_lake.py."""

import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pyarrow as pa
import pytest
import shapely

from facadelake.core.errors import SchemaError, StoreError
from facadelake.lake import commit as commit_module
from facadelake.lake.commit import CommitResult, commit_campaign
from facadelake.lake.connect import hold_lock
from facadelake.lake.read import list_versions, read_table, read_tables
from schemas.tables import TABLES
from tests.unit.lake.small_campaign import BUILDING, CAMPAIGN, INPUTS, commit, in_process, lake_tables


@pytest.mark.usefixtures("first")
def test_every_table_comes_back_as_it_went_in(tmp_path: Path) -> None:
    tables = lake_tables()
    found = read_tables(tmp_path, list(TABLES))
    for name, table in tables.items():
        back = found[name]
        assert back.schema == table.schema, name
        key = [(column, "ascending") for column in TABLES[name].key]
        back, table = back.sort_by(key), table.sort_by(key)
        for column in table.column_names:
            if column in TABLES[name].geometry_columns:  # another flavour of WKB, the same shape
                came, went = (shapely.from_wkb(t[column].to_numpy(zero_copy_only=False)) for t in (back, table))
                assert (shapely.equals_exact(came, went) | (shapely.is_missing(came) & shapely.is_missing(went))).all()
            else:
                assert back[column].equals(table[column]), f"{name}.{column}"


def test_same_run_again_writes_nothing_and_names_the_version_it_has(tmp_path: Path, first: CommitResult) -> None:
    other = commit(tmp_path, campaign_id="2026-10")
    again = commit(tmp_path, run_id="run-2")
    assert first.changed
    assert other.version > first.version
    assert again == CommitResult(version=first.version, changed=False)
    assert read_table(tmp_path, "runs", campaign_id=CAMPAIGN)["run_id"].to_pylist() == ["run-1"]


def test_changed_inputs_replace_the_campaign_and_the_old_version_stays_readable(
    tmp_path: Path, first: CommitResult
) -> None:
    commit(tmp_path, campaign_id="2026-10", defects=1)
    second = commit(tmp_path, run_id="run-2", inputs="j" * 64, defects=5)
    assert second.version > first.version
    assert len(read_table(tmp_path, "defects", campaign_id=CAMPAIGN)) == 5
    assert len(read_table(tmp_path, "defects", campaign_id="2026-10")) == 1
    assert len(read_table(tmp_path, "defects", campaign_id=CAMPAIGN, as_of=first.version)) == 3
    listed = list_versions(tmp_path).to_pylist()
    assert [(v["campaign_id"], v["run_id"]) for v in listed] == [
        (CAMPAIGN, "run-1"),
        ("2026-10", "run-1"),
        (CAMPAIGN, "run-2"),
    ]
    assert listed[-1]["version"] == second.version


def test_failure_half_way_leaves_the_version_before(
    tmp_path: Path, first: CommitResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    insert = commit_module.insert

    def failing(connection, kind, table):
        if kind.name == "observations":
            raise OSError(28, "No space left on device")
        insert(connection, kind, table)

    monkeypatch.setattr(commit_module, "insert", failing)
    with pytest.raises(
        StoreError, match=r"committing tower 2026-04 .* No space left .* nothing of this run was written"
    ):
        commit(tmp_path, run_id="run-2", inputs="j" * 64, defects=9)
    monkeypatch.undo()
    assert list_versions(tmp_path)["version"].to_pylist() == [first.version]
    assert read_table(tmp_path, "runs")["run_id"].to_pylist() == ["run-1"]
    assert len(read_table(tmp_path, "defects")) == 3
    assert commit(tmp_path, run_id="run-2", inputs="j" * 64, defects=9).changed


@pytest.mark.parametrize("stop_at", ["poses", "checks"])
def test_killed_commit_leaves_the_version_before_and_blocks_nobody(
    tmp_path: Path, first: CommitResult, stop_at: str
) -> None:
    code = f"""
        import time
        insert = commit_module.insert
        def slow(connection, kind, table):
            insert(connection, kind, table)
            if kind.name == {stop_at!r}:
                print("half-way", flush=True); time.sleep(60)
        commit_module.insert = slow
        commit(Path({str(tmp_path)!r}), run_id="run-2", inputs="j" * 64, defects=9)
    """
    with subprocess.Popen(in_process(code), stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        assert child.stdout.readline() == "half-way\n"
        child.send_signal(signal.SIGKILL)
    assert child.returncode == -signal.SIGKILL
    assert len(read_table(tmp_path, "defects")) == 3
    assert list_versions(tmp_path)["version"].to_pylist() == [first.version]
    began = time.monotonic()
    assert commit(tmp_path, run_id="run-3", inputs="j" * 64, defects=9).changed
    assert time.monotonic() - began < 20  # s: the dead process's lock is not waited for
    assert len(read_table(tmp_path, "defects")) == 9


@pytest.mark.usefixtures("first")
def test_kill_inside_the_catalogs_own_write_is_undone_on_reading(tmp_path: Path) -> None:
    """SQLite leaves a hot journal when its writer dies between pages; a read-only opening must cope with it."""
    code = f"""
        import os, sqlite3
        catalog = sqlite3.connect({str(tmp_path / "catalog.sqlite")!r}, isolation_level=None)
        catalog.execute("PRAGMA cache_size = 1"); catalog.execute("PRAGMA cache_spill = 1")
        catalog.execute("BEGIN IMMEDIATE")
        catalog.execute("DELETE FROM ducklake_data_file")
        catalog.execute("CREATE TABLE filler AS WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n "
                        "WHERE i < 5000) SELECT i, hex(randomblob(200)) AS x FROM n")
        os._exit(9)
    """
    subprocess.run([sys.executable, "-c", textwrap.dedent(code)], check=False)
    assert (tmp_path / "catalog.sqlite-journal").exists()
    assert len(read_table(tmp_path, "defects")) == 3


@pytest.mark.usefixtures("first")
def test_two_committers_and_a_reader_at_once(tmp_path: Path) -> None:
    code = """
        for k in range(2):
            done = commit(Path({lake!r}), campaign_id="c{n}", run_id=f"run-{n}-{{k}}", inputs=f"{{k}}" * 64)
            assert done.changed
    """
    children = [
        subprocess.Popen(in_process(code.format(lake=str(tmp_path), n=n)), stderr=subprocess.PIPE, text=True)
        for n in range(2)
    ]
    while any(child.poll() is None for child in children):
        assert len(read_table(tmp_path, "defects", campaign_id=CAMPAIGN)) == 3
        time.sleep(0.3)  # s
    for child in children:
        assert child.returncode == 0, child.communicate()[1]
    assert list_versions(tmp_path)["campaign_id"].to_pylist().count("c0") == 2
    assert sorted(read_table(tmp_path, "runs")["run_id"].to_pylist()) == ["run-0-1", "run-1", "run-1-1"]


def test_waiting_for_another_writer_ends_with_a_message(tmp_path: Path) -> None:
    with hold_lock(tmp_path):
        code = f"""
            from facadelake.lake.connect import hold_lock
            from facadelake.core.errors import StoreError
            try:
                with hold_lock(Path({str(tmp_path)!r}), timeout_s=0.2):
                    print("got it")
            except StoreError as error:
                print(error)
        """
        done = subprocess.run(in_process(code), capture_output=True, text=True, check=True)
    assert "being written by another process and stayed locked for 0.2 s; wait until" in done.stdout


def test_tables_that_do_not_fit_are_refused_before_the_lake_is_touched(tmp_path: Path) -> None:
    tables = dict(lake_tables())
    keys = {"building_id": BUILDING, "campaign_id": CAMPAIGN, "run_id": "run-1", "inputs_sha256": INPUTS}
    with pytest.raises(SchemaError, match=r"missing \['defects'\]"):
        commit_campaign(tmp_path, tables={k: v for k, v in tables.items() if k != "defects"}, **keys)
    with pytest.raises(SchemaError, match=r"rows with run_id \['run-1'\]; this run's is run-9"):
        commit_campaign(tmp_path, tables=tables, **{**keys, "run_id": "run-9"})
    with pytest.raises(SchemaError, match="one row, of the inputs"):
        commit_campaign(tmp_path, tables=tables, **{**keys, "inputs_sha256": "z" * 64})
    with pytest.raises(SchemaError, match="table photos has the columns"):
        commit_campaign(tmp_path, tables={**tables, "photos": pa.table({"a": [1]})}, **keys)
    assert list(tmp_path.iterdir()) == []
