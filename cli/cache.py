"""Commands of the stage cache: what it holds, and removing what no version of the lake was made of."""

from __future__ import annotations

import re
import time
from typing import TYPE_CHECKING, Annotated

import typer

from cli.options import DEFAULT_LAKE, ExistingLakePath, console, require_lake
from facadelake.core.errors import InputDataError

if TYPE_CHECKING:
    from collections.abc import Iterable

    from facadelake.core.cache import CacheEntry

cache = typer.Typer(
    help="The results of finished stages: list them, remove those that are not needed.",
    invoke_without_command=True,
    rich_markup_mode="rich",
)

_SECONDS = {"h": 3600.0, "d": 86400.0, "w": 7 * 86400.0}
_DURATION = re.compile(r"(\d+(?:\.\d+)?)\s*([hdw])")


@cache.callback()
def list_entries(
    context: typer.Context,
    lake: ExistingLakePath = DEFAULT_LAKE,
    every: Annotated[bool, typer.Option("--all", help="One line an entry, not one a stage.")] = False,
) -> None:
    """List the cached results by stage: how many, how large, when last used, how many a version was made of.

    A run whose inputs and code are unchanged is answered from the cache. Removing an entry loses nothing that is
    committed: the stage runs again when it is needed.
    """
    if context.invoked_subcommand is None:
        _show(lake, every)
        return
    for name, option in (("lake", "--lake"), ("every", "--all")):
        source = context.get_parameter_source(name)
        if source is not None and source.name == "COMMANDLINE":
            subcommand = f"facadelake cache {context.invoked_subcommand}"
            raise InputDataError(
                f"{option} before '{context.invoked_subcommand}' is of the listing, and would not count; "
                + (f"write {subcommand} --lake {lake}" if option == "--lake" else f"leave it out: {subcommand}")
            )


@cache.command()
def prune(
    older_than: Annotated[
        str | None, typer.Option(help="Remove results not used for this long, such as 12h, 30d or 8w.")
    ] = None,
    max_size: Annotated[
        str | None,
        typer.Option(help="Remove the longest unused until the cache is not larger, such as 20GB or 500MiB."),
    ] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Show what would be removed, and remove nothing.")] = False,
    lake: ExistingLakePath = DEFAULT_LAKE,
) -> None:
    """Remove cached results that the tables of no version of the lake were made of.

    Results that a version's tables were made of stay, so that inspecting its campaign again is quick; so do results
    used within the last day, which a run may be reading. The checks and pictures of committed campaigns (the stages
    validate and draw) are removed like others, and results of an earlier Facadelake, which are never used.
    Example: facadelake cache prune --older-than 30d --max-size 20GB
    """
    from facadelake.core.cache import open_stage_cache
    from facadelake.lake import read_stage_keys

    if older_than is None and max_size is None:
        raise InputDataError("nothing to prune by: give --older-than (such as 30d), --max-size (such as 20GB), or both")
    require_lake(lake)
    needed = {key for run in read_stage_keys(lake) for key in run.keys.values()}
    pruned = open_stage_cache(lake).prune(
        needed=needed,
        older_than_s=None if older_than is None else _parse_duration(older_than),
        max_size_bytes=None if max_size is None else _parse_size(max_size),
        dry_run=dry_run,
    )
    verb = "would be removed" if dry_run else "removed"
    console.print(f"{_count(pruned.removed)} {verb}")
    if pruned.leftovers:
        console.print(f"{len(pruned.leftovers)} folders of interrupted runs {verb}")
    if pruned.unrecorded:
        console.print(f"{len(pruned.unrecorded)} results of an earlier Facadelake {verb}")
    if pruned.needed:
        console.print(f"{_count(pruned.needed)} kept: versions of the lake were made of them")
    if pruned.in_use:
        console.print(f"{_count(pruned.in_use)} kept: used within the last day, or by a run")


def _show(lake: object, every: bool) -> None:
    from pathlib import Path

    from rich.table import Table

    from facadelake.core.cache import compute_size_bytes, open_stage_cache
    from facadelake.lake import read_stage_keys

    assert isinstance(lake, Path)
    require_lake(lake)
    entries = open_stage_cache(lake).list_entries()
    unrecorded = open_stage_cache(lake).find_unrecorded()
    if unrecorded:
        size = _format_size(sum(compute_size_bytes(folder) for folder in unrecorded))
        console.print(
            f"{len(unrecorded)} results, {size}, are of an earlier Facadelake (they have no manifest) and are not "
            "used; facadelake cache prune --older-than 1d removes them"
        )
    elif not entries:
        console.print(f"the cache of the lake {lake} is empty")
    if not entries:
        return
    needed = {key for run in read_stage_keys(lake) for key in run.keys.values()}
    table = Table(title=f"Cached results of {lake}: {_count(entries)}")
    if every:
        for name in ("stage", "key", "size", "last used", "of a version"):
            table.add_column(name, justify="right" if name == "size" else "left")
        for entry in entries:
            size, used = _format_size(entry.size_bytes), _format_age(entry.used_at_s)
            table.add_row(entry.stage, entry.key, size, used, "yes" if entry.key in needed else "")
    else:
        for name in ("stage", "results", "size", "last used", "of a version"):
            table.add_column(name, justify="left" if name in ("stage", "last used") else "right")
        for stage in sorted({entry.stage for entry in entries}):
            of_stage = [entry for entry in entries if entry.stage == stage]
            size = _format_size(sum(entry.size_bytes for entry in of_stage))
            used = _format_age(max(entry.used_at_s for entry in of_stage))
            count = sum(entry.key in needed for entry in of_stage)
            table.add_row(stage, str(len(of_stage)), size, used, str(count))
    console.print(table)


def _parse_duration(text: str) -> float:
    found = _DURATION.fullmatch(text.strip())
    if found is None:
        raise InputDataError(
            f"--older-than '{text}' is not a duration; write hours, days or weeks, such as 12h, 30d, 8w"
        )
    return float(found[1]) * _SECONDS[found[2]]


def _parse_size(text: str) -> int:
    from pydantic import ByteSize, TypeAdapter, ValidationError

    try:
        return int(TypeAdapter(ByteSize).validate_python(text))
    except ValidationError as error:
        raise InputDataError(f"--max-size '{text}' is not a size; write a number and a unit, such as 20GB") from error


def _count(entries: Iterable[CacheEntry]) -> str:
    found = list(entries)
    return f"{len(found)} results, {_format_size(sum(entry.size_bytes for entry in found))}"


def _format_size(size_bytes: int) -> str:
    from pydantic import ByteSize

    return ByteSize(size_bytes).human_readable(separator=" ")


def _format_age(used_at_s: float) -> str:
    age_s = max(0.0, time.time() - used_at_s)
    if age_s < 2 * _SECONDS["h"]:
        return f"{age_s / 60:.0f} min ago"
    return f"{age_s / 3600:.0f} h ago" if age_s < 2 * _SECONDS["d"] else f"{age_s / 86400:.0f} days ago"
