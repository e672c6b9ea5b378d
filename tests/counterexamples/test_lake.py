"""Lakes that cannot be written or read: the version before stays whole, and the next run works."""

from __future__ import annotations

import os
import re
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from facadelake.core.errors import InputDataError, StoreError
from facadelake.lake.connect import hold_lock, open_catalog_to_write
from facadelake.lake.read import list_versions, query, read_table
from schemas.tables import SCHEMA_VERSION
from tests.counterexamples.command_line import facadelake
from tests.unit.lake.small_campaign import commit, in_process

NOTHING_WRITTEN = (
    "nothing of this run was written and the earlier versions are whole; "
    "check free space and rights of the lake's folder, then run again (the stages' results are cached)"
)


def assert_refused_on_a_full_disk(lake: Path, message: str) -> None:
    """What failed, which file, the system's own words, and the remedy."""
    doing, remedy = f"committing tower 2026-04 to the lake {lake} failed: ", f"; {NOTHING_WRITTEN}"
    assert message.startswith(doing), message
    assert message.endswith(remedy), message
    cause = message[len(doing) : -len(remedy)]
    assert re.search(r"(?i)could not write file|no space left|disk.*full|disk i/o error", cause), cause


def assert_as_before(lake: Path, version: int) -> None:
    assert list_versions(lake)["version"].to_pylist() == [version]
    assert read_table(lake, "runs")["run_id"].to_pylist() == ["run-1"]
    assert len(read_table(lake, "defects")) == 3


@pytest.mark.parametrize(("defects", "limit_bytes"), [(3000, 120_000), (4, 4096)])
def test_disk_full_at_commit_leaves_nothing_half_written(tmp_path: Path, defects: int, limit_bytes: int) -> None:
    """A real write error of the system: a limit on file size stops a large data file, or the small catalog."""
    first = commit(tmp_path)
    code = f"""
        from facadelake.core.errors import InputDataError, StoreError
        try:
            commit(Path({str(tmp_path)!r}), run_id="run-2", inputs="j" * 64, defects={defects}, sightings=1)
        except StoreError as error:
            print(error)
    """
    limit = f"import resource; resource.setrlimit(resource.RLIMIT_FSIZE, ({limit_bytes}, {limit_bytes}))"
    done = subprocess.run(in_process(code, head=limit), capture_output=True, text=True, check=True)
    assert_refused_on_a_full_disk(tmp_path, done.stdout.rstrip("\n"))
    assert_as_before(tmp_path, first.version)
    assert commit(tmp_path, run_id="run-2", inputs="j" * 64, defects=4).changed
    assert len(read_table(tmp_path, "defects")) == 4
    assert len(read_table(tmp_path, "defects", as_of=first.version)) == 3


def test_full_file_system_leaves_nothing_half_written(tmp_path: Path) -> None:
    """ENOSPC proper, on a file system of 4 MB."""
    disk = tmp_path / "disk"
    disk.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=4m", "tmpfs", str(disk)], capture_output=True, check=False
    )
    if mounted.returncode:
        pytest.skip("mounting a small file system needs root; the file size limit covers the same path")
    try:
        lake = disk / "lake"
        first = commit(lake)
        with (disk / "ballast").open("wb") as ballast:
            ballast.write(b"0" * (os.statvfs(disk).f_bavail * os.statvfs(disk).f_frsize - 150_000))
        with pytest.raises(StoreError) as raised:
            commit(lake, run_id="run-2", inputs="j" * 64, defects=3000, sightings=1)
        assert_refused_on_a_full_disk(lake, str(raised.value))
        assert_as_before(lake, first.version)
        (disk / "ballast").unlink()
        assert commit(lake, run_id="run-2", inputs="j" * 64, defects=4).changed
    finally:
        subprocess.run(["umount", str(disk)], check=True)


def test_lake_of_a_newer_facadelake_is_left_alone(tmp_path: Path) -> None:
    commit(tmp_path)
    with hold_lock(tmp_path), open_catalog_to_write(tmp_path) as connection:
        connection.execute("INSERT INTO migrations VALUES (?, 'from_the_future', now())", [SCHEMA_VERSION + 1])
    before = sorted(path for path in tmp_path.rglob("*") if path.suffix == ".parquet")
    message = (
        f"the lake has schema version {SCHEMA_VERSION + 1}, this Facadelake knows versions up to {SCHEMA_VERSION}; "
        "update Facadelake, or name another lake"
    )
    with pytest.raises(StoreError) as raised:
        commit(tmp_path, run_id="run-2", inputs="j" * 64)
    assert str(raised.value) == message
    with pytest.raises(StoreError) as raised:
        read_table(tmp_path, "defects")
    assert str(raised.value) == message
    done = facadelake("defects", "tower", "--lake", tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (1, "", f"StoreError: {message}\n")
    assert sorted(path for path in tmp_path.rglob("*") if path.suffix == ".parquet") == before


def test_no_lake_yet(tmp_path: Path) -> None:
    done = facadelake("defects", "castle", "--lake", tmp_path)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == (
        f"StoreError: there is no lake in {tmp_path} (no catalog.sqlite); "
        "inspect a campaign first, or name another lake\n"
    )
    assert list(tmp_path.iterdir()) == []


def cut_off(content: bytes) -> bytes:
    """The first half of a file."""
    return content[: len(content) // 2]


def overwrite(content: bytes) -> bytes:
    """A file of the same size with zeros in its first pages."""
    return content[:100] + bytes(200) + content[300:]


@pytest.mark.parametrize(
    ("damage", "problem"),
    [(cut_off, "it has … of … bytes"), (overwrite, "it cannot be read: …"), (None, "it does not exist")],
    ids=["cut off", "overwritten", "gone"],
)
def test_a_damaged_file_is_named_with_the_way_back(
    tmp_path: Path, damage: Callable[[bytes], bytes] | None, problem: str
) -> None:
    """DuckDB's "invalid footer length" blamed the question: it is a fault of the store."""
    first = commit(tmp_path)
    earlier = set((tmp_path / "tables" / "main" / "defects").glob("*.parquet"))
    second = commit(tmp_path, run_id="run-2", inputs="j" * 64, defects=4)
    (tmp_path / "published").mkdir()
    (newest,) = set((tmp_path / "tables" / "main" / "defects").glob("*.parquet")) - earlier
    content = newest.read_bytes()
    newest.unlink()
    if damage is not None:
        newest.write_bytes(damage(content))
    wanted = (
        f"the lake {tmp_path} is damaged: {newest} of table defects ({problem}; it holds tower 2026-04, in version "
        f"{second.version} and later). The way back: restore the file from a backup of the lake; version "
        f"{first.version} was made before it (--as-of); "
        f"{tmp_path}/published has the published files of each version; or inspect the campaign again into another "
        "lake (--lake)"
    )
    for read in (
        lambda: query(tmp_path, "SELECT defect_class, min(score) FROM defects GROUP BY ALL"),
        lambda: read_table(tmp_path, "defects"),
        # What is overwritten inside a file, and not read to replace its rows, does not hinder that.
        *([lambda: commit(tmp_path, run_id="run-3", inputs="k" * 64, defects=5)] if damage is not overwrite else []),
    ):
        with pytest.raises(StoreError) as raised:
            read()
        said = re.sub(r"it has [\d,]+ of [\d,]+ bytes", "it has … of … bytes", str(raised.value))
        assert re.sub("(it cannot be read: ).*(; it holds)", r"\1…\2", said) == wanted
    assert len(read_table(tmp_path, "defects", as_of=first.version)) == 3
    done = facadelake("sql", "SELECT * FROM defects", "--lake", tmp_path)
    assert done.returncode == 1 and f"{newest} of table defects" in done.stderr, done.stderr
    with pytest.raises(InputDataError, match="the question cannot be answered"):  # its own fault
        query(tmp_path, "SELECT no_such_column FROM photos")


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (None, "it has tables, but no catalog.sqlite"),
        (b"", "its catalog.sqlite cannot be read (no such table: ducklake_snapshot)"),
        (b"hello", "its catalog.sqlite cannot be read (file is not a database)"),
    ],
    ids=["gone", "empty", "a text"],
)
def test_a_lake_without_its_catalog_is_neither_taken_as_none_nor_begun_anew(
    tmp_path: Path, content: bytes | None, problem: str
) -> None:
    """Tables without a catalog were "no lake": an inspection would have begun another one over them."""
    commit(tmp_path)
    catalog = tmp_path / "catalog.sqlite"
    whole = catalog.read_bytes()
    catalog.unlink()
    if content is not None:
        catalog.write_bytes(content)
    wanted = (
        f"the lake {tmp_path} is damaged: {problem}. The way back: restore catalog.sqlite from a backup of the lake, "
        "of the same time as its tables; published/ has the published files of each version; or inspect the campaigns "
        "again into another lake (--lake)"
    )
    for attempt in (
        lambda: read_table(tmp_path, "defects"),
        lambda: commit(tmp_path, run_id="run-2", inputs="j" * 64),
    ):
        with pytest.raises(StoreError) as raised:
            attempt()
        assert str(raised.value) == wanted
    for command in (("campaigns",), ("defects", "tower"), ("sql", "versions")):
        done = facadelake(*command, "--lake", tmp_path)
        assert (done.returncode, done.stdout, done.stderr) == (1, "", f"StoreError: {wanted}\n")
    catalog.write_bytes(whole)
    assert len(read_table(tmp_path, "defects")) == 3


def test_a_catalog_cut_off_is_named(tmp_path: Path) -> None:
    commit(tmp_path)
    catalog = tmp_path / "catalog.sqlite"
    catalog.write_bytes(cut_off(catalog.read_bytes()))
    with pytest.raises(StoreError, match=r"is damaged: its catalog\.sqlite cannot be read \(.*malformed\)\. The way"):
        read_table(tmp_path, "defects")


def test_a_file_in_the_place_of_a_lake(tmp_path: Path) -> None:
    (tmp_path / "lake").write_text("no lake")
    for command in (("campaigns",), ("defects", "tower")):
        done = facadelake(*command, "--lake", tmp_path / "lake")
        assert (done.returncode, done.stdout) == (1, "")
        assert done.stderr == (
            f"StoreError: the lake {tmp_path}/lake is a file; a lake is a folder: name another with --lake\n"
        )
