"""``facadelake cache`` lists results and removes those that no version of the lake was made of."""

from __future__ import annotations

import json
import os
import time
from pathlib import Path

import pyarrow as pa
import pytest
from typer.testing import CliRunner

from cli.main import app
from facadelake.core.cache import MANIFEST, open_stage_cache
from facadelake.core.errors import InputDataError
from facadelake.lake import commit as commit_module
from facadelake.lake.recorded_stage_keys import read_stage_keys
from tests.unit.lake.small_campaign import BUILDING, CAMPAIGN, INPUTS, lake_tables


def commit_with_keys(lake: Path, keys: dict[str, str], *, run_id: str, inputs: str = INPUTS) -> None:
    tables = dict(lake_tables(run_id=run_id, inputs=inputs))
    runs = tables["runs"]
    at = runs.schema.get_field_index("stage_keys")
    tables["runs"] = runs.set_column(at, runs.schema.field(at), pa.array([json.dumps(keys)], pa.string()))
    commit_module.commit_campaign(
        lake, building_id=BUILDING, campaign_id=CAMPAIGN, run_id=run_id, tables=tables, inputs_sha256=inputs
    )


def add_entry(lake: Path, stage: str, key: str, *, days: float, size: int = 1000) -> None:
    made = open_stage_cache(lake).get_or_make(
        stage, key, lambda folder: (folder / "a").write_bytes(b"x" * size) and None
    )
    then = time.time() - days * 86400
    os.utime(made.folder / MANIFEST, (then, then))


def run(*arguments: object) -> str:
    done = CliRunner().invoke(app, [str(argument) for argument in arguments], env={"COLUMNS": "160"})
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    return done.stdout


@pytest.fixture
def lake(tmp_path: Path) -> Path:
    """Two runs of one campaign, the second in place of the first, and results of both and of none."""
    commit_with_keys(tmp_path, {"ingest": "old", "merge": "both"}, run_id="run-1")
    commit_with_keys(tmp_path, {"ingest": "new", "merge": "both"}, run_id="run-2", inputs="j" * 64)
    for stage, key in (("ingest", "old"), ("ingest", "new"), ("merge", "both"), ("merge", "unused")):
        add_entry(tmp_path, stage, key, days=40)
    return tmp_path


def kept(lake: Path) -> set[str]:
    return {entry.key for entry in open_stage_cache(lake).list_entries()}


def test_keys_of_replaced_runs_are_of_versions_too(lake: Path) -> None:
    runs = read_stage_keys(lake)
    assert [(one.run_id, dict(one.keys)) for one in runs] == [
        ("run-1", {"ingest": "old", "merge": "both"}), ("run-2", {"ingest": "new", "merge": "both"}),
    ]  # fmt: skip
    assert read_stage_keys(lake / "nowhere") == ()


def test_listing_counts_by_stage(lake: Path) -> None:
    listed = run("cache", "--lake", lake)
    rows = {
        row.split("│")[1].strip(): [cell.strip() for cell in row.split("│")[2:-1]]
        for row in listed.splitlines()
        if "│" in row
    }
    assert rows["ingest"][0] == "2" and rows["ingest"][-1] == "2"
    assert rows["merge"][0] == "2" and rows["merge"][-1] == "1"
    assert "40 days ago" in listed
    each = run("cache", "--all", "--lake", lake)
    assert "unused" in each and each.count("yes") == 3


@pytest.mark.parametrize("command", [["cache"], ["cache", "prune", "--older-than", "30d"]])
def test_a_folder_that_is_no_lake_is_refused(command: list[str], tmp_path: Path) -> None:
    (tmp_path / "cache" / "notes" / "of somebody").mkdir(parents=True)
    for folder in (tmp_path, tmp_path / "nowhere"):
        with pytest.raises(InputDataError, match=r"there is no lake in .*; inspect a campaign first, or name another"):
            run(*command, "--lake", folder)
    assert (tmp_path / "cache" / "notes" / "of somebody").is_dir() and not (tmp_path / "nowhere").exists()


@pytest.mark.parametrize("option", ["--lake", "--all"])
def test_options_of_the_listing_are_refused_before_a_subcommand(
    option: str, lake: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They would not count: what is pruned would be the default lake, not the one that was named."""
    monkeypatch.setenv("FACADELAKE_LAKE", str(lake))
    named = [option, str(tmp_path_factory.mktemp("another"))] if option == "--lake" else [option]
    with pytest.raises(InputDataError, match=f"{option} before 'prune' is of the listing.*facadelake cache prune"):
        run("cache", *named, "prune", "--older-than", "30d")
    assert kept(lake) == {"old", "new", "both", "unused"}


def test_results_of_an_earlier_version_are_named_as_such(lake: Path) -> None:
    """Those of schema 1 have no manifest."""
    for path in [*lake.glob(f"cache/*/*/{MANIFEST}")]:
        path.unlink()
        then = time.time() - 40 * 86400
        os.utime(path.parent, (then, then))
    listed = run("cache", "--lake", lake)
    assert "4 results, 3.9 KiB, are of an earlier Facadelake" in " ".join(listed.split()) and "is empty" not in listed
    assert "4 results of an earlier Facadelake removed" in run("cache", "prune", "--older-than", "1d", "--lake", lake)
    assert list(lake.glob("cache/*/[!.]*")) == []


@pytest.mark.parametrize("command", [["cache"], ["cache", "prune"], ["defects"], ["sql"], ["review", "list"], ["view"]])
def test_what_only_reads_a_lake_does_not_say_that_it_creates_one(command: list[str]) -> None:
    assert "created" not in run(*command, "--help") and "created" in run("inspect", "--help")


def test_the_help_of_pruning_names_what_it_removes(lake: Path) -> None:
    add_entry(lake, "draw", "pictures", days=40)
    helped = " ".join(run("cache", "prune", "--help").replace("│", " ").split())
    assert "checks and pictures of committed campaigns (the stages validate and draw) are removed" in helped
    run("cache", "prune", "--older-than", "30d", "--lake", lake)
    assert kept(lake) == {"old", "new", "both"}


def test_pruning_removes_what_no_version_was_made_of(lake: Path) -> None:
    assert "1 results" in run("cache", "prune", "--older-than", "30d", "--dry-run", "--lake", lake)
    assert kept(lake) == {"old", "new", "both", "unused"}
    told = run("cache", "prune", "--older-than", "30d", "--lake", lake)
    assert kept(lake) == {"old", "new", "both"}
    assert "1 results" in told and "removed" in told and "3 results" in told and "versions of the lake" in told


def test_pruning_by_size(lake: Path) -> None:
    add_entry(lake, "draw", "large", days=39, size=100_000)
    run("cache", "prune", "--max-size", "50 kB", "--lake", lake)
    assert kept(lake) == {"old", "new", "both"}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "nothing to prune by: give --older-than"),
        (["--older-than", "a month"], "'a month' is not a duration; write hours, days or weeks"),
        (["--max-size", "much"], "'much' is not a size; write a number and a unit"),
    ],
)
def test_limits_that_cannot_be_read(lake: Path, arguments: list[str], message: str) -> None:
    done = CliRunner().invoke(app, ["cache", "prune", *arguments, "--lake", str(lake)])
    assert message in str(done.exception)
    assert kept(lake) == {"old", "new", "both", "unused"}
