"""A campaign is tracked anew where another process has committed one of the building meanwhile."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest

from facadelake.core.errors import HistoryOutdatedError
from flows import inspect_building

NOTHING: Any = None
JOB: Any = SimpleNamespace(building=SimpleNamespace(id="tower"))
OUTDATED = HistoryOutdatedError(
    "the lake has other campaigns or tracks of tower than when it was tracked: another process has committed "
    "meanwhile; nothing was written, run again"
)


@pytest.fixture
def numbers(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """Stages that do nothing; the history is the number of the attempt."""
    attempts = iter(range(1, 10))
    monkeypatch.setattr(inspect_building, "track", lambda *_: SimpleNamespace(stage=next(attempts)))
    monkeypatch.setattr(inspect_building, "validate_tables", lambda job, results, stage: stage)
    return attempts


def test_the_history_is_made_anew_and_it_is_told(
    numbers: Iterator[int], monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def commit(job: Any, results: Any, tracked: Any, checks: int) -> str:
        if checks < 3:
            raise OUTDATED
        return "committed"

    monkeypatch.setattr(inspect_building, "commit", commit)
    with caplog.at_level(logging.WARNING):
        tracked, checks, committed = inspect_building._commit_tracked(JOB, NOTHING)
    assert (tracked.stage, checks, committed) == (3, 3, "committed")
    assert [record.getMessage() for record in caplog.records] == 2 * [
        "another process has committed campaigns or tracks of tower meanwhile; tracking again"
    ]


def test_a_third_failure_ends_the_inspection(numbers: Iterator[int], monkeypatch: pytest.MonkeyPatch) -> None:
    def commit(*_: Any) -> None:
        raise OUTDATED

    monkeypatch.setattr(inspect_building, "commit", commit)
    with pytest.raises(HistoryOutdatedError):
        inspect_building._commit_tracked(JOB, NOTHING)
    assert next(numbers) == 4
