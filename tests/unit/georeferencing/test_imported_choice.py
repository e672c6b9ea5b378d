"""Which poses an inspection imports: those asked for, the portfolio's, or none."""

from __future__ import annotations

from pathlib import Path

import pytest

from facadelake.campaigns.preflight import choose_poses
from facadelake.core.errors import InputDataError
from facadelake.registry import Building, read_portfolio

REGISTRY = """
buildings:
  - id: hall
    name: Hall
    model: hall.ifc
    photographs: "{campaign}/images"
    poses: "{campaign}/poses.csv"
    detector: {kind: coco, file: boxes.json}
"""


@pytest.fixture
def hall(tmp_path: Path) -> Building:
    (tmp_path / "portfolio.yaml").write_text(REGISTRY)
    (tmp_path / "2026-04").mkdir()
    (tmp_path / "2026-04" / "poses.csv").write_text("image\n")
    return read_portfolio(tmp_path / "portfolio.yaml").get_building("hall")


def test_the_registrys_unless_a_control_is_named(hall: Building, tmp_path: Path) -> None:
    own = tmp_path / "2026-04" / "poses.csv"
    assert choose_poses(hall, "2026-04", "auto", None) == own
    assert choose_poses(hall, "2026-04", "gcp", None) is None
    other = tmp_path / "other.csv"
    other.write_text("image\n")
    assert choose_poses(hall, "2026-04", "auto", str(other)) == other


def test_poses_that_are_not_there_or_contradict(hall: Building, tmp_path: Path) -> None:
    with pytest.raises(InputDataError, match=r"2026-10/poses\.csv.*do not exist.*--georeference"):
        choose_poses(hall, "2026-10", "auto", None)
    with pytest.raises(InputDataError, match="contradict"):
        choose_poses(hall, "2026-04", "gcp", "other.csv")
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputDataError, match="no poses at"):
        choose_poses(hall, "2026-04", "auto", str(tmp_path / "empty"))
