"""Pictures of wrong states: which place, which two campaigns, the earlier one on the left."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import cv2
import numpy as np
import pyarrow as pa
import pytest

from facadelake.evaluation.history import HistoryComparison, write_confusion_sheets
from facadelake.evaluation.history.evaluate import EvaluatedHistory
from facadelake.tracking import CampaignRecords, DefectArrays, Look, LookRequest, TrackedCampaign
from schemas.vocabulary import LookVerdict, TrackState
from tests.unit.evaluation.history.made_history import CAMPAIGNS, called, change, compare

DARK, LIGHT = 40, 220


def make_records(compared: HistoryComparison) -> list[CampaignRecords]:
    """Campaigns whose defects are those of the comparison, named as their true defects."""
    records = []
    for campaign in CAMPAIGNS:
        ids = [defect_id for of, defect_id in compared.defects if of == campaign]
        count = len(ids)
        arrays = DefectArrays(
            defect_id=np.array(ids, dtype=object),
            defect_class=np.zeros(count, dtype=np.int64),
            facade=np.array([""] * count, dtype=object),
            xyz_site_m=np.zeros((count, 3)),
            covariance_m2=np.zeros((count, 3, 3)),
            normal_site=np.tile([0.0, -1.0, 0.0], (count, 1)),
            width_m=np.ones(count),
            height_m=np.ones(count),
        )
        tracked = TrackedCampaign(
            campaign_id=campaign, captured_at=datetime(int(campaign), 4, 1, tzinfo=UTC), frame_sigma_m=0.01,
            defects=arrays,
        )  # fmt: skip
        records.append(
            CampaignRecords(
                run_id=campaign,
                inputs_sha256="",
                tracked=tracked,
                defect_table=pa.table({"defect_class": ["crack"] * count}),
                sizes={},
                posed={},
                root=Path(),
            )
        )
    return records


def draw_look(request: LookRequest) -> Look:
    """A look whose picture is dark in the campaign that detected the defect, and light in the other."""
    halves = [np.full((160, 160), grey, np.uint8) for grey in (DARK, LIGHT)]
    picture = np.hstack([halves[0], np.full((160, 4), 255, np.uint8), halves[1]])
    data = cv2.imencode(".jpg", picture)[1].tobytes()
    return Look(
        key=request.key, verdict=LookVerdict.UNDECIDED, photo_ids=("a.jpg", "b.jpg"), photo_counts=(1, 1), picture=data
    )


@pytest.fixture
def requested(monkeypatch: pytest.MonkeyPatch) -> list[LookRequest]:
    """The looks that are asked for; no photograph is read."""
    asked: list[LookRequest] = []

    def look(requests: Sequence[LookRequest], campaigns: Mapping[str, object], surface: object) -> list[Look]:
        asked.extend(requests)
        return [draw_look(request) for request in requests]

    monkeypatch.setattr("facadelake.evaluation.history.pictures.look_at_places", look)
    monkeypatch.setattr("facadelake.evaluation.history.pictures.Surface", lambda model: None)
    return asked


def write(folder: Path, rows: Sequence[Any]) -> list[str]:
    compared = compare(rows)
    history = SimpleNamespace(records=make_records(compared))
    evaluated = EvaluatedHistory(compared=compared, history=cast(Any, history), model=cast(Any, None))
    return [path.name for path in write_confusion_sheets(evaluated, folder, "tower")]


def test_each_kind_of_wrong_state_has_a_sheet(tmp_path: Path, requested: list[LookRequest]) -> None:
    assert write(tmp_path, called()) == []
    (tmp_path / "new-called-seen.png").write_bytes(b"of an earlier evaluation")
    rows = change(called(), "T1", "2025", state=TrackState.REPAIRED)
    rows = change(rows, "T4", "2026", state=TrackState.GROWN)
    assert write(tmp_path, rows) == ["seen-called-grown.png", "seen-called-repaired.png"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["seen-called-grown.png", "seen-called-repaired.png"]
    # T1 with its detection before; T4, hidden in 2025, with that of 2024.
    assert {request.key for request in requested} == {("2024", "D1", "2025"), ("2024", "D4", "2026")}


def test_the_earlier_campaign_is_on_the_left(tmp_path: Path, requested: list[LookRequest]) -> None:
    # D2 is detected in 2025 and in 2026: the other detection is the later one.
    write(tmp_path, change(called(), "T2", "2025", state=TrackState.FIRST_SEEN))
    assert [request.key for request in requested] == [("2026", "D2", "2025")]
    sheet = cv2.imread(str(tmp_path / "new-called-first_seen.png"))
    row = sheet[34 + 80, 8:].mean(axis=1)
    assert row[40] > 200  # 2025: looked at, light
    assert row[400] < 80  # 2026: where the defect was found, dark


def test_a_track_of_one_campaign_is_compared_with_the_campaign_before(
    tmp_path: Path, requested: list[LookRequest]
) -> None:
    rows = [row for row in called() if row.track_id != "T2" or row.campaign_id == "2025"]
    write(tmp_path, change(rows, "T2", "2025", state=TrackState.FIRST_SEEN))
    assert ("2025", "D2", "2024") in {request.key for request in requested}


def test_false_tracks_are_drawn_where_they_are_called_repaired(tmp_path: Path, requested: list[LookRequest]) -> None:
    false = replace(called()[0], track_id="T9", defect_id=None, state=TrackState.NOT_FOUND)
    assert write(tmp_path, [*called(), false]) == []
    assert write(tmp_path, [*called(), replace(false, state=TrackState.REPAIRED)]) == ["no_defect-called-repaired.png"]
