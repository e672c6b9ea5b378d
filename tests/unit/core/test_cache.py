"""A cache entry is intact or computed again; pruning removes what nothing needs."""

import json
import logging
import os
import shutil
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from facadelake.core.cache import DIAGNOSTICS, IN_USE_S, MANIFEST, CachedResult, StageCache


def make_two_files(folder: Path) -> None:
    (folder / "rows").mkdir()
    (folder / "rows" / "a.parquet").write_bytes(b"0123456789")
    (folder / "b.json").write_text("{}")


@pytest.fixture
def cache(tmp_path: Path) -> StageCache:
    return StageCache(root=tmp_path / "cache")


def entry(cache: StageCache, key: str = "k1", stage: str = "merge") -> CachedResult:
    return cache.get_or_make(stage, key, make_two_files)


def age(cached: CachedResult, days: float) -> None:
    then = time.time() - days * 86400
    os.utime(cached.folder / MANIFEST, (then, then))


def test_an_entry_is_made_once_and_records_the_hash_of_its_contents(cache: StageCache) -> None:
    first = entry(cache)
    again = cache.get_or_make("merge", "k1", lambda folder: pytest.fail("it is there"))
    assert (first.hit, again.hit) == (False, True)
    assert first.content_sha256 == again.content_sha256 == entry(cache, "k2").content_sha256


def test_diagnostics_are_checked_but_no_part_of_the_content(cache: StageCache) -> None:
    def with_log(folder: Path) -> None:
        make_two_files(folder)
        (folder / DIAGNOSTICS).mkdir()
        (folder / DIAGNOSTICS / "worker.log").write_text(f"process {os.getpid()}")

    logged = cache.get_or_make("merge", "k2", with_log)
    assert logged.content_sha256 == entry(cache).content_sha256
    (logged.folder / DIAGNOSTICS / "worker.log").write_text("another")
    assert not cache.get_or_make("merge", "k2", with_log).hit


def edit_manifest(**values: object) -> Callable[[Path], object]:
    def edit(folder: Path) -> None:
        manifest = json.loads((folder / MANIFEST).read_text())
        (folder / MANIFEST).write_text(json.dumps(manifest | values))

    return edit


def replace_by_another_entry(folder: Path) -> None:
    """Intact in itself, and the result of something else."""
    StageCache(root=folder.parents[1]).get_or_make("merge", "k2", lambda other: (other / "c").write_text("c") and None)
    shutil.rmtree(folder)
    shutil.copytree(folder.with_name("k2"), folder)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda folder: (folder / "rows" / "a.parquet").write_bytes(b"01234"), "has 5 bytes, 10 were written"),
        (lambda folder: (folder / "rows" / "a.parquet").write_bytes(b"0123456780"), "rows/a.parquet was changed"),
        (lambda folder: (folder / "b.json").unlink(), "missing: b.json"),
        (lambda folder: (folder / "c.json").write_text("{}"), "added: c.json"),
        (lambda folder: (folder / MANIFEST).write_text('{"files": {"b.js'), f"no readable {MANIFEST}"),
        (lambda folder: (folder / MANIFEST).unlink(), f"no readable {MANIFEST}"),
        (lambda folder: (folder / MANIFEST).write_bytes(b"\xff\xfe\x00"), f"no readable {MANIFEST}"),
        (lambda folder: (folder / MANIFEST).write_text("[]"), f"no readable {MANIFEST}"),
        (edit_manifest(files=[]), f"no readable {MANIFEST}"),
        (edit_manifest(files=None), f"no readable {MANIFEST}"),
        (edit_manifest(files={"b.json": None}), f"no readable {MANIFEST}"),
        (edit_manifest(files={"b.json": [2]}), f"no readable {MANIFEST}"),
        (edit_manifest(content_sha256=None), f"no readable {MANIFEST}"),
        (edit_manifest(content_sha256="0" * 64), f"the content_sha256 of {MANIFEST} is not that of its files"),
        (edit_manifest(key="k2"), "it is the result merge/k2"),
        (edit_manifest(stage="draw"), "it is the result draw/k1"),
        (replace_by_another_entry, "it is the result merge/k2"),
        (lambda folder: (shutil.rmtree(folder), folder.write_text("")), f"no readable {MANIFEST}"),
        (lambda folder: (shutil.rmtree(folder), folder.symlink_to("nowhere")), f"no readable {MANIFEST}"),
    ],
)
def test_damage_is_reported_and_the_entry_computed_again(
    cache: StageCache, damage: object, message: str, caplog: pytest.LogCaptureFixture
) -> None:
    first = entry(cache)
    damage(first.folder)  # type: ignore[operator]
    with caplog.at_level(logging.WARNING):
        again = entry(cache)
    assert not again.hit and message in caplog.text and "computed again" in caplog.text
    assert (again.folder / "rows" / "a.parquet").read_bytes() == b"0123456789"
    assert again.content_sha256 == first.content_sha256
    assert entry(cache).hit


def test_a_killed_run_leaves_nothing_that_counts(cache: StageCache) -> None:
    def half(folder: Path) -> None:
        (folder / "b.json").write_text("{")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        cache.get_or_make("merge", "k1", half)
    assert cache.list_entries() == ()
    part = cache.root / "merge" / ".k1.0a1b2c3d.part"  # what a kill -9 leaves
    part.mkdir()
    assert cache.find_leftovers() == (part,)
    assert not entry(cache).hit and not part.exists()


def test_entries_are_listed_with_size_and_last_use(cache: StageCache) -> None:
    old, new = entry(cache, "old"), entry(cache, "new", "draw")
    age(old, 3)
    listed = {one.key: one for one in cache.list_entries()}
    assert listed.keys() == {"old", "new"} and listed["new"].stage == "draw"
    manifest_bytes = (new.folder / MANIFEST).stat().st_size
    assert listed["new"].size_bytes == 12 + manifest_bytes
    assert 2.99 < (time.time() - listed["old"].used_at_s) / 86400 < 3.01  # days
    assert entry(cache, "old").hit  # a hit is a use
    assert time.time() - next(one for one in cache.list_entries() if one.key == "old").used_at_s < 60  # s


def test_pruning_by_age_keeps_what_is_needed_and_what_may_be_in_use(cache: StageCache) -> None:
    for key, days in (("gone", 40), ("needed", 40), ("young", 10), ("now", 0)):
        age(entry(cache, key), days)
    would = cache.prune(needed={"needed"}, older_than_s=30 * 86400, dry_run=True)
    assert [one.key for one in would.removed] == ["gone"] and len(cache.list_entries()) == 4
    pruned = cache.prune(needed={"needed"}, older_than_s=30 * 86400)
    assert [one.key for one in pruned.removed] == ["gone"] and [one.key for one in pruned.needed] == ["needed"]
    assert {one.key for one in cache.list_entries()} == {"needed", "young", "now"}
    assert [one.key for one in cache.prune(needed=set(), older_than_s=0).in_use] == ["now"]


def test_pruning_by_size_begins_with_the_longest_unused(cache: StageCache) -> None:
    for key, days in (("first", 9), ("second", 8), ("third", 7)):
        age(entry(cache, key), days)
    size = cache.list_entries()[0].size_bytes
    pruned = cache.prune(needed={"first"}, max_size_bytes=int(size * 2.1))
    assert [one.key for one in pruned.removed] == ["second"] and [one.key for one in pruned.needed] == ["first"]
    assert cache.prune(needed=set(), max_size_bytes=10**9).removed == ()


def test_an_entry_that_a_run_has_locked_stays(cache: StageCache) -> None:
    from filelock import FileLock

    made = entry(cache)
    age(made, 99)
    with FileLock(made.folder.parent / ".k1.lock"):
        assert [one.key for one in cache.prune(needed=set(), older_than_s=IN_USE_S).in_use] == ["k1"]
    assert made.folder.is_dir()


def test_a_manifest_names_every_file(cache: StageCache) -> None:
    made = entry(cache)
    manifest = json.loads((made.folder / MANIFEST).read_text())
    assert manifest["stage"] == "merge" and set(manifest["files"]) == {"b.json", "rows/a.parquet"}
