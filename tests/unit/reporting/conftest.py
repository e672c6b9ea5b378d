from __future__ import annotations

import pytest

from tests.unit.reporting.painted_wall import PaintedWall, make_painted_wall


@pytest.fixture(scope="session")
def painted(tmp_path_factory: pytest.TempPathFactory) -> PaintedWall:
    return make_painted_wall(tmp_path_factory.mktemp("photographs"))
