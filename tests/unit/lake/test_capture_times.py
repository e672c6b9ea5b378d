"""When the photographs of observations and defects were taken, and the path of a defect's best photograph."""

from __future__ import annotations

from datetime import UTC, datetime

from facadelake.lake.campaign_tables import add_capture_times
from tests.unit.lake.small_campaign import stage_tables

TIMES = [datetime(2026, 4, 14, 8, 20, second, tzinfo=UTC) for second in (4, 8, 12)]


def test_times_are_those_of_the_photographs_and_null_without_a_clock() -> None:
    tables = stage_tables()
    photos = tables["photos"].to_pylist()
    names = [row["photo_id"] for row in photos]
    times = [TIMES[k % 3] if k else None for k in range(len(names))]  # the first photograph's clock was not set
    index = tables["photos"].column_names.index("taken_at")
    field = tables["photos"].schema.field(index)
    tables["photos"] = tables["photos"].set_column(index, field, [times])
    taken_at = dict(zip(names, times, strict=True))
    found = add_capture_times("/data/hall/2026-04", tables)
    observations, defects = found["observations"].to_pylist(), found["defects"].to_pylist()
    assert [row["captured_at"] for row in observations] == [taken_at[row["photo_id"]] for row in observations]
    for defect in defects:
        seen = [taken_at[row["photo_id"]] for row in observations if row["defect_id"] == defect["defect_id"]]
        known = [time for time in seen if time is not None]
        assert defect["captured_from"] == min(known, default=None)
        assert defect["captured_to"] == max(known, default=None)
        assert defect["best_photo_uri"] == f"/data/hall/2026-04/{defect['best_photo_id']}"
    assert {row["captured_at"] for row in observations} - {None}
