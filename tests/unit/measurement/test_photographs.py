"""A table of detections and photographs on disk: which cracks get which columns."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import shapely

from benchmarks.drawn_cracks import draw_crack
from facadelake.core.progress import listen_to_progress
from facadelake.core.tables import table_from_rows
from facadelake.measurement.campaign import measure_detections

NUMBERS = ("crack_width_px", "crack_width_max_px", "crack_width_sigma_px", "crack_width_limit_px", "crack_length_px")


class Bar:
    """Counts the steps of the last piece of work."""

    total, done = 0, 0

    def begin(self, label: str, total: int | None) -> int:
        self.total, self.done = total or 0, 0
        return 0

    def advance(self, handle: int, steps: int) -> None:
        self.done += steps

    def end(self, handle: int) -> None:
        pass


def rows_of(root: Path, *given: dict[str, Any]) -> list[dict[str, Any]]:
    crack = draw_crack(np.random.default_rng(11), 4.0)
    cv2.imwrite(str(root / "wall.png"), crack.image)
    (root / "broken.jpg").write_bytes(b"no picture")
    left, top, width, height = crack.box_px
    usual = {
        "photo_id": "wall.png", "detection_outcome": "accepted", "defect_class": "crack", "source_class": "crack",
        "score": 1.0, "box_x_px": left, "box_y_px": top, "box_width_px": width, "box_height_px": height,
        "detector": "coco:x", "detector_sha256": "0",
    }  # fmt: skip
    table = table_from_rows("detections", [{"detection_id": f"d{i}", **usual, **one} for i, one in enumerate(given)])
    bar = Bar()
    with listen_to_progress(bar):
        rows: list[dict[str, Any]] = measure_detections(table, root).to_pylist()
    assert bar.done == bar.total > 0
    return rows


def test_each_accepted_crack_has_an_outcome_and_no_other_row_has(tmp_path: Path) -> None:
    rows = rows_of(
        tmp_path, {}, {"crack_width_px": 3.5}, {"photo_id": "broken.jpg"}, {"defect_class": "spalling"},
        {"detection_outcome": "bad_box"}, {"box_x_px": 5.0, "box_y_px": 5.0, "box_width_px": 3.0, "box_height_px": 3.0},
        {"photo_id": "broken.jpg", "crack_width_px": 2.0},
    )  # fmt: skip
    outcomes = [row["crack_width_outcome"] for row in rows]
    assert outcomes == ["measured", "stated", "not_readable", None, None, "no_line", "stated"]
    assert rows[0]["crack_width_px"] == pytest.approx(4.0, rel=0, abs=0.3)  # px
    assert all(rows[0][name] > 0 for name in NUMBERS)
    assert rows[0]["crack_width_px"] < rows[0]["crack_width_max_px"] < 8.0  # px
    line = shapely.from_wkt(rows[0]["crack_line"])
    assert line.length == pytest.approx(rows[0]["crack_length_px"], rel=0.03)
    assert line.within(shapely.box(0, 0, 400, 400))
    assert rows[1]["crack_width_px"] == 3.5  # a stated width is kept
    assert rows[1]["crack_width_sigma_px"] is None
    assert rows[1]["crack_length_px"] == pytest.approx(rows[0]["crack_length_px"], rel=0, abs=1e-9)
    assert all(row[name] is None for row in rows[2:6] for name in NUMBERS)


def test_a_photograph_that_exif_would_turn_is_measured_as_it_is_stored(tmp_path: Path) -> None:
    (plain,) = rows_of(tmp_path, {})
    image = cv2.imread(str(tmp_path / "wall.png"))
    header = bytes.fromhex("ffe1002245786966000049492a0008000000010012010300010000000600000000000000")
    stored = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 97])[1].tobytes()
    (tmp_path / "turned.jpg").write_bytes(stored[:2] + header + stored[2:])
    assert cv2.imread(str(tmp_path / "turned.jpg")).shape == image.transpose(1, 0, 2).shape
    (turned,) = rows_of(tmp_path, {"photo_id": "turned.jpg"})
    assert turned["crack_width_px"] == pytest.approx(plain["crack_width_px"], rel=0, abs=0.2)  # px
