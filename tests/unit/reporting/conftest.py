from __future__ import annotations

import pytest

from tests.unit.reporting.painted_wall import Painted, painted_wall


@pytest.fixture(scope="session")
def painted(tmp_path_factory: pytest.TempPathFactory) -> Painted:
    return painted_wall(tmp_path_factory.mktemp("photographs"))
