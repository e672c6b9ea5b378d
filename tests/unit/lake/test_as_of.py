"""A version of the lake by its number or by a time."""

from __future__ import annotations

import inspect
import sqlite3
from contextlib import closing
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from typer.testing import CliRunner

from cli.main import app
from facadelake.core.errors import InputDataError, StoreError
from facadelake.lake.as_of import resolve_version
from facadelake.lake.connect import CATALOG
from facadelake.lake.read import list_versions, read_table, read_tables
from tests.unit.lake.small_campaign import BUILDING, commit

DAY = datetime(2026, 5, 4, tzinfo=UTC)


def set_times(lake: Path, times: dict[int, datetime]) -> None:
    with closing(sqlite3.connect(lake / CATALOG)) as catalog:
        for version, time in times.items():
            catalog.execute(
                "UPDATE ducklake_snapshot SET snapshot_time = ? WHERE snapshot_id = ?", (time.isoformat(" "), version)
            )
        catalog.commit()


@pytest.fixture(scope="module")
def lake(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, int, int]:
    """Two versions: of 4 May 2026, 12:00, and of the last second of 5 May, UTC."""
    folder = tmp_path_factory.mktemp("lake")
    first, second = (commit(folder, campaign_id=name, defects=1).version for name in ("2026-04", "2026-10"))
    set_times(folder, {first: DAY + timedelta(hours=12), second: DAY + timedelta(days=2, seconds=-1)})
    assert [row["committed_at"].day for row in list_versions(folder).to_pylist()] == [4, 5]
    return folder, first, second


@pytest.mark.parametrize(
    ("text", "which"),
    [
        ("2026-05-04", 0),  # a date means its end
        ("2026-05-05", 1),
        ("2027-01-01", 1),
        ("2026-05-04T12:00", 0),  # committed at that time
        ("2026-05-04 12:00:00", 0),
        ("2026-05-04T12:00Z", 0),
        ("2026-05-04T14:00+02:00", 0),
        ("2026-05-05T23:59:58", 0),
        ("2026-05-05T23:59:59", 1),
        ("2026-05-05T18:59:59-05:00", 1),
    ],
)
def test_a_time_is_the_last_version_committed_until_then(lake: tuple[Path, int, int], text: str, which: int) -> None:
    folder, *versions = lake
    assert resolve_version(folder, text) == versions[which]
    assert len(read_table(folder, "campaigns", as_of=versions[which])) == which + 1


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("2026-05-04T11:59:59", "had no version at 2026-05-04T11:59:59 (2026-05-04 11:59:59 UTC); its first is "),
        ("2026-05-03", "had no version at 2026-05-03 (2026-05-03 23:59:59 UTC); its first is "),
        ("2026-05-04T13:00+02:00", "had no version at 2026-05-04T13:00+02:00 (2026-05-04 11:00:00 UTC); its first is "),
    ],
)
def test_there_was_no_version_before_the_first(lake: tuple[Path, int, int], text: str, told: str) -> None:
    folder, first, _ = lake
    with pytest.raises(InputDataError) as raised:
        resolve_version(folder, text)
    assert str(raised.value) == f"the lake {folder} {told}{first}, of 2026-05-04 12:00:00 UTC"


@pytest.mark.parametrize("text", ["2026-04", "2026-W19", "2026-02-30", "20260504T12", "yesterday", "-1", "1.5", ""])
def test_what_is_neither_a_number_nor_a_time_is_refused(lake: tuple[Path, int, int], text: str) -> None:
    with pytest.raises(InputDataError) as raised:
        resolve_version(lake[0], text)
    assert str(raised.value) == (
        f"'{text}' is no version and no time; give a version such as 12, a date such as 2026-04-30 (its end, UTC), or "
        "a time such as 2026-04-30T14:30 (UTC) or 2026-04-30T14:30+02:00"
    )


def test_a_number_is_that_version(lake: tuple[Path, int, int]) -> None:
    assert resolve_version(lake[0], None) is None
    assert resolve_version(lake[0], "7") == resolve_version(lake[0], "v000007") == 7  # a release's folder


def test_a_clock_that_was_wrong_is_told(tmp_path: Path) -> None:
    first, second = (commit(tmp_path, campaign_id=name, defects=1).version for name in ("2026-04", "2026-10"))
    set_times(tmp_path, {first: DAY + timedelta(days=1), second: DAY})
    with pytest.raises(InputDataError) as raised:
        resolve_version(tmp_path, "2026-05-04")
    assert str(raised.value) == (
        f"which version the lake {tmp_path} had at 2026-05-04 cannot be said: version {first} is of "
        f"2026-05-05 00:00:00 UTC and the later version {second} of 2026-05-04 00:00:00 UTC, so a clock was wrong; "
        "give the version by its number"
    )
    assert resolve_version(tmp_path, "2026-05-05") == second


def test_without_a_lake(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="there is no lake in"):
        resolve_version(tmp_path, "2026-05-04")


# What writes the lake and adds to its newest state, or does not read its tables.
_NEWEST_ONLY = {
    "inspect", "demo", "regrade", "review import", "review track", "track", "cache list", "cache prune",
    "evaluate-detector", "describe-detector", "doctor", "promote-model", "up", "down", "status", "deploy",
    "systemd-unit", "intake receive", "inspect-portfolio",
}  # fmt: skip


def test_every_command_that_reads_the_lake_reads_earlier_versions() -> None:
    commands = [("", command) for command in app.registered_commands]
    for group in app.registered_groups:
        assert group.typer_instance is not None
        commands += [(f"{group.name} ", command) for command in group.typer_instance.registered_commands]
    without = set()
    for group_name, command in commands:
        assert command.callback is not None
        name = command.name or command.callback.__name__.replace("_", "-")
        if "as_of" not in inspect.signature(command.callback).parameters:
            without.add(group_name + name)
    assert without <= _NEWEST_ONLY
    assert len(commands) - len(without) >= 12


def test_commands_take_a_time(lake: tuple[Path, int, int]) -> None:
    folder, first, _ = lake
    run = CliRunner()
    where = ["--lake", str(folder), "--portfolio", str(folder / "none.yaml")]
    answer = run.invoke(app, ["sql", "SELECT count(*) AS n FROM campaigns", "--json", "--as-of", "2026-05-04", *where])
    assert '"n": 1' in answer.stdout
    told = run.invoke(app, ["defects", BUILDING, "2026-10", "--as-of", "2026-05-04", *where])
    assert isinstance(told.exception, InputDataError)
    assert f"has at version {first} no campaign '2026-10' of building 'tower'" in str(told.exception)


def test_columns_of_a_table_that_are_not_needed_are_left_out(tmp_path: Path) -> None:
    commit(tmp_path, defects=2)
    found = read_tables(tmp_path, ["defects", "observations"], columns={"observations": ("defect_id", "area_m2")})
    assert set(found["observations"].column_names) == {"defect_id", "area_m2"}
    whole = read_tables(tmp_path, ["defects", "observations"])
    assert found["defects"].equals(whole["defects"])
    assert found["observations"]["area_m2"].equals(whole["observations"]["area_m2"])
