"""Lists of defects in the terminal."""

from io import StringIO
from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest
from rich.console import Console

from cli.terminal import listings
from cli.terminal.listings import read_exported, show_defects
from facadelake.core.errors import InputDataError
from tests.sql.small_history import FIRST, SECOND, commit_history
from tests.unit.lake.small_campaign import BUILDING, commit


@pytest.mark.parametrize(
    ("known", "told"),
    [
        ({"crack_width_mm": 0.44, "crack_width_limit_mm": 0.2, "crack_width_outcome": "measured"}, "0.4"),
        ({"crack_width_mm": 24.5, "crack_width_sigma_mm": 9.0, "crack_width_outcome": "measured"}, "24.5 ± 9.0"),
        ({"crack_width_mm": None, "crack_width_limit_mm": 3.21, "crack_width_outcome": "below_limit"}, "< 3.2"),
        ({"crack_width_mm": None, "crack_width_limit_mm": 3.21, "crack_width_outcome": "no_line"}, ""),
    ],
)
def test_a_cracks_width_or_its_bound_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, known: dict[str, Any], told: str
) -> None:
    commit(tmp_path, defects=1)
    table = listings.read_table(tmp_path, "defects", building_id=BUILDING)
    rows = [{**row, "defect_class": "crack", **known} for row in table.to_pylist()]
    changed = pa.Table.from_pylist(rows, schema=table.schema)
    monkeypatch.setattr(listings, "read_table", lambda *_, **__: changed)
    console = Console(file=StringIO(), width=200)
    show_defects(console, tmp_path, tmp_path, BUILDING, None, None, 10, None)
    assert isinstance(console.file, StringIO)
    head, line = (line for line in console.file.getvalue().splitlines() if "crack" in line)
    column = [cell.strip() for cell in head.strip("\u2503").split("\u2503")].index("crack mm")
    assert line.strip("\u2502").split("\u2502")[column].strip() == told


def test_an_export_says_where_the_rows_of_a_table_of_the_history_are(tmp_path: Path) -> None:
    versions = commit_history(tmp_path)
    with pytest.raises(InputDataError) as raised:
        read_exported(tmp_path, "tracks", BUILDING, FIRST, None)
    assert str(raised.value) == (
        "table tracks is of the whole history of a building, and is filed with its latest campaign (2026-04); leave "
        "out --campaign, or export track_states, which has what campaign 'z-2025' says of each track"
    )
    assert len(read_exported(tmp_path, "tracks", BUILDING, None, None)) == 8
    assert len(read_exported(tmp_path, "track_states", BUILDING, FIRST, None)) == 4
    with pytest.raises(InputDataError) as raised:
        read_exported(tmp_path, "looks", BUILDING, FIRST, None)
    assert str(raised.value) == (
        f"the lake {tmp_path} has no rows of 'looks' for building 'tower', campaign 'z-2025'; it has some of {SECOND}"
    )
    with pytest.raises(
        InputDataError, match=r"no rows of 'tracks' for building 'tower'.*'facadelake track tower' makes"
    ):
        read_exported(tmp_path, "tracks", BUILDING, None, versions[SECOND])
