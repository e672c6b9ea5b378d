"""A lake with the small campaign in it, made once and copied: a commit takes a second, a copy none."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from facadelake.lake.commit import CommitResult
from tests.unit.lake.small_campaign import commit


@pytest.fixture(scope="session")
def template(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, CommitResult]:
    """The lake to copy."""
    folder = tmp_path_factory.mktemp("template")
    return folder, commit(folder)


@pytest.fixture
def first(tmp_path: Path, template: tuple[Path, CommitResult]) -> CommitResult:
    """The first commit of the lake that is in ``tmp_path``."""
    folder, committed = template
    shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
    return committed
